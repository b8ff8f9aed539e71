"""CRC-32 of IEEE 802.3, some bits a clock."""

import zlib
from functools import reduce
from operator import xor

from amaranth.hdl import Const, Module, Mux, Signal
from amaranth.lib import wiring
from amaranth.lib.wiring import In, Out

_START = 0xFFFF_FFFF
_POLYNOMIAL = 0xEDB8_8320  # bit-reversed: the lowest bit is the first on the wire
_RESIDUE = 0xDEBB_20E3  # what the register holds after intact data with their CRC behind them


def _shifted(bit: int, bits: int) -> int:
    """What a set bit of the data adds to the register after as many shifts as there are bits."""
    value = 1 << bit
    for _ in range(bits):
        value = value >> 1 ^ _POLYNOMIAL * (value & 1)
    return value


class Crc32(wiring.Component):
    """The CRC of ``zlib.crc32``, of the bits since ``start``.

    Like the table of D. V. Sarwate, "Computation of cyclic redundancy checks via table look-up", CACM 31 (1988), with
    the entry made of one constant for each set bit. Fewer bits a clock take fewer cells; 8 bits take 142 LUTs of four
    inputs.

    Parameters
    ----------
    bits : bits a clock, 1, 2, 4 or 8

    Members
    -------
    start : strobe: begins anew, instead of what else would come in this clock
    data, valid : the next bits, the first one lowest
    shift : with ``valid``: no data; the lowest bits of ``crc`` leave, the next ones follow
    crc : of the bits so far
    match : they end with their CRC, lowest byte first
    """

    def __init__(self, bits: int) -> None:
        self.bits = bits
        super().__init__(
            {
                "start": In(1),
                "data": In(bits),
                "valid": In(1),
                "shift": In(1),
                "crc": Out(32),
                "match": Out(1),
            }
        )

    reference = staticmethod(zlib.crc32)

    def elaborate(self, platform):
        m = Module()
        register = Signal(32, init=_START)
        index = Signal(self.bits)
        m.d.comb += [
            index.eq(Mux(self.shift, 0, register ^ self.data)),
            self.crc.eq(~register),
            self.match.eq(register == _RESIDUE),
        ]
        entry = reduce(xor, (Mux(index[bit], Const(_shifted(bit, self.bits), 32), 0) for bit in range(self.bits)))
        with m.If(self.start):
            m.d.sync += register.eq(_START)
        with m.Elif(self.valid):
            m.d.sync += register.eq((register >> self.bits) ^ entry)
        return m
