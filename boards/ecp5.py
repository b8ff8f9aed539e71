"""What boards with an ECP5 share: parts of the FPGA that the tools don't choose by themselves."""

from amaranth.hdl import Cat, ClockSignal, Const, Instance, Module, Signal

from gateware.arithmetic import Multiply


class Ecp5:
    """A part of an ECP5 board's platform, which every one of :mod:`boards.board` has."""

    def get_multiplier(self, multiply: Multiply) -> Module:
        """A MULT18X18D with the registers inside it, which Yosys leaves unused: 278 MHz at speed 6, 132-146 without."""
        m = Module()
        pins = {}
        for name, factor in (("A", multiply.a), ("B", multiply.b)):
            wide = Signal(factor.shape() if len(factor) == 18 else Const(0, 18).shape(), name=name)
            m.d.comb += wide.eq(factor)  # with its sign
            pins |= {f"i_{name}{bit}": wide[bit] for bit in range(18)}
            pins[f"i_SIGNED{name}"] = int(factor.shape().signed)
        product = [Signal(name=f"P{bit}") for bit in range(36)]
        pins |= {f"o_P{bit}": wire for bit, wire in enumerate(product)}
        m.submodules.multiplier = Instance(
            "MULT18X18D",
            p_REG_INPUTA_CLK="CLK0",
            p_REG_INPUTB_CLK="CLK0",
            p_REG_OUTPUT_CLK="CLK0",
            p_GSR="DISABLED",
            i_CLK0=ClockSignal(),
            i_CE0=1,
            i_RST0=0,
            i_SOURCEA=0,
            i_SOURCEB=0,
            **pins,
        )
        m.d.comb += multiply.product.eq(Cat(product))
        return m
