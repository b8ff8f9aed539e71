"""``magtrak info``: who a card is and what it is doing."""

import click

from .common import BAUD, PORT, connected, table


@click.command()
@PORT
@BAUD
def main(port: str | None, baud: int) -> None:
    """Show who the card is and what it is doing."""
    from ..state import State
    from ..summary import median

    with connected(port, baud) as card:
        state = State.read(card)
        link, one = card.link.statistics, card.identity
        rows = [
            ("port", card.link.port),
            ("serial number", one.serial_text),
            ("protocol", f"version {one.version}, map 0x{one.map_hash:08X}"),
            ("clock", f"{one.clock_hz / 1e6:g} MHz"),
            ("images", f"up to {one.max_columns} x {one.rows}"),
            ("built with", str(one.built)),
            ("UART", f"{one.link_baud} baud" if one.link_baud else "none: USB, or a virtual card"),
            ("measurement", state.measurement()),
            ("camera", state.sensor.text()),
            ("laser", state.laser()),
            ("motor", state.motor()),
            ("angle", state.angle()),
            ("images seen", f"{state.values['frames']}, {state.values['dropped']} dropped"),
            ("encoder", f"{state.values['index_passes']} passes of the index, {state.encoder_errors} errors"),
            ("commands", f"{state.values['damaged_commands']} damaged, {state.values['line_errors']} bytes lost"),
            ("link", f"{link.lost} packets lost, {link.damaged} damaged, answers in {_ms(median(card.round_trips_s))}"),
        ]
    click.echo(table(rows))


def _ms(seconds: float) -> str:
    return f"{1e3 * seconds:.1f} ms"
