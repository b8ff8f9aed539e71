"""``magtrak list``: the cards on this computer."""

import click

from .common import BAUD, table


@click.command()
@click.argument("ports", nargs=-1, metavar="[PORT]...")
@click.option("--all", "every", is_flag=True, help="Greet every serial port; opening a port resets some devices.")
@BAUD
def main(ports: tuple[str, ...], every: bool, baud: int) -> None:
    """List the cards on this computer.

    Looks at USB ports that can be a card's, at those in the environment variable MAGTRAK_PORTS, and at PORTs: a virtual
    card's port is the path given to magtrak-sim --link.
    """
    import sys

    from ..discover import candidates, greet_all

    found = greet_all(candidates(ports, every=every), baud)
    cards = [one for one in found if one.identity is not None]
    if cards:
        rows = [("PORT", "SERIAL", "VERSION", "IMAGES UP TO", "CLOCK", "USB")]
        for one in cards:
            card, candidate = one.identity, one.candidate
            assert card is not None
            size, clock = f"{card.max_columns} x {card.rows}", f"{card.clock_hz / 1e6:g} MHz"
            usb = f"{candidate.usb} {candidate.product}".strip() or "-"
            rows.append((candidate.port, card.serial_text, str(card.version), size, clock, usb))
        click.echo(table(rows))
    for one in found:
        if one.identity is None:
            click.echo(f"magtrak: {one.problem}", err=True)
    if not found:
        click.echo("magtrak: no port that can be a card's; `magtrak doctor` tells what is wrong", err=True)
    sys.exit(0 if cards else 1)
