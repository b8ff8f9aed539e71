"""Sets a camera up from its table, and keeps its exposure and gain as the host wants them."""

from amaranth.hdl import Cat, Const, Module, Mux, Signal
from amaranth.lib import data, memory, wiring
from amaranth.lib.wiring import In, Out

from magtrak.protocol import SetupCause

from ..layouts import CameraSetup
from .sccb import Sccb
from .sensor import Check, SensorTable

WAIT_MS = 10
"""After power-up, and after a step that waits: more than any camera here needs after a reset (OV5640: 5 ms)."""

RESTART_MS = 1000
"""From a failure to the next try."""

ATTEMPTS = 3
"""Times that a register is written, or checked, before the set-up fails."""


class _Step(data.Struct):
    address: 16
    data: 8
    mask: 8
    check: 1
    wait: 1


class Setup(wiring.Component):
    """Runs the steps of a table once after reset, then the controls, and these again whenever exposure or gain change.

    Whatever is written is read back, and written again if it differs. After :data:`ATTEMPTS` it fails: ``ready`` falls,
    ``setup`` tells where and why, and after :data:`RESTART_MS` all begins anew, so that a camera that was plugged in
    late gets its set-up. The controls are written one after the other: an image in between may have old and new ones.

    Parameters
    ----------
    table : the kind of camera
    clock_hz : frequency of the ``sync`` domain
    bus_hz : of SCL; 100 kHz is what all cameras and wires take

    Members
    -------
    exposure, gain : wanted; rows, and 1/16
    ready : all is written, and was read back
    setup : the last failure, kept; and how many there were
    unacknowledged : a byte was not acknowledged since reset
    scl_low, sda_low, sda : as in :class:`~gateware.camera.sccb.Sccb`
    """

    def __init__(self, table: SensorTable, clock_hz: int, bus_hz: int = 100_000) -> None:
        self.table = table
        self.clock_hz = clock_hz
        self.sccb = Sccb(table.device, table.address_bytes, max(4, -(-clock_hz // (4 * bus_hz))))
        super().__init__(
            {
                "exposure": In(16),
                "gain": In(10),
                "ready": Out(1),
                "setup": Out(CameraSetup),
                "unacknowledged": Out(1),
                "scl_low": Out(1),
                "sda_low": Out(1),
                "sda": In(1, init=1),
            }
        )

    def _steps(self) -> list[dict[str, int]]:
        table = self.table
        steps = [
            {
                "address": s.address,
                "data": s.data,
                "mask": s.mask,
                "check": isinstance(s, Check),
                "wait": not isinstance(s, Check) and s.wait,
            }
            for s in table.steps
        ]
        return steps + [
            {"address": c.address, "data": c.data, "mask": 0xFF, "check": 0, "wait": 0} for c in table.controls
        ]

    def elaborate(self, platform):
        m = Module()
        m.submodules.sccb = sccb = self.sccb
        steps = self._steps()
        m.submodules.steps = table = memory.Memory(shape=_Step, depth=len(steps), init=steps)
        port = table.read_port()
        index = Signal(range(len(steps) + 1))
        m.d.comb += [port.addr.eq(index), port.en.eq(1)]
        step = Signal(_Step)

        exposure = Signal(16)  # as written
        gain = Signal(10)  # as written
        control = Signal(8)  # what they add to the step's data
        values = {"exposure": exposure, "gain": self._code(m, gain)}
        with m.Switch(index):
            for number, one in enumerate(self.table.controls):
                with m.Case(len(self.table.steps) + number):
                    part = one.part
                    m.d.comb += control.eq(values[part.value][part.low : part.low + part.bits] << part.at)

        m.d.comb += [
            self.scl_low.eq(sccb.scl_low),
            self.sda_low.eq(sccb.sda_low),
            sccb.sda.eq(self.sda),
            sccb.i.p.address.eq(step.address),
            sccb.i.p.data.eq(step.data),
        ]
        prescaler = Signal(range(max(2, self.clock_hz // 1000)))
        waited = Signal(range(RESTART_MS))  # ms
        attempt = Signal(range(ATTEMPTS))
        differs = Signal()
        m.d.comb += differs.eq(((sccb.data ^ step.data) & step.mask) != 0)

        def wait(milliseconds: int, state: str) -> None:
            with m.If(prescaler != self.clock_hz // 1000 - 1):
                m.d.sync += prescaler.eq(prescaler + 1)
            with m.Else():
                m.d.sync += [prescaler.eq(0), waited.eq(waited + 1)]
                with m.If(waited == milliseconds - 1):
                    m.d.sync += waited.eq(0)
                    m.next = state

        def fail(cause) -> None:
            """Once more, or for good."""
            m.next = "Again"
            m.d.sync += [attempt.eq(attempt + 1)]
            with m.If(attempt == ATTEMPTS - 1):
                m.d.sync += [
                    self.ready.eq(0),
                    attempt.eq(0),
                    self.setup.address.eq(step.address),
                    self.setup.read.eq(sccb.data),
                    self.setup.cause.eq(cause),
                    self.setup.failures.eq(self.setup.failures + ~self.setup.failures.all()),
                ]
                m.next = "Failed"

        refused = ~sccb.acknowledged & self.table.acknowledges
        with m.If(sccb.done & ~sccb.acknowledged):
            m.d.sync += self.unacknowledged.eq(1)
        with m.FSM():
            with m.State("Power"):
                wait(WAIT_MS, "Begin")
            with m.State("Begin"):
                m.d.sync += [index.eq(0), exposure.eq(self.exposure), gain.eq(self.gain)]
                m.next = "Fetch"
            with m.State("Fetch"):
                m.next = "Load"
            with m.State("Load"):
                m.d.sync += [step.eq(port.data), step.data.eq(port.data.data | control)]
                m.next = "Again"
            with m.State("Again"):
                m.next = "Write"
                with m.If(step.check):
                    m.next = "Read"
            with m.State("Write"):
                m.d.comb += sccb.i.valid.eq(1)
                m.next = "Written"
            with m.State("Written"):
                with m.If(sccb.done):
                    m.next = "Read"
                    with m.If(refused):
                        fail(SetupCause.ACKNOWLEDGE)
                    with m.Elif(step.mask == 0):
                        m.next = "Next"
            with m.State("Read"):
                m.d.comb += [sccb.i.valid.eq(1), sccb.i.p.read.eq(1)]
                m.next = "Compare"
            with m.State("Compare"):
                with m.If(sccb.done):
                    m.next = "Next"
                    with m.If(refused):
                        fail(SetupCause.ACKNOWLEDGE)
                    with m.Elif(differs):
                        fail(Mux(step.check, SetupCause.IDENTITY.value, SetupCause.READ_BACK.value))
            with m.State("Next"):
                m.d.sync += [attempt.eq(0), index.eq(index + 1)]
                m.next = "Fetch"
                with m.If(step.wait):
                    m.next = "Wait"
                with m.Elif(index == len(steps) - 1):
                    m.next = "Ready"
            with m.State("Wait"):
                wait(WAIT_MS, "Fetch")
            with m.State("Ready"):
                m.d.sync += self.ready.eq(1)
                with m.If((exposure != self.exposure) | (gain != self.gain)):
                    m.d.sync += [exposure.eq(self.exposure), gain.eq(self.gain), index.eq(len(self.table.steps))]
                    m.next = "Fetch"
            with m.State("Failed"):
                wait(RESTART_MS, "Begin")
        return m

    def _code(self, m: Module, gain: Signal) -> Signal:
        """What stands in the camera for ``gain``; :meth:`SensorTable.gain_code` is the definition."""
        most = self.table.gain_doublings
        if most is None:
            return gain
        code = Signal(10)
        for doublings in range(6):
            # The highest bit that is set decides: later statements win.
            with m.If(gain[doublings + 4]):
                if doublings <= most:
                    m.d.comb += code.eq(Cat(gain[doublings : doublings + 4], Const((1 << doublings) - 1, 6)))
                else:
                    m.d.comb += code.eq((1 << most) - 1 << 4 | 15)
        return code
