"""What can go wrong with a board."""


class BoardError(Exception):
    """Something that the user can mend, in one sentence."""
