"""Packet types and what is in them."""

import enum

from .fields import Field, Layout

POSITION_FRACTION_BITS = 8
"""Columns are unsigned fixed point Q12.8: 1/256 px, pixel centres at whole numbers."""

MAX_EDGES = 16
"""Encoder edges that one frame can carry."""

SNAPSHOT_PIXELS = 120
"""Pixels that one piece of a snapshot can have: it delays a frame by 1.3 ms at 3 Mbaud, at most."""


class PacketType(enum.IntEnum):
    """First byte of a packet. Types below 0x80 go to the host, the others to the card."""

    FRAME = 0x01
    ANSWER = 0x02
    SNAPSHOT = 0x03
    READ = 0x80
    WRITE = 0x81


class RowForm(enum.IntEnum):
    """How the rows of a frame are written."""

    COMPACT = 0
    FULL = 1


class Phase(enum.IntEnum):
    """What an image is for, while images with and without laser alternate."""

    MEASURED = 0  # the background was subtracted; or ambient_mode is off
    BACKGROUND = 1  # laser off; no rows follow
    SKIPPED = 2  # the laser was switched while it was exposed; no rows follow
    UNSUBTRACTED = 3  # measured, but there was no background of this size and these settings yet


class FieldParity(enum.IntEnum):
    """Which rows of the picture an image has."""

    PROGRESSIVE = 0  # all
    EVEN = 1  # 0, 2, 4 ... of an interlaced picture
    ODD = 2  # 1, 3, 5 ...


class SnapshotSource(enum.IntEnum):
    """What a snapshot shows, and the bytes of a pixel."""

    RAW = 0  # 3 bytes: R, G, B as the camera sent them
    GATE = 1  # 1 byte: 255 where the colour passes the gate, in the region of interest; else 0
    WEIGHT = 2  # 1 byte: the weight, in the region of interest; else 0


class AnswerCode(enum.IntEnum):
    """What became of a command."""

    DONE = 0
    PENDING = 1  # accepted, in force from the start of the next frame
    UNKNOWN_TYPE = 2
    UNKNOWN_ADDRESS = 3
    NOT_ALLOWED = 4  # writing what can only be read, or the reverse
    OUT_OF_RANGE = 5
    MALFORMED = 6  # intact, but of the wrong length for its type
    NO_CLOCK = 7  # a gate table cannot be written: the pixels' clock stands still


COMMAND = Layout(
    "command",
    (
        Field("address", 16, "register address"),
        Field("value", 32, "value to write; 0 when reading"),
    ),
)

ANSWER = Layout(
    "answer",
    (
        Field("to", 16, "sequence number of the command"),
        Field("code", 8, "an AnswerCode"),
        Field("address", 16, "register address of the command"),
        Field("value", 32, "what reading the register gives now; 0 where it can't be read"),
    ),
)

FRAME_FLAGS = Layout(
    "frame flags",
    (
        Field("index_seen", 1, "the index has been passed since reset: counts have an origin"),
        Field("speed_in_band", 1, "the motor's speed stayed within its band for the whole frame"),
        Field("laser_on", 1, "the laser was enabled for the whole frame"),
        Field("encoder_fault", 1, "an illegal transition or a wrong count per turn since the frame before"),
        Field("camera_fault", 1, "the image broke the camera's contract: see camera_errors"),
        Field("rows_lost", 1, "the image had more rows than the card stores or could write; the first ones are here"),
        Field("motor_stopped", 1, "a fault has stopped the motor: see motor_cause"),
        Field("_reserved", 9),
    ),
)

CAMERA_ERRORS = Layout(
    "camera errors",
    (
        Field("blanking", 1, "less than 16 clocks between two rows"),
        Field("row_period", 1, "less than 48 clocks from row to row"),
        Field("frame_gap", 1, "less than 64 clocks between the last pixel of a frame and the next frame"),
        Field("row_length", 1, "rows of different length in one frame"),
        Field("columns", 1, "more columns than the card takes"),
        Field("rows", 1, "more rows than the card takes"),
        Field("framing", 1, "a row without end, or a frame without end"),
        Field("_reserved", 1),
    ),
)

ENCODER_ERRORS = Layout(
    "encoder errors",
    (
        Field("illegal", 16, "transitions of A and B at once, saturating"),
        Field("turns", 16, "turns whose count was not counts_per_turn, saturating"),
    ),
)

FRAME = Layout(
    "frame",
    (
        Field("frame", 32, "number of the image since reset; images that were dropped are counted"),
        Field("flags", 16, "see frame flags"),
        Field("generation", 16, "generation of the settings in force"),
        Field("form", 8, "a RowForm"),
        Field("detector", 8, "a Detector: how positions were measured"),
        Field("camera_errors", 8, "what was wrong with this image: see camera errors"),
        Field("edges", 8, "entries of the edge log"),
        Field("edge_shift", 8, "the log holds every 2^edge_shift-th edge"),
        Field("phase", 8, "a Phase: what the image is for"),
        Field("rows", 16, "rows that follow"),
        Field("first_row", 16, "row of the image that the first one is"),
        Field("columns", 16, "columns of the image"),
        Field("dropped", 32, "images dropped since reset because no buffer was free"),
        Field("encoder_errors", 32, "since reset: see encoder errors"),
        Field("damaged_commands", 16, "commands since reset that were not intact, saturating"),
        Field("index_passes", 16, "passes of the index since reset, modulo 65536"),
        Field("index_count", 32, "the zero of the angle, a count, as index_policy has it", "counts", signed=True),
        Field("exposure_us", 32, "exposure as the settings have it", "us"),
        Field("time_offset_ns", 32, "time offset as the settings have it", "ns", signed=True),
        Field("first_time", 64, "arrival of column 0 of the first row", "clocks since reset"),
        Field("first_count", 32, "encoder count then", "counts", signed=True),
        Field("first_age", 32, "time since the last edge then, saturating", "clocks"),
        Field("first_period", 32, "time between the last two edges then, saturating", "clocks"),
        Field("last_time", 64, "arrival of column 0 of the last row", "clocks since reset"),
        Field("last_count", 32, "encoder count then", "counts", signed=True),
        Field("last_age", 32, "time since the last edge then, saturating", "clocks"),
        Field("last_period", 32, "time between the last two edges then, saturating", "clocks"),
        Field("row_step", 8, "from one row of the image to the next in the picture: 1, or 2 where it is interlaced"),
        Field("field", 8, "a FieldParity: which rows these are"),
        Field("line_errors", 16, "bytes from the host since reset that the physical link lost, saturating"),
    ),
)

SNAPSHOT_FLAGS = Layout(
    "snapshot flags",
    (
        Field("fault", 1, "the row broke the camera's contract and may be incomplete"),
        Field("_reserved", 7),
    ),
)

SNAPSHOT = Layout(
    "snapshot",
    (
        Field("frame", 32, "number of the image that the pixels are from"),
        Field("generation", 16, "generation of the settings in force in it"),
        Field("number", 8, "number of the snapshot: what was written to the register"),
        Field("source", 8, "a SnapshotSource"),
        Field("row", 16, "row of the pixels in that image"),
        Field("column", 16, "column of the first one"),
        Field("step", 8, "from one pixel to the next, and from one row to the next"),
        Field("flags", 8, "see snapshot flags"),
        Field("pixels", 8, f"pixels that follow, up to {SNAPSHOT_PIXELS}; none: the snapshot is complete"),
    ),
)

EDGE = Layout(
    "edge",
    (
        Field("time", 32, "low half of the time of the edge", "clocks since reset"),
        Field("count", 31, "count after the edge", "counts", signed=True),
        Field("backward", 1, "the count went down"),
    ),
)

_ROW_FLAGS = (
    Field("valid", 1, "a line was found; without it every other field but overflow is 0"),
    Field("ambiguous", 1, "another peak comes near this one in strength, or the colour lies elsewhere"),
    Field("saturated", 1, "a pixel of the run is at full scale in one channel"),
    Field("cut", 1, "the run, or the filter on it, touches a border of image or region, or the filter found no peak"),
    Field("overflow", 1, "the row broke the camera's contract and may be incomplete"),
)

COMPACT_ROW = Layout(
    "compact row",
    (
        Field("position", 19, "column of the line", "px, Q11.8"),
        *_ROW_FLAGS,
        Field("peak", 4, "greatest weight of the run, upper 4 of 8 bits"),
        Field("width", 4, "columns of the run, saturating"),
    ),
)

FULL_ROW = Layout(
    "full row",
    (
        Field("position", 20, "column of the line", "px, Q12.8"),
        *_ROW_FLAGS,
        Field("second_valid", 1, "second_position holds a runner-up"),
        Field("_reserved0", 6),
        Field("sum", 20, "sum of the weights of the run"),
        Field("width", 12, "columns of the run", "px"),
        Field("peak", 8, "greatest weight of the run"),
        Field("gated", 12, "gated pixels in the run and within reach of it", "px"),
        Field("clipped", 12, "pixels of the run at full scale in one channel", "px"),
        Field("second_position", 20, "column of the runner-up, to half a column", "px, Q12.8"),
        Field("runner_up", 8, "strength of the runner-up over that of the peak, saturating", "1/256"),
        Field("_reserved1", 4),
    ),
)
