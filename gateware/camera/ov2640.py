"""OV2640: 640 x 480 cut out of SVGA, RGB565, not scaled, nothing automatic.

After the register descriptions of OmniVision's data sheet of the OV2640: the bank of the image processor (0xFF = 0) and
that of the sensor (0xFF = 1). The sheet was not at hand: addresses, bits and values
are from knowledge of it, and are to be compared with it before anyone relies on them.
"""

from magtrak.protocol import Sensor

from .sensor import Check, Control, Part, SensorTable, Write

_PROCESSOR = Write(0xFF, 0x00, mask=0x01)  # RA_DLMT[0]: which bank the addresses mean
_SENSOR = Write(0xFF, 0x01, mask=0x01)

OV2640 = SensorTable(
    sensor=Sensor.OV2640,
    device=0x30,  # 0x60 to write, 0x61 to read
    address_bytes=1,
    acknowledges=False,
    steps=(
        _SENSOR,
        Check(0x0A, 0x26),  # PIDH: product, upper byte
        Check(0x0B, 0x40, mask=0xFC),  # PIDL: 0x41 and 0x42 are known
        Write(0x12, 0x80, mask=0, wait=True),  # COM7[7]: all registers as after reset
        _SENSOR,
        Write(0x12, 0x40, mask=0x76),  # COM7: [6:4] SVGA, [2] no zoom, [1] no colour bar
        Write(0x11, 0x00, mask=0xBF),  # CLKRC: the input clock, neither doubled nor divided
        Write(0x17, 0x11),  # HREFST: first column of the array, in 16
        Write(0x18, 0x43),  # HREFEND: 50 more: 800
        Write(0x32, 0x00),  # REG32: [5:3], [2:0] lowest bits of these
        Write(0x19, 0x00),  # VSTRT: first row, in 8
        Write(0x1A, 0x4B),  # VEND: 75 more: 600
        Write(0x03, 0x00),  # COM1: [3:2], [1:0] lowest bits of these; [7:6] no dummy images
        Write(0x13, 0xC0, mask=0x25),  # COM8: [5] banding filter off, [2] gain, [0] exposure not automatic
        Write(0x15, 0x00, mask=0x3A),  # COM10: PCLK always running, data at its falling edge, HREF, VSYNC active high
        _PROCESSOR,
        Write(0xE0, 0x04),  # RESET[2]: the port is held while it is set
        Write(0xC0, 0x64),  # HSIZE8: what the sensor sends, 800 / 8
        Write(0xC1, 0x4B),  # VSIZE8: 600 / 8
        Write(0x8C, 0x00),  # SIZEL: lowest bits of both
        Write(0x50, 0x00),  # CTRLI: neither columns nor rows divided
        Write(0x51, 0xA0),  # HSIZE: 640 / 4 of them
        Write(0x52, 0x78),  # VSIZE: 480 / 4
        Write(0x53, 0x50),  # XOFFL: from column 80 on
        Write(0x54, 0x3C),  # YOFFL: from row 60 on
        Write(0x55, 0x00),  # VHYX: upper bits of these four
        Write(0x57, 0x00, mask=0x80),  # TEST[7]: upper bit of HSIZE
        Write(0x5A, 0xA0),  # ZMOW: 640 / 4 columns go out, so nothing is scaled
        Write(0x5B, 0x78),  # ZMOH: 480 / 4 rows
        Write(0x5C, 0x00, mask=0x07),  # ZMHH: upper bits of both
        Write(0xC2, 0x0E),  # CTRL0: [3] YUV422, [2] YUV, [1] RGB
        Write(0xC3, 0xD7),  # CTRL1: all but [5] gamma and [3] automatic white balance
        Write(0xDA, 0x09),  # IMAGE_MODE: [3:2] RGB565, [0] upper byte first
        Write(0x05, 0x00, mask=0x01),  # R_BYPASS[0]: through the processor
        Write(0xE0, 0x00),  # RESET: go
        _SENSOR,  # that of the controls
    ),
    controls=(
        Control(0x00, Part("gain", 0, 8)),  # GAIN
        Control(0x45, Part("exposure", 10, 6)),  # REG45: [5:0] AEC[15:10]
        Control(0x10, Part("exposure", 2, 8)),  # AEC[9:2]
        Control(0x04, Part("exposure", 0, 2), data=0x20),  # REG04: [1:0] AEC[1:0], no mirror, no flip
    ),
    gain_doublings=4,  # (b7+1)(b6+1)(b5+1)(b4+1)(1 + b[3:0] / 16)
)
