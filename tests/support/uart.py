"""What a UART makes of bytes that were sent at another baud rate: bit by bit, 8N1."""


def misread(data: bytes, ratio: float) -> bytes:
    """Bytes as a receiver sees them whose bits are ``ratio`` times as long as the sender's.

    The line idles before and after. A frame whose stop bit is low is given out all the same, as USB adapters do.
    """
    line = [1] * 10
    for byte in data:
        line += [0, *(byte >> n & 1 for n in range(8)), 1]
    line += [1] * (10 + round(10 * ratio))
    out = bytearray()
    at = 0.0
    while at < len(line):
        if line[int(at)]:  # idle: look for the next edge
            at = int(at) + 1
            continue
        bits = [line[place] if (place := int(at + ratio * (n + 1.5))) < len(line) else 1 for n in range(9)]
        out.append(sum(bit << n for n, bit in enumerate(bits[:8])))
        at += ratio * 9.5
        if not bits[8]:  # no stop bit: wait for the line to go up
            while at < len(line) and not line[int(at)]:
                at += 1
    return bytes(out)
