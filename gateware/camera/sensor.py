"""What a set-up needs to know of a kind of camera."""

from dataclasses import dataclass

from magtrak.protocol import Sensor


@dataclass(frozen=True)
class Write:
    """Writes a register and reads back the bits of ``mask``; 0: does not read, for a register that clears itself.

    ``wait``: the camera then needs :data:`~gateware.camera.setup.WAIT_MS` for itself.
    """

    address: int
    data: int
    mask: int = 0xFF
    wait: bool = False


@dataclass(frozen=True)
class Check:
    """Reads a register, which must have ``data`` in the bits of ``mask``."""

    address: int
    data: int
    mask: int = 0xFF


@dataclass(frozen=True)
class Part:
    """Bits ``low`` to ``low + bits - 1`` of ``value`` ("exposure" or "gain"), at bit ``at`` of a register."""

    value: str
    low: int
    bits: int
    at: int = 0


@dataclass(frozen=True)
class Control:
    """A register that exposure or gain stand in, besides what ``data`` has."""

    address: int
    part: Part
    data: int = 0


@dataclass(frozen=True)
class SensorTable:
    """A kind of camera.

    Parameters
    ----------
    sensor : which it is; :data:`magtrak.protocol.IMAGE_SIZES` has the size of its images
    device : its address on the bus, 7 bits
    address_bytes : of a register's address
    acknowledges : whether a byte without acknowledge is a failure; SCCB itself leaves the ninth bit open
    steps : the set-up, in order
    controls : registers of exposure (16 bits, rows) and gain, written at the end, and again when the host sets others
    gain_doublings : the gain's code: None for 1/16, as the host has it; a number for that many bits, each of which
        doubles, above four bits that add sixteenths
    high_byte_first : see :class:`~gateware.camera.dvp.Dvp`
    """

    sensor: Sensor
    device: int
    address_bytes: int
    acknowledges: bool
    steps: tuple[Write | Check, ...]
    controls: tuple[Control, ...]
    gain_doublings: int | None = None
    high_byte_first: bool = True

    def gain_code(self, gain: int) -> int:
        """The definition: what stands in the camera for a gain of 16 to 1023 sixteenths; its greatest for more."""
        if self.gain_doublings is None:
            return gain
        doublings = gain.bit_length() - 5
        if doublings > self.gain_doublings:
            return (1 << self.gain_doublings) - 1 << 4 | 15
        return (1 << doublings) - 1 << 4 | gain >> doublings & 15

    def control_values(self, exposure: int, gain: int) -> list[tuple[int, int]]:
        """The definition: address and value of each control."""
        values = {"exposure": exposure, "gain": self.gain_code(gain)}
        return [
            (c.address, c.data | (values[c.part.value] >> c.part.low & (1 << c.part.bits) - 1) << c.part.at)
            for c in self.controls
        ]
