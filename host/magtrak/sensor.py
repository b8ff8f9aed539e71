"""What a card tells of its camera's bus, set-up and timing, in people's words."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from .protocol import CAMERA_ROW, CAMERA_SETUP, CAMERA_STATE, IMAGE_SIZES, ROW_CLOCKS, Sensor, SetupCause

REGISTERS = (
    "camera_state",
    "camera_setup",
    "camera_row",
    "camera_rows",
    "camera_rate",
    "camera_exposure",
    "camera_gain",
)


@dataclass(frozen=True)
class SensorReport:
    """The registers of the camera, read, and the card's clock in Hz."""

    values: Mapping[str, int]
    clock_hz: float

    @property
    def sensor(self) -> Sensor | int:
        """Which camera it is; a number where this host does not know it."""
        number = self._state["sensor"]
        return Sensor(number) if number in list(Sensor) else number

    @property
    def name(self) -> str:
        """As its maker calls it."""
        kind = self.sensor
        if kind == Sensor.DVP:
            return "a camera without set-up"
        if kind == Sensor.RGB:
            return "parallel video"
        return kind.name if isinstance(kind, Sensor) else f"camera number {kind}"

    @property
    def present(self) -> bool:
        """Whether the images come from a camera's bus at all."""
        return self.sensor != Sensor.NONE

    @property
    def clock_mhz(self) -> float:
        """The pixel clock as measured, to 0.2 % of the card's."""
        return self.values["camera_rate"] * self.clock_hz / 512e6

    def text(self) -> str:
        """In a line."""
        if not self.present:
            return "none: images come from within the card"
        troubles = [bad for _, well, _, bad in self.looks() if not well]
        if troubles:
            return f"{self.name}: {troubles[0]}"
        return f"{self.name}, {self._size()}, pixel clock {self.clock_mhz:.1f} MHz{self._exposure()}"

    def looks(self) -> Iterator[tuple[str, bool, str, str]]:
        """What was looked at, whether it is well, and what to say if it is, or if it is not."""
        if not self.present:
            return
        state = self._state
        yield (
            "camera clock",
            not state["clock_missing"],
            f"{self.clock_mhz:.1f} MHz",
            "no pixel clock: check the camera's power, its input clock (XCLK) and the wire PCLK",
        )
        failures = self._setup["failures"]
        again = f", after {failures} set-ups that failed: check the wires SCL and SDA" if failures else ""
        # What is said of the bus alone means nothing while there is no clock: cameras answer only with theirs.
        yield "camera set-up", bool(state["ready"]), f"{self.name} is set up{again}", self._failure()
        wanted = IMAGE_SIZES.get(self.sensor) if isinstance(self.sensor, Sensor) else None
        seen = self._size()
        if self.values["camera_rows"]:
            size = f"{wanted[0]} x {wanted[1]}" if wanted else ""
            right = wanted is None or seen == size
            cure = "check HREF, VSYNC and their polarity"
            yield "camera image", right, seen, f"the last image had {seen}, not {size}: {cure}"
        counts = (
            (state["cut"], "images cut because the pixel clock is too fast for the card: lower it"),
            (state["broken"], "rows with half a pixel, or cut short: check PCLK and HREF for noise, shorten the wires"),
            (state["unsteady"], "images with uneven rows, or other rows than the one before: check HREF and VSYNC"),
        )
        faults = [f"{number} {what}" for number, what in counts if number]
        yield "camera timing", not faults, "steady", "; ".join(faults)

    @property
    def _state(self) -> dict[str, int]:
        return CAMERA_STATE.unpack(self.values["camera_state"].to_bytes(CAMERA_STATE.size, "little"))

    @property
    def _setup(self) -> dict[str, int]:
        return CAMERA_SETUP.unpack(self.values["camera_setup"].to_bytes(CAMERA_SETUP.size, "little"))

    def _size(self) -> str:
        row = CAMERA_ROW.unpack(self.values["camera_row"].to_bytes(CAMERA_ROW.size, "little"))
        rows = self.values["camera_rows"]
        if not rows:
            return "no image yet"
        if row["shortest"] != row["longest"]:
            return f"{rows} rows of {row['shortest']} to {row['longest']} px"
        return f"{row['longest']} x {rows}"

    def _exposure(self) -> str:
        """As set; in ms where the length of a row is known."""
        if self.sensor not in IMAGE_SIZES:
            return ""
        rows, gain = self.values["camera_exposure"], self.values["camera_gain"] / 16
        clocks = ROW_CLOCKS.get(Sensor(self.sensor))
        time = f" ({rows * clocks / self.clock_mhz / 1e3:.2f} ms)" if clocks and self.clock_mhz else ""
        return f", exposure {rows} rows{time}, gain {gain:.2f}"

    def _failure(self) -> str:
        """Why it is not set up, and what to do."""
        setup = self._setup
        at, read = f"0x{setup['address']:02X}", f"0x{setup['read']:02X}"
        cause = setup["cause"]
        if cause == SetupCause.ACKNOWLEDGE:
            return f"{self.name} does not answer (register {at}): check SCL, SDA, their pull-ups, power and XCLK"
        if cause == SetupCause.IDENTITY and setup["read"] == 0xFF and self._state["unacknowledged"]:
            return f"{self.name} does not answer: check SCL, SDA, their pull-ups, power and XCLK"
        if cause == SetupCause.IDENTITY:
            return f"the camera is no {self.name}: its register {at} reads {read}; use the bitstream for the one it is"
        if cause == SetupCause.READ_BACK:
            return f"register {at} of {self.name} does not keep what is written (it reads {read}): check its power"
        return f"{self.name} is being set up: look again in a second"
