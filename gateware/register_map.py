"""Where the register file keeps what: numbers of registers, and the memory that tells about each."""

from magtrak.protocol import LUT_WORDS, REGISTERS, Access, MotorMode, Register, RowForm, Scope

from .features import Features

TABLES = tuple(r for r in REGISTERS if r.words > 1)
"""The gate tables, in the order of :class:`~gateware.layouts.LutWrite`'s axes."""

NUMBER_BITS = 8
BANK_BIT = 6
"""Of a setting of scope ``FRAME``, whose numbers are below: it has two words, with 0 and with 1 in this bit."""

PAGE_BITS = 8
"""Registers whose addresses have the same bits above these are a page."""


def _pages() -> dict[int, tuple[int, int]]:
    """Base and size of each page without tables: the number of a register is base | the rest of its address."""
    sizes: dict[int, int] = {}
    scopes: dict[int, bool] = {}
    for r in REGISTERS:
        if r not in TABLES:
            page = r.address >> PAGE_BITS
            sizes[page] = max(sizes.get(page, 0), (r.address & (1 << PAGE_BITS) - 1) + 1)
            scopes[page] = scopes.get(page, False) or r.scope is Scope.FRAME
    free = [True] * (1 << NUMBER_BITS)
    bases: dict[int, tuple[int, int]] = {}
    # The page of the settings first: it starts at 0, and nothing else has its numbers, or those of its second bank.
    for page in sorted(sizes, key=lambda page: (not scopes[page], -sizes[page])):
        size = sizes[page]
        align = 1 << (size - 1).bit_length()
        assert not scopes[page] or (not bases and size <= 1 << BANK_BIT), "settings need one page of 64 at most"
        base = next((at for at in range(0, len(free), align) if all(free[at : at + size])), None)
        assert base is not None, f"no room for {size} numbers: put registers of page {page:#x} closer, or into others"
        taken = 2 << BANK_BIT if scopes[page] else size
        free[base : base + taken] = [False] * taken
        bases[page] = (base, size)
    return bases


PAGES = _pages()
TABLE_BASE = next(
    at
    for at in range(0, 1 << NUMBER_BITS, 4)
    if not any(at < base + size and base < at + 4 for base, size in PAGES.values()) and at >= 2 << BANK_BIT
)
"""Number of the first gate table."""


def number(register: Register) -> int:
    """The register's number."""
    if register in TABLES:
        return TABLE_BASE + TABLES.index(register)
    return PAGES[register.address >> PAGE_BITS][0] | register.address & (1 << PAGE_BITS) - 1


NOWHERE = next(at for at in range(1 << NUMBER_BITS) if at not in {number(r) for r in REGISTERS})
"""A number that no register has."""


def built(register: Register, features: Features) -> tuple[int, int, int]:
    """Least and greatest value that a card of these features takes, and the one after reset."""
    only = {
        "floor": (features.runs, 255),
        "form": (features.full_rows, int(RowForm.COMPACT)),
        "counts_per_turn": (features.turn_check, 0),
        "motor_period": (features.pwm_period, register.init),
        "exposure_us": (features.notes, 0),
        "time_offset_ns": (features.notes, 0),
    }
    is_built, value = only.get(register.name, (True, 0))
    if not is_built:
        return value, value, value
    low, high = register.range
    limits = {
        "ambient_mode": features.background_cells > 0,
        "isolate": features.isolate,
        "centroid_window": features.window,
        "snapshot": features.snapshot,
        "motor_mode": features.speed_loop,
        "motor_watch": features.speed_loop,
        "laser_conditions": features.speed_loop,
        "detector": features.runs,
    }
    if not limits.get(register.name, True):
        high = int(MotorMode.DUTY) if register.name == "motor_mode" else 0
    return low, high, min(register.init, high)


assert all(r.words == LUT_WORDS for r in TABLES)
assert all(number(r) < 1 << BANK_BIT for r in REGISTERS if r.scope is Scope.FRAME and r.access is Access.BOTH)
