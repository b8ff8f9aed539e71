"""Greeting, commands and frames, against a card that is none."""

import time
from dataclasses import replace

import numpy as np
import pytest

from magtrak import protocol
from magtrak.built import Built
from magtrak.card import Card, Identity
from magtrak.errors import CardError, EndOfStreamError, SettingsError
from magtrak.link import Link
from magtrak.motor import Motor
from magtrak.settings import Ambient, Camera, LaserSwitch, Peak, Runs, Settings
from magtrak.settings_file import load_settings
from tests.support.fake_card import FakeCard
from tests.support.frames import CLOCK_HZ, Recorder

PATIENCE_S = 0.15


def frame_payloads(count: int) -> list[bytes]:
    return Recorder(lambda t: 100 * t, rows=4).payloads(count, lambda number: np.full(4, number + 0.5))


def test_greeting_reads_who_the_card_is() -> None:
    with FakeCard() as fake, Link(fake.port) as link:
        identity = Card(link).identity
        assert (identity.version, identity.map_hash) == (protocol.VERSION, protocol.map_hash())
        assert (identity.clock_hz, identity.max_columns, identity.max_rows) == (CLOCK_HZ, 2048, 2048)


@pytest.mark.parametrize(
    ("identity", "message"),
    [
        ({"magic": 0x12345678}, "is no Magtrak card: it calls itself 0x12345678"),
        ({"version": protocol.VERSION + 1}, r"speaks version \d+ of the protocol, .* update magtrak on this computer"),
        ({"version": 0}, "update the card's bitstream"),
        ({"map_hash": 1}, r"another register map \(0x00000001, not 0x[0-9A-F]{8}\): use bitstream and magtrak of"),
    ],
)
def test_cards_that_are_not_understood_are_refused_with_the_reason(identity: dict[str, int], message: str) -> None:
    with FakeCard(identity=identity) as fake, Link(fake.port) as link, pytest.raises(CardError, match=message):
        Card(link)


def test_other_devices_are_told_apart() -> None:
    with (
        FakeCard(chatter=b"$GPGGA,123519,4807.038,N\r\n" * 5) as fake,
        Link(fake.port) as link,
        pytest.raises(CardError, match="sends data, but no Magtrak packets: it is another device, or has another baud"),
    ):
        Card(link, PATIENCE_S)
    with (
        FakeCard(drop_answers=range(100)) as fake,
        Link(fake.port) as link,
        pytest.raises(CardError, match="does not answer as a Magtrak card: check port and baud rate"),
    ):
        Card(link, PATIENCE_S)


def test_a_command_whose_answer_is_lost_is_sent_again_and_the_order_stays() -> None:
    with FakeCard(drop_answers=[8, 9, 20]) as fake, Link(fake.port) as link:
        card = Card(link, PATIENCE_S)
        card.apply(Settings())
        for name, (value,) in Settings().register_values(CLOCK_HZ):
            assert fake.value(name) == value
        assert fake.written[-1][0] == "commit"


@pytest.mark.parametrize(
    ("identity", "settings", "message"),
    [
        ({"background_cells": 0}, Settings(ambient=Ambient("skip")), "ambient.mode needs the subtraction .* to off"),
        ({"features": 0x3FE}, Settings(runs=Runs(neighbours=2)), "runs.neighbours needs the filter .*: set it to 0"),
        ({"features": 0x3FD}, Settings(peak=Peak("centroid")), "peak.window needs the windowed .* the whole run"),
        ({"features": 0x3FB}, Settings(motor=Motor(mode="speed")), "motor.mode needs the speed loop.*: use duty"),
        ({"features": 0x3EF}, Settings(), "peak.detector needs the measurement of grey .* binary, as .*paper"),
        (
            {"features": 0x3FB},
            Settings(motor=Motor(watch=("stall",))),
            "motor.watch needs the speed .*: leave it out",
        ),
        ({"features": 0x3FB}, Settings(laser=LaserSwitch(needs_speed=True)), "laser.needs_speed .*: leave it out"),
    ],
)
def test_settings_that_need_what_a_card_is_built_without_are_refused(identity, settings, message) -> None:  # type: ignore[no-untyped-def]
    with FakeCard(identity=identity) as fake, Link(fake.port) as link:
        card = Card(link)
        with pytest.raises(SettingsError, match=message):
            card.apply(settings)
        assert not fake.written
        card.apply(load_settings("paper"))  # fits any card


def test_a_card_tells_what_it_is_built_with() -> None:
    assert "without" not in str(Built(0x3FF, 100)) and "speed loop" in str(Built(0x3FF, 100))
    assert str(Built(0b1000, 0)).startswith("snapshots; without filter of isolated pixels, ")
    with FakeCard(identity={"features": 0}) as fake, Link(fake.port) as link:
        card = Card(link)
        with pytest.raises(SettingsError, match="floor needs the measurement of grey values"):
            card.write("floor", 20)
        card.apply(load_settings("paper"))
        assert fake.value("floor") == 255
        assert fake.value("motor_period") == 1024
        with pytest.raises(SettingsError, match="time_offset_s needs the exposure and time offset in frames"):
            card.apply(replace(load_settings("paper"), camera=Camera(time_offset_s=-1e-3)))
    with FakeCard(identity={"features": 0x3F7}) as fake, Link(fake.port) as link, pytest.raises(SettingsError):
        Card(link).write("snapshot", 1)


def test_tables_arrive_word_for_word() -> None:
    settings = Settings()
    with FakeCard() as fake, Link(fake.port) as link:
        Card(link).apply(settings)
        for name, words in settings.tables():
            first = protocol.register(name).address
            assert [fake.registers[first + n] for n in range(protocol.LUT_WORDS)] == list(words)


def test_settings_are_committed_last_and_nothing_moves_or_shines_before_the_start() -> None:
    settings = Settings(motor=Motor(duty=-0.5))
    with FakeCard(loop_for_ever=True) as fake, Link(fake.port) as link:
        card = Card(link)
        generation = card.apply(settings)
        assert fake.written[-1] == ("commit", generation)
        assert "laser_arm" not in dict(fake.written)
        assert {value for name, value in fake.written if name in ("motor_duty", "motor_mode", "run")} == {0}
        del fake.written[:]
        card.start(settings)
        assert fake.written == [
            ("laser_arm", protocol.LASER_KEY),
            ("motor_duty", -16384),
            ("motor_mode", protocol.MotorMode.DUTY),
            ("run", 1),
        ]
        del fake.written[:]
        card.stop()
        assert fake.written == [("laser_arm", 0), ("motor_mode", 0), ("run", 0)]


def test_refusals_name_register_and_reason() -> None:
    with FakeCard(refuse=["floor", "laser_arm"]) as fake, Link(fake.port) as link:
        card = Card(link)
        with pytest.raises(CardError, match=r"the card refuses writing 9 to floor: it does not allow it$"):
            card.write("floor", 9)
        with pytest.raises(CardError, match="is the interlock closed"):
            card.write("laser_arm", protocol.LASER_KEY)
        with pytest.raises(ValueError, match="floor takes 0 to 255, not 256"):
            card.write("floor", 256)
        card.write("weight_g", -3)
        assert card.read("weight_g") == -3


def test_frames_that_come_between_answers_are_kept() -> None:
    with FakeCard(frame_payloads(5)) as fake, Link(fake.port) as link:
        card = Card(link)
        card.write("run", 1)
        numbers = []
        with pytest.raises(EndOfStreamError):
            for frame in card.frames():
                if frame is not None:
                    numbers.append(frame.number)
        assert numbers == [0, 1, 2, 3, 4]


def test_reading_while_frames_flow() -> None:
    with FakeCard(frame_payloads(60), frame_s=0.002, loop_for_ever=True) as fake, Link(fake.port) as link:
        card = Card(link)
        card.write("run", 1)
        for _ in range(20):
            assert card.read("clock_hz") == CLOCK_HZ
        frames = [frame for _, frame in zip(range(60), filter(None, card.frames()), strict=False)]
        assert [frame.number for frame in frames] == list(range(60))


def test_impossible_frames_are_counted_and_left_out() -> None:
    payloads = frame_payloads(3)
    payloads[1] = payloads[1] + b"\0"
    with FakeCard(payloads) as fake, Link(fake.port) as link:
        card = Card(link)
        card.write("run", 1)
        numbers = []
        with pytest.raises(EndOfStreamError):
            for frame in card.frames():
                numbers += [frame.number] if frame else []
        assert numbers == [0, 2]
        assert card.damaged_frames == 1


def test_the_lease_is_renewed_while_frames_are_awaited() -> None:
    with FakeCard(loop_for_ever=True) as fake, Link(fake.port) as link:
        card = Card(link)
        card.apply(Settings())
        card.start(Settings())
        before, start = fake.commands, time.monotonic()
        for frame in card.frames(poll_s=0.02):
            assert frame is None
            if time.monotonic() - start > 1.1:
                break
        # A lease of 1 s is renewed five times in it.
        assert 4 <= fake.commands - before <= 8


@pytest.mark.parametrize(("full_rows", "max_rows", "rows"), [(1, 64, 64), (0, 64, 256), (0, 1024, 2048)])
def test_a_card_with_compact_rows_only_has_four_times_as_many(full_rows: int, max_rows: int, rows: int) -> None:
    built = Built(full_rows << protocol.FEATURES.index("full_rows"), 0)
    assert Identity(1, 0, CLOCK_HZ, 640, max_rows, built).rows == rows
