"""The serial port, on pseudo-terminals."""

import contextlib
import os
import pty
import threading
import tty
from collections.abc import Iterator
from pathlib import Path

import pytest

from magtrak.errors import EndOfStreamError, LinkError
from magtrak.link import Link
from magtrak.protocol import Packet, frame_packet


@pytest.fixture
def terminal() -> Iterator[tuple[int, str]]:
    """Descriptor of the card's side, and the name of the host's."""
    master, slave = pty.openpty()
    tty.setraw(slave)
    name = os.ttyname(slave)
    os.close(slave)
    yield master, name
    with contextlib.suppress(OSError):
        os.close(master)


def packets(count: int, size: int = 50) -> list[Packet]:
    return [Packet(1, n, bytes((n + k) % 251 for k in range(size))) for n in range(count)]


def test_packets_go_both_ways(terminal: tuple[int, str]) -> None:
    master, name = terminal
    with Link(name) as link:
        assert link.send(0x80, b"abc") == 0
        assert link.send(0x81, b"") == 1
        expected = frame_packet(Packet(0x80, 0, b"abc")) + frame_packet(Packet(0x81, 1, b""))
        assert os.read(master, 100) == expected
        os.write(master, frame_packet(Packet(1, 9, b"\0\1")))
        assert link.receive(2) == Packet(1, 9, b"\0\1")
        assert link.receive(0.01) is None
        assert (link.packets, link.damaged_packets, link.lost_packets) == (1, 0, 0)


def test_packets_before_the_end_are_all_given_out(terminal: tuple[int, str]) -> None:
    master, name = terminal
    sent = packets(40)
    with Link(name) as link:
        os.write(master, b"".join(map(frame_packet, sent)))
        assert link.receive(2) == sent[0]
        for packet in sent[1:]:
            assert link.receive(2) == packet
        os.close(master)
        for _ in range(2):  # and again: it stays ended
            with pytest.raises(EndOfStreamError, match="was closed by the other end"):
                link.receive(2)
        with pytest.raises(LinkError):
            link.send(0x80, b"")


def test_end_in_the_middle_of_a_packet_is_no_orderly_end(terminal: tuple[int, str]) -> None:
    master, name = terminal
    first, second = packets(2)
    with Link(name) as link:
        os.write(master, frame_packet(first) + frame_packet(second)[:20])
        assert link.receive(2) == first
        assert link.receive(0.05) is None
        os.close(master)
        with pytest.raises(LinkError, match="in the middle of a packet") as caught:
            link.receive(2)
        assert not isinstance(caught.value, EndOfStreamError)


def test_damaged_and_lost_packets_are_counted(terminal: tuple[int, str]) -> None:
    master, name = terminal
    sent = [Packet(1, (0xFFFE + n) & 0xFFFF, b"12345") for n in range(5)]
    wire = [bytearray(frame_packet(p)) for p in sent]
    wire[1][5] ^= 0x40
    with Link(name) as link:
        os.write(master, b"".join([*wire[:3], wire[4]]))
        got = [link.receive(2) for _ in range(3)]
        assert got == [sent[0], sent[2], sent[4]]
        assert (link.packets, link.damaged_packets, link.lost_packets) == (3, 1, 2)


def test_a_slow_consumer_loses_nothing(terminal: tuple[int, str]) -> None:
    master, name = terminal
    sent = packets(2000, 200)

    def write() -> None:
        data = b"".join(map(frame_packet, sent))
        while data:
            data = data[os.write(master, data) :]

    with Link(name) as link:
        writer = threading.Thread(target=write)
        writer.start()
        writer.join(timeout=20)  # far more than the system buffers: somebody must be reading
        assert not writer.is_alive()
        assert [link.receive(2) for _ in sent] == sent
        assert link.bytes_received == sum(len(frame_packet(p)) for p in sent)


def test_ports_that_cannot_be_opened(tmp_path: Path) -> None:
    with pytest.raises(LinkError, match="does not exist: is the card plugged in, or magtrak-sim running"):
        Link(str(tmp_path / "card"))
    (tmp_path / "file").write_text("")
    with pytest.raises(LinkError, match="it is no serial port, or broken; check the name"):
        Link(str(tmp_path / "file"))
    with pytest.raises(LinkError, match="cannot be opened"):
        Link(str(tmp_path))
    (tmp_path / "stale").symlink_to("/dev/pts/none")
    with pytest.raises(LinkError, match="does not exist"):
        Link(str(tmp_path / "stale"))


def test_a_port_in_use_is_said_to_be(terminal: tuple[int, str]) -> None:
    _, name = terminal
    with Link(name), pytest.raises(LinkError, match="another program has it open"):
        Link(name)
    Link(name).close()


def test_a_symbolic_link_is_a_pseudo_terminal_too(terminal: tuple[int, str], tmp_path: Path) -> None:
    master, name = terminal
    (tmp_path / "card").symlink_to(name)
    with Link(str(tmp_path / "card")) as link:
        os.close(master)
        with pytest.raises(EndOfStreamError):
            link.receive(2)
