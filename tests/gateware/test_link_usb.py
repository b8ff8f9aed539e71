"""USB at the level of UTMI: a host enumerates the card, and moves bytes however slowly either side takes them."""

import random
import warnings

import pytest

from gateware.link.usb import FULL_SPEED_BYTES, HIGH_SPEED_BYTES, PRODUCT, VENDOR, UsbSerial, utmi
from magtrak.protocol import Packet, frame_packet
from tests.support.streams import receive, send
from tests.support.ulpi import UlpiHost, ulpi_bus
from tests.support.usb import StalledError, UsbHost, simulate_usb

with warnings.catch_warnings():
    warnings.simplefilter("ignore", DeprecationWarning)
    from luna.gateware.interface.ulpi import UTMITranslator
    from luna.gateware.usb.usb2.reset import USBResetSequencer

SERIAL = "00c0ffee12345678"
DATA = 4  # the endpoint
GET_DESCRIPTOR, SET_ADDRESS, SET_CONFIGURATION = 6, 5, 9
SET_LINE_CODING = 0x20


async def enumerate_card(host):
    """What an operating system does with a new device, and what it learns of it."""
    await host.reset()
    first = await host.control((0x80, GET_DESCRIPTOR, 0x0100, 0, 8))
    assert first[7] == 64  # of endpoint 0
    await host.control((0x00, SET_ADDRESS, 23, 0, 0))
    host.address = 23
    device = await host.control((0x80, GET_DESCRIPTOR, 0x0100, 0, 18))
    head = await host.control((0x80, GET_DESCRIPTOR, 0x0200, 0, 9))
    total = int.from_bytes(head[2:4], "little")
    configuration = await host.control((0x80, GET_DESCRIPTOR, 0x0200, 0, total))
    assert len(configuration) == total
    strings = [await host.control((0x80, GET_DESCRIPTOR, 0x0300 | n, 0x0409, 255)) for n in device[14:17]]
    await host.control((0x00, SET_CONFIGURATION, configuration[5], 0, 0))
    return device, configuration, [string[2:].decode("utf-16-le") for string in strings]


def test_enumeration():
    bus = utmi()
    dut = UsbSerial(bus, SERIAL)

    async def testbench(ctx):
        host = UsbHost(ctx, bus)
        device, configuration, strings = await enumerate_card(host)
        assert len(device) == 18
        assert int.from_bytes(device[8:10], "little") == VENDOR
        assert int.from_bytes(device[10:12], "little") == PRODUCT
        assert strings == ["Magtrak", "Magtrak card", SERIAL]
        endpoints = {}
        at = 0
        while at < len(configuration):
            if configuration[at + 1] == 5:
                endpoints[configuration[at + 2]] = configuration[at + 3] & 3, configuration[at + 4]
            at += configuration[at]
        assert endpoints == {0x83: (3, 64), 0x84: (2, 64), 0x04: (2, 64)}
        # What a driver does when the port is opened.
        await host.control((0x21, SET_LINE_CODING, 0, 0, 7), (3_000_000).to_bytes(4, "little") + b"\0\0\x08")
        with pytest.raises(StalledError):
            await host.control((0xC0, 0x55, 0, 0, 4))  # no request of anybody's
        assert (await host.control((0x80, GET_DESCRIPTOR, 0x0100, 0, 18))) == device

    simulate_usb(dut, testbench)


def test_high_speed_through_a_phy(monkeypatch):
    """Register writes, chirps, enumeration and bulk packets of 512 bytes on a ULPI bus; the long waits made short."""
    monkeypatch.setattr(UTMITranslator, "_CYCLES_1_MILLISECONDS", 100)
    monkeypatch.setattr(USBResetSequencer, "_CYCLES_2_MILLISECONDS", 1000)
    bus = ulpi_bus()
    dut = UsbSerial(bus, SERIAL, HIGH_SPEED_BYTES)
    to_host = bytes(n % 255 + 1 for n in range(2000)) + b"\0" + b"short\0"
    to_card = bytes(random.Random(1).randrange(256) for _ in range(1200))
    at_card = bytearray()

    async def card_sends(ctx):
        await send(ctx, dut.i, to_host)

    async def card_takes(ctx):
        at_card.extend(await receive(ctx, dut.o, len(to_card)))

    async def testbench(ctx):
        host = UlpiHost(ctx, bus)
        _, configuration, strings = await enumerate_card(host)
        assert host.chirp > 500
        # In the end: no chirp, high-speed termination, driving (function control, 0x04), no pull-downs (0x0A).
        assert host.registers[0x04] & 0x1F == 0
        assert host.registers[0x0A] & 0b110 == 0
        assert strings == ["Magtrak", "Magtrak card", SERIAL]
        assert bytes([7, 5, 0x84, 2]) + HIGH_SPEED_BYTES.to_bytes(2, "little") in configuration
        got, sent = bytearray(), 0
        while len(got) < len(to_host) or sent < len(to_card):
            packet = to_card[sent : sent + HIGH_SPEED_BYTES]
            if packet and await host.transfer_out(DATA, packet):
                sent += len(packet)
            got += await host.transfer_in(DATA) or b""
            await host.clock(400)
        await host.clock(2000)
        assert got == to_host
        assert at_card == to_card
        assert [len(packet) for packet in host.in_packets if packet] == [512, 512, 512, 465, 6]

    simulate_usb(dut, testbench, card_sends, card_takes, usb_hz=60e6)


@pytest.mark.parametrize("seed", range(2))
def test_bytes_go_both_ways_at_once_with_back_pressure(seed):
    """Stalls on both sides: each byte arrives once, in order, and a packet ends after each zero."""
    print("seed", seed)
    rng = random.Random(seed)
    bus = utmi()
    dut = UsbSerial(bus, SERIAL)
    sizes = [1, 54, 55, 56, 130, rng.randrange(1, 200)]  # 55 bytes of payload fill a packet of USB to the last byte
    to_host = b"".join(
        frame_packet(Packet(1, n, rng.randbytes(size).replace(b"\0", b"\1"))) for n, size in enumerate(sizes)
    )
    to_card = rng.randbytes(400)
    at_card = bytearray()

    async def card_sends(ctx):
        await send(ctx, dut.i, to_host, stall=[0.0, 0.9][seed], seed=seed)

    async def card_takes(ctx):
        at_card.extend(await receive(ctx, dut.o, len(to_card), stall=[0.0, 0.98][seed], seed=seed))

    async def testbench(ctx):
        host = UsbHost(ctx, bus)
        await enumerate_card(host)
        got, sent = bytearray(), 0
        while len(got) < len(to_host) or sent < len(to_card):
            if sent < len(to_card) and rng.random() < 0.7:
                size = rng.choice([1, 17, FULL_SPEED_BYTES])
                if await host.transfer_out(DATA, to_card[sent : sent + size]):
                    sent += len(to_card[sent : sent + size])
            if rng.random() < 0.7:
                got += await host.transfer_in(DATA) or b""
            assert to_host.startswith(got)
            await host.clock(rng.choice([5, 300]))
        for _ in range(400):
            if len(at_card) == len(to_card):
                break
            await host.clock(20)
        assert got == to_host
        assert at_card == to_card
        # No zero but at the end of a packet of USB; and where it ends a full one, an empty one says so.
        for packet, following in zip(host.in_packets, [*host.in_packets[1:], b""], strict=True):
            assert 0 not in packet[:-1]
            assert packet[-1:] in (b"\0", b"") or len(packet) == FULL_SPEED_BYTES
            assert len(packet) < FULL_SPEED_BYTES or packet[-1] != 0 or following == b""
        assert any(len(packet) == FULL_SPEED_BYTES for packet in host.in_packets)
        assert host.naks > 0

    simulate_usb(dut, testbench, card_sends, card_takes, clocks=1_500_000)


def test_a_host_that_does_not_read_stops_the_card_and_loses_nothing():
    bus = utmi()
    dut = UsbSerial(bus, SERIAL)
    data = bytes(n % 255 + 1 for n in range(400)) + b"\0"
    taken = 0

    async def card_sends(ctx):
        nonlocal taken
        for byte in data:
            await send(ctx, dut.i, [byte])
            taken += 1

    async def testbench(ctx):
        host = UsbHost(ctx, bus)
        await enumerate_card(host)
        await host.clock(3000)
        waiting = taken
        assert waiting < 200, "two packets and the crossing hold less"
        await host.clock(3000)
        assert taken == waiting
        got = b""
        while len(got) < len(data):
            got += await host.transfer_in(DATA) or b""
        assert got == data

    simulate_usb(dut, testbench, card_sends)
