"""``magtrak self-test``: does this card do what it should?"""

import click

from .common import BAUD, PORT, connected


@click.command()
@PORT
@BAUD
@click.option("--camera", is_flag=True, help="The card has a camera: leave out what needs the test picture.")
@click.option("--loop-back", is_flag=True, help="Motor outputs are wired to the encoder's inputs, and to no motor.")
def main(port: str | None, baud: int, camera: bool, loop_back: bool) -> None:
    """Test a card by its test picture: link, registers, gate, positions, counters, angle inputs.

    Its settings are left as they were; the laser stays off. The exit status is 1 where something failed.
    """
    from ..selftest.bench import Options
    from ..selftest.run import CHECKS, Result, examine

    colours = {Result.OK: "green", Result.FAILED: "red", Result.NOT_TRIED: "yellow"}
    width = max(len(name) for name, _ in CHECKS)
    count = dict.fromkeys(Result, 0)
    with connected(port, baud) as card:
        for outcome in examine(card, Options(camera, loop_back)):
            mark = click.style(f"{outcome.result.value:9}", fg=colours[outcome.result])
            click.echo(f"{mark}  {outcome.name:{width}}  {outcome.text}")
            count[outcome.result] += 1
    click.echo(", ".join(f"{number} {result.value}" for result, number in count.items() if number))
    raise SystemExit(1 if count[Result.FAILED] else 0)
