"""What can go wrong for a user: one sentence each, with the thing, the value and the cure."""


class MagtrakError(Exception):
    """A mistake or fault that the user can do something about; the message is the whole story."""


class CalibrationError(MagtrakError):
    """A calibration that cannot be used."""


class SettingsError(MagtrakError):
    """Settings that cannot be used, or that this card does not have."""


class LinkError(MagtrakError):
    """The port cannot be opened, or died."""


class EndOfStreamError(LinkError):
    """The other end of a pseudo-terminal closed it between two packets: the virtual card has finished."""


class CardError(MagtrakError):
    """What answers is no card that this host understands, or the card refused a command."""


class RefusedError(CardError):
    """The card refused a command.

    Parameters
    ----------
    message : for people
    code : an ``AnswerCode``
    """

    def __init__(self, message: str, code: int) -> None:
        super().__init__(message)
        self.code = code


class CardResetError(CardError):
    """The card has started anew, and knows nothing of what it was told."""


class OutputError(MagtrakError):
    """A file cannot be written."""


class LearnError(MagtrakError):
    """Pictures from which no colours can be learned."""
