"""What people write of a device that transmits."""

from ....errors import InputError


def mac_address(text: str) -> bytes:
    """The six bytes of ``aa:bb:cc:dd:ee:ff``.

    Raises:
        InputError: it is no such address.
    """
    parts = text.split(":")
    try:
        address = bytes(int(part, 16) for part in parts)
    except ValueError:
        address = b""
    if len(address) != 6 or any(len(part) != 2 for part in parts):
        raise InputError(f"{text!r} is refused: allowed is a MAC address, aa:bb:cc:dd:ee:ff")
    return address
