"""Renders the wire format as a page."""

from collections.abc import Iterable

from . import camera, packets, registers
from .fields import Layout

_INTRO = """\
# Wire format

<!-- Rendered by `python -m magtrak.protocol`; a test compares. Change `host/magtrak/protocol` instead. -->

The card and the host exchange packets over a byte stream: 8N1 on a UART, CDC-ACM on USB, a pseudo-terminal on the
virtual card. Everything is little-endian. A packet is

| bytes | what |
|---|---|
| 1 | type |
| 2 | sequence number of the sender, modulo 65536 |
| n | payload |
| 4 | CRC-32 (IEEE 802.3) of all the above |

encoded with COBS and followed by a zero byte. A receiver drops what is not intact and counts it.

The card answers every intact command, in order; a damaged one is counted (`damaged_commands`) and gets no answer.
After a reset the card sends a lone zero byte first, so that a packet which the reset cut off costs only itself. The
first registers tell what the card is: the host reads `magic`, `version` and `map_hash` (this version: `0x{hash:08X}`)
and refuses a card that it does not understand.
"""


def _table(head: Iterable[str], rows: Iterable[Iterable[str]]) -> str:
    head = list(head)
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines) + "\n"


def _layout(layout: Layout) -> str:
    rows = []
    for offset, field in layout:
        bits = f"{offset}" if field.bits == 1 else f"{offset}..{offset + field.bits - 1}"
        name = "reserved" if field.reserved else f"`{field.name}`"
        rows.append([bits, name, "signed" if field.signed else "", field.unit, field.doc])
    return f"{layout.size} bytes.\n\n" + _table(["bits", "field", "", "unit", "meaning"], rows)


def _enum(values: type) -> str:
    return _table(["value", "name"], ([f"0x{int(v):02X}", f"`{v.name}`"] for v in values))  # type: ignore[attr-defined]


def render() -> str:
    """The page, as Markdown."""
    parts = [_INTRO.replace("{hash:08X}", f"{registers.map_hash():08X}")]
    parts += ["## Packet types\n", _enum(packets.PacketType)]
    parts += ["## Commands: `READ` and `WRITE`\n", _layout(packets.COMMAND)]
    parts += ["## `ANSWER`\n", _layout(packets.ANSWER), _enum(packets.AnswerCode)]
    parts += [
        "## `FRAME`\n",
        "The header below, then `edges` entries of the edge log, oldest first, then `rows` rows in the form that `form`"
        " tells.\n",
        _layout(packets.FRAME),
    ]
    parts += ["### Phases\n", _enum(packets.Phase)]
    parts += ["### Frame flags\n", _layout(packets.FRAME_FLAGS)]
    parts += ["### Camera errors\n", _layout(packets.CAMERA_ERRORS)]
    parts += ["### Encoder errors\n", _layout(packets.ENCODER_ERRORS)]
    parts += [
        "### Edge\n",
        "An edge from count k - 1 to k, or back, lies at exactly k counts: at `count` when it went up, at `count` + 1"
        " when it went down.\n",
        _layout(packets.EDGE),
    ]
    parts += ["### Field parity\n", _enum(packets.FieldParity)]
    parts += ["### Compact row\n", _layout(packets.COMPACT_ROW)]
    parts += ["### Full row\n", _layout(packets.FULL_ROW)]
    parts += [
        "## `SNAPSHOT`\n",
        "A piece of a picture: the header below, then `pixels` pixels of one row, `step` columns apart. The region is"
        f" sent in strips of {packets.SNAPSHOT_PIXELS} pixels from left to right, each strip from its first row to its"
        " last. Pieces go between frames; what the card cannot take from one image it takes from a later one. One"
        " without pixels ends the snapshot.\n",
        _layout(packets.SNAPSHOT),
    ]
    parts += ["### Snapshot flags\n", _layout(packets.SNAPSHOT_FLAGS)]
    parts += ["### Snapshot sources\n", _enum(packets.SnapshotSource)]
    parts += ["### Detectors\n", _enum(registers.Detector)]
    parts += ["### Choices\n", _enum(registers.Choice)]
    parts += ["### Windows\n", _enum(registers.Window)]
    for heading, causes in (
        ("Ambient modes", registers.AmbientMode),
        ("Laser causes", registers.LaserCause),
        ("Motor modes", registers.MotorMode),
        ("Motor causes", registers.MotorCause),
        ("Index policies", registers.IndexPolicy),
    ):
        parts += [f"### {heading}\n", _enum(causes)]
    doc = (registers.__doc__ or "").split("\n\n", 1)[1]
    parts += ["## Registers\n", doc]
    for layout in (camera.CAMERA_STATE, camera.CAMERA_SETUP, camera.CAMERA_ROW):
        parts += [f"### {layout.name.capitalize()}\n", _layout(layout)]
    parts += ["### Sensors\n", _enum(camera.Sensor)]
    parts += ["### Causes of a failed set-up\n", _enum(camera.SetupCause)]
    rows: list[list[str]] = []
    for r in registers.REGISTERS:
        address = f"0x{r.address:04X}" + (f"..{r.address + r.words - 1:04X}" if r.words > 1 else "")
        low, high = r.range
        full = (low, high) == registers.Register("", 0, r.bits, r.scope, r.access, "", signed=r.signed).range
        kind = f"{'s' if r.signed else 'u'}{r.bits}" + ("" if full else f", {low} to {high}")
        rows.append([address, f"`{r.name}`", r.scope.value, r.access.value, kind, r.unit, str(r.init), r.doc])
    parts.append(_table(["address", "name", "scope", "access", "value", "unit", "reset", "meaning"], rows))
    return "\n".join(parts)
