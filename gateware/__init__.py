"""The card, in Amaranth.

:class:`gateware.core.Core` is the whole card without clocks, pins and link; a
board wraps it. Settings, packets and rows come from :mod:`magtrak.protocol`.
"""
