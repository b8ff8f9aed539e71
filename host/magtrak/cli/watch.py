"""``magtrak watch``: what a card is doing, live."""

import click

from .common import BAUD, PORT, connected


@click.command()
@click.option("--run", is_flag=True, help="Have it measure meanwhile; laser and motor stay as they are.")
@click.option("--seconds", type=click.FloatRange(min=0), metavar="S", help="End after S seconds.")
@PORT
@BAUD
def main(run: bool, seconds: float | None, port: str | None, baud: int) -> None:
    """Show rates, losses, angle, laser and motor, over and over, until Ctrl-C.

    On a terminal five times a second in the same place, elsewhere a line a second.
    """
    import sys
    import time

    from ..watch import Watch

    live = sys.stdout.isatty()
    every_s = 0.2 if live else 1.0
    with connected(port, baud) as card:
        before = card.read("run")
        watch = Watch(card)
        start, shown_s, lines = time.monotonic(), 0.0, 0
        try:
            if run:
                card.write("run", 1)
            for frame in card.frames(poll_s=0.05):
                now = time.monotonic()
                watch.take(frame)
                if now - shown_s >= every_s:
                    shown_s = now
                    text = watch.lines() if live else [watch.line()]
                    if lines:
                        click.echo(f"\x1b[{lines}A", nl=False)
                    for one in text:
                        click.echo(f"\r{one}\x1b[K" if live else one)
                    lines = len(text) if live else 0
                if seconds is not None and now - start >= seconds:
                    break
        finally:
            if run:
                card.write("run", before)
