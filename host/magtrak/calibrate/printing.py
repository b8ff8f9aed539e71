"""Prints calibration boards: PNG or PDF, at their true size, with a scale bar to check the print by."""

from pathlib import Path
from typing import Any

import numpy as np

from ..errors import OutputError
from .board import Board

DPI = 600
MARGIN_MM = 8.0
BAR_MM = 200.0


def page_mm(board: Board) -> tuple[float, float]:
    """Size of the page: pattern, blank band and a margin, and a strip for the scale bar."""
    left, top, right, bottom = _extent(board)
    return right - left, bottom - top


def write_board(board: Board, path: Path) -> None:
    """A PNG (600 dots an inch, written into it) or PDF file, by the path's suffix.

    Raises
    ------
    OutputError
        The file cannot be written, or is neither.
    """
    if path.suffix.lower() not in (".png", ".pdf"):
        raise OutputError(f"{path} has to end in .png or .pdf")
    page = _draw(board)
    try:
        if path.suffix.lower() == ".pdf":
            path.write_bytes(_pdf(page, page_mm(board)))
        else:
            path.write_bytes(_png(page))
    except OSError as error:
        raise OutputError(f"{path} cannot be written: {error.strerror}") from None


def _extent(board: Board) -> tuple[float, float, float, float]:
    width, height = board.size_mm
    left, top, right, bottom = -MARGIN_MM, -MARGIN_MM, width + MARGIN_MM, height + MARGIN_MM
    if board.band_mm is not None:
        left, top = min(left, board.band_mm[0]), min(top, board.band_mm[1])
        right, bottom = max(right, board.band_mm[2]), max(bottom, board.band_mm[3])
    return left, top, right, bottom


def _draw(board: Board) -> Any:
    """The page in grey levels, :data:`DPI`; the large board at a resolution that keeps it below 100 million px."""
    import cv2

    scale = _scale(board)
    left, top, right, bottom = _extent(board)
    page = np.full((round((bottom - top) * scale), round((right - left) * scale)), 255, np.uint8)
    pattern = _pattern(board, scale)
    x, y = round(-left * scale), round(-top * scale)
    page[y : y + pattern.shape[0], x : x + pattern.shape[1]] = pattern
    # The scale bar stands above the pattern, in the margin, where no line is measured.
    length = min(BAR_MM, board.size_mm[0])
    thick = max(round(0.4 * scale), 1)
    bar_y = round((-top - MARGIN_MM * 0.45) * scale)
    cv2.rectangle(page, (x, bar_y), (x + round(length * scale), bar_y + thick), 0, -1)
    for part in range(int(length // 10) + 1):
        at = x + round(part * 10 * scale)
        high = round((2.0 if part % 5 == 0 else 1.2) * scale)
        cv2.rectangle(page, (at, bar_y - high), (at + thick // 2, bar_y), 0, -1)
    text = f"{length:g} mm: measure this bar.  {board.name}, {board.columns} x {board.rows}"
    text += f" squares of {board.square_mm:g} mm"
    if board.pattern == "charuco":
        text += f", markers {board.marker_mm:g} mm, {board.dictionary} from {board.first_marker}"
    size = scale * 2.2 / 22
    place = (x + round((length + 4) * scale), bar_y + thick)
    cv2.putText(page, text, place, cv2.FONT_HERSHEY_SIMPLEX, size, 0, max(round(size * 1.5), 1), cv2.LINE_AA)
    return page


def _scale(board: Board) -> float:
    """Dots a millimetre; whole dots for a square, so that every edge falls on one."""
    width, height = page_mm(board)
    most = float(np.sqrt(100e6 / (width * height)))
    wanted = min(DPI / 25.4, most)
    return max(round(board.square_mm * wanted), 1) / board.square_mm


def _pattern(board: Board, scale: float) -> Any:
    width, height = (round(size * scale) for size in board.size_mm)
    if board.pattern == "charuco":
        from .detect import charuco

        return charuco(board).generateImage((width, height), marginSize=0)
    row, column = np.indices((board.rows, board.columns))
    side = round(board.square_mm * scale)
    squares: Any = np.kron((row + column) % 2, np.ones((side, side), np.uint8)) * 255
    return squares.astype(np.uint8)


def _png(page: Any) -> bytes:
    import cv2

    done, data = cv2.imencode(".png", page)
    assert done
    return bytes(data.tobytes())


def _pdf(page: Any, size_mm: tuple[float, float]) -> bytes:
    """A PDF of one page that holds the picture at its true size. Source: ISO 32000-1, 8.9.5."""
    import zlib

    bits = zlib.compress(np.packbits(page > 127, axis=1).tobytes(), 9)
    width, height = (side * 72 / 25.4 for side in size_mm)
    content = f"q {width:.4f} 0 0 {height:.4f} 0 0 cm /Page Do Q".encode()
    objects = [
        b"<< /Type /Catalog /Pages 2 0 R >>",
        b"<< /Type /Pages /Kids [3 0 R] /Count 1 >>",
        f"<< /Type /Page /Parent 2 0 R /MediaBox [0 0 {width:.4f} {height:.4f}] /Contents 4 0 R"
        " /Resources << /XObject << /Page 5 0 R >> >> /PieceInfo << >> >>".encode(),
        b"<< /Length %d >>\nstream\n%s\nendstream" % (len(content), content),
        b"<< /Type /XObject /Subtype /Image /Width %d /Height %d /ColorSpace /DeviceGray /BitsPerComponent 1"
        b" /Filter /FlateDecode /Length %d >>\nstream\n%s\nendstream" % (page.shape[1], page.shape[0], len(bits), bits),
    ]
    data = b"%PDF-1.4\n%\xe2\xe3\xcf\xd3\n"
    places = []
    for number, item in enumerate(objects, 1):
        places.append(len(data))
        data += b"%d 0 obj\n%s\nendobj\n" % (number, item)
    start = len(data)
    data += b"xref\n0 %d\n0000000000 65535 f \n" % (len(objects) + 1)
    data += b"".join(b"%010d 00000 n \n" % place for place in places)
    data += b"trailer\n<< /Size %d /Root 1 0 R >>\nstartxref\n%d\n%%%%EOF\n" % (len(objects) + 1, start)
    return data
