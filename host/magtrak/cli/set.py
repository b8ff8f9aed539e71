"""``magtrak set``: registers and settings of a card that runs."""

import click

from .common import BAUD, PORT, connected, table


@click.command()
@click.argument("assignments", nargs=-1, required=True, metavar="NAME=VALUE...")
@click.option("--wait", type=click.FloatRange(min=0), default=0.5, show_default=True, metavar="S", help="For an image.")
@PORT
@BAUD
def main(assignments: tuple[str, ...], wait: float, port: str | None, baud: int) -> None:
    """Set registers (floor=30) or settings (weight.floor=30, peak.detector=binary, 'gate.hue=[90, 160]').

    Those of the measurement take effect all at once with the next image; they are shown as read back, what is in force,
    and "pending" where no image came in time. All else stays as it is; the gate's colours cannot be read from a card.
    """
    from ..adjust import needs_commit, parse_assignment
    from ..protocol import Access, register

    with connected(port, baud) as card:
        turn = card.read("counts_per_turn")
        values = [one for text in assignments for one in parse_assignment(text, card.identity.clock_hz, turn)]
        card.write_all(values)
        in_force = card.wait_in_force(card.commit(), wait) if needs_commit(values) else True
        rows = []
        for name, words in values:
            entry = register(name)
            if entry.access is Access.WRITE:
                rows.append((name, "table" if entry.words > 1 else str(words[0]), "written" if in_force else "pending"))
                continue
            now = card.read(name)
            pending = entry.scope.value == "frame" and not in_force
            rows.append((name, f"{now} {entry.unit}".strip(), f"{words[0]} pending: no image comes" if pending else ""))
    click.echo(table(rows))
