"""The one error of the virtual card."""


class SimError(Exception):
    """A user's mistake or a missing tool, in one sentence that says what to do."""
