"""What a card tells of its camera's bus and set-up: words of the registers ``camera_*``."""

import enum

from .fields import Field, Layout


class Sensor(enum.IntEnum):
    """Where the images come from."""

    NONE = 0  # a source within the card, as the test picture is, or a simulation
    DVP = 1  # a camera with a parallel port that needs no set-up by the card
    RGB = 2  # parallel video: DVI receiver or video converter
    OV7670 = 3
    OV2640 = 4
    OV5640 = 5


IMAGE_SIZES = {Sensor.OV7670: (640, 480), Sensor.OV2640: (640, 480), Sensor.OV5640: (640, 480)}
"""Columns and rows that the card sets a camera to."""

ROW_CLOCKS = {Sensor.OV7670: 1568, Sensor.OV5640: 1896}
"""Pixel clocks from row to row of these, where the data sheet says so: the unit of the exposure."""


class SetupCause(enum.IntEnum):
    """Why setting up the camera failed last."""

    NONE = 0
    ACKNOWLEDGE = 1  # it did not acknowledge
    IDENTITY = 2  # it is another kind of camera, or none
    READ_BACK = 3  # a register did not keep what was written


CAMERA_STATE = Layout(
    "camera state",
    (
        Field("sensor", 4, "a Sensor: where the images come from"),
        Field("clock_missing", 1, "the pixel clock stands still, or never came"),
        Field("ready", 1, "the camera is set up, or needs no set-up"),
        Field("unacknowledged", 1, "a byte to the camera was not acknowledged since reset"),
        Field("cut", 8, "images cut or lost because the card is slower than the camera, saturating"),
        Field("broken", 8, "rows with half a pixel, or cut by the vertical sync, saturating"),
        Field("unsteady", 4, "images with rows of different length, or other rows than the one before, saturating"),
        Field("_reserved", 5),
    ),
)

CAMERA_SETUP = Layout(
    "camera set-up",
    (
        Field("address", 16, "register of the camera at which the set-up failed last"),
        Field("read", 8, "what was read there"),
        Field("cause", 3, "a SetupCause: why it failed"),
        Field("failures", 5, "set-ups that failed since reset, saturating"),
    ),
)

CAMERA_ROW = Layout(
    "camera row",
    (
        Field("shortest", 16, "shortest row of the last image", "px"),
        Field("longest", 16, "longest row of the last image", "px"),
    ),
)
