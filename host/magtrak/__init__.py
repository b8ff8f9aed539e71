"""Host driver of the Magtrak card: link, geometry, clouds, tools.

Nothing here imports the gateware or Amaranth; the wire format in
:mod:`magtrak.protocol` is what the two sides share.
"""

__version__ = "0.1.0"
