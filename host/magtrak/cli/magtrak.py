"""``magtrak``: one command with many, each imported only when it is used."""

from importlib import import_module

import click

COMMANDS: dict[str, tuple[str, str]] = {
    "learn-gate": ("learn_gate", "Learn the laser's colours from a picture or two."),
    "doctor": ("doctor", "Find out why a card cannot be reached, and what to do."),
    "get": ("get", "Show registers of a card."),
    "info": ("info", "Show who a card is and what it is doing."),
    "list": ("list", "List the cards on this computer."),
    "replay": ("replay", "Make the cloud of a recording anew."),
    "self-test": ("self_test", "Test a card by its test picture."),
    "set": ("set", "Set registers or settings of a card that runs."),
    "snapshot": ("snapshot", "Fetch a picture of what a card sees."),
    "watch": ("watch", "Show rates, losses, angle, laser and motor, live."),
    "calibrate": ("calibrate", "Calibrate camera and laser, show and check a calibration."),
    "validate": ("validate", "Measure how good the scanner is."),
}
"""Name of each command: its module beside this one, and one line for the list."""


class LazyGroup(click.Group):
    """A group whose commands are ``main`` of modules that are imported when asked for.

    Parameters
    ----------
    commands : name of each command: module (relative to this package) and help in one line
    """

    def __init__(self, *args: object, lazy: dict[str, tuple[str, str]] | None = None, **more: object) -> None:
        super().__init__(*args, **more)  # type: ignore[arg-type]
        self.lazy = lazy or {}

    def list_commands(self, ctx: click.Context) -> list[str]:
        return sorted({*super().list_commands(ctx), *self.lazy})

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if cmd_name not in self.lazy:
            return super().get_command(ctx, cmd_name)
        command: click.Command = import_module(f".{self.lazy[cmd_name][0]}", __package__).main
        return command

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        rows = [(name, self.lazy[name][1]) for name in self.list_commands(ctx) if name in self.lazy]
        if rows:
            with formatter.section("Commands"):
                formatter.write_dl(rows)


@click.group(cls=LazyGroup, lazy=COMMANDS, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(package_name="magtrak")
def main() -> None:
    """Tools for a Magtrak card, its recordings and its calibration."""
