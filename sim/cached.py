"""Things that take long to make, kept under a hash of all that went into them."""

import fcntl
import hashlib
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

BUILD = Path(__file__).resolve().parent.parent / "build"


@contextmanager
def cached(build: Path, name: str, *parts: str | bytes) -> Iterator[tuple[Path, Path | None]]:
    """The place of a thing, and a folder to make it in where it is not there yet; one process makes it.

    Parameters
    ----------
    build : folder of such things, mostly below :data:`BUILD`
    name : of the thing
    parts : all that it depends on
    """
    digest = hashlib.sha256(b"\0".join(p.encode() if isinstance(p, str) else p for p in parts)).hexdigest()[:16]
    place = build / f"{name}-{digest}"
    build.mkdir(parents=True, exist_ok=True)
    with (build / f"{name}-{digest}.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if place.exists():
            yield place, None
            return
        with tempfile.TemporaryDirectory(dir=build, prefix=f"{name}-") as folder:
            yield place, Path(folder)
            shutil.copytree(folder, place, symlinks=True)
