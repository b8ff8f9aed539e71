"""OV7670: VGA, RGB565, as linear as it goes, nothing automatic.

After the register descriptions of OmniVision's data sheet of the OV7670/OV7171 ("device control register list").
The sheet was not at hand: addresses, bits and values
are from knowledge of it, and are to be compared with it before anyone relies on them.
What drivers put into reserved registers besides is left out.
"""

from magtrak.protocol import Sensor

from .sensor import Check, Control, Part, SensorTable, Write

OV7670 = SensorTable(
    sensor=Sensor.OV7670,
    device=0x21,  # 0x42 to write, 0x43 to read
    address_bytes=1,
    acknowledges=False,
    steps=(
        Check(0x0A, 0x76),  # PID: product, upper byte
        Check(0x0B, 0x73),  # VER: product, lower byte
        Write(0x12, 0x80, mask=0, wait=True),  # COM7[7]: all registers as after reset, the window 640 x 480
        Write(0x12, 0x04),  # COM7[2]: RGB; VGA; no colour bar
        Write(0x11, 0xC0, mask=0x7F),  # CLKRC[6]: the input clock without division
        Write(0x6B, 0x0A, mask=0xC0),  # DBLV[7:6]: PLL bypassed
        Write(0x15, 0x00),  # COM10: HREF, PCLK always running, data at its falling edge, VSYNC active high
        Write(0x40, 0xD0, mask=0xF0),  # COM15: [7:6] all of 00 to FF, [5:4] RGB565
        Write(0x8C, 0x00, mask=0x03),  # RGB444[1]: off, or it overrides RGB565
        Write(
            0x13, 0x88, mask=0x27
        ),  # COM8: [5] banding filter, [2] gain, [1] white balance, [0] exposure not automatic
        Write(0x3B, 0x00, mask=0xE0),  # COM11: [7] no night mode, which would lengthen images
        Write(0x01, 0x80),  # BLUE: white balance, twice 1.0
        Write(0x02, 0x80),  # RED: likewise
        Write(0x3D, 0x08, mask=0xC1),  # COM13: [7] no gamma, [6] saturation not automatic, [0] U and V not swapped
        Write(0x41, 0x08, mask=0x38),  # COM16: [5] edges, [4] de-noise not automatic, [3] white balance gains used
        Write(0x3F, 0x00, mask=0x1F),  # EDGE: no enhancement, it would move the line's flanks
        Write(0x4C, 0x00),  # DNSTH: no de-noise
    ),
    controls=(
        Control(0x00, Part("gain", 0, 8)),  # GAIN: AGC[7:0]
        Control(0x03, Part("gain", 8, 2, at=6)),  # VREF: [7:6] AGC[9:8], [3:0] lowest bits of the window's rows
        Control(0x07, Part("exposure", 10, 6)),  # AECHH: AEC[15:10]
        Control(0x10, Part("exposure", 2, 8)),  # AECH: AEC[9:2]
        Control(0x04, Part("exposure", 0, 2)),  # COM1: [1:0] AEC[1:0]
    ),
    gain_doublings=6,  # (b9+1)(b8+1)(b7+1)(b6+1)(b5+1)(b4+1)(1 + b[3:0] / 16)
)
