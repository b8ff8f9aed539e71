"""The suffix by which a boot loader tells that a file is for it: USB DFU 1.1, appendix B."""

import struct
import zlib


def suffixed(data: bytes, vendor: int, product: int) -> bytes:
    """``data`` with the 16 bytes that name the device."""
    head = struct.pack("<HHHH3sB", 0xFFFF, product, vendor, 0x0100, b"UFD", 16)
    # DFU's CRC is that of Ethernet without the last inversion.
    return data + head + struct.pack("<I", zlib.crc32(data + head) ^ 0xFFFFFFFF)
