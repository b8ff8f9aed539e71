"""Wire format: codecs against an independent one, damage, and the page that is rendered from it."""

import random
from pathlib import Path

import pytest
from cobs import cobs
from hypothesis import given
from hypothesis import strategies as st

from magtrak import protocol
from magtrak.protocol import Deframer, Field, Layout, Packet, cobs_decode, cobs_encode, frame_packet
from magtrak.protocol.document import render

DOCS = Path(__file__).parents[2] / "docs"

# Long stretches without a zero are where COBS has its corners.
blobs = st.lists(
    st.one_of(st.binary(max_size=8), st.integers(250, 515).map(lambda n: b"x" * n), st.just(b"\0")), max_size=6
).map(b"".join)
packets = st.builds(Packet, st.integers(0, 255), st.integers(0, 0xFFFF), blobs)


def test_page_is_what_the_tables_say() -> None:
    assert (DOCS / "protocol.md").read_text() == render(), "run: python -m magtrak.protocol > docs/protocol.md"


@given(blobs)
def test_cobs_encodes_as_another_implementation_does(data: bytes) -> None:
    encoded = cobs_encode(data)
    assert encoded == cobs.encode(data)
    assert 0 not in encoded
    assert cobs_decode(encoded) == data


@given(st.binary(max_size=600))
def test_cobs_decodes_as_another_implementation_does(data: bytes) -> None:
    try:
        expected = cobs.decode(data)
    except cobs.DecodeError:
        expected = None
    if expected is None or not data:
        with pytest.raises(ValueError):
            cobs_decode(data)
    else:
        assert cobs_decode(data) == expected


@given(st.lists(packets, max_size=5), st.integers(1, 300))
def test_packets_come_through_in_pieces_of_any_size(sent: list[Packet], size: int) -> None:
    stream = b"".join(map(frame_packet, sent))
    deframer = Deframer()
    got = [p for at in range(0, len(stream), size) for p in deframer.feed(stream[at : at + size])]
    assert got == sent
    assert deframer.damaged == 0
    assert not deframer.within_packet


@pytest.mark.parametrize("seed", range(8))
def test_damage_costs_the_packets_it_hits_and_no_more(seed: int) -> None:
    rng = random.Random(seed)
    for _ in range(40):
        sent = [Packet(1, n, rng.randbytes(rng.randrange(60))) for n in range(10)]
        wire = [bytearray(frame_packet(p)) for p in sent]
        hit = rng.randrange(10)
        # Neither delimiter nor zero: the packet's bounds stay.
        at = rng.randrange(len(wire[hit]) - 1)
        wire[hit][at] = (wire[hit][at] + rng.randrange(1, 255) - 1) % 255 + 1 if wire[hit][at] else 1
        changed = bytes(wire[hit]) != frame_packet(sent[hit])
        deframer = Deframer()
        got = list(deframer.feed(b"".join(wire)))
        assert got == [p for n, p in enumerate(sent) if n != hit or not changed]
        assert deframer.damaged == int(changed)


def test_starting_in_the_middle_costs_one_packet() -> None:
    sent = [Packet(1, n, bytes([n, 0, n])) for n in range(3)]
    stream = b"".join(map(frame_packet, sent))
    deframer = Deframer()
    assert list(deframer.feed(stream[4:])) == sent[1:]
    assert deframer.damaged == 1


def test_noise_without_delimiter_is_dropped_and_counted_once() -> None:
    deframer = Deframer(limit=100)
    for _ in range(10):
        assert list(deframer.feed(b"x" * 90)) == []
    assert deframer.within_packet
    good = Packet(1, 2, b"good")
    assert list(deframer.feed(b"x\0" + frame_packet(good))) == [good]
    assert deframer.damaged == 1


@given(st.data())
def test_layouts_give_back_what_they_packed(data: st.DataObject) -> None:
    layout = data.draw(st.sampled_from([protocol.FRAME, protocol.EDGE, protocol.FULL_ROW, protocol.COMPACT_ROW]))
    values = {f.name: data.draw(st.integers(*f.range)) for f in layout.fields if not f.reserved}
    packed = layout.pack(values)
    assert len(packed) == layout.size
    assert layout.unpack(packed) == values


def test_layout_refuses_what_does_not_fit() -> None:
    layout = Layout("pair", (Field("a", 4), Field("b", 4, signed=True)))
    assert layout.pack({"a": 15, "b": -8}) == b"\x8f"
    with pytest.raises(ValueError, match=r"pair.a is 16, outside 0 to 15"):
        layout.pack({"a": 16, "b": 0})
    with pytest.raises(KeyError):
        layout.pack({"a": 1})
    with pytest.raises(ValueError, match=r"pair takes 1 bytes, got 2"):
        layout.unpack(b"12")


def test_registers_do_not_overlap_and_start_within_their_range() -> None:
    taken: set[int] = set()
    for entry in protocol.REGISTERS:
        addresses = set(range(entry.address, entry.address + entry.words))
        assert not addresses & taken, entry.name
        taken |= addresses
        assert entry.decode(entry.encode(entry.init)) == entry.init


def test_register_values_out_of_range_are_refused() -> None:
    weight = protocol.register("weight_g")
    assert weight.decode(weight.encode(-128)) == -128
    with pytest.raises(ValueError, match=r"weight_g takes -512 to 511, not 512"):
        weight.encode(512)
    with pytest.raises(KeyError, match=r"'wait'"):
        protocol.register("wait")
