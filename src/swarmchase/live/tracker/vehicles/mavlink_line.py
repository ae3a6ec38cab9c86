"""MAVLink messages in and out of a transport, as the computer beside an autopilot says and hears them."""

from typing import Any

from ....errors import InputError
from .transports import Transport

OWN_COMPONENT = 191  # MAV_COMP_ID_ONBOARD_COMPUTER


class MavlinkLine:
    """Of the autopilot whose system id this is: its companion shares it.

    Raises:
        InputError: pymavlink is not installed.
    """

    def __init__(self, transport: Transport, system: int) -> None:
        try:
            from pymavlink.dialects.v20 import common
        except ModuleNotFoundError as error:
            raise InputError("pymavlink is missing: pip install 'swarmchase[live]'") from error
        self.messages: Any = common.MAVLink(None, srcSystem=system, srcComponent=OWN_COMPONENT)
        """Makes them: pymavlink's."""
        self.messages.robust_parsing = True
        self._transport = transport

    def received(self) -> list[Any]:
        """All that have come; those of the type BAD_DATA are none."""
        messages: list[Any] = []
        for data in self._transport.read():
            found = self.messages.parse_buffer(data)
            messages += found or []
            # pymavlink keeps what it has parsed as long as something incomplete follows.
            del self.messages.buf[: self.messages.buf_index]
            self.messages.buf_index = 0
        return messages

    def is_for_us(self, message: Any) -> bool:
        """Whether one that may name whom it is for names us, or nobody: a ground station has answers of its own."""
        system, component = message.target_system, message.target_component
        return system in {0, self.messages.srcSystem} and component in {0, OWN_COMPONENT}

    def send(self, message: Any) -> None:
        """What cannot be sent is lost."""
        self._transport.write(message.pack(self.messages))
        self.messages.seq = (self.messages.seq + 1) % 256

    def close(self) -> None:
        """Close the transport."""
        self._transport.close()
