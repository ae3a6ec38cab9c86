"""Whether a vehicle is in the air, from what its autopilot says of it in one way or another."""

from .heartbeat import AutopilotHeartbeat

IN_AIR = 2  # MAV_LANDED_STATE
UNDEFINED = 0


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
        self._said: bool | None = None
        """In EXTENDED_SYS_STATE, since it was armed."""

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
            self.is_airborne = self._said
        else:
            # What was known from before it was armed is not known any more.
            unsaid = self.is_airborne or None
            self.is_airborne = beat.firmware.airborne_of_status.get(beat.system_status, unsaid)

    def take_up_landed_state(self, landed_state: int) -> None:
        """An EXTENDED_SYS_STATE has come."""
        if self._is_armed and landed_state != UNDEFINED:
            self._said = landed_state == IN_AIR
            if not self._said:
                self.is_airborne = False
