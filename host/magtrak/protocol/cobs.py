"""Packets on a byte stream: COBS framing and CRC-32.

A packet is ``type (1) | sequence (2) | payload | CRC-32 (4)``, little-endian,
COBS-encoded, and ends with a zero byte. Since COBS output holds no zero, a
receiver that starts anywhere is in step again after the next zero byte, and a
damaged packet costs only itself.

Sources: S. Cheshire and M. Baker, "Consistent Overhead Byte Stuffing", IEEE/ACM
Transactions on Networking 7(2), 1999; CRC-32 as in IEEE 802.3 (``zlib.crc32``)
over type, sequence and payload.
"""

import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass

HEADER = struct.Struct("<BH")
CRC = struct.Struct("<I")
OVERHEAD = HEADER.size + CRC.size
BLOCK = 254  # non-zero bytes that one code byte can announce


def cobs_encode(data: bytes) -> bytes:
    """Encode ``data``; the result has no zero byte, and no delimiter behind it."""
    out = bytearray()
    blocks = data.split(b"\0")
    for number, block in enumerate(blocks, 1):
        while len(block) >= BLOCK:
            out.append(BLOCK + 1)
            out += block[:BLOCK]
            block = block[BLOCK:]
            if not block and number == len(blocks):
                return bytes(out)  # data that ends with a full block need no further code
        out.append(len(block) + 1)
        out += block
    return bytes(out)


def cobs_decode(data: bytes) -> bytes:
    """Decode what :func:`cobs_encode` made.

    Raises
    ------
    ValueError
        ``data`` is empty, has a zero byte, or ends within a block.
    """
    if not data:
        raise ValueError("nothing to decode")
    if 0 in data:
        raise ValueError("a zero byte in COBS data")
    # In place: the code at a block's end becomes the zero that the block stands for, except after a full block.
    out = bytearray(data)
    full = []
    at, size = 0, len(data)
    while True:
        code = data[at]
        at += code
        if at >= size:
            break
        out[at] = 0
        if code > BLOCK:
            full.append(at)
    if at > size:
        raise ValueError(f"a block of {code - 1} bytes at {at - code} ends after the data")
    for place in reversed(full):
        del out[place]
    return bytes(memoryview(out)[1:])


@dataclass(frozen=True)
class Packet:
    """An intact packet: its type, the sender's sequence number (modulo 65536) and payload."""

    type: int
    sequence: int
    payload: bytes


def frame_packet(packet: Packet) -> bytes:
    """Bytes for the wire, zero delimiter included."""
    body = HEADER.pack(packet.type, packet.sequence) + packet.payload
    return cobs_encode(body + CRC.pack(zlib.crc32(body))) + b"\0"


def unframe_packet(data: bytes) -> Packet:
    """The packet in ``data``, one packet's bytes without delimiter.

    Raises
    ------
    ValueError
        The data are not intact.
    """
    body = cobs_decode(data)
    if len(body) < OVERHEAD:
        raise ValueError(f"{len(body)} bytes are too few for a packet")
    if zlib.crc32(body[:-4]) != CRC.unpack(body[-4:])[0]:
        raise ValueError("CRC mismatch")
    kind, sequence = HEADER.unpack_from(body)
    return Packet(kind, sequence, body[HEADER.size : -4])


class Deframer:
    """Cuts a byte stream into packets; whatever is damaged is dropped and counted.

    Parameters
    ----------
    limit : most bytes that may come without a delimiter; more are dropped as
        one damaged packet, so that noise cannot fill the memory

    Attributes
    ----------
    packets : intact packets so far
    damaged : stretches between two delimiters that were no intact packet
    """

    def __init__(self, limit: int = 1 << 17) -> None:
        self.limit = limit
        self.packets = 0
        self.damaged = 0
        self._rest = bytearray()
        self._skipping = False

    @property
    def within_packet(self) -> bool:
        """Bytes have come since the last delimiter."""
        return bool(self._rest) or self._skipping

    def feed(self, data: bytes) -> Iterator[Packet]:
        """Take the next bytes of the stream, give the packets that they complete.

        Everything is taken even if the caller stops early: the packets are
        made at once.
        """
        return iter(self._take(data))

    def _take(self, data: bytes) -> list[Packet]:
        self._rest += data
        packets = []
        *stretches, rest = bytes(self._rest).split(b"\0")
        for stretch in stretches:
            if self._skipping:  # the end of a stretch that was too long, counted already
                self._skipping = False
            elif stretch:  # delimiters in a row are idle filling
                try:
                    packets.append(unframe_packet(stretch))
                    self.packets += 1
                except ValueError:
                    self.damaged += 1
        if len(rest) > self.limit:
            rest = b""
            if not self._skipping:
                self.damaged += 1
            self._skipping = True
        self._rest = bytearray(rest)
        return packets
