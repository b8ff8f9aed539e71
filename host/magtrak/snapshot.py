"""Pictures of what the card sees, fetched in pieces between the frames."""

import time
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from . import protocol
from .card import Card
from .errors import CardError
from .protocol import Packet, SnapshotSource

SOURCES = tuple(source.name.lower() for source in SnapshotSource)
PATIENCE_S = 5.0
"""Without a piece for so long, no image comes."""

ATTEMPTS = 3


@dataclass(frozen=True)
class Area:
    """Which pixels: first and last column and row, and every how many-th of each."""

    first_column: int = 0
    last_column: int = 4095
    first_row: int = 0
    last_row: int = 4095
    step: int = 1


@dataclass(frozen=True)
class Snapshot:
    """A picture.

    Attributes
    ----------
    picture : (rows, columns, 3) for raw, else (rows, columns)
    first_frame, last_frame : numbers of the images that its pieces are from
    faults : pieces of rows that broke the camera's contract
    """

    picture: NDArray[np.uint8]
    first_frame: int
    last_frame: int
    faults: int


class DamagedPieceError(ValueError):
    """The payload is no piece of a snapshot, though intact on the wire."""


@dataclass(frozen=True)
class Piece:
    """A piece: its header, and pixels of shape (n, 3) or (n,)."""

    header: dict[str, int]
    pixels: NDArray[np.uint8]


def decode_piece(payload: bytes) -> Piece:
    """The piece in the payload of a ``SNAPSHOT`` packet; :exc:`DamagedPieceError` where it is none."""
    size = protocol.SNAPSHOT.size
    if len(payload) < size:
        raise DamagedPieceError(f"{len(payload)} bytes are too few for the header of a piece")
    header = protocol.SNAPSHOT.unpack(payload[:size])
    if header["source"] not in list(SnapshotSource) or header["step"] == 0:
        raise DamagedPieceError(f"source {header['source']} with step {header['step']} is not known")
    channels = 3 if header["source"] == SnapshotSource.RAW else 1
    if len(payload) != size + channels * header["pixels"]:
        raise DamagedPieceError(f"{len(payload)} bytes do not hold {header['pixels']} pixels of {channels} bytes")
    pixels = np.frombuffer(payload, np.uint8, offset=size)
    return Piece(header, pixels.reshape(-1, 3) if channels == 3 else pixels)


def take_snapshot(card: Card, source: str, area: Area) -> Snapshot:
    """Fetch a picture. Where the card stands still, it measures meanwhile; laser and motor stay as they are.

    Raises
    ------
    CardError
        No image comes, or pieces were lost again and again.
    """
    running = card.read("run")
    try:
        card.write("run", 1)
        for _ in range(ATTEMPTS):
            pieces = _fetch(card, source, area)
            snapshot = _assemble(pieces, area)
            if snapshot is not None:
                return snapshot
    finally:
        card.write("run", running)
    raise CardError(
        f"pieces of the picture were lost {ATTEMPTS} times: the link loses data, `magtrak doctor` tells more"
    )


def _fetch(card: Card, source: str, area: Area) -> list[Piece]:
    """All pieces that came of one snapshot, the last one without pixels."""
    number = card.read("snapshot") % 255 + 1
    pieces: list[Piece] = []
    heard = [time.monotonic()]

    def keep(packet: Packet) -> None:
        try:
            piece = decode_piece(packet.payload)
        except DamagedPieceError:
            return
        if piece.header["number"] == number:  # another one's last pieces may still be under way
            pieces.append(piece)
            heard[0] = time.monotonic()

    card.on_snapshot = keep
    try:
        values = {
            "snapshot_source": SnapshotSource[source.upper()],
            "snapshot_step": area.step,
            "snapshot_column_first": area.first_column,
            "snapshot_column_last": area.last_column,
            "snapshot_row_first": area.first_row,
            "snapshot_row_last": area.last_row,
            "snapshot": number,
        }
        card.write_all([(name, [value]) for name, value in values.items()])
        for _ in card.frames(poll_s=0.02):
            if pieces and not pieces[-1].header["pixels"]:
                return pieces
            if time.monotonic() - heard[0] > PATIENCE_S:
                if pieces:
                    return pieces  # the last one was lost
                raise CardError("no image comes from the camera: check its cable and power, and that it runs")
    finally:
        card.on_snapshot = None
    raise AssertionError("frames never end")


def _assemble(pieces: list[Piece], area: Area) -> Snapshot | None:
    """The picture; None where a piece is missing."""
    parts = [piece for piece in pieces if piece.header["pixels"]]
    if not parts:
        raise CardError(
            f"columns {area.first_column} to {area.last_column}, rows {area.first_row} to {area.last_row} are not in"
            " the image: choose a region in it"
        )
    step = area.step
    rows = (max(part.header["row"] for part in parts) - area.first_row) // step + 1
    columns = max((p.header["column"] - area.first_column) // step + p.header["pixels"] for p in parts)
    picture = np.zeros((rows, columns, *parts[0].pixels.shape[1:]), np.uint8)
    seen = np.zeros((rows, columns), bool)
    for part in parts:
        row = (part.header["row"] - area.first_row) // step
        column = (part.header["column"] - area.first_column) // step
        end = column + part.header["pixels"]
        picture[row, column:end] = part.pixels
        seen[row, column:end] = True
    if pieces[-1].header["pixels"] or not seen.all():
        return None
    numbers = [part.header["frame"] for part in parts]
    return Snapshot(picture, numbers[0], numbers[-1], sum(part.header["flags"] & 1 for part in parts))
