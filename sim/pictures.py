"""Pictures from a folder."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import numpy.typing as npt

from .errors import SimError

SUFFIXES = (".png", ".jpg", ".jpeg", ".bmp")


class Pictures:
    """The pictures of a folder (PNG, JPEG, BMP) in order of name, all of one size.

    Every file is opened at once, so that a bad one is found before the scan and not in the middle of it; the pixels
    are read one picture at a time.

    Parameters
    ----------
    folder : where they are

    Raises
    ------
    SimError : no folder, no picture, one that can't be read, or one of another size; names the file
    """

    def __init__(self, folder: Path) -> None:
        try:
            names = sorted(path for path in folder.iterdir() if path.suffix.lower() in SUFFIXES)
        except OSError as error:
            raise SimError(f"the folder of pictures {folder} can't be read: {error.strerror}") from error
        if not names:
            raise SimError(f"there is no picture in {folder}; put PNG, JPEG or BMP files there")
        self.paths = names
        shapes = [self._read(path).shape for path in names]
        self.height, self.width = shapes[0][:2]
        for path, shape in zip(names, shapes, strict=True):
            if shape != shapes[0]:
                raise SimError(
                    f"the picture {path} has {shape[1]} x {shape[0]} pixels, and {names[0].name} has "
                    f"{self.width} x {self.height}; all have to be of one size"
                )

    def __len__(self) -> int:
        return len(self.paths)

    def __getitem__(self, number: int) -> npt.NDArray[np.uint8]:
        """Picture ``number``: (height, width, 3), red, green, blue."""
        return self._read(self.paths[number])

    def __iter__(self) -> Iterator[npt.NDArray[np.uint8]]:
        return map(self._read, self.paths)

    @staticmethod
    def _read(path: Path) -> npt.NDArray[np.uint8]:
        from PIL import Image  # here, so that scenes need no Pillow

        try:
            with Image.open(path) as image:
                return np.asarray(image.convert("RGB"))
        except (OSError, ValueError, SyntaxError, Image.DecompressionBombError) as error:
            raise SimError(f"the picture {path} can't be read ({error}); replace it or take it away") from error
