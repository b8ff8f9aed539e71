"""What goes wrong between a card and the host, without a gateware: one sentence each, nothing received is lost."""

import os
import re
import threading
import time
import tty
from pathlib import Path

import numpy as np
import pytest

from magtrak import protocol
from magtrak.card import Card
from magtrak.cloud.ply import read_ply
from magtrak.errors import CardError, CardResetError
from magtrak.link import Link
from magtrak.settings import Settings
from tests.host.test_card import frame_payloads
from tests.host.test_receive import Receiver, wall
from tests.support.fake_card import FakeCard
from tests.support.uart import misread

PATIENCE_S = 0.15


@pytest.fixture
def receiver(tmp_path: Path) -> Receiver:
    return Receiver(tmp_path)


@pytest.mark.parametrize("ratio", [3, 1.5, 1 / 4, 12.0, 0.9])
def test_another_baud_rate(ratio: float) -> None:
    """A card at 3 Mbaud, a host at 1, 2, 12, 0.25 and 3.3: silent, or sending frames, as it was left."""
    streaming = frame_payloads(400)
    with (
        FakeCard(streaming, frame_s=0.002, identity={"run": 1}, line=lambda data: misread(data, ratio)) as fake,
        Link(fake.port) as link,
        pytest.raises(CardError, match="sends data, but no Magtrak packets: it is another device, or has another baud"),
    ):
        Card(link, PATIENCE_S)
    with (
        FakeCard(line=lambda data: misread(data, ratio)) as fake,
        Link(fake.port) as link,
        pytest.raises(CardError, match="does not answer as a Magtrak card: check port and baud rate"),
    ):
        Card(link, PATIENCE_S)


def test_the_model_of_a_wrong_baud_rate_is_right_at_the_right_one() -> None:
    data = bytes(range(256)) * 2
    assert misread(data, 1.0) == data
    assert misread(data, 1.02) == data  # 2 % is what a UART bears
    assert misread(data, 3.0) != data and misread(data, 0.5) != data
    with FakeCard(line=lambda data: misread(data, 1.02)) as fake, Link(fake.port) as link:
        assert Card(link).identity.version == protocol.VERSION


def test_a_plug_that_gives_back_what_it_gets() -> None:
    master, slave = os.openpty()
    tty.setraw(slave)

    def echo() -> None:
        while True:
            try:
                os.write(master, os.read(master, 1000))
            except OSError:
                return

    thread = threading.Thread(target=echo)
    thread.start()
    with (
        Link(os.ttyname(slave)) as link,
        pytest.raises(CardError, match="does not answer as a Magtrak card"),
    ):
        Card(link, PATIENCE_S)
    os.close(slave)
    thread.join(timeout=60)
    os.close(master)
    assert not thread.is_alive()


def test_a_card_of_another_version_is_named_by_the_command(receiver: Receiver) -> None:
    with FakeCard(identity={"version": protocol.VERSION + 1}) as card:
        said = receiver.fails(card.port, "--record", "scan.mcap")
    assert "update magtrak on this computer" in said
    assert not (receiver.folder / "scan.mcap").exists()
    assert not receiver.cloud.exists()


def test_a_card_reset_in_the_middle_of_a_frame_is_told_and_costs_that_frame(receiver: Receiver) -> None:
    with FakeCard(wall(20), frame_s=0.01, reset_in=10) as card:
        done = receiver.run(card.port)
    assert done.returncode == 1
    assert "the card was reset during the scan: check its power, then start again" in done.stderr
    assert "the cloud so far is in cloud.ply" in done.stderr
    assert done.stdout.startswith("10 frames, 480 points, 0 lost frames (0 dropped by the card), 1 damaged packets")
    assert len(read_ply(receiver.cloud)) == 480


def test_a_card_that_was_reset_is_started_again_where_that_is_wanted(receiver: Receiver) -> None:
    with FakeCard(wall(20), frame_s=0.01, reset_in=10, loop_for_ever=True) as card:
        done = receiver.run(card.port, "--reconnect", "10", "--frames", "15", "--record", "scan.mcap")
        assert dict(card.written)["laser_arm"] == 0
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("15 frames, 720 points, ") and "1 restarts of the card" in done.stdout
    cloud = read_ply(receiver.cloud)
    assert sorted(set(cloud["scalar_frame"])) == list(range(15))
    assert (np.diff(cloud["scalar_time"]) >= 0).all()


def test_frames_before_a_fault_are_all_given_out() -> None:
    """They wait in the host when the card says that it is off."""
    payloads = frame_payloads(30)
    with FakeCard(payloads, loop_for_ever=True) as fake, Link(fake.port) as link:
        card = Card(link)
        card.apply(Settings())
        card.start(Settings())
        while fake.frames_sent < 30:
            time.sleep(0.01)
        fake.registers[protocol.register("run").address] = 0
        card._checked_s = 0  # ask at once
        time.sleep(0.3)  # longer than a fifth of the lease
        numbers = []
        with pytest.raises(CardResetError):
            for frame in card.frames():
                numbers += [frame.number] if frame else []
        assert numbers == list(range(30))


def test_a_second_program_is_told_who_has_the_port(receiver: Receiver) -> None:
    with FakeCard(frame_payloads(20), frame_s=0.01, loop_for_ever=True) as fake, Link(fake.port) as link:
        card = Card(link)
        card.write("run", 1)
        said = receiver.fails(fake.port)
        assert re.search(rf"another program has it open, [^;]*\({os.getpid()}\)[^;]*; close that first", said), said
        numbers = [frame.number for _, frame in zip(range(20), filter(None, card.frames()), strict=False)]
        assert numbers == list(range(20))
        assert (link.statistics.damaged, link.statistics.lost) == (0, 0)
    assert not receiver.cloud.exists()
