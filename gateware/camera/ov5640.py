"""OV5640: 640 x 480 from the middle, every two rows and columns binned, RGB565, not scaled, nothing automatic.

After the register descriptions of OmniVision's data sheet of the OV5640 ("register tables"). For an input clock of
24 MHz: 28 MHz PCLK. The sheet was not at hand: addresses, bits and values
are from knowledge of it, and are to be compared with it before anyone relies on them.
"""

from magtrak.protocol import Sensor

from .sensor import Check, Control, Part, SensorTable, Write


def _word(address: int, value: int) -> tuple[Write, Write]:
    """A value in two registers, the upper byte first."""
    return Write(address, value >> 8), Write(address + 1, value & 0xFF)


OV5640 = SensorTable(
    sensor=Sensor.OV5640,
    device=0x3C,  # 0x78 to write, 0x79 to read
    address_bytes=2,
    acknowledges=True,
    steps=(
        Check(0x300A, 0x56),  # chip ID, upper byte
        Check(0x300B, 0x40),  # chip ID, lower byte
        Write(0x3103, 0x11, mask=0x02),  # [1]: clock from the pad while the PLL is set
        Write(0x3008, 0x82, mask=0, wait=True),  # [7]: all registers as after reset
        Write(0x3008, 0x42),  # [6]: power-down while it is set up
        Write(0x3103, 0x03, mask=0x02),  # [1]: clock from the PLL
        Write(0x3017, 0x7F),  # outputs: VSYNC, HREF, PCLK, D9 to D6
        Write(0x3018, 0xFC),  # outputs: D5 to D0
        Write(0x3034, 0x1A),  # PLL: [3:0] 10 bits, which divides by 2.5
        Write(0x3035, 0x21),  # PLL: [7:4] system clock / 2
        Write(0x3036, 0x46),  # PLL: times 70
        Write(0x3037, 0x13),  # PLL: [4] / 2, [3:0] input / 3: 24 / 3 * 70 / 2 / 2 / 2.5 = 56 MHz
        Write(0x3108, 0x11),  # [5:4] PCLK = 56 / 2, [3:2] 56 / 1, [1:0] SCLK = 56 / 2 MHz
        *_word(0x3800, 640),  # window of the array: first column; 672 binned ones are read
        *_word(0x3802, 488),  # first row; 488 binned ones
        *_word(0x3804, 1983),  # last column
        *_word(0x3806, 1463),  # last row
        *_word(0x3808, 640),  # columns that go out
        *_word(0x380A, 480),  # rows
        *_word(0x380C, 1896),  # a line's clocks of SCLK
        *_word(0x380E, 600),  # an image's lines: 24.6 images a second
        *_word(0x3810, 16),  # columns left out at each side: 672 - 2 * 16
        *_word(0x3812, 4),  # rows left out: 488 - 2 * 4
        Write(0x3814, 0x31),  # columns: every second pair
        Write(0x3815, 0x31),  # rows: every second pair
        Write(0x3820, 0x41),  # [2:1] no flip, [0] rows binned
        Write(0x3821, 0x01),  # [5] no JPEG, [2:1] no mirror, [0] columns binned
        Write(0x3503, 0x03),  # [1] gain, [0] exposure by hand
        Write(0x3406, 0x01),  # [0]: white balance by hand, at its gains after reset, 1.0
        Write(0x5000, 0x07),  # [7] no lens correction, [5] no gamma, [2:1] pixel defects, [0] colours interpolated
        Write(0x5001, 0x03),  # [7] no effects, [5] not scaled, [1] colour matrix, [0] white balance gains used
        Write(0x501F, 0x01),  # [2:0]: the processor gives RGB
        Write(0x4300, 0x61),  # RGB565: R[4:0] G[5:3], then G[2:0] B[4:0]
        Write(0x3008, 0x02, wait=True),  # go
    ),
    controls=(
        Control(0x3500, Part("exposure", 12, 4)),  # [3:0]: exposure in 1/16 line, [19:16]
        Control(0x3501, Part("exposure", 4, 8)),  # [15:8]
        Control(0x3502, Part("exposure", 0, 4, at=4)),  # [7:0], sixteenths 0
        Control(0x350A, Part("gain", 8, 2)),  # [1:0]: gain in 1/16, [9:8]
        Control(0x350B, Part("gain", 0, 8)),  # [7:0]
    ),
)
