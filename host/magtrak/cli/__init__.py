"""Command lines. What they share is here; each command imports what is heavy only when it runs."""

import sys
from pathlib import Path
from typing import NoReturn


def fail(message: str) -> NoReturn:
    """Tell the user in one line of standard error what went wrong, and exit with status 1."""
    print(f"{Path(sys.argv[0]).stem}: {message}", file=sys.stderr)
    raise SystemExit(1)
