"""Serial line, 8N1: a low start bit, eight data bits with the lowest first, a high stop bit.

Bits are timed by a phase that grows by a constant each clock and wraps once a bit, so that any rate
can be had to within clock / 2**21. It begins with each byte: bit k of a byte comes ceil(k * clocks per bit) clocks
after its start bit.
"""

from amaranth.hdl import Cat, Const, Module, Signal
from amaranth.lib import wiring
from amaranth.lib.cdc import FFSynchronizer
from amaranth.lib.fifo import SyncFIFOBuffered
from amaranth.lib.wiring import In, Out, connect, flipped

from ..layouts import Bytes

_PHASE_BITS = 20

ROOM = 16
"""Bytes that may still come after ``rts`` fell."""


def _step(clock_hz: float, baud: float, least: int) -> int:
    """Growth of the phase per clock, in 2**-20 bits; :exc:`ValueError` below ``least`` clocks a bit."""
    if baud <= 0 or clock_hz < least * baud:
        raise ValueError(f"baud is {baud:g}; up to {clock_hz / least:g} is possible with a clock of {clock_hz:g} Hz")
    return max(1, round((baud << _PHASE_BITS) / clock_hz))


class UartTransmitter(wiring.Component):
    """Bytes to a serial line.

    Throughput: a byte every 10 bits, rounded up to a whole number of clocks. Latency: the start bit begins a clock
    after the byte was taken.

    Parameters
    ----------
    clock_hz : frequency of the ``sync`` domain
    baud : bits per second, at most a third of ``clock_hz``

    Members
    -------
    i : bytes
    tx : line, high while idle

    Raises
    ------
    ValueError
        The clock is too slow for the rate.
    """

    def __init__(self, clock_hz: int, baud: int) -> None:
        self.step = _step(clock_hz, baud, 3)
        self.clock_hz = clock_hz
        self.baud = baud
        super().__init__({"i": In(Bytes), "tx": Out(1, init=1)})

    def elaborate(self, platform):
        m = Module()
        bits = Signal(10)  # the one on the line is the lowest
        left = Signal(range(11))
        phase = Signal(_PHASE_BITS)
        following = Signal(_PHASE_BITS + 1)
        idle = left == 0
        m.d.comb += [
            following.eq(phase + self.step),
            self.i.ready.eq(idle | ((left == 1) & following[-1])),
            self.tx.eq(bits[0] | idle),
        ]
        m.d.sync += phase.eq(following)
        with m.If(self.i.valid & self.i.ready):
            m.d.sync += [bits.eq(Cat(Const(0, 1), self.i.payload, Const(1, 1))), left.eq(10), phase.eq(0)]
        with m.Elif(following[-1] & ~idle):
            m.d.sync += [bits.eq(bits >> 1), left.eq(left - 1)]
        return m


class UartReceiver(wiring.Component):
    """Bytes from a serial line.

    Every bit is the majority of three clocks at its middle. The falling edge of the start bit sets the
    phase, so the two ends may differ by what moves the stop bit's middle by less than half a bit, less what edges are
    late: 1.3 % from 4 clocks a bit on, 3.3 % from 8 on, 2 % on either side from 13 on.
    (``tests/gateware/test_link_uart.py`` tries every rate, ``tests/formal/test_uart.py`` proves three.)

    Latency: the byte is there at the middle of its stop bit, and 4 clocks.

    Parameters
    ----------
    clock_hz : frequency of the ``sync`` domain
    baud : bits per second, at most a quarter of ``clock_hz``

    Members
    -------
    rx : line, asynchronous
    o : bytes; one that is not taken until the next is complete is lost
    errors : bytes lost for want of a stop bit, or because the one before was not taken; stays at 65535

    Raises
    ------
    ValueError
        The clock is too slow for the rate.
    """

    def __init__(self, clock_hz: int, baud: int) -> None:
        self.step = _step(clock_hz, baud, 4)
        self.clock_hz = clock_hz
        self.baud = baud
        super().__init__({"rx": In(1, init=1), "o": Out(Bytes), "errors": Out(16)})

    def elaborate(self, platform):
        m = Module()
        line = Signal(init=1)
        m.submodules.synchronizer = FFSynchronizer(self.rx, line, init=1)

        # The majority of the last three clocks: its middle one is a clock ago.
        past = Signal(3, init=0b111)
        m.d.sync += past.eq(Cat(line, past))
        level = (past[0] & past[1]) | (past[1] & past[2]) | (past[0] & past[2])

        # `level` tells the start bit two clocks after `line` does, and the phase starts a clock later. With half a step
        # more than half a bit, bit k is read around clock ceil((k + 0.5) * clocks per bit - 0.5) of its byte, counted
        # from the first low one: midway between the latest that it may begin and the earliest that it may end.
        phase = Signal(_PHASE_BITS, init=(1 << (_PHASE_BITS - 1)) + self.step // 2)
        following = Signal(_PHASE_BITS + 1)
        bits = Signal(8)
        left = Signal(range(10))
        lost = Signal()
        m.d.comb += following.eq(phase + self.step)
        m.d.sync += phase.eq(following)
        with m.If(self.o.ready):
            m.d.sync += self.o.valid.eq(0)

        with m.FSM():
            with m.State("Idle"):
                # Half a bit more, so that the phase wraps at the middles.
                m.d.sync += [phase.eq(phase.init), left.eq(9)]
                with m.If(~level):
                    m.next = "Start"
            with m.State("Start"):
                with m.If(following[-1]):
                    m.next = "Bits"
                    with m.If(level):  # too short for a start bit
                        m.next = "Idle"
            with m.State("Bits"):
                with m.If(following[-1]):
                    m.d.sync += left.eq(left - 1)
                    with m.If(left != 1):
                        m.d.sync += bits.eq(Cat(bits[1:], level))
                    with m.Elif(level):
                        m.next = "Idle"
                        with m.If(self.o.valid & ~self.o.ready):
                            m.d.comb += lost.eq(1)
                        with m.Else():
                            m.d.sync += [self.o.valid.eq(1), self.o.payload.eq(bits)]
                    with m.Else():
                        m.d.comb += lost.eq(1)
                        m.next = "Break"
            with m.State("Break"):
                with m.If(level):
                    m.next = "Idle"

        with m.If(lost & ~self.errors.all()):
            m.d.sync += self.errors.eq(self.errors + 1)
        return m


class Uart(wiring.Component):
    """Both directions of a serial line, with flow control where it is wanted.

    With it, ``rts`` tells the other end to stop while fewer than :data:`ROOM` bytes would find room, which is what
    adapters may still send then, and ``cts`` low holds back the next byte.

    Parameters
    ----------
    clock_hz, baud : as in :class:`UartReceiver`
    flow_control : without it, ``rts`` is high and ``cts`` is ignored

    Members
    -------
    rx, tx : lines
    rts : the other end may send
    cts : this end may send, asynchronous
    o : bytes received
    i : bytes to send
    errors : bytes lost, as in :class:`UartReceiver`

    Raises
    ------
    ValueError
        The clock is too slow for the rate.
    """

    def __init__(self, clock_hz: int, baud: int, *, flow_control: bool = False) -> None:
        self.receiver = UartReceiver(clock_hz, baud)
        self.transmitter = UartTransmitter(clock_hz, baud)
        self.flow_control = flow_control
        super().__init__(
            {
                "rx": In(1, init=1),
                "tx": Out(1, init=1),
                "rts": Out(1),
                "cts": In(1),
                "o": Out(Bytes),
                "i": In(Bytes),
                "errors": Out(16),
            }
        )

    def elaborate(self, platform):
        m = Module()
        m.submodules.receiver = receiver = self.receiver
        m.submodules.transmitter = transmitter = self.transmitter
        m.d.comb += [
            receiver.rx.eq(self.rx),
            self.tx.eq(transmitter.tx),
            self.errors.eq(receiver.errors),
        ]
        if not self.flow_control:
            m.d.comb += self.rts.eq(1)
            connect(m, receiver.o, flipped(self.o))
            connect(m, flipped(self.i), transmitter.i)
            return m

        m.submodules.fifo = fifo = SyncFIFOBuffered(width=8, depth=2 * ROOM)
        connect(m, receiver.o, fifo.w_stream)
        connect(m, fifo.r_stream, flipped(self.o))
        m.d.sync += self.rts.eq(fifo.level < ROOM)
        may_send = Signal()
        m.submodules.synchronizer = FFSynchronizer(self.cts, may_send)
        m.d.comb += [
            transmitter.i.payload.eq(self.i.payload),
            transmitter.i.valid.eq(self.i.valid & may_send),
            self.i.ready.eq(transmitter.i.ready & may_send),
        ]
        return m
