"""A USB host and its PHY on a ULPI bus, high speed; as UTMI+ Low Pin Interface, revision 1.1, chapter 3."""

from types import SimpleNamespace

from amaranth.hdl import Signal

from .usb import PATIENCE, UsbHost

SE0, J, K = 0b00, 0b01, 0b10
VBUS_VALID = 0b1100
TRANSMIT, REGISTER_WRITE = 0b01, 0b10  # the upper two bits of a command
CHIRP_CLOCKS = 200


def pin(width: int = 1) -> SimpleNamespace:
    return SimpleNamespace(i=Signal(width), o=Signal(width), oe=Signal())


def ulpi_bus() -> SimpleNamespace:
    """What :func:`gateware.link.usb.ulpi` makes of a board's pins, without them."""
    clk = SimpleNamespace(o=Signal())
    return SimpleNamespace(data=pin(8), clk=clk, dir=pin(), nxt=pin(), stp=pin(), rst=pin())


class UlpiHost(UsbHost):
    """A :class:`UsbHost` on such a bus.

    Attributes
    ----------
    registers : of the PHY, as the card wrote them
    chirp : clocks for which the card chirped
    """

    def __init__(self, ctx, bus) -> None:
        super().__init__(ctx, bus)
        self.registers: dict[int, int] = {}
        self.chirp = 0

    async def clock(self, count: int = 1) -> None:
        """Clocks in which the PHY takes what the card writes to its registers."""
        for _ in range(count):
            command = self._command()
            if command >> 6 == REGISTER_WRITE:
                await self._accept()
                value = await self._accept()
                assert self.ctx.get(self.bus.stp.o)
                self.registers[command & 0x3F] = value
            await self.ctx.tick("usb")

    async def reset(self) -> None:
        """A bus reset, in which card and host find each other fit for high speed."""
        await self.line(SE0)
        while self._command() != TRANSMIT << 6:
            await self.clock()
        self.ctx.set(self.bus.nxt.i, 1)
        while not self.ctx.get(self.bus.stp.o):
            assert self.chirp == 0 or self.ctx.get(self.bus.data.o) == 0
            self.chirp += 1
            await self.ctx.tick("usb")
        self.ctx.set(self.bus.nxt.i, 0)
        for _ in range(3):
            await self.line(K)
            await self.clock(CHIRP_CLOCKS)
            await self.line(J)
            await self.clock(CHIRP_CLOCKS)
        await self.line(SE0)
        await self.clock(CHIRP_CLOCKS)
        self.address = 0
        self._toggles.clear()

    async def line(self, state: int) -> None:
        """The PHY tells the state of the line."""
        await self._drive([(VBUS_VALID | state, 0)], first_nxt=0)

    async def send(self, packet: bytes) -> None:
        await self._drive([(byte, 1) for byte in packet], first_nxt=1)
        await self.clock(2)

    async def receive(self) -> bytes:
        for _ in range(PATIENCE):
            if self._command() >> 6 == TRANSMIT:
                break
            await self.clock()
        else:
            return b""
        low = await self._accept() & 0xF
        packet = bytearray([low | (~low & 0xF) << 4])
        while not self.ctx.get(self.bus.stp.o):
            packet.append(await self._accept())
        await self.clock(3)
        return bytes(packet)

    def _command(self) -> int:
        """What the card drives while the bus is its own."""
        return 0 if self.ctx.get(self.bus.dir.i) else self.ctx.get(self.bus.data.o)

    async def _accept(self) -> int:
        """Take a byte from the card."""
        self.ctx.set(self.bus.nxt.i, 1)
        *_, data = await self.ctx.tick("usb").sample(self.bus.data.o)
        self.ctx.set(self.bus.nxt.i, 0)
        return data

    async def _drive(self, content, *, first_nxt: int) -> None:
        """Take the bus, for a clock in which nobody drives it, give out bytes with their NXT, and release it."""
        ctx, bus = self.ctx, self.bus
        while self._command():
            await self.clock()
        ctx.set(bus.dir.i, 1)
        ctx.set(bus.nxt.i, first_nxt)
        await ctx.tick("usb")
        for byte, nxt in content:
            ctx.set(bus.data.i, byte)
            ctx.set(bus.nxt.i, nxt)
            await ctx.tick("usb")
        ctx.set(bus.dir.i, 0)
        ctx.set(bus.nxt.i, 0)
        await ctx.tick("usb")
