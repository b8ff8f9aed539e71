"""What a card tells of its camera, in words."""

import pytest
from click.testing import CliRunner

from magtrak.cli.magtrak import main
from magtrak.doctor import examine
from magtrak.protocol import CAMERA_SETUP, CAMERA_STATE, Sensor, SetupCause, register
from magtrak.sensor import REGISTERS, SensorReport
from tests.support.fake_card import FakeCard
from tests.support.frames import CLOCK_HZ


def registers(
    sensor: Sensor | int = Sensor.OV7670,
    *,
    row: tuple[int, int] = (640, 640),
    rows: int = 480,
    mhz: float = 24.0,
    setup: dict[str, int] | None = None,
    **state: int,
) -> dict[str, int]:
    """Registers of a camera that is well, but for what is given."""
    nothing = dict.fromkeys((field.name for field in CAMERA_STATE.fields), 0)
    word = CAMERA_STATE.pack(nothing | {"sensor": int(sensor), "ready": 1} | state)
    none = {"address": 0, "read": 0, "cause": 0, "failures": 0}
    return {
        "camera_state": int.from_bytes(word, "little"),
        "camera_setup": int.from_bytes(CAMERA_SETUP.pack(none | (setup or {})), "little"),
        "camera_row": row[0] | row[1] << 16,
        "camera_rows": rows,
        "camera_rate": round(512e6 * mhz / CLOCK_HZ),
        "camera_exposure": 200,
        "camera_gain": 24,
    }


def report(values: dict[str, int]) -> SensorReport:
    assert set(values) == set(REGISTERS)
    return SensorReport(values, CLOCK_HZ)


def bad(values: dict[str, int]) -> dict[str, str]:
    return {what: text for what, well, _, text in report(values).looks() if not well}


def test_cameras_that_are_well() -> None:
    values = registers()
    assert report(values).text() == "OV7670, 640 x 480, pixel clock 24.0 MHz, exposure 200 rows (13.05 ms), gain 1.50"
    assert bad(values) == {}
    assert report(registers(Sensor.OV2640)).text().endswith("exposure 200 rows, gain 1.50")
    assert report(registers(Sensor.RGB, row=(720, 720), rows=240)).text() == (
        "parallel video, 720 x 240, pixel clock 24.0 MHz"
    )
    assert report(registers(Sensor.DVP)).text() == "a camera without set-up, 640 x 480, pixel clock 24.0 MHz"
    assert report(registers(9)).text() == "camera number 9, 640 x 480, pixel clock 24.0 MHz"
    assert report(registers(rows=0, row=(0, 0))).text().startswith("OV7670, no image yet")
    nothing = dict.fromkeys(REGISTERS, 0)
    assert report(nothing).text() == "none: images come from within the card" and bad(nothing) == {}


@pytest.mark.parametrize(
    ("values", "what", "text"),
    [
        (registers(clock_missing=1), "camera clock", "no pixel clock: check the camera's power"),
        (registers(ready=0), "camera set-up", "is being set up: look again in a second"),
        (
            registers(Sensor.OV5640, ready=0, setup={"cause": SetupCause.ACKNOWLEDGE, "address": 0x300A}),
            "camera set-up",
            "OV5640 does not answer (register 0x300A): check SCL",
        ),
        (
            registers(ready=0, unacknowledged=1, setup={"cause": SetupCause.IDENTITY, "address": 10, "read": 0xFF}),
            "camera set-up",
            "OV7670 does not answer: check SCL",
        ),
        (
            registers(ready=0, setup={"cause": SetupCause.IDENTITY, "address": 10, "read": 0x26}),
            "camera set-up",
            "the camera is no OV7670: its register 0x0A reads 0x26",
        ),
        (
            registers(ready=0, setup={"cause": SetupCause.READ_BACK, "address": 0x40, "read": 0xC0}),
            "camera set-up",
            "register 0x40 of OV7670 does not keep what is written (it reads 0xC0)",
        ),
        (registers(row=(638, 640)), "camera image", "had 480 rows of 638 to 640 px, not 640 x 480: check HREF"),
        (registers(rows=479), "camera image", "had 640 x 479, not 640 x 480"),
        (registers(cut=3), "camera timing", "3 images cut because the pixel clock is too fast"),
        (registers(broken=255, unsteady=2), "camera timing", "255 rows with half a pixel, or cut short"),
    ],
)
def test_what_is_not_well_is_said(values: dict[str, int], what: str, text: str) -> None:
    found = bad(values)
    assert list(found) == [what]
    assert text in found[what]
    assert found[what] in report(values).text()


def test_failures_that_are_over_are_told() -> None:
    values = registers(setup={"cause": SetupCause.READ_BACK, "failures": 2})
    assert bad(values) == {}
    assert "after 2 set-ups that failed" in {what: good for what, _, good, _ in report(values).looks()}["camera set-up"]


def test_commands_show_the_camera_and_reach_it() -> None:
    known = {"frames": 5, "laser_state": 4} | registers(cut=1)
    with FakeCard(identity=known) as card:
        shown = CliRunner().invoke(main, ["info", "--port", card.port])
        found = {one.what: one for one in examine(card.port)}
        changed = CliRunner().invoke(
            main, ["set", "camera_exposure=300", "camera_gain=32", "--port", card.port], catch_exceptions=False
        )
        assert (card.value("camera_exposure"), card.value("camera_gain")) == (300, 32)
        wrong = CliRunner().invoke(main, ["set", "camera_gain=8", "--port", card.port])
    assert "OV7670: 1 images cut because" in shown.output
    assert not found["camera timing"].well and found["camera clock"].well and found["camera set-up"].well
    assert changed.exit_code == 0 and "300 rows" in changed.output
    assert wrong.exit_code and f"from 16 to {register('camera_gain').range[1]}" in wrong.output
