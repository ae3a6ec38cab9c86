"""Whether a vehicle is in the air, from what its autopilot says of it in one way or another."""

from .heartbeat import AutopilotHeartbeat

UNDEFINED, IN_AIR, TAKE_OFF = 0, 2, 3  # MAV_LANDED_STATE
HOVERS_S, HOVERS_MPS = 3.0, 0.3
"""A take-off in which it neither climbs nor sinks for so long has ended: older ArduCopters, 4.0 among them, say that
they take off in GUIDED until they are told to fly somewhere."""


class LandedState:
    """EXTENDED_SYS_STATE counts where it comes; elsewhere the status in heartbeats, where the firmware says it there.

    What has been said counts until something else is: messages get lost, and a vehicle that flies must not be let go
    for that. But a vehicle that is not armed does not fly, and must say anew that it does. It counts as in the air from
    the next heartbeat on, which says in what mode it has come there: PX4 ends a take-off by choosing another one.
    """

    def __init__(self) -> None:
        self.is_airborne: bool | None = None
        """Not while it takes off or lands; None where nobody can say. What never flies is where it can be moved."""
        self._is_armed = False
        self._said: int | None = None
        """In EXTENDED_SYS_STATE, since it was armed."""
        self._hovers_since_ns: int | None = None
        """In a take-off."""

    def take_up_heartbeat(self, beat: AutopilotHeartbeat) -> None:
        """A heartbeat has come."""
        self._is_armed = beat.is_armed
        if not beat.is_armed:
            self._said = None
        if beat.never_flies:
            self.is_airborne = True
        elif not beat.is_armed:
            self.is_airborne = False
        elif self._said is not None:
            self.is_airborne = self._said == IN_AIR or self._has_taken_off(beat.time_ns)
        else:
            # What was known from before it was armed is not known any more.
            unsaid = self.is_airborne or None
            self.is_airborne = beat.firmware.airborne_of_status.get(beat.system_status, unsaid)

    def take_up_landed_state(self, landed_state: int) -> None:
        """An EXTENDED_SYS_STATE has come."""
        if not self._is_armed or landed_state == UNDEFINED:
            return
        if landed_state != self._said:
            self._said, self._hovers_since_ns = landed_state, None
            self.is_airborne = landed_state == IN_AIR and self.is_airborne

    def take_up_climb(self, up_mps: float, now_ns: int) -> None:
        """A position has come, with its vertical speed."""
        if abs(up_mps) >= HOVERS_MPS:
            self._hovers_since_ns = None
        elif self._hovers_since_ns is None:
            self._hovers_since_ns = now_ns

    def _has_taken_off(self, now_ns: int) -> bool:
        since_ns = self._hovers_since_ns
        return self._said == TAKE_OFF and since_ns is not None and now_ns - since_ns >= HOVERS_S * 1e9
