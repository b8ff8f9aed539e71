"""All simulations here show where a block RAM is read and written at once, or used before it was read."""

import pytest
from amaranth.hdl import Module, Mux, Signal, Value

from gateware.memory import BlockRam

_elaborate = BlockRam.elaborate


def _inverted(self, platform):
    """As :meth:`BlockRam.elaborate`, but a word that is read while it is written comes inverted, and ones stand there
    before anything was read.
    """
    m = Module()
    plain = BlockRam(self.shape, self.depth, self.init, registered=self.registered)
    m.submodules.plain = _elaborate(plain, platform)
    met, word = Signal(init=1), Signal(self.shape)
    m.d.comb += [
        plain.write.addr.eq(self.write.addr),
        plain.write.data.eq(self.write.data),
        plain.write.en.eq(self.write.en),
        plain.read.addr.eq(self.read.addr),
        plain.read.en.eq(self.read.en),
        word.eq(plain.read.data),
        Value.cast(self.read.data).eq(Mux(met, ~Value.cast(word), Value.cast(word))),
    ]
    meets = self.write.en & (self.write.addr == self.read.addr)
    with m.If(self.read.en):
        if self.registered:
            before = Signal()
            m.d.sync += before.eq(meets)
            meets = before
        m.d.sync += met.eq(meets)
    return m


@pytest.fixture(autouse=True)
def collisions_show(monkeypatch):
    monkeypatch.setattr(BlockRam, "elaborate", _inverted)
