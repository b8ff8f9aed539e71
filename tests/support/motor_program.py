"""The motor's program, run as its definition has it: a step a call."""

from collections.abc import Callable

from gateware.motion.assembly import Program
from gateware.motion.motor import FLAGS, INPUTS, OUTPUTS, SETTINGS


class Stepped:
    """A part of the motor's program, and its variables.

    Parameters
    ----------
    part : writes the part
    variables : that the part needs and does not make itself
    """

    def __init__(self, part: Callable[[Program], None], *variables: str) -> None:
        self.program = Program(tuple(INPUTS), FLAGS, OUTPUTS)
        self.program.variable(*SETTINGS, *variables)
        self.program.label("part")
        part(self.program)
        self.program.wait()
        self.state = dict.fromkeys(self.program.variables, 0)

    def step(self, **values: int) -> dict[str, int]:
        """What a step puts out; ``values`` are inputs, flags and variables, the others are 0 or as they were."""
        unknown = set(values) - {*INPUTS, *FLAGS, *self.state}
        assert not unknown, f"the program does not know {unknown}"
        self.state |= {name: value for name, value in values.items() if name in self.state}
        inputs = {name: values.get(name, 0) for name in INPUTS}
        flags = {name: int(values.get(name, 0)) for name in FLAGS}
        return dict(self.program.run(self.state, inputs, flags, "part"))
