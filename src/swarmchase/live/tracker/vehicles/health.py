"""What an autopilot says of its battery, its satellite receiver and its heading: for people, nothing depends on it."""

from typing import Any

from ...link.messages import Health
from .telemetry import Wanted

OLD_S = 10.0
"""What was said longer ago is not known any more."""
HEALTH_HZ = 1.0
OVER_S = 5.0
EXTENDED_STATUS_STREAM, EXTRA2_STREAM = 2, 11  # MAV_DATA_STREAM
MESSAGES = (
    Wanted(1, HEALTH_HZ, EXTENDED_STATUS_STREAM, OVER_S),  # SYS_STATUS
    Wanted(24, HEALTH_HZ, EXTENDED_STATUS_STREAM, OVER_S),  # GPS_RAW_INT
    Wanted(74, HEALTH_HZ, EXTRA2_STREAM, OVER_S),  # VFR_HUD
)
MOST_PERCENT, UNKNOWN_SATELLITES, MOST_FIX = 100, 255, 8


class HealthReport:
    """Takes in SYS_STATUS, GPS_RAW_INT and VFR_HUD."""

    def __init__(self) -> None:
        self._said: dict[str, tuple[int, Any]] = {}
        """By message: when it came, and what it said last."""

    def take_up(self, message: Any, now_ns: int) -> None:
        """One of the three has come."""
        self._said[message.get_type()] = now_ns, message

    def health(self, tracker: int, now_ns: int) -> Health | None:
        """What is known now; None where nothing is."""
        status, gps, hud = (self._of_late(kind, now_ns) for kind in ("SYS_STATUS", "GPS_RAW_INT", "VFR_HUD"))
        health = Health(
            tracker,
            None if status is None else _within(status.battery_remaining, MOST_PERCENT),
            None if gps is None else _within(gps.fix_type, MOST_FIX),
            None if gps is None else _within(gps.satellites_visible, UNKNOWN_SATELLITES - 1),
            None if hud is None else float(hud.heading % 360),
        )
        return None if health == Health(tracker) else health

    def _of_late(self, kind: str, now_ns: int) -> Any | None:
        said_ns, message = self._said.get(kind, (0, None))
        return None if now_ns - said_ns > OLD_S * 1e9 else message


def _within(number: int, most: int) -> int | None:
    """Autopilots say -1 or 255 for what they do not know."""
    return number if 0 <= number <= most else None
