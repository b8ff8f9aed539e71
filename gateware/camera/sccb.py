"""Writes and reads a camera's registers: SCCB, which is I2C in all that is used here."""

from amaranth.hdl import Cat, Const, Module, Mux, Signal
from amaranth.lib import data, stream, wiring
from amaranth.lib.cdc import FFSynchronizer
from amaranth.lib.wiring import In, Out


class Request(data.Struct):
    """A register to write, or to read."""

    read: 1
    address: 16
    data: 8


class Sccb(wiring.Component):
    """Master of a two-wire bus, alone on it. Both lines are pulled up, and only ever pulled low here.

    A write is one transmission: device, address, data (three phases, with 16-bit addresses four bytes). A read is two:
    device and address; then device and the register's data, after which the ninth bit is left high. The ninth bit of
    all other bytes is looked at: SCCB calls it "don't care", a slave that keeps to I2C pulls it low. What to make of it
    is left to the user. The slave cannot hold the clock: cameras do not.

    Source: OmniVision, Serial Camera Control Bus functional specification.

    Latency of a write: 120 quarters of a bit with 8-bit addresses, 156 with 16; of a read 168 and 204.

    Parameters
    ----------
    device : address of the camera, 7 bits
    address_bytes : of a register, 1 or 2
    quarter_clocks : clocks of a quarter of a bit, at least 4

    Members
    -------
    i : requests, one at a time
    done : strobe; the members below speak of the request that is done, until the next is taken
    data : what was read
    acknowledged : every byte was
    scl_low, sda_low : pull the line low
    sda : level of the line, asynchronous

    Raises
    ------
    ValueError
        A parameter is out of range.
    """

    def __init__(self, device: int, address_bytes: int, quarter_clocks: int) -> None:
        if not 0 <= device <= 127:
            raise ValueError(f"device is {device}; 0 to 127 are possible")
        if address_bytes not in (1, 2):
            raise ValueError(f"address_bytes is {address_bytes}; 1 and 2 are possible")
        if quarter_clocks < 4:
            raise ValueError(f"quarter_clocks is {quarter_clocks}; 4 and more are possible")
        self.device = device
        self.address_bytes = address_bytes
        self.quarter_clocks = quarter_clocks
        super().__init__(
            {
                "i": In(stream.Signature(Request)),
                "done": Out(1),
                "data": Out(8),
                "acknowledged": Out(1),
                "scl_low": Out(1),
                "sda_low": Out(1),
                "sda": In(1, init=1),
            }
        )

    def elaborate(self, platform):
        m = Module()
        sda = Signal(init=1)
        m.submodules.synchronizer = FFSynchronizer(self.sda, sda, init=1)
        request = Signal(Request)
        fetching = Signal()  # the second transmission of a read

        # A bit has four quarters: the clock is high in the two in the middle.
        divider = Signal(range(self.quarter_clocks))
        quarter = Signal(2)
        step = Signal()
        bit_over = Signal()
        m.d.comb += [step.eq(divider == self.quarter_clocks - 1), bit_over.eq(step & (quarter == 3))]
        m.d.sync += divider.eq(Mux(step, 0, divider + 1))
        m.d.sync += quarter.eq(quarter + step)

        bits = Signal(9)  # the next is the highest; the ninth is left to the slave
        left = Signal(range(9))
        position = Signal(range(4))  # of the byte in its transmission
        last = Signal()
        following = Signal(8)  # the byte after this one
        address = [request.address[8:], request.address[:8]][2 - self.address_bytes :]
        m.d.comb += last.eq(Mux(fetching, position == 1, position == self.address_bytes + ~request.read))
        with m.Switch(position):
            for number, byte in enumerate([*address, request.data]):
                with m.Case(number):
                    m.d.comb += following.eq(Mux(fetching, 0xFF, byte))

        clock = Signal(init=1)
        line = Signal(init=1)
        m.d.sync += [self.scl_low.eq(~clock), self.sda_low.eq(~line)]
        high = (quarter == 1) | (quarter == 2)
        m.d.sync += self.done.eq(0)
        with m.FSM():
            with m.State("Wait"):
                m.d.comb += self.i.ready.eq(1)
                m.d.sync += [divider.eq(0), quarter.eq(0), fetching.eq(0)]
                with m.If(self.i.valid):
                    m.d.sync += [request.eq(self.i.payload), self.acknowledged.eq(1)]
                    m.next = "Start"
            with m.State("Start"):
                # The line falls in the middle of a high clock.
                m.d.comb += [clock.eq(quarter != 3), line.eq(quarter < 2)]
                m.d.sync += [
                    bits.eq(Cat(Const(1, 1), fetching, Const(self.device, 7))),
                    left.eq(8),
                    position.eq(0),
                ]
                with m.If(bit_over):
                    m.next = "Byte"
            with m.State("Byte"):
                m.d.comb += [clock.eq(high), line.eq(bits[-1])]
                with m.If(step & (quarter == 2)):
                    with m.If(left == 0):
                        own = fetching & (position == 1)  # the ninth bit of what was read
                        m.d.sync += self.acknowledged.eq(self.acknowledged & (~sda | own))
                    with m.Elif(fetching & (position == 1)):
                        m.d.sync += self.data.eq(Cat(sda, self.data))
                with m.If(bit_over):
                    m.d.sync += [bits.eq(Cat(Const(1, 1), bits)), left.eq(left - 1)]
                    with m.If(left == 0):
                        m.d.sync += [bits.eq(Cat(Const(1, 1), following)), left.eq(8), position.eq(position + 1)]
                        with m.If(last):
                            m.next = "Stop"
            with m.State("Stop"):
                # The line rises in the middle of a high clock, and stays so for a bit.
                m.d.comb += [clock.eq(quarter != 0), line.eq(quarter >= 2)]
                with m.If(bit_over):
                    m.next = "Free"
            with m.State("Free"):
                with m.If(bit_over):
                    m.d.sync += fetching.eq(1)
                    with m.If(request.read & ~fetching):
                        m.next = "Start"
                    with m.Else():
                        m.d.sync += self.done.eq(1)
                        m.next = "Wait"
        return m
