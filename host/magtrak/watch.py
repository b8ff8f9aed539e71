"""Rates, losses and state of a card that runs, gathered from its frames and registers."""

import time

from .card import Card
from .frames import Frame
from .state import State
from .summary import Rates, median


class Watch:
    """Takes every frame, and asks the card for the rest when it is to be shown.

    Parameters
    ----------
    card : greeted
    """

    def __init__(self, card: Card) -> None:
        self.card = card
        now = time.monotonic()
        self._frames = 0
        self._rates, self._images = Rates(now), Rates(now)
        self._lost_frames = 0
        self._last: Frame | None = None
        self._first_images: int | None = None

    def take(self, frame: Frame | None) -> None:
        """A frame, or None where none came."""
        if frame is None:
            return
        if self._last is not None and frame.number > self._last.number:
            self._lost_frames += frame.number - self._last.number - 1
        self._last = frame
        self._frames += 1

    def lines(self) -> list[str]:
        """For a terminal."""
        state, rates = self._now()
        card = self.card
        return [
            f"card {card.identity.serial_text} on {card.link.port}",
            f"measurement  {state.measurement()}",
            f"rate         {rates}",
            f"losses       {self._losses(state)}",
            f"line         {self._line()}",
            f"angle        {state.angle()}, {state.values['index_passes']} passes of the index",
            f"motor        {state.motor()}",
            f"laser        {state.laser()}",
        ]

    def line(self) -> str:
        """All in one."""
        state, rates = self._now()
        return f"{rates}; {self._losses(state)}; {state.angle()}; motor {state.motor()}; laser {state.laser()}"

    def _now(self) -> tuple[State, str]:
        state = State.read(self.card)
        now = time.monotonic()
        images = state.values["frames"]
        self._first_images = images if self._first_images is None else self._first_images
        frame_rate, byte_rate = self._rates.update(now, self._frames, self.card.link.statistics.bytes)
        image_rate, _ = self._images.update(now, images - self._first_images, 0)
        parts = [f"{image_rate:.1f} images/s", f"{frame_rate:.1f} frames/s", f"{byte_rate / 1e3:.0f} kB/s"]
        if self._frames and self.card.clock.mapping is not None:
            parts.append(f"frames late by {1e3 * median(self.card.delays_s):.1f} ms")
        parts.append(f"answers in {1e3 * median(self.card.round_trips_s):.1f} ms")
        return state, ", ".join(parts)

    def _losses(self, state: State) -> str:
        link = self.card.link.statistics
        return (
            f"{state.values['dropped']} images dropped, {self._lost_frames} frames lost,"
            f" {link.damaged} packets damaged, {state.encoder_errors} encoder errors"
        )

    def _line(self) -> str:
        if self._last is None:
            return "no frame yet"
        rows = self._last.rows
        lit = rows.valid.mean() if len(rows.row) else 0.0
        doubtful = rows.ambiguous.sum() + rows.cut.sum()
        return f"in {100 * lit:.0f} % of {len(rows.row)} rows, {rows.saturated.sum()} saturated, {doubtful} doubtful"
