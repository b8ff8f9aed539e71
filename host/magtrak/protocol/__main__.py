"""``python -m magtrak.protocol`` prints ``docs/protocol.md``."""

from .document import render

print(render(), end="")
