"""Who has a vehicle: the agent, in the mode in which set-points move it, or a pilot or a failsafe that took it out of
that mode.

The mode is asked for when the first set-point comes, and counts once a heartbeat shows it. Whatever else a heartbeat
shows afterwards was done by a pilot or a failsafe, and the vehicle is left alone until a heartbeat shows the mode
again. A failsafe has it in whatever mode; where its status stays, as ArduPilot's does, a pilot gives the vehicle back
by choosing the mode after it.
"""

from .heartbeat import CRITICAL, AutopilotHeartbeat

MOST_REQUESTS = 10
"""Without success: then it is taken as refused, until a pilot sets the mode."""


class ModeKeeper:
    """Told every heartbeat."""

    def __init__(self) -> None:
        self.is_confirmed = False
        """The last heartbeat shows the mode."""
        self.taken_over = False
        self.requests = 0
        """For the mode, without success."""
        self._last: AutopilotHeartbeat | None = None
        self._has_failsafe = self._is_known_to_be_refused = False
        self._mode_before_request: int | None = None

    @property
    def is_in_other_hands(self) -> bool:
        """Whether it is to be left alone."""
        return self.taken_over or self._has_failsafe

    def take_up(self, beat: AutopilotHeartbeat) -> None:
        """A heartbeat has come."""
        last, self._last = self._last, beat
        self._take_up_failsafe(beat, last)
        if beat.is_guided:
            self.is_confirmed, self.taken_over, self.requests = True, False, 0
            self._is_known_to_be_refused = False
        elif self.is_confirmed or self._mode_before_request not in {None, beat.custom_mode}:
            self.is_confirmed, self.taken_over, self._mode_before_request = False, True, None

    def _take_up_failsafe(self, beat: AutopilotHeartbeat, last: AutopilotHeartbeat | None) -> None:
        was_critical = last is not None and last.is_critical
        is_chosen = last is not None and beat.is_guided and not last.is_guided
        if not beat.is_critical:
            self._has_failsafe = False
        elif not was_critical:
            self._has_failsafe = True
        elif beat.system_status == CRITICAL and is_chosen:
            self._has_failsafe = False

    def ask(self) -> bool:
        """Whether the mode may be asked for once more; if not, it is refused and the vehicle is left alone."""
        if self.requests >= MOST_REQUESTS:
            self.taken_over, self._mode_before_request, self.requests = True, None, 0
            return False
        self._mode_before_request = None if self._last is None else self._last.custom_mode
        self.requests += 1
        return True

    def refused(self) -> bool:
        """It has been refused. Whether that is news: it is asked for again, and refused again, until it is given."""
        is_news = self.requests > 0 and not self._is_known_to_be_refused
        self._is_known_to_be_refused |= is_news
        return is_news
