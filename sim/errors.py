"""The one error that a user of the simulator may see."""


class SimError(Exception):
    """A user's mistake, as one sentence that names the thing, the value and what to do."""
