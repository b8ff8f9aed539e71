"""One board built in full, from Amaranth to a bitstream; the result is kept by content."""

import json
import stat
from dataclasses import asdict, replace
from pathlib import Path
from typing import ClassVar

import pytest

import boards.build
from boards import program, table
from boards.build import TRIES, UNITS, Result, _crossings, _digest, _plain, build, check, folder, summary
from boards.catalogue import BOARDS
from boards.dfu import suffixed
from boards.errors import BoardError

BOARD = BOARDS["ulx3s-12f"]


def test_a_board_is_built_in_full():
    result = build(BOARD)
    place = folder(BOARD, None)
    report = json.loads((place / "report.json").read_text())
    assert result.used["TRELLIS_COMB"] == report["utilization"]["TRELLIS_COMB"]["used"]
    assert 1000 < result.used["TRELLIS_COMB"] < result.available["TRELLIS_COMB"]
    assert result.used["EHXPLLL"] == 1
    bits = (place / UNITS["ecp5"].bitstream).read_bytes()
    assert bits[:2] == b"\xff\x00", "not a Lattice bitstream"
    assert b"LFE5U-12F" in bits[:200]
    # The PLL makes of 25 MHz what the board's file says, by nextpnr's own reckoning.
    assert result.wanted_mhz == pytest.approx({"sync": BOARD.sync_hz / 1e6}, rel=1e-3)
    check(BOARD, result)
    assert build(BOARD) == result
    assert summary(BOARD, result).startswith("ulx3s-12f: ")


def test_a_clock_that_is_too_slow_fails_in_one_sentence():
    result = Result("", 1.0, {}, {}, {"sync": 51.24, "camera": 80.0}, {"sync": 60.0, "camera": 50.0})
    with pytest.raises(
        BoardError,
        match=r"ulx3s-12f does not meet its timing with .*: sync reaches 51\.2 of 60 MHz; report",
    ):
        check(BOARD, result)


@pytest.mark.parametrize(("enough", "seeds"), [(1, [1]), (3, [1, 2, 3]), (9, [1, 2, 3, 4, 5])])
def test_a_placement_that_is_too_slow_begins_anew(tmp_path: Path, monkeypatch, enough: int, seeds: list[int]):
    """The tools are not run: from seed ``enough`` on the clock is met."""
    tried = []

    class Plan:
        files: ClassVar[dict[str, str]] = {"top.il": "module"}

        def extract(self, place: Path) -> None:
            pass

    def plan(board, link, source, serial, seed=None):
        tried.append(seed)
        return Plan()

    def read(place: Path, digest: str, seconds: float, seed: int) -> Result:
        return Result(digest, seconds, {}, {}, {"sync": 61.0 if seed >= enough else 59.0}, {"sync": 60.0}, {}, seed)

    for name, replacement in (("BUILD", tmp_path), ("plan", plan), ("_run", lambda *_, **__: None), ("_read", read)):
        monkeypatch.setattr(boards.build, name, replacement)
    result = build(BOARD)
    assert tried == [None, *seeds]
    assert result.seed == seeds[-1]
    assert bool(result.missed) == (enough > TRIES)
    assert build(BOARD) == result
    assert tried[len(seeds) + 1 :] == [None]


def test_a_digest_is_of_names_and_contents_but_of_no_address():
    netlist = {"top.il": "cell \\USBStreamInEndpoint_139763209382288", "top.ys": b"read"}
    digest = _digest(netlist)
    assert digest == _digest({**netlist, "top.il": "cell \\USBStreamInEndpoint_140271529683472"})
    assert digest != _digest({**netlist, "top.il": "cell \\USBStreamOutEndpoint_139763209382288"})
    assert digest != _digest({"top.il": netlist["top.il"], "top.ysread": b""})


def test_what_crosses_too_slowly_fails_too():
    """Seven nanoseconds are in time for a clock of 60 MHz, and not for one of 150; usb is no clock of pixels."""
    parts = [{"delay": 1.5}, {"delay": 5.5}]
    names = {"sync": "posedge $glbnet$clk", "pixel": "posedge $glbnet$card.core.pixels.pixel_clk", "usb": "posedge usb"}
    ways = [("sync", "pixel"), ("pixel", "sync"), ("sync", "sync"), ("sync", "usb")]
    paths = [{"from": names[start], "to": names[end], "path": parts} for start, end in ways]
    crossing_ns = _crossings([*paths, {"from": "<async>", "to": names["pixel"], "path": parts}])
    assert crossing_ns == {"sync to pixel": 7.0, "pixel to sync": 7.0}
    mhz = {"sync": 60.0, "pixel": 150.0}
    with pytest.raises(BoardError, match=r": sync to pixel takes 7\.0 of 6\.7 ns; report"):
        check(BOARD, Result("", 1.0, {}, {}, mhz, mhz, crossing_ns))
    check(BOARD, Result("", 1.0, {}, {}, mhz, mhz, {"pixel to sync": 7.0}))


@pytest.mark.parametrize(
    ("net", "name"),
    [
        ("$glbnet$clk", "sync"),
        ("$glbnet$usb_io_clk", "usb_io"),
        ("$glbnet$clk_sync", "sync"),
        ("$glbnet$card.core.pixels.pixel_clk", "pixel"),
        ("card.camera_clk_$glb_clk", "camera"),
    ],
)
def test_clocks_have_plain_names(net, name):
    assert _plain(net) == name


def test_a_loader_that_fails_is_told_in_one_sentence(tmp_path: Path, monkeypatch):
    for module in ("program", "build"):
        monkeypatch.setattr(f"boards.{module}.folder", lambda board, link, source: tmp_path)
    with pytest.raises(BoardError, match="has no link 'film'"):
        program.program(BOARD, "film")
    with pytest.raises(BoardError, match="run 'make bitstream' first"):
        program.program(BOARD, None)
    (tmp_path / "top.bit").write_bytes(b"bits")
    slow = Result("", 1.0, {}, {}, {"sync": 59.0}, {"sync": 60.0})
    (tmp_path / "result.json").write_text(json.dumps(asdict(slow)))
    with pytest.raises(BoardError, match="does not meet its timing"):
        program.program(BOARD, None)
    (tmp_path / "result.json").write_text(json.dumps(asdict(replace(slow, mhz={"sync": 61.0}))))
    loader = tmp_path / "loader"
    cases = (
        ('echo "$@"; exit 0', None),
        ("exit 1", "ulx3s-12f was not programmed: is it plugged in"),
        ("echo error while loading shared libraries: libusb; exit 127", "needs libraries of the system: libusb-1.0"),
    )
    for script, text in cases:
        loader.write_text(f"#!/bin/sh\n{script}\n")
        loader.chmod(loader.stat().st_mode | stat.S_IXUSR)
        if text is None:
            program.program(BOARD, None, loader=loader)
        else:
            with pytest.raises(BoardError, match=text):
                program.program(BOARD, None, loader=loader)


def test_the_dfu_suffix_is_that_of_the_standard():
    """By hand: of nothing at all, device 1209:5af0."""
    data = suffixed(b"", 0x1209, 0x5AF0)
    assert data[:12] == bytes.fromhex("ffff f05a 0912 0001 554644 10".replace(" ", ""))
    assert len(data) == 16
    crc = 0xFFFFFFFF
    for byte in data[:12]:
        crc ^= byte
        for _ in range(8):
            crc = crc >> 1 ^ (0xEDB88320 if crc & 1 else 0)
    assert int.from_bytes(data[12:], "little") == crc


def test_the_table_replaces_the_last(tmp_path: Path):
    page = tmp_path / "page.md"
    page.write_text(f"before\n{table.BEGIN}\nold\n{table.END}\nafter\n")
    used = {"TRELLIS_COMB": 5, "DP16KD": 6, "MULT18X18D": 7}
    line = table.line(
        BOARD, "uart", Result("", 61.4, used, dict.fromkeys(used, 100), {"sync": 77.2}, {"sync": 60.0024}, {}, 3)
    )
    assert line == "| `ulx3s-12f` | uart | sync 77 (60) | 3 | 5 of 100 | 6 of 100 | 7 of 100 | 61 |"
    table.insert([line], page)
    assert (
        page.read_text()
        == f"before\n{table.BEGIN}\n{table.HEAD}\n|---|---|---|---:|---:|---:|---:|---:|\n{line}\n{table.END}\nafter\n"
    )
