"""``magtrak get``: registers of a card."""

import click

from .common import BAUD, PORT, connected, table


@click.command()
@click.argument("names", nargs=-1, metavar="[NAME]...")
@PORT
@BAUD
def main(names: tuple[str, ...], port: str | None, baud: int) -> None:
    """Show registers, all that can be read if no NAME is given: of settings, what is in force."""
    from ..protocol import REGISTERS, Access, Register, register
    from . import fail

    chosen: list[Register] = []
    for name in names:
        try:
            chosen.append(register(name))
        except KeyError as error:
            fail(f"{error.args[0]}; `magtrak get` lists them all")
        if chosen[-1].access is Access.WRITE:
            fail(f"register {name} can only be written")
    chosen = chosen or [one for one in REGISTERS if one.access is not Access.WRITE]
    with connected(port, baud) as card:
        values = card.read_all([one.name for one in chosen])
    click.echo(table([(one.name, str(value), one.unit, one.doc) for one, value in zip(chosen, values, strict=True)]))
