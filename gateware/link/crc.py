"""CRC-32 of IEEE 802.3, a byte a clock."""

import zlib
from functools import reduce
from operator import xor

from amaranth.hdl import Const, Module, Mux, Signal
from amaranth.lib import wiring
from amaranth.lib.wiring import In, Out

_START = 0xFFFF_FFFF
_POLYNOMIAL = 0xEDB8_8320  # bit-reversed: the lowest bit is the first on the wire
_RESIDUE = 0xDEBB_20E3  # what the register holds after intact data with their CRC behind them


def _shifted(bit: int) -> int:
    """What a set bit of a byte adds to the register after eight shifts."""
    value = 1 << bit
    for _ in range(8):
        value = value >> 1 ^ _POLYNOMIAL * (value & 1)
    return value


class Crc32(wiring.Component):
    """The CRC of ``zlib.crc32``, of the bytes since ``start``.

    Like the byte-wise table of D. V. Sarwate, "Computation of cyclic redundancy checks via table look-up", CACM 31
    (1988), with the entry made of one constant for each set bit. A simulation computes eight sums of whole words so,
    not 32 of single bits, which had been a tenth of its work.

    Members
    -------
    start : strobe: begins anew, before a byte of this same clock
    data, valid : a byte
    crc : of the bytes so far
    match : they end with their CRC, lowest byte first
    """

    start: In(1)
    data: In(8)
    valid: In(1)
    crc: Out(32)
    match: Out(1)

    reference = staticmethod(zlib.crc32)

    def elaborate(self, platform):
        m = Module()
        register = Signal(32, init=_START)
        before, index = Signal(32), Signal(8)
        m.d.comb += [
            before.eq(Mux(self.start, _START, register)),
            index.eq(before ^ self.data),
            self.crc.eq(~register),
            self.match.eq(register == _RESIDUE),
        ]
        entry = reduce(xor, (Mux(index[bit], Const(_shifted(bit), 32), 0) for bit in range(8)))
        with m.If(self.valid):
            m.d.sync += register.eq((before >> 8) ^ entry)
        with m.Elif(self.start):
            m.d.sync += register.eq(_START)
        return m
