"""Rules for udev: who may open a card's port, and who shall leave it alone."""

from .discover import USB_IDS

FILE = "70-magtrak.rules"
"""Name of the file in ``/etc/udev/rules.d``; the number lies before 73, where ``uaccess`` is acted upon."""


def rules() -> str:
    """Text of the file.

    People at the machine may open the port (``uaccess``). ModemManager, which would talk to it for 10 to 20 s after it
    is plugged in, leaves it alone. FTDI adapters hand over what they have after 1 ms instead of 16.
    """
    lines = [
        f"# {FILE}: Magtrak cards and the USB adapters that they may be behind.",
        f"# Install: magtrak doctor --udev | sudo tee /etc/udev/rules.d/{FILE}",
        "# then:    sudo udevadm control --reload && sudo udevadm trigger",
    ]
    for (vendor, product), name in USB_IDS.items():
        above = f'ATTRS{{idVendor}}=="{vendor:04x}", ATTRS{{idProduct}}=="{product:04x}"'
        here = above.replace("ATTRS", "ATTR")
        lines += [
            "",
            f"# {name}",
            f'SUBSYSTEM=="usb", ENV{{DEVTYPE}}=="usb_device", {here}, TAG+="uaccess", ENV{{ID_MM_DEVICE_IGNORE}}="1"',
            f'SUBSYSTEM=="tty", {above}, TAG+="uaccess", ENV{{ID_MM_PORT_IGNORE}}="1"',
        ]
        if vendor == 0x0403:
            lines.append(
                f'ACTION=="add", SUBSYSTEM=="usb-serial", DRIVER=="ftdi_sio", {above}, ATTR{{latency_timer}}="1"'
            )
    return "\n".join(lines) + "\n"
