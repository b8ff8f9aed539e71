"""Amaranth shapes of what :mod:`magtrak.protocol` defines, and the streams inside the card."""

from amaranth.hdl import Shape, signed
from amaranth.lib import data, enum, stream, wiring
from amaranth.lib.wiring import Out

from magtrak import protocol
from magtrak.protocol import Access, FieldParity, Layout, Scope


def struct(layout: Layout) -> data.StructLayout:
    """A protocol layout as an Amaranth one, bit for bit."""
    return data.StructLayout({field.name: Shape(field.bits, field.signed) for field in layout.fields})


def settings(scope: Scope) -> data.StructLayout:
    """The values of all registers of a scope that the host can read and write."""
    return data.StructLayout(
        {r.name: Shape(r.bits, r.signed) for r in protocol.REGISTERS if r.scope is scope and r.access is Access.BOTH}
    )


FrameSettings = settings(Scope.FRAME)
"""Settings in force for one whole frame. They change in the clock after the first pixel of a
frame was taken: a block may use them from its second pipeline stage on."""

NowSettings = settings(Scope.NOW)

Row = struct(protocol.FULL_ROW)
Edge = struct(protocol.EDGE)
CameraErrors = struct(protocol.CAMERA_ERRORS)
EncoderErrors = struct(protocol.ENCODER_ERRORS)
CameraState = struct(protocol.CAMERA_STATE)
CameraSetup = struct(protocol.CAMERA_SETUP)
CameraRow = struct(protocol.CAMERA_ROW)


class CameraStatus(data.Struct):
    """What a source tells of its camera, each under its register's name; all 0 for a source without one."""

    camera_state: CameraState
    camera_setup: CameraSetup
    camera_row: CameraRow
    camera_rows: 12
    camera_rate: 11


class Field(enum.Enum, shape=2):
    """As :class:`magtrak.protocol.FieldParity`; a camera that is not interlaced sends ``PROGRESSIVE``."""

    PROGRESSIVE = FieldParity.PROGRESSIVE
    EVEN = FieldParity.EVEN
    ODD = FieldParity.ODD


class Pixel(data.Struct):
    """A pixel and where it stands.

    A row comes as consecutive or spaced pixels from ``row_first`` to ``row_last``; the first pixel
    of an image has ``frame_first`` as well.
    """

    r: 8
    g: 8
    b: 8
    row_first: 1
    row_last: 1
    frame_first: 1


class Video(wiring.Signature):
    """Images from a source that cannot wait.

    Contract of the source: at most one pixel a clock; at least 16 clocks from ``row_last`` to the next
    ``row_first``, 48 clocks from ``row_first`` to ``row_first``, and one blank row (at least 64 clocks)
    between the last pixel of an image and the next image; with the isolated-pixel filter a row of the image's length
    and 128 clocks, or else the image's last row is flagged. ``frame_end`` is a strobe in the blank row, with
    or after the last pixel and before the next ``frame_first``.

    Members
    -------
    pixel : stream of :class:`Pixel`, always ready
    frame_end : the image is complete
    field : which rows of the picture it has, valid with its first pixel
    """

    def __init__(self) -> None:
        members = {"pixel": Out(stream.Signature(Pixel, always_ready=True)), "frame_end": Out(1), "field": Out(Field)}
        super().__init__(members)


class SettingWrite(data.Struct):
    """A register of scope ``NOW`` takes a value."""

    address: 16
    value: signed(32)


class LutWrite(wiring.Signature):
    """Writes to the gate tables: word ``word`` of the idle bank of table ``axis`` (0 hue, 1 luminance,
    2 saturation); and ``swap``, the strobe with which settings come in force, and with it the other banks of
    those tables that ``written`` has a bit for.
    """

    def __init__(self) -> None:
        super().__init__(
            {"valid": Out(1), "axis": Out(2), "word": Out(3), "data": Out(32), "swap": Out(1), "written": Out(3)}
        )


class RowResult(data.Struct):
    """What was measured in row ``row`` of the image."""

    row: 12
    record: Row


class Rows(wiring.Signature):
    """Results of an image: its rows in order, then ``frame_end``.

    Members
    -------
    row : stream of :class:`RowResult`, always ready; at most one in 32 clocks
    frame_end : strobe, after the last row of the image
    """

    def __init__(self) -> None:
        super().__init__({"row": Out(stream.Signature(RowResult, always_ready=True)), "frame_end": Out(1)})


class Packet(data.Struct):
    """A byte of a packet, and whether it is the packet's last."""

    data: 8
    last: 1


Bytes = stream.Signature(8)
"""Bytes as the physical link moves them, delimiters included."""

Packets = stream.Signature(Packet)
"""Packets as blocks inside the card pass them on, neither framed nor encoded."""

__all__ = [
    "Bytes",
    "CameraErrors",
    "CameraRow",
    "CameraSetup",
    "CameraState",
    "CameraStatus",
    "Edge",
    "EncoderErrors",
    "Field",
    "FrameSettings",
    "LutWrite",
    "NowSettings",
    "Packet",
    "Packets",
    "Pixel",
    "Row",
    "RowResult",
    "Rows",
    "SettingWrite",
    "Video",
    "settings",
    "struct",
]
