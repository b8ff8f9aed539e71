"""Damages a recorded stream in every way a wire can, and checks frame by frame what the decoder makes of it.

``python -m tests.fuzz.damage --packets 1000000`` goes on until so many packets were damaged, and prints the counts.

A packet is *untouched* where its bytes follow each other unchanged, its delimiter included, behind a delimiter or the
beginning of the stream. Every untouched packet must come out, in order, as often as it is in the stream; nothing may
come out that is not, byte for byte, a packet of the undamaged stream; and each packet that does not come out must be in
the count of losses.
"""

import argparse
import random
import time
from collections import Counter
from dataclasses import dataclass, field

import numpy as np

from magtrak import protocol
from magtrak.frames import decode_frame
from magtrak.protocol import Packet, PacketType, RowForm, frame_packet
from magtrak.stream import PacketStream
from tests.support.frames import Recorder, full_rows

WINDOW = 64
"""Packets of a round; the first and the last are left whole, so that every loss lies between two that are not."""

POOL = 1024


def pool(seed: int) -> list[Packet]:
    """A stream as a card sends it: frames of both forms, answers, pieces of pictures; the sequence number wraps."""
    rng = random.Random(seed)
    frames = iter(_frames(POOL, rng))
    packets = []
    for number in range(POOL):
        kind = rng.choices((PacketType.FRAME, PacketType.ANSWER, PacketType.SNAPSHOT), (6, 1, 1))[0]
        if kind == PacketType.FRAME:
            payload = next(frames)
        elif kind == PacketType.ANSWER:
            values = (rng.randrange(1 << f.bits) for f in protocol.ANSWER.fields)
            payload = protocol.ANSWER.pack(dict(zip([f.name for f in protocol.ANSWER.fields], values, strict=True)))
        else:
            payload = rng.randbytes(protocol.SNAPSHOT.size) + rng.choice((bytes(60), rng.randbytes(300)))
        packets.append(Packet(kind, (65000 + number) & 0xFFFF, payload))
    return packets


def _frames(count: int, rng: random.Random) -> list[bytes]:
    """Payloads of frames, from none to a dozen rows."""
    payloads = Recorder(lambda t: 300 + 400 * t, rows=4).payloads(count)
    made = []
    for payload in payloads:
        header = protocol.FRAME.unpack(payload[: protocol.FRAME.size])
        edges = payload[protocol.FRAME.size :][: header["edges"] * protocol.EDGE.size]
        rows = rng.randrange(13)
        form = rng.choice(list(RowForm))
        if form == RowForm.FULL:
            data = full_rows([rng.choice((np.nan, rng.uniform(0, 60))) for _ in range(rows)])
        else:
            data = b"".join(rng.randbytes(protocol.COMPACT_ROW.size) for _ in range(rows))
        made.append(protocol.FRAME.pack({**header, "rows": rows, "form": form}) + edges + data)
        decode_frame(made[-1])  # they are frames
    return made


@dataclass
class Stream:
    """Bytes, and of each the place in the undamaged stream that it is from; -1 for what was not there."""

    data: np.ndarray
    origin: np.ndarray

    def part(self, begin: int, end: int) -> "Stream":
        return Stream(self.data[begin:end], self.origin[begin:end])


def join(*parts: Stream) -> Stream:
    return Stream(np.concatenate([p.data for p in parts]), np.concatenate([p.origin for p in parts]))


def _noise(rng: random.Random, count: int) -> Stream:
    data = np.frombuffer(rng.randbytes(count) if rng.random() < 0.7 else bytes(count), np.uint8)
    return Stream(data, np.full(count, -1))


def _length(rng: random.Random) -> int:
    return rng.choice((1, 1, 1, 2, 3, rng.randrange(1, 40), rng.randrange(1, 600)))


def flip(stream: Stream, rng: random.Random, at: int) -> Stream:
    """Some bytes change, a bit or more of each."""
    data, origin = stream.data.copy(), stream.origin.copy()
    for place in range(at, min(at + rng.choice((1, 1, 2, 8)), len(data))):
        data[place] ^= rng.choice((1 << rng.randrange(8), rng.randrange(1, 256)))
        origin[place] = -1
    return Stream(data, origin)


def insert(stream: Stream, rng: random.Random, at: int) -> Stream:
    """Bytes that were never sent, zeros among them."""
    return join(stream.part(0, at), _noise(rng, _length(rng)), stream.part(at, len(stream.data)))


def delete(stream: Stream, rng: random.Random, at: int) -> Stream:
    """Bytes that never arrive."""
    return join(stream.part(0, at), stream.part(min(at + _length(rng), len(stream.data)), len(stream.data)))


def overwrite(stream: Stream, rng: random.Random, at: int) -> Stream:
    """A burst of noise in place of what was sent."""
    noise = _noise(rng, _length(rng))
    rest = stream.part(min(at + len(noise.data), len(stream.data)), len(stream.data))
    return join(stream.part(0, at), noise, rest)


def splice(stream: Stream, rng: random.Random, at: int) -> Stream:
    """Old bytes come again at another place."""
    begin = rng.randrange(len(stream.data))
    again = stream.part(begin, begin + _length(rng))
    return join(stream.part(0, at), again, stream.part(at, len(stream.data)))


DAMAGES = (flip, insert, delete, overwrite, splice)


@dataclass
class Result:
    """Counts of a run."""

    rounds: int = 0
    packets: int = 0
    touched: int = 0
    decoded: int = 0
    frames: int = 0
    damages: Counter[str] = field(default_factory=Counter)


def untouched(stream: Stream, starts: np.ndarray, ends: np.ndarray) -> list[int]:
    """Which packets are whole in a stream, in order, each as often as it is there."""
    origin = stream.origin
    follows = np.zeros(len(origin), bool)
    follows[1:] = (origin[1:] == origin[:-1] + 1) & (origin[:-1] >= 0)
    # Where the stretch of unbroken bytes ends to which each byte belongs.
    breaks = np.append(np.flatnonzero(~follows), len(origin))
    stretch_end = breaks[np.searchsorted(breaks, np.arange(len(origin)), side="right")]
    places = np.flatnonzero(np.isin(origin, starts))
    found = []
    for place in places.tolist():
        number = int(np.searchsorted(starts, origin[place]))
        behind = place == 0 or stream.data[place - 1] == 0
        if behind and stretch_end[place] - place >= ends[number] - starts[number]:
            found.append(number)
    return found


def play(packets: list[Packet], wires: list[bytes], rng: random.Random, result: Result) -> None:
    """One round; raises AssertionError where the decoder does what it must not."""
    begin = rng.randrange(len(packets) - WINDOW)
    sent = packets[begin : begin + WINDOW]
    lengths = np.array([len(wire) for wire in wires[begin : begin + WINDOW]])
    ends = np.cumsum(lengths)
    starts = ends - lengths
    whole = np.frombuffer(b"".join(wires[begin : begin + WINDOW]), np.uint8)
    stream = Stream(whole, np.arange(len(whole)))
    first, last = stream.part(0, int(ends[0])), stream.part(int(starts[-1]), len(whole))
    middle = stream.part(int(ends[0]), int(starts[-1]))
    for _ in range(rng.choice((0, 1, 4, 16, 48))):
        damage = rng.choice(DAMAGES)
        middle = damage(middle, rng, rng.randrange(len(middle.data)))
        result.damages[damage.__name__] += 1
    # The last packet is whole only behind a delimiter: damage to the one before it would cost it, too.
    delimiter = Stream(np.zeros(1, np.uint8), np.array([-1]))
    stream = join(first, middle, delimiter, last)

    decoder = PacketStream()
    got: list[Packet] = []
    data = stream.data.tobytes()
    cuts = sorted(rng.randrange(len(data)) for _ in range(rng.randrange(6)))
    for piece in (data[a:b] for a, b in zip([0, *cuts], [*cuts, len(data)], strict=True)):
        got += decoder.feed(piece)
    check(sent, untouched(stream, starts, ends), got, decoder)
    whole_ones = set(untouched(stream, starts, ends))
    result.rounds += 1
    result.packets += WINDOW
    result.touched += WINDOW - len(whole_ones)
    result.decoded += len(got)
    result.frames += sum(packet.type == PacketType.FRAME for packet in got)


def check(sent: list[Packet], expected: list[int], got: list[Packet], decoder: PacketStream) -> None:
    """What came out against what was put in."""
    number_of = {packet: number for number, packet in enumerate(sent)}
    numbers = []
    for packet in got:
        assert packet in number_of, f"never sent: {packet}"
        numbers.append(number_of[packet])
    wanted = iter(numbers)
    for number in expected:
        assert number in wanted, f"packet {number} is untouched and did not come out; {numbers} did"
    statistics = decoder.statistics()
    assert statistics.packets == len(got)
    missing = len(sent) - len(set(numbers))
    if numbers == sorted(set(numbers)):
        assert statistics.lost == missing and statistics.restarts == 0, f"{missing} missing, {statistics}"
    else:  # packets came again: some losses are counted twice, none is left out
        assert statistics.lost >= missing and statistics.restarts >= 1, f"{missing} missing, {statistics}"
    assert not missing or statistics.lost


def run(amount: int, seed: int) -> Result:
    """Until ``amount`` packets were damaged."""
    rng = random.Random(seed)
    packets = pool(seed)
    wires = [frame_packet(packet) for packet in packets]
    result = Result()
    while result.touched < amount:
        play(packets, wires, rng, result)
    return result


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--packets", type=int, default=1_000_000, help="how many to damage")
    parser.add_argument("--seed", type=int, default=random.randrange(2**32))
    options = parser.parse_args()
    print(f"damage: seed {options.seed}", flush=True)
    start = time.monotonic()
    result = run(options.packets, options.seed)
    kinds = ", ".join(f"{count} {name}s" for name, count in sorted(result.damages.items()))
    print(
        f"damage: {result.touched} damaged packets of {result.packets} in {result.rounds} streams ({kinds});"
        f" {result.decoded} came out, {result.frames} of them frames, each as it was sent; every untouched one did,"
        f" every loss is counted; {time.monotonic() - start:.0f} s"
    )


if __name__ == "__main__":
    main()
