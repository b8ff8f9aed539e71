"""The serial port, on pseudo-terminals."""

import contextlib
import os
import pty
import signal
import subprocess
import sys
import termios
import threading
import time
import tty
from collections.abc import Iterator
from pathlib import Path

import pytest
import serial

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


def counted(link: Link) -> tuple[int, int, int]:
    now = link.statistics
    return now.packets, now.damaged, now.lost


def test_packets_go_both_ways(terminal: tuple[int, str]) -> None:
    master, name = terminal
    with Link(name) as link:
        assert link.send(0x80, b"abc") == 0
        assert link.send(0x81, b"") == 1
        expected = frame_packet(Packet(0x80, 0, b"abc")) + frame_packet(Packet(0x81, 1, b""))
        sent = b""
        while len(sent) < len(expected):  # two writes may arrive one after the other
            sent += os.read(master, 100)
        assert sent == expected
        os.write(master, frame_packet(Packet(1, 9, b"\0\1")))
        assert link.receive(2) == Packet(1, 9, b"\0\1")
        assert link.receive(0.01) is None
        assert counted(link) == (1, 0, 0)


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
        assert counted(link) == (3, 1, 2)


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
        writer.join(timeout=60)  # far more than the system buffers: somebody must be reading
        assert not writer.is_alive()
        assert [link.receive(2) for _ in sent] == sent
        assert link.statistics.bytes == sum(len(frame_packet(p)) for p in sent)


def test_a_program_that_stands_still_loses_nothing_and_sees_its_backlog(terminal: tuple[int, str]) -> None:
    master, name = terminal
    data = b"".join(map(frame_packet, packets(8000, 400)))
    with Link(name) as link:
        left = data
        while left:  # nobody takes packets meanwhile; a pipe holds a third of it
            left = left[os.write(master, left) :]
        got = [packet for packet in [link.receive(2)] if packet]
        assert link.statistics.backlog > 0
        got += [packet for _ in range(7999) if (packet := link.receive(2))]
        assert got == packets(8000, 400)
        os.write(master, frame_packet(got[0]))  # the backlog is that at the time of the newest bytes
        assert link.receive(2) == got[0]
        assert link.statistics.backlog < 1000


def test_arrival_is_when_the_bytes_came_not_when_they_were_asked_for(terminal: tuple[int, str]) -> None:
    master, name = terminal
    with Link(name) as link:
        os.write(master, frame_packet(Packet(1, 0, b"x")))
        assert link.receive(2) is not None  # the process runs now
        before = time.monotonic()
        os.write(master, frame_packet(Packet(1, 1, b"x")))
        time.sleep(1.5)
        assert link.receive(2) is not None
        assert before <= link.arrival_s < before + 1.2


def test_a_sequence_that_goes_back_is_a_restart_not_a_loss(terminal: tuple[int, str]) -> None:
    master, name = terminal
    with Link(name) as link:
        os.write(master, b"".join(frame_packet(Packet(1, n, b"x")) for n in (7, 8, 10, 0, 1)))
        for _ in range(5):
            link.receive(2)
        now = link.statistics
        assert (now.packets, now.lost, now.restarts, now.damaged) == (5, 1, 1, 0)
        link.begin()
        os.write(master, frame_packet(Packet(1, 4, b"x")))
        link.receive(2)
        assert (link.statistics.packets, link.statistics.lost, link.statistics.restarts) == (1, 2, 0)


def alive(pid: int) -> bool:
    """Whether a process runs; one that ended and was not waited for does not."""
    try:
        return "\nState:\tZ" not in Path(f"/proc/{pid}/status").read_text()
    except FileNotFoundError:
        return False


def gone(pid: int, within_s: float = 60.0) -> bool:
    deadline = time.monotonic() + within_s
    while alive(pid) and time.monotonic() < deadline:
        time.sleep(0.01)
    return not alive(pid)


PROGRAM = """
import signal, sys, time
from magtrak.link import Link
signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's background programs ignore it
link = Link(sys.argv[1])
try:
    print(link.reader_pid, flush=True)
    while True:
        link.receive(0.1)
except KeyboardInterrupt:
    print("interrupted", link.receive(1).payload, flush=True)
    link.close()
"""


def program(name: str) -> tuple[subprocess.Popen[str], int]:
    """A program without a main guard that holds the port, and the number of its reading process."""
    process = subprocess.Popen([sys.executable, "-W", "error", "-c", PROGRAM, name], stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    return process, int(process.stdout.readline())


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM])
def test_a_killed_program_leaves_no_process_and_no_lock(terminal: tuple[int, str], number: signal.Signals) -> None:
    master, name = terminal
    process, reader = program(name)
    assert alive(reader)
    process.send_signal(number)
    process.communicate(timeout=60)
    assert gone(reader)
    with Link(name) as link:
        os.write(master, frame_packet(Packet(1, 0, b"x")))
        assert link.receive(2) is not None


def test_ctrl_c_of_a_terminal_reaches_the_program_alone(terminal: tuple[int, str]) -> None:
    master, name = terminal
    process, reader = program(name)
    assert os.getsid(reader) != os.getsid(process.pid)  # a terminal's signals stay within its session
    process.send_signal(signal.SIGINT)
    time.sleep(0.2)
    assert alive(reader)
    os.write(master, frame_packet(Packet(1, 0, b"late")))
    out, _ = process.communicate(timeout=60)
    assert out == "interrupted b'late'\n"
    assert process.returncode == 0
    assert gone(reader)


def test_a_reader_that_was_killed_is_an_error_not_a_silence(terminal: tuple[int, str]) -> None:
    _, name = terminal
    with Link(name) as link:
        os.kill(link.reader_pid, signal.SIGKILL)
        with pytest.raises(LinkError, match="the process that read it was ended; start again"):
            link.receive(5)


@pytest.mark.parametrize("error", [serial.SerialException("x"), OSError(5, "x"), termios.error(5, "x")])
def test_an_unplugged_port_is_one_error_with_a_cure_and_loses_nothing(
    terminal: tuple[int, str], error: Exception, monkeypatch: pytest.MonkeyPatch
) -> None:
    master, name = terminal

    def gone(_: bytes) -> None:
        raise error

    with Link(name) as link:
        monkeypatch.setattr(link, "_is_pseudo_terminal", False)  # what follows is of ports on USB
        os.write(master, b"".join(map(frame_packet, packets(3))))
        assert link.receive(2) == packets(3)[0]
        monkeypatch.setattr(link._serial, "write", gone)
        with pytest.raises(LinkError, match="went away: check cable and power of the card, then start again"):
            link.send(0x80, b"")
        os.close(master)
        assert [link.receive(2) for _ in range(2)] == packets(3)[1:]
        with pytest.raises(LinkError, match="went away: check cable and power of the card, then start again"):
            link.receive(2)


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
