"""``magtrak doctor``: what is wrong, and what to do."""

import click

from .common import BAUD, table


@click.command()
@click.option("--port", metavar="PORT", help="Look at this port alone; by default at all that can be a card's.")
@click.option("--udev", is_flag=True, help="Print the udev rules for cards, and do nothing else.")
@BAUD
def main(port: str | None, udev: bool, baud: int) -> None:
    """Find out why a card cannot be reached or loses data, and say what to do.

    Nothing is changed in a card. The exit status is 1 where something is not well.
    """
    from ..doctor import examine
    from ..udev import rules

    if udev:
        click.echo(rules(), nl=False)
        return
    findings = list(examine(port, baud))
    marks = {True: click.style("ok   ", fg="green"), False: click.style("BAD  ", fg="red", bold=True)}
    lines = table([(one.what, one.text) for one in findings]).splitlines()
    for one, line in zip(findings, lines, strict=True):
        click.echo(marks[one.well] + line)
    bad = sum(not one.well for one in findings)
    click.echo("all well" if not bad else f"{bad} of {len(findings)} not well")
    raise SystemExit(1 if bad else 0)
