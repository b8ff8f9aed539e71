"""``magtrak self-test`` against the virtual card in pattern mode: it passes, leaves no trace, and sees faults."""

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from magtrak import protocol
from magtrak.card import Card
from magtrak.errors import CardError
from magtrak.link import Link
from magtrak.protocol import Access, Packet, PacketType, RowForm, register
from magtrak.selftest import angle, counters, laser, link, pattern, registers, tables
from magtrak.selftest.bench import CLOSED, OPEN, Bench, FailedError, NotTriedError, Options
from magtrak.selftest.run import CHECKS, Result, examine
from tests.support.virtual import run, virtual_card

Change = Callable[[Packet], Packet | None]


@pytest.fixture(scope="module")
def port(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """One card for all tests here: each leaves it as it was, which is a part of what they test."""
    path = tmp_path_factory.mktemp("selftest") / "card"
    with virtual_card(path, "--pattern", "--pace", "real"):
        yield path


@pytest.fixture
def card(port: Path) -> Iterator[Card]:
    with Link(str(port)) as opened:
        yield Card(opened)


def tamper(card: Card, change: Change) -> None:
    """Something between card and host that changes packets, or takes them away."""
    receive = card.link.receive

    def changed(timeout_s: float) -> Packet | None:
        packet = receive(timeout_s)
        return None if packet is None else change(packet)

    card.link.receive = changed  # type: ignore[method-assign]


def settings(card: Card) -> dict[str, int]:
    names = [one.name for one in protocol.REGISTERS if one.access is Access.BOTH]
    return dict(zip(names, card.read_all(names), strict=True)) | {"generation": card.read("generation")}


def gated_rows(card: Card, images: int = 3) -> int:
    """Rows with a point, by the settings in force, in the last of a few images."""
    for frame in card.frames():
        images -= frame is not None
        if frame is not None and not images:
            return int(frame.rows.valid.sum())
    raise AssertionError


def test_a_card_passes_and_is_left_as_it_was(port: Path) -> None:
    """Settings, generation and all: with the user's own before, and the same after; the gate is the preset's."""
    with Link(str(port)) as opened:
        card = Card(opened)
        card.write_all([("lut_hue", CLOSED), ("lut_luminance", OPEN), ("lut_saturation", OPEN)])
        card.write_all([("floor", [33]), ("motor_kp", [1234]), ("motor_speed", [-5]), ("run", [1])])
        card.write("commit", 777)
        assert card.wait_in_force(777, 10)
        assert gated_rows(card) == 0
        before = settings(card)
    done = run("magtrak", "self-test", "--port", port, "--loop-back")
    assert done.returncode == 0, done.stdout + done.stderr
    lines = done.stdout.splitlines()
    assert len(lines) == len(CHECKS) + 2
    assert all(line.startswith("ok ") for line in lines[:-1]), done.stdout
    assert lines[-1] == f"{len(CHECKS) + 1} ok"
    with Link(str(port)) as opened:
        card = Card(opened)
        assert settings(card) == before
        assert card.read("laser_state") & 3 == 0
        assert gated_rows(card) == 120, "the gate is not that of the preset"
        card.write("run", 0)


@pytest.mark.parametrize(
    ("board", "detectors", "lacks"),
    [
        (
            "icebreaker",
            ["rows by binary: 0.0000 px", "built without fir, centroid of the run, centroid in a window, maximum"],
            ["without filter of isolated pixels", "measurement of grey values"],
        ),
        (
            "ulx3s-12f-lean",
            ["rows by binary, fir, centroid of the run, centroid in a window, maximum: 0.0000 px"],
            ["without speed loop, snapshots, log of encoder edges, full form of rows, check of every turn"],
        ),
    ],
)
def test_a_card_of_less_passes_and_tells_what_it_lacks(
    tmp_path: Path, board: str, detectors: list[str], lacks: list[str]
) -> None:
    """What it lacks is refused, and said so."""
    with virtual_card(tmp_path / "card", "--pattern", "--board", board, "--pace", "real"):
        done = run("magtrak", "self-test", "--port", tmp_path / "card", "--loop-back")
        info = run("magtrak", "info", "--port", tmp_path / "card")
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stdout.splitlines()[-1].startswith(f"{len(CHECKS) - 1} ok, 2 not tried")
    assert all(text in done.stdout for text in detectors), done.stdout
    assert all(text in info.stdout for text in lacks), info.stdout


def test_what_is_not_wired_is_not_tried(card: Card) -> None:
    with Bench(card, Options(camera=True)) as bench:
        for check in (pattern.positions, tables.effect):
            with pytest.raises(NotTriedError, match="the images are a camera's"):
                check(bench)
        with pytest.raises(NotTriedError, match="take the motor off, wire PWM to encoder A"):
            angle.loop_back(bench)


def test_a_motor_that_runs_is_left_alone(card: Card) -> None:
    card.write("motor_mode", 1)
    with pytest.raises(CardError, match="the motor is on: stop it first"):
        next(iter(examine(card, Options())))
    assert card.read("motor_mode") == 1
    card.write("motor_mode", 0)


def frame_of(packet: Packet) -> dict[str, int] | None:
    return protocol.FRAME.unpack(packet.payload[: protocol.FRAME.size]) if packet.type == PacketType.FRAME else None


def shifted(rows: slice, by: int) -> Change:
    """Positions in these rows lie ``by`` steps further on."""

    def change(packet: Packet) -> Packet:
        if (head := frame_of(packet)) is None:
            return packet
        layout = protocol.FULL_ROW if head["form"] == RowForm.FULL else protocol.COMPACT_ROW
        at = protocol.FRAME.size + head["edges"] * protocol.EDGE.size
        data = bytearray(packet.payload)
        for row in range(head["rows"])[rows]:
            place = slice(at + row * layout.size, at + (row + 1) * layout.size)
            fields = layout.unpack(bytes(data[place]))
            if fields["valid"]:
                data[place] = layout.pack({**fields, "position": fields["position"] + by})
        return Packet(packet.type, packet.sequence, bytes(data))

    return change


def without_every(number: int) -> Change:
    """Some frames never come."""
    count = 0

    def change(packet: Packet) -> Packet | None:
        nonlocal count
        count += packet.type == PacketType.FRAME
        return None if packet.type == PacketType.FRAME and not count % number else packet

    return change


def answers(name: str, value: Callable[[int], int], code: int | None = None) -> Change:
    """The card's answers for a register are other ones."""

    def change(packet: Packet) -> Packet:
        if packet.type != PacketType.ANSWER:
            return packet
        answer = protocol.ANSWER.unpack(packet.payload)
        if answer["address"] != register(name).address:
            return packet
        changed = {**answer, "value": value(answer["value"])} | ({} if code is None else {"code": code})
        return Packet(packet.type, packet.sequence, protocol.ANSWER.pack(changed))

    return change


FAULTS: tuple[tuple[Callable[[Bench], str], Change, str], ...] = (
    (link.throughput, answers("magic", lambda value: value ^ 1), "the register magic read as 0x4b54474c"),
    (link.damage, answers("damaged_commands", lambda value: 5), "a damaged command was counted 0 times"),
    (registers.reading, answers("ambient_mode", lambda value: 3), "ambient_mode reads 3, which is not within 0 to 2"),
    (registers.writing, answers("sweep_low", lambda value: value & ~0x100), "sweep_low was written .* and reads"),
    (registers.refusing, answers("detector", lambda value: value, 0), "to detector was answered DONE, not OUT_OF"),
    (registers.committing, answers("floor", lambda value: 7), "floor was committed as 0 and reads 7"),
    (pattern.positions, shifted(slice(120), 2), r"image \d+, row \d+: the line is at \d+ px, measured \d+.008"),
    (pattern.positions, shifted(slice(120), -256), r"image \d+, row \d+: the line is at \d+ px, measured \d+.000"),
    (
        pattern.positions,
        shifted(slice(120), 256 * 70),
        "is not the test picture; if a camera is connected, say",
    ),
    (counters.lossless, without_every(9), r"image \d+ came after \d+"),
    (counters.dropping, without_every(9), r"images are missing before image \d+, and \d+ were counted as dropped"),
    (laser.off, answers("laser_state", lambda value: value | 2), "armed"),
)


@pytest.mark.parametrize(("check", "change", "text"), FAULTS, ids=lambda one: getattr(one, "__name__", ""))
def test_faults_are_seen(card: Card, check: Callable[[Bench], str], change: Change, text: str) -> None:
    with Bench(card, Options()) as bench:
        tamper(card, change)
        with pytest.raises(FailedError, match=text):
            check(bench)
        del card.link.receive  # type: ignore[misc]
        bench.restore()


def test_tables_that_do_not_arrive_are_seen(card: Card) -> None:
    write = card.write_all
    with Bench(card, Options()) as bench:
        card.write_all = lambda values: write([one for one in values if one[0] != "lut_saturation"])  # type: ignore
        with pytest.raises(FailedError, match="lut_saturation"):
            tables.effect(bench)
        card.write_all = write  # type: ignore[method-assign]


def test_inputs_that_are_not_wired_are_seen(card: Card) -> None:
    """The virtual card's are: with A and B exchanged by the decoder, the counts go the other way, which is as good;
    with the motor held still nothing comes.
    """
    write = card.write
    with Bench(card, Options(loop_back=True)) as bench:
        card.write = lambda name, value: None if name == "motor_duty" else write(name, value)  # type: ignore
        angle.WAIT_S, waited = 0.3, angle.WAIT_S
        try:
            with pytest.raises(FailedError, match="the count stands still: are A and B wired"):
                angle.loop_back(bench)
        finally:
            angle.WAIT_S = waited
            card.write = write  # type: ignore[method-assign]


def test_the_whole_tells_what_failed_and_goes_on(card: Card, monkeypatch: pytest.MonkeyPatch) -> None:
    some = [one for one in CHECKS if one[0] in ("images: positions", "laser: off")]
    monkeypatch.setattr("magtrak.selftest.run.CHECKS", some)
    tamper(card, shifted(slice(120), 2))
    outcomes = list(examine(card, Options()))
    assert [one.name for one in outcomes if one.result is Result.FAILED] == ["images: positions"]
    assert [one.result for one in outcomes[1:]] == [Result.OK, Result.OK]
