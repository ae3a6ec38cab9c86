"""A serial port from the standard library alone (POSIX)."""

import os
from pathlib import Path

from ..errors import InputError


def open_serial_port(path: Path, baud: int = 115_200) -> int:
    """A file descriptor of the port: raw bytes, 8N1, no flow control, never blocking.

    Raises:
        InputError: there is no such port, it is not ours to open, or it does not know the speed.
    """
    import termios
    import tty

    speed = getattr(termios, f"B{baud}", None)
    if speed is None:
        raise InputError(f"baud = {baud} is refused: serial ports know 9600, 57600, 115200, 921600 and the like")
    try:
        descriptor = os.open(path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
    except OSError as error:
        raise InputError(f"cannot open {path}: {error.strerror or error}") from error
    try:
        tty.setraw(descriptor)
        attributes = termios.tcgetattr(descriptor)
        attributes[2] = (attributes[2] | termios.CLOCAL | termios.CREAD) & ~(termios.CSTOPB | termios.CRTSCTS)
        attributes[4] = attributes[5] = speed
        termios.tcsetattr(descriptor, termios.TCSANOW, attributes)
    except (termios.error, OSError) as error:
        os.close(descriptor)
        raise InputError(f"{path} is no serial port: {error.args[-1]}") from error
    return descriptor
