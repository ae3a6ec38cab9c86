"""When something was sent, on our own clock, from the time that its sender wrote into it."""

FASTEST_DRIFT = 1e-4
"""Seconds a second that two clocks may drift apart: twice what two cheap quartz oscillators do."""
STEP_BACK_S = 0.2
"""A sender whose time goes back by more has been started again or set; by less, its messages were reordered."""


class SenderClock:
    """The offset between two clocks is taken from the message that was the fastest of all; every other was delayed by
    the difference. So a message that has waited somewhere is known to be old, however long the wait was.

    The error is the delay of the fastest message: it is counted as none.
    """

    def __init__(self) -> None:
        self._offset_ns: int | None = None
        self._sender_ns = 0
        self._now_ns = 0

    def local_ns(self, sender_ns: int, now_ns: int) -> int:
        """When a message that has come now was sent, on our clock: never later than now."""
        delay_ns = now_ns - sender_ns
        if self._offset_ns is None or sender_ns < self._sender_ns - STEP_BACK_S * 1e9:
            self._offset_ns = delay_ns
        else:
            drifted_ns = round((now_ns - self._now_ns) * FASTEST_DRIFT)
            self._offset_ns = min(delay_ns, self._offset_ns + drifted_ns)
        self._sender_ns, self._now_ns = sender_ns, now_ns
        return sender_ns + self._offset_ns
