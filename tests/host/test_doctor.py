"""What the doctor finds, on systems made for it."""

import os
import pty
from pathlib import Path

import pytest

from magtrak import discover, doctor
from magtrak.doctor import Finding, System, examine
from magtrak.link import Link
from magtrak.udev import FILE, rules
from tests.host.test_card import frame_payloads
from tests.support.fake_card import FakeCard


@pytest.fixture
def system(tmp_path: Path) -> System:
    for name in ("sys", "proc", "rules"):
        (tmp_path / name).mkdir()
    return System(tmp_path / "sys", tmp_path / "proc", (tmp_path / "rules",))


def found(port: str | None, system: System) -> dict[str, Finding]:
    """By what was looked at; how quick the answers are is this machine's business."""
    return {one.what: one for one in examine(port, system=system) if one.what != "answers"}


def test_a_card_that_is_well(system: System) -> None:
    with FakeCard(frame_payloads(1), identity={"frames": 5, "laser_state": 4, "serial_low": 0xABC}) as card:
        all_of_it = found(card.port, system)
    assert all(one.well for one in all_of_it.values()), all_of_it
    assert all_of_it[card.port].text == "card ABC, images up to 2048 x 2048"
    assert all_of_it["link"].text.endswith("ms, none lost")


def test_a_card_with_troubles(system: System) -> None:
    known = {"run": 1, "camera_errors": 0b1001, "encoder_errors": 3, "safety": 0x0101_0000}
    with FakeCard(identity=known, loop_for_ever=True) as card:
        bad = {what: one.text for what, one in found(card.port, system).items() if not one.well}
    assert set(bad) == {"images", "camera", "encoder", "interlock", "motor"}
    assert "(blanking, row_length)" in bad["camera"]
    assert "3 errors" in bad["encoder"]
    assert "stall" in bad["motor"]


def test_answers_that_are_lost(system: System) -> None:
    with FakeCard(identity={"frames": 5, "laser_state": 4}, skip_sequence_at=100) as card:
        finding = found(card.port, system)["link"]
    assert not finding.well and finding.text.startswith("1 packets lost on the way from the card: try another cable")


def test_ports_that_are_none_or_in_use(system: System, tmp_path: Path) -> None:
    assert "does not exist: plug the card in" in found("/dev/nowhere", system)["/dev/nowhere"].text
    (tmp_path / "stale").symlink_to("/dev/pts/none")
    assert (
        "leads nowhere: start magtrak-sim again" in found(str(tmp_path / "stale"), system)[str(tmp_path / "stale")].text
    )
    with FakeCard(chatter=b"hello") as card:
        assert "is another device, or has another baud rate" in found(card.port, system)[card.port].text
        with Link(card.port):
            text = found(card.port, system)[card.port].text
    assert "another program has it open" in text or "is in use by" in text


def test_usb_and_what_gets_in_its_way(system: System, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(doctor, "candidates", lambda: [])
    (system.proc / "77").mkdir()
    (system.proc / "77" / "comm").write_text("ModemManager\n")
    before = found(None, system)
    assert not any(one.well for one in before.values())
    assert (
        "install it with `magtrak doctor --udev | sudo tee /etc/udev/rules.d/70-magtrak.rules`"
        in before["udev rules"].text
    )
    assert "no USB port that can be a card's" in before["port"].text
    (system.rules[0] / FILE).write_text(rules())
    after = found(None, system)
    assert after["udev rules"].well and after["ModemManager"].well


def test_an_adapter_that_waits(system: System, monkeypatch: pytest.MonkeyPatch) -> None:
    master, slave = pty.openpty()
    name = Path(os.ttyname(slave)).name
    timer = system.sys / "class/tty" / name / "device"
    timer.mkdir(parents=True)
    (timer / "latency_timer").write_text("16\n")
    finding = found(os.ttyname(slave), system)[f"{os.ttyname(slave)} latency"]
    assert not finding.well and "the adapter waits 16 ms" in finding.text
    os.close(master)
    os.close(slave)


def test_a_port_that_may_not_be_opened(system: System, monkeypatch: pytest.MonkeyPatch) -> None:
    with FakeCard() as card:
        monkeypatch.setattr(os, "access", lambda *_: False)
        text = found(card.port, system)[card.port].text
    assert "install the udev rules, or join its group by `sudo usermod -aG" in text


def test_udev_rules_name_every_adapter() -> None:
    text = rules()
    for vendor, product in discover.USB_IDS:
        assert text.count(f'{{idVendor}}=="{vendor:04x}"') >= 2 and f'{{idProduct}}=="{product:04x}"' in text
    assert text.count('TAG+="uaccess"') == 2 * len(discover.USB_IDS)
    assert (
        text.count('ENV{ID_MM_PORT_IGNORE}="1"') == len(discover.USB_IDS) == text.count('ENV{ID_MM_DEVICE_IGNORE}="1"')
    )
    assert text.count('ATTR{latency_timer}="1"') == sum(vendor == 0x0403 for vendor, _ in discover.USB_IDS)
    assert all(line.startswith("#") or line.count('"') % 2 == 0 for line in text.splitlines())
