"""The link: how quick, how intact, and what becomes of what is not."""

import time

from .. import protocol
from ..protocol import Packet, PacketType, frame_packet, register
from ..summary import median
from .bench import Bench, FailedError

PINGS = 100
SLOW_S = 50e-3
READS = 1000


def latency(bench: Bench) -> str:
    """A command at a time, and how long its answer takes: half of them within 50 ms."""
    card = bench.card
    card.write("run", 0)
    card.round_trips_s.clear()
    for _ in range(PINGS):
        card.read("magic")
    typical, slowest = median(card.round_trips_s), max(card.round_trips_s)
    if typical > SLOW_S:
        raise FailedError(f"answers take {1e3 * typical:.1f} ms: see `magtrak doctor` for the adapter's latency")
    return f"answers in {1e3 * typical:.1f} ms, the slowest of {PINGS} in {1e3 * slowest:.1f} ms"


def throughput(bench: Bench) -> str:
    """Many commands under way at once: each is answered, in order, and no packet is damaged or missing."""
    card = bench.card
    card.write("run", 0)
    before, since = card.link.statistics, time.monotonic()
    answers = card.read_all(["magic"] * READS)
    took_s = time.monotonic() - since
    if set(answers) != {protocol.MAGIC}:
        raise FailedError(f"the register magic read as {next(one for one in answers if one != protocol.MAGIC):#x}")
    found = card.link.statistics - before
    if found.damaged or found.lost:
        raise FailedError(f"of {READS} answers {found.lost} got lost and {found.damaged} were damaged: check the cable")
    return f"{READS / took_s:.0f} commands/s, {found.bytes / took_s / 1e3:.0f} kB/s of answers, none damaged"


def damage(bench: Bench) -> str:
    """A command with a wrong bit: no answer, but counted; the next one is answered."""
    card = bench.card
    before = card.read("damaged_commands")
    payload = protocol.COMMAND.pack({"address": register("magic").address, "value": 0})
    sent = bytearray(frame_packet(Packet(PacketType.READ, 0x55, payload)))
    sent[2] ^= 0x40
    answered = card.link.statistics.packets
    card.link.send_bytes(bytes(sent))
    counted = card.read("damaged_commands") - before
    packets = card.link.statistics.packets - answered
    if before == 0xFFFF:
        return "the card's counter of damaged commands is full"
    if counted != 1:
        raise FailedError(f"a damaged command was counted {counted} times")
    if packets != 1:
        raise FailedError(f"a damaged command and a good one brought {packets} answers")
    return "a damaged command is counted, and has no effect"
