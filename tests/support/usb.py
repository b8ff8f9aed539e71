"""A USB host at the UTMI level: tokens, data, handshakes and control transfers as USB 2.0, chapters 8 and 9."""

from collections.abc import Sequence

from amaranth.sim import Simulator

CLOCKS_PER_BYTE = 8  # at full speed a PHY with a 12 MHz clock has a byte every 8 clocks
PATIENCE = 400

OUT, IN, SETUP, SOF = 0xE1, 0x69, 0x2D, 0xA5
DATA0, DATA1 = 0xC3, 0x4B
ACK, NAK, STALL = 0xD2, 0x5A, 0x1E


def _crc(data: int, bits: int, polynomial: int, width: int) -> int:
    """CRC of USB: all ones at first, lowest bit first, inverted."""
    crc = (1 << width) - 1
    for number in range(bits):
        lowest = (crc ^ data >> number) & 1
        crc = crc >> 1 ^ (polynomial if lowest else 0)
    return crc ^ (1 << width) - 1


def token(kind: int, address: int, endpoint: int) -> bytes:
    fields = address | endpoint << 7
    return bytes([kind]) + (fields | _crc(fields, 11, 0x14, 5) << 11).to_bytes(2, "little")


def data_packet(kind: int, payload: bytes) -> bytes:
    crc = _crc(int.from_bytes(payload, "little"), 8 * len(payload), 0xA001, 16)
    return bytes([kind]) + payload + crc.to_bytes(2, "little")


class StalledError(Exception):
    """The device refused a request."""


class UsbHost:
    """Drives a UTMI bus.

    Parameters
    ----------
    ctx : context of the testbench
    bus : as of :func:`gateware.link.usb.utmi`

    Attributes
    ----------
    naks : packets that the device refused for the moment
    in_packets : payloads of all packets received from bulk endpoints
    """

    def __init__(self, ctx, bus) -> None:
        self.ctx = ctx
        self.bus = bus
        self.address = 0
        self.naks = 0
        self.in_packets: list[bytes] = []
        self._toggles: dict[tuple[int, int], int] = {}

    async def clock(self, count: int = 1) -> None:
        await self.ctx.tick("usb").repeat(count)

    async def reset(self) -> None:
        """A bus reset of 50 us, then idle."""
        self.ctx.set(self.bus.line_state, 0)
        await self.clock(600)
        self.ctx.set(self.bus.line_state, 0b01)
        await self.clock(50)
        self.address = 0
        self._toggles.clear()

    async def send(self, packet: bytes) -> None:
        ctx, bus = self.ctx, self.bus
        ctx.set(bus.rx_active, 1)
        await self.clock(CLOCKS_PER_BYTE)
        for byte in packet:
            ctx.set(bus.rx_data, byte)
            ctx.set(bus.rx_valid, 1)
            await self.clock()
            ctx.set(bus.rx_valid, 0)
            await self.clock(CLOCKS_PER_BYTE - 1)
        ctx.set(bus.rx_active, 0)
        await self.clock(3)

    async def receive(self) -> bytes:
        """The packet that the device sends; none within the time-out of USB gives nothing."""
        ctx, bus = self.ctx, self.bus
        packet = bytearray()
        for _ in range(PATIENCE):
            if ctx.get(bus.tx_valid):
                break
            await self.clock()
        while ctx.get(bus.tx_valid):
            packet.append(ctx.get(bus.tx_data))
            ctx.set(bus.tx_ready, 1)
            await self.clock()
            ctx.set(bus.tx_ready, 0)
            await self.clock(CLOCKS_PER_BYTE - 1)
        await self.clock(3)
        return bytes(packet)

    async def transfer_in(self, endpoint: int) -> bytes | None:
        """The payload of one packet, acknowledged; None where the device has none."""
        key = (endpoint, 1)
        await self.send(token(IN, self.address, endpoint))
        packet = await self.receive()
        assert packet, f"no answer from endpoint {endpoint}"
        if packet[0] == NAK:
            self.naks += 1
            return None
        if packet[0] == STALL:
            raise StalledError
        payload = packet[1:-2]
        assert packet == data_packet(packet[0], payload), packet.hex()
        wanted = DATA1 if self._toggles.get(key, 0) else DATA0
        await self.send(bytes([ACK]))
        if packet[0] != wanted:
            return None  # sent again because an acknowledgement was lost
        self._toggles[key] = 1 - self._toggles.get(key, 0)
        if endpoint:
            self.in_packets.append(payload)
        return payload

    async def transfer_out(self, endpoint: int, payload: bytes, kind: int = OUT) -> bool:
        """Send one packet; whether the device took it."""
        key = (endpoint, 0)
        await self.send(token(kind, self.address, endpoint))
        await self.send(data_packet(DATA1 if self._toggles.get(key, 0) else DATA0, payload))
        answer = await self.receive()
        if answer == bytes([STALL]):
            raise StalledError
        if answer != bytes([ACK]):
            assert answer == bytes([NAK]), answer.hex()
            self.naks += 1
            return False
        self._toggles[key] = 1 - self._toggles.get(key, 0)
        return True

    async def control(self, setup: Sequence[int], data: bytes = b"") -> bytes:
        """A control transfer: ``bmRequestType``, ``bRequest``, ``wValue``, ``wIndex``, ``wLength``."""
        kind, request, value, index, length = setup
        self._toggles[0, 0] = 0
        words = b"".join(word.to_bytes(2, "little") for word in (value, index, length))
        assert await self.transfer_out(0, bytes([kind, request]) + words, SETUP)
        self._toggles[0, 0] = self._toggles[0, 1] = 1
        got = bytearray()
        if kind & 0x80:
            while len(got) < length:
                payload = await self._patiently(self.transfer_in, 0)
                got += payload
                if len(payload) < 64:
                    break
            self._toggles[0, 0] = 1
            await self._patiently(self.transfer_out, 0, b"")
        else:
            if data:
                await self._patiently(self.transfer_out, 0, data)
            self._toggles[0, 1] = 1
            assert await self._patiently(self.transfer_in, 0) == b""
        return bytes(got)

    async def _patiently(self, what, *arguments):
        for _ in range(50):
            if (done := await what(*arguments)) not in (None, False):
                return done
        raise AssertionError(f"nothing but NAK from {what.__name__}{arguments}")


def simulate_usb(dut, testbench, *more, clocks: int = 400_000, usb_hz: float = 12e6) -> None:
    """Like :func:`tests.support.simulation.simulate`, with a ``usb`` domain of ``usb_hz`` and a ``sync`` of 25 MHz."""

    async def timeout(ctx):
        await ctx.delay(clocks / usb_hz)
        raise TimeoutError(f"the testbench has not ended after {clocks} clocks")

    simulator = Simulator(dut)
    simulator.add_clock(1 / usb_hz, domain="usb")
    simulator.add_clock(1 / 25e6, domain="sync")
    simulator.add_testbench(timeout, background=True)
    simulator.add_testbench(testbench)
    for process in more:
        simulator.add_testbench(process, background=True)
    simulator.run()
