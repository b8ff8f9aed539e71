"""The wire format and the register map, defined once.

Standard library only. The gateware derives its Amaranth layouts from these
tables, the host derives its codecs and numpy types, and ``docs/protocol.md``
is rendered from them (``python -m magtrak.protocol``).
"""

from .cobs import Deframer, Packet, cobs_decode, cobs_encode, frame_packet
from .fields import Field, Layout
from .packets import (
    ANSWER,
    CAMERA_ERRORS,
    COMMAND,
    COMPACT_ROW,
    EDGE,
    ENCODER_ERRORS,
    FRAME,
    FRAME_FLAGS,
    FULL_ROW,
    MAX_EDGES,
    POSITION_FRACTION_BITS,
    AnswerCode,
    PacketType,
    RowForm,
)
from .registers import (
    LASER_KEY,
    LUT_WORDS,
    MAGIC,
    REGISTERS,
    VERSION,
    Access,
    Choice,
    Detector,
    LaserCause,
    Register,
    Scope,
    map_hash,
    register,
)

__all__ = [
    "ANSWER",
    "CAMERA_ERRORS",
    "COMMAND",
    "COMPACT_ROW",
    "EDGE",
    "ENCODER_ERRORS",
    "FRAME",
    "FRAME_FLAGS",
    "FULL_ROW",
    "LASER_KEY",
    "LUT_WORDS",
    "MAGIC",
    "MAX_EDGES",
    "POSITION_FRACTION_BITS",
    "REGISTERS",
    "VERSION",
    "Access",
    "AnswerCode",
    "Choice",
    "Deframer",
    "Detector",
    "Field",
    "LaserCause",
    "Layout",
    "Packet",
    "PacketType",
    "Register",
    "RowForm",
    "Scope",
    "cobs_decode",
    "cobs_encode",
    "frame_packet",
    "map_hash",
    "register",
]
