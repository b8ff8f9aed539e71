"""What the header of a frame is made of, by the moment at which it is known; and how a frame is read."""

from amaranth.hdl import signed
from amaranth.lib import data, wiring
from amaranth.lib.wiring import In, Out

from magtrak.protocol import EDGE, FRAME, MAX_EDGES

from ..features import ROW_WORDS
from ..layouts import CameraErrors, EncoderErrors, Field
from ..motion.angle import AngleStamp

HEADER_WORDS = FRAME.size // 4
EDGE_WORDS = EDGE.size // 4
EDGE_BASE = 1 << (HEADER_WORDS - 1).bit_length()
"""Where the edges begin among the 32-bit words of a frame; the header begins at 0."""

WORDS = EDGE_BASE + MAX_EDGES * EDGE_WORDS

STEADY_CLOCKS = 100
"""How long what is known at the beginning of an image stays so at least, and what is known of its motion."""


class StartFacts(data.Struct):
    """Settings of the image: from the clock after its first pixel on for :data:`STEADY_CLOCKS` at least."""

    generation: 16
    detector: 8
    exposure_us: 32
    time_offset_ns: signed(32)


class ImageFacts(data.Struct):
    """Laser and motor, as of the end of the image."""

    laser_on: 1
    speed_in_band: 1
    motor_stopped: 1
    phase: 2
    field: Field


class MotionFacts(data.Struct):
    """Motion during the image, as of the clock in which the edge log was taken."""

    first: AngleStamp
    last: AngleStamp
    index_seen: 1
    index_count: signed(32)
    index_passes: 16
    encoder_errors: EncoderErrors
    encoder_fault: 1
    edges: range(MAX_EDGES + 1)
    edge_shift: 8


class VisionFacts(data.Struct):
    """The camera's behaviour, as of the end of the image's results."""

    errors: CameraErrors
    columns: 16


class RowFacts(data.Struct):
    """What was stored of an image."""

    vision: VisionFacts
    rows: 16
    lost: 1


class FrameReader(wiring.Signature):
    """How a complete frame is read from its buffer.

    Parameters
    ----------
    max_rows : full rows of a buffer

    Members
    -------
    ready : a frame waits; the members below speak of it
    word_index, word : words of header and edge log, 2 clocks later; the header says what else the frame has
    row_index, row : words of its rows, 2 clocks later, where :class:`~gateware.frame.rows.RowStore` has them
    done : strobe: it is no longer needed
    """

    def __init__(self, max_rows: int) -> None:
        super().__init__(
            {
                "ready": Out(1),
                "word_index": In(range(WORDS)),
                "word": Out(32),
                "row_index": In(range(ROW_WORDS * max_rows)),
                "row": Out(32),
                "done": In(1),
            }
        )
