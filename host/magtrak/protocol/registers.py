"""The register map.

Registers are 32 bits wide at word addresses. A narrower value stands in the
low bits; a signed one is sign-extended to 32. Three scopes:

``NOW``
    takes effect when written.
``FRAME``
    settings of the measurement: kept aside until ``commit`` is written, then in
    force, all at once, from the first pixel of the next frame. Reading gives
    what is in force. Writing a setting while a commit waits withdraws that
    commit: write ``commit`` again.
``CARD``
    read only: what the card is, or measures.
"""

import enum
import zlib
from dataclasses import dataclass

from . import camera, packets
from .packets import SnapshotSource

VERSION = 1
"""Version of the protocol. A host refuses a card of another version."""

MAGIC = 0x4B54474D
"""Register 0 of every card: "MGTK" in ASCII, first character in the lowest byte."""

LASER_KEY = 0x1A5E
"""What has to be written to ``laser_arm``; anything else disarms."""

LUT_WORDS = 8
"""Words of a gate table: 256 entries of one bit, entry i is bit i % 32 of word i // 32."""


class Access(enum.Enum):
    READ = "read"
    WRITE = "write"
    BOTH = "read, write"


class Scope(enum.Enum):
    NOW = "now"
    FRAME = "frame"
    CARD = "card"


class Detector(enum.IntEnum):
    """How a row's position is measured."""

    BINARY = 0  # the paper's: mean column of all gated pixels
    FIR = 1  # zero crossing of the smoothed derivative
    CENTROID = 2  # mean column by grey value: of the run, or of a window about the crossing
    MAXIMUM = 3  # column of the greatest weight of the run


class Choice(enum.IntEnum):
    """Which of a row's runs counts."""

    STRONGEST = 0
    FIRST = 1
    LAST = 2
    WIDEST = 3
    NEAREST = 4  # to the last row of the image that had a line; the strongest where there is none


class Window(enum.IntEnum):
    """Over which columns a centroid goes."""

    RUN = 0
    HALF_7 = 1
    HALF_15 = 2
    HALF_31 = 3


class AmbientMode(enum.IntEnum):
    """How images without laser are taken, whose light is subtracted from the others."""

    OFF = 0
    ALTERNATE = 1  # one background, then ambient_measured images
    SKIP = 2  # likewise, with an image left out where the laser is switched: it holds some of both


class IndexPolicy(enum.IntEnum):
    """What a pass of the index does to the zero of the angle. The count runs on: the edges of a frame need that."""

    RESET = 0  # each pass is the zero anew
    LATCH = 1  # none moves it; passes are latched and checked
    FIRST = 2  # the first one since the policy was written is the zero


class MotorMode(enum.IntEnum):
    """What the motor does."""

    OFF = 0
    DUTY = 1  # open loop, motor_duty
    SPEED = 2  # turns at motor_speed
    SWEEP = 3  # between sweep_low and sweep_high
    SEARCH = 4  # turns until the index passes, then stands


class Bridge(enum.IntEnum):
    """What the motor's H-bridge wants."""

    SIGN_MAGNITUDE = 0
    LOCKED_ANTIPHASE = 1


class MotorCause(enum.IntEnum):
    """What stopped the motor."""

    NONE = 0
    STALL = 1
    RUNAWAY = 2
    ENCODER = 3
    TURN = 4
    INDEX_MISSING = 5
    SEARCH = 6
    LEASE = 7


class LaserCause(enum.IntEnum):
    """Why the laser is not armed."""

    NEVER_ARMED = 0
    COMMAND = 1
    INTERLOCK = 2
    LEASE = 3
    MOTOR = 4


@dataclass(frozen=True)
class Register:
    """One register, or a table of ``words`` registers at consecutive addresses.

    Parameters
    ----------
    name : identifier
    address : word address
    bits : width of the value, 1 to 32
    scope : when a written value takes effect
    access : what the host may do
    doc : what it means, one sentence
    unit : unit or fixed-point format
    init : value after reset
    signed : two's complement
    low, high : values accepted; others are refused as out of range. By default
        all that ``bits`` can hold.
    words : number of registers
    """

    name: str
    address: int
    bits: int
    scope: Scope
    access: Access
    doc: str
    unit: str = ""
    init: int = 0
    signed: bool = False
    low: int | None = None
    high: int | None = None
    words: int = 1

    @property
    def range(self) -> tuple[int, int]:
        """Smallest and largest value accepted."""
        if self.signed:
            low, high = -(1 << (self.bits - 1)), (1 << (self.bits - 1)) - 1
        else:
            low, high = 0, (1 << self.bits) - 1
        return low if self.low is None else self.low, high if self.high is None else self.high

    def encode(self, value: int) -> int:
        """The 32-bit word for ``value``; :exc:`ValueError` where it is out of range."""
        low, high = self.range
        if not low <= value <= high:
            raise ValueError(f"register {self.name} takes {low} to {high}, not {value}")
        return value & 0xFFFF_FFFF

    def decode(self, word: int) -> int:
        """The value of a 32-bit word as read."""
        value = word & ((1 << self.bits) - 1)
        if self.signed and value >> (self.bits - 1):
            value -= 1 << self.bits
        return value


def _card(name: str, address: int, bits: int, doc: str, unit: str = "", *, signed: bool = False) -> Register:
    return Register(name, address, bits, Scope.CARD, Access.READ, doc, unit, signed=signed)


def _now(name: str, address: int, bits: int, doc: str, unit: str = "", **more: int) -> Register:
    return Register(name, address, bits, Scope.NOW, Access.BOTH, doc, unit, **more)  # type: ignore[arg-type]


def _frame(name: str, address: int, bits: int, doc: str, unit: str = "", **more: int) -> Register:
    return Register(name, address, bits, Scope.FRAME, Access.BOTH, doc, unit, **more)  # type: ignore[arg-type]


FEATURES = (
    "isolate",
    "window",
    "speed_loop",
    "snapshot",
    "runs",
    "edge_log",
    "full_rows",
    "turn_check",
    "pwm_period",
    "notes",
)
"""What a card may be built without, by its bit in the register ``features``."""


REGISTERS: tuple[Register, ...] = (
    # What the card is.
    _card("magic", 0x0000, 32, "0x4B54474D; any other value: not a Magtrak card"),
    _card("version", 0x0001, 16, "version of the protocol"),
    _card("map_hash", 0x0002, 32, "CRC-32 of the register map and packet layouts of the gateware"),
    _card("clock_hz", 0x0003, 32, "frequency of the card's clock, in which all times count", "Hz"),
    _card("max_columns", 0x0004, 16, "columns that an image may have", "px"),
    _card(
        "max_rows",
        0x0005,
        16,
        "rows of an image that the card stores in the full form; in the compact form four times as many, up to 2048",
        "px",
    ),
    _card("serial_low", 0x0006, 32, "serial number of the card, lower half; 0 in both halves: it has none"),
    _card("serial_high", 0x0007, 32, "upper half"),
    _card("link_baud", 0x0008, 32, "rate of the card's UART; 0: another kind of link", "baud"),
    _card("features", 0x0009, 16, "what it is built with, a bit each: " + ", ".join(FEATURES)),
    # Acquisition.
    _now("run", 0x0010, 1, "1: images are measured and sent, from the next whole one on"),
    _now("form", 0x0011, 1, "a RowForm: 0 compact, 1 full rows", init=1),
    Register(
        "commit",
        0x0012,
        16,
        Scope.NOW,
        Access.WRITE,
        "puts the settings written so far in force at the next frame, under this generation number",
    ),
    _card("generation", 0x0013, 16, "generation in force"),
    _card("pending", 0x0014, 1, "1: a commit waits for the next frame"),
    _card("frames", 0x0015, 32, "images seen since reset"),
    _card("dropped", 0x0016, 32, "images dropped because no buffer was free"),
    _card("damaged_commands", 0x0017, 16, "commands that were not intact, saturating"),
    _card("camera_errors", 0x0018, 8, "every camera error since reset: see camera errors"),
    _card("line_errors", 0x0019, 16, "bytes from the host that the physical link lost, saturating"),
    _card("commands", 0x001A, 16, "intact commands since reset, modulo 65536"),
    # Settings of the measurement.
    _frame("weight_r", 0x0100, 10, "weight of red", "1/256", signed=True, init=85),
    _frame("weight_g", 0x0101, 10, "weight of green", "1/256", signed=True, init=86),
    _frame("weight_b", 0x0102, 10, "weight of blue", "1/256", signed=True, init=85),
    _frame("floor", 0x0103, 8, "subtracted from the mix: only what is above belongs to a run", "grey levels", init=20),
    _frame("run_gated", 0x0104, 12, "gated pixels that a run needs in it or within reach", "px", init=1),
    _frame("run_reach", 0x0105, 4, "how far from a run gated pixels count for it", "px", init=8),
    _frame("run_bridge", 0x0106, 4, "longest gap that does not end a run", "px"),
    _frame("run_width_min", 0x0107, 12, "narrowest run that counts", "px", init=1),
    _frame("run_width_max", 0x0108, 12, "widest run that counts", "px", init=4095),
    _frame("column_first", 0x0109, 12, "first column of the region of interest", "px"),
    _frame("column_last", 0x010A, 12, "last column of the region of interest", "px", init=4095),
    _frame("row_first", 0x010B, 12, "first row of the region of interest", "px"),
    _frame("row_last", 0x010C, 12, "last row of the region of interest", "px", init=4095),
    _frame("detector", 0x010D, 3, "a Detector", init=int(Detector.FIR), high=max(Detector)),
    _frame("choice", 0x010E, 3, "a Choice", high=max(Choice)),
    _frame(
        "ambiguous_ratio",
        0x010F,
        8,
        "a runner-up of at least this part of the peak's strength (fir: contrast, binary: sum) makes a row ambiguous",
        "1/256",
        init=96,
    ),
    _frame(
        "ambient_mode",
        0x0120,
        2,
        "an AmbientMode: 0 off, 1 alternate laser on and off, 2 with a skipped image at each change",
        high=max(AmbientMode),
    ),
    _frame("ambient_measured", 0x0121, 8, "measured images to one background", "images", init=1, low=1),
    _card("background_cells", 0x0122, 24, "blocks of pixels that the background may have"),
    _frame("exposure_us", 0x0110, 32, "exposure of the camera; only passed on in each frame", "us"),
    _frame(
        "time_offset_ns",
        0x0111,
        32,
        "added to the calibration's time offset by the host; only passed on",
        "ns",
        signed=True,
    ),
    _frame("isolate", 0x0112, 4, "gated neighbours of 8 that a gated pixel needs to stay; 0: all stay", high=8),
    _frame("centroid_window", 0x0113, 2, "a Window: 0 the run, 1 to 3: 7, 15, 31 columns to each side", init=1),
    _frame(
        "centroid_base",
        0x0114,
        4,
        "part of the window's greatest mix that its base lies above the brighter of its ends",
        "1/16",
        init=2,
    ),
    *(
        Register(
            f"lut_{axis}",
            0x0200 + 0x10 * number,
            32,
            Scope.FRAME,
            Access.WRITE,
            f"gate table of {axis}: bit set, colour passes; a commit brings it in force if it was written since it last"
            " came in force, all its words",
            words=LUT_WORDS,
        )
        for number, axis in enumerate(("hue", "luminance", "saturation"))
    ),
    # Encoder and index barrier.
    _now("encoder_filter", 0x0300, 8, "clocks that A, B and index must be stable to count", "clocks", init=3),
    _now("encoder_swap", 0x0301, 1, "1: swap A and B, which reverses the direction"),
    _now("index_invert", 0x0302, 1, "1: the index barrier is active low"),
    _now("counts_per_turn", 0x0303, 24, "encoder counts of one turn, to check every turn; 0: no check", "counts"),
    _card("count", 0x0304, 32, "encoder count", "counts", signed=True),
    _card("index_count", 0x0305, 32, "the zero of the angle, a count, as index_policy has it", "counts", signed=True),
    _card("index_passes", 0x0306, 16, "passes of the index since reset, modulo 65536"),
    _card("encoder_errors", 0x0307, 32, "see encoder errors"),
    _now("index_policy", 0x0308, 2, "an IndexPolicy: 0 reset, 1 latch only, 2 first pass only", high=max(IndexPolicy)),
    _card("pass_count", 0x0309, 32, "count at the last pass of the index", "counts", signed=True),
    _card("index_difference", 0x030A, 32, "counts by which the last turn was off", "counts", signed=True),
    _card("speed", 0x030B, 32, "speed of the encoder", "1/256 counts/s", signed=True),
    # Motor.
    _now("motor_period", 0x0320, 16, "period of the PWM, at least 16", "clocks", init=1024, low=16),
    _now("motor_duty", 0x0321, 16, "duty and direction", "1/32768", signed=True, low=-32767),
    _now("motor_brake", 0x0322, 1, "1: brake output on, PWM off"),
    _now("motor_mode", 0x0323, 3, "a MotorMode; 0 also lets a motor that was stopped start again", high=max(MotorMode)),
    _now("motor_bridge", 0x0324, 1, "a Bridge: 0 sign-magnitude, 1 locked anti-phase"),
    _now("motor_speed", 0x0325, 32, "speed wanted", "1/256 counts/s", signed=True, low=-(2**31) + 1),
    _now(
        "motor_acceleration",
        0x0326,
        24,
        "the most by which the wanted speed changes",
        "1/256 counts/s per ms",
        init=256,
    ),
    _now("motor_kp", 0x0327, 24, "proportional gain", "1/65536 duty (1/32768) per count/s"),
    _now("motor_ki", 0x0328, 24, "integral gain, per ms", "1/65536 duty (1/32768) per count/s"),
    _now("motor_kff", 0x0329, 24, "feed-forward gain", "1/65536 duty (1/32768) per count/s"),
    _now("motor_friction", 0x032A, 15, "duty added in the direction wanted", "1/32768"),
    _now("motor_duty_max", 0x032B, 15, "greatest duty of the loop, to either side", "1/32768", init=32767),
    _now(
        "sweep_low", 0x032C, 32, "where a sweep begins to turn round to forward, from the zero", "counts", signed=True
    ),
    _now(
        "sweep_high", 0x032D, 32, "where a sweep begins to turn round to backward, from the zero", "counts", signed=True
    ),
    _now("motor_search", 0x032E, 24, "how far the index is looked for in each direction; 0: without end", "counts"),
    _now(
        "motor_watch",
        0x032F,
        5,
        "faults that stop the motor: bit 0 stall, 1 run-away, 2 encoder, 3 index, 4 lease",
        init=31,
    ),
    _now(
        "motor_stall_ms",
        0x0330,
        16,
        "a driven motor that moves less than 2 counts for so long is stalled",
        "ms",
        init=300,
    ),
    _now(
        "motor_runaway",
        0x0331,
        16,
        "edges in a row against the wanted direction that are a run-away",
        "counts",
        init=64,
    ),
    _now("motor_speed_max", 0x0332, 31, "a greater speed is a run-away", "1/256 counts/s", init=2**31 - 1),
    _now(
        "encoder_tolerance", 0x0333, 8, "illegal transitions that are tolerated; one is forgotten every 128 ms", init=8
    ),
    _now("index_tolerance", 0x0334, 8, "counts by which a turn may be off", "counts", init=4),
    _now("speed_low", 0x0335, 31, "the band: least magnitude of the speed", "1/256 counts/s"),
    _now("speed_high", 0x0336, 31, "the band: greatest magnitude of the speed", "1/256 counts/s", init=2**31 - 1),
    _card("motor_state", 0x0337, 8, "bit 0 stopped by a fault, 1 index found, 2 speed in band, 3 angle in sector"),
    _card("motor_cause", 0x0338, 8, "a MotorCause: what stopped the motor since it was last started"),
    # Laser.
    Register(
        "laser_arm",
        0x0340,
        16,
        Scope.NOW,
        Access.WRITE,
        "0x1A5E arms the laser, anything else disarms it; writing needs the interlock closed",
    ),
    _now(
        "laser_lease_ms",
        0x0341,
        16,
        "the laser is disarmed when no intact command came for this long",
        "ms",
        init=1000,
        low=10,
    ),
    _now("laser_delay_ms", 0x0342, 16, "time from arming to emission; the lamp is on meanwhile", "ms", init=100),
    _card(
        "laser_state",
        0x0343,
        8,
        "bit 0 emitting, 1 armed, 2 interlock closed, 3 lease alive, 4 motor not stopped by a fault, 5 permitted by"
        " laser_conditions and ambient_mode",
    ),
    _card(
        "laser_cause",
        0x0344,
        8,
        "a LaserCause: why the laser was disarmed last, or could not be armed",
    ),
    _now(
        "laser_conditions",
        0x0345,
        2,
        "what else the light needs, and goes out without until it is back: bit 0 speed in band, 1 angle in sector",
    ),
    _now("sector_low", 0x0346, 32, "the sector: first count, from the zero", "counts", signed=True),
    _now("sector_high", 0x0347, 32, "the sector: last count, from the zero", "counts", signed=True),
    _card("safety", 0x0348, 32, "laser_state, laser_cause, motor_state and motor_cause, 8 bits each, in one reading"),
    # Camera.
    _card("camera_state", 0x0500, 32, "see camera state"),
    _card("camera_setup", 0x0501, 32, "see camera set-up"),
    _card("camera_row", 0x0502, 32, "shortest and longest row of the last image, 16 bits each, in one reading", "px"),
    _card("camera_rows", 0x0503, 12, "rows of the last image", "px"),
    _card("camera_rate", 0x0504, 11, "pixel clock (DVP: two clocks a pixel)", "clock_hz / 512"),
    _now("camera_exposure", 0x0505, 16, "exposure that the camera is set to", "rows", init=200, low=1),
    _now("camera_gain", 0x0506, 10, "gain that the camera is set to", "1/16", init=16, low=16),
    # Snapshot.
    _now(
        "snapshot",
        0x0400,
        8,
        "a new number starts a snapshot as set below, and gives up one that is under way; 0: none; the same number"
        " again does nothing",
    ),
    _now("snapshot_source", 0x0401, 2, "a SnapshotSource: 0 raw, 1 gate, 2 weight", high=max(SnapshotSource)),
    _now("snapshot_step", 0x0402, 6, "every so many-th row and column", "px", init=1, low=1),
    _now("snapshot_column_first", 0x0403, 12, "first column", "px"),
    _now("snapshot_column_last", 0x0404, 12, "last column; the image's last where that is less", "px", init=4095),
    _now("snapshot_row_first", 0x0405, 12, "first row", "px"),
    _now("snapshot_row_last", 0x0406, 12, "last row; the image's last where that is less", "px", init=4095),
    _card("snapshot_busy", 0x0407, 1, "1: pieces of it are still to be taken; it needs images, so run must be 1"),
)


_BY_NAME = {register.name: register for register in REGISTERS}
assert len(_BY_NAME) == len(REGISTERS), "a register name is used twice"


def register(name: str) -> Register:
    """The register of that name; :exc:`KeyError` names it where there is none."""
    try:
        return _BY_NAME[name]
    except KeyError:
        raise KeyError(f"no register is called {name!r}") from None


def map_hash() -> int:
    """CRC-32 of everything both sides must agree on, as the card reports it."""
    lines = [f"version {VERSION}"]
    lines += [
        f"{r.name} {r.address} {r.bits} {r.scope.value} {r.access.value} {r.signed} {r.range} {r.words}"
        for r in REGISTERS
    ]
    for layout in (
        packets.COMMAND,
        packets.ANSWER,
        packets.FRAME,
        packets.EDGE,
        packets.COMPACT_ROW,
        packets.FULL_ROW,
        packets.SNAPSHOT,
        camera.CAMERA_STATE,
        camera.CAMERA_SETUP,
        camera.CAMERA_ROW,
    ):
        lines += [f"{layout.name} {offset} {field.name} {field.bits} {field.signed}" for offset, field in layout]
    return zlib.crc32("\n".join(lines).encode())
