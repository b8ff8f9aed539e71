"""The registers: read, written, kept aside until they are committed, and refused."""

from ..errors import RefusedError, SettingsError
from ..protocol import REGISTERS, Access, AnswerCode, PacketType, Register, Scope, register
from .bench import Bench, FailedError

_STARTS = ("run", "snapshot", "motor_mode", "motor_duty", "motor_brake")
"""Writing these would do something."""

_NOWHERE = 0xFFFF
"""An address without a register."""


def reading(bench: Bench) -> str:
    """Every register that can be read is, twice, and says nothing that it cannot hold."""
    entries = [one for one in REGISTERS if one.access is not Access.WRITE and one.words == 1]
    names = [one.name for one in entries]
    for entry, value in zip(entries, bench.card.read_all(names), strict=True):
        low, high = entry.range
        if entry.access is Access.BOTH and not low <= value <= high:
            raise FailedError(f"{entry.name} reads {value}, which is not within {low} to {high}")
    return f"{len(names)} registers read"


def writing(bench: Bench) -> str:
    """Registers that take effect at once hold the least and the greatest value that they may have; but for those that
    need what the card is built without.
    """
    entries = [one for one in REGISTERS if one.scope is Scope.NOW and one.access is Access.BOTH]
    entries = [one for one in entries if one.name not in _STARTS and _built(bench, one)]
    names = [one.name for one in entries]
    before = bench.card.read_all(names)
    for values in ([one.range[0] for one in entries], [one.range[1] for one in entries], before):
        bench.card.write_all([(name, [value]) for name, value in zip(names, values, strict=True)])
        for name, value, read in zip(names, values, bench.card.read_all(names), strict=True):
            if read != value:
                raise FailedError(f"{name} was written {value} and reads {read}")
    return f"{len(names)} registers hold their least and their greatest value"


def _built(bench: Bench, entry: Register) -> bool:
    try:
        bench.card.identity.built.check([(entry.name, [entry.range[1]])])
    except SettingsError:
        return False
    return True


def committing(bench: Bench) -> str:
    """Settings of the measurement read as before until a commit and an image, then as written. What this card is built
    without is refused, and told.
    """
    card = bench.card
    card.write("run", 1)
    entries = [one for one in REGISTERS if one.scope is Scope.FRAME and one.access is Access.BOTH]
    names = [one.name for one in entries]
    missing = set()
    for choose in (min, max):
        wanted = {}
        before = card.read_all(names)
        for entry in entries:
            value = choose(entry.range)
            try:
                card.write(entry.name, value)
                wanted[entry.name] = value
            except SettingsError:  # before it is sent
                missing.add(entry.name)
            except RefusedError as error:
                if error.code != AnswerCode.OUT_OF_RANGE:
                    raise
                missing.add(entry.name)
        if card.read_all(names) != before:
            raise FailedError("settings took effect before they were committed")
        bench.commit({})
        if card.read("pending"):
            raise FailedError("a commit still waits after it took effect")
        for entry, value in zip(entries, card.read_all(names), strict=True):
            if entry.name in wanted and value != wanted[entry.name]:
                raise FailedError(f"{entry.name} was committed as {wanted[entry.name]} and reads {value}")
    built = f"; built without what {', '.join(sorted(missing))} need" if missing else ""
    return f"{len(names) - len(missing)} settings wait for their commit{built}"


def refusing(bench: Bench) -> str:
    """Values out of range, registers that cannot be written, read, or are not there: each is refused for its reason."""
    card = bench.card
    count = 0
    names = [one.name for one in REGISTERS if one.access is Access.BOTH]
    before = card.read_all(names)
    for entry in REGISTERS:
        low, high = entry.range
        if entry.access is Access.READ:
            count += _refused(bench, entry.name, 0, AnswerCode.NOT_ALLOWED)
        elif entry.access is Access.BOTH and entry.words == 1:
            least, most = (-(1 << 31), (1 << 31) - 1) if entry.signed else (0, (1 << 32) - 1)
            outside = ([high + 1] if high < most else []) + ([low - 1] if low > least else [])
            for value in outside:
                count += _refused(bench, entry.name, value, AnswerCode.OUT_OF_RANGE)
    for name, old, new in zip(names, before, card.read_all(names), strict=True):
        if new != old:
            raise FailedError(f"{name} took a value that it refused: it was {old} and reads {new}")
    count += _refused(bench, None, 0, AnswerCode.UNKNOWN_ADDRESS)
    return f"{count} wrong commands refused"


def _refused(bench: Bench, name: str | None, value: int, code: AnswerCode) -> int:
    address = register(name).address if name else _NOWHERE
    found = bench.card.ask(PacketType.WRITE, address, value)["code"]
    if found != code:
        what = name or "an address without a register"
        raise FailedError(f"writing {value} to {what} was answered {_name(found)}, not {code.name}")
    return 1


def _name(code: int) -> str:
    return AnswerCode(code).name if code in list(AnswerCode) else str(code)
