"""The timestamps of signatures: they only ever rise, also over restarts, so that no recorded packet counts twice; and
they are of now, so that no packet counts that somebody has held back.

Sent: real time, or one more than the last, whichever is greater, as long as anybody accepts that. Accepted of each
sender: only what is

- newer than the newest accepted so far. It is written to the state file at once, so that it outlives the process
  (kill -9 included; after a power cut it may lack what the system had not written yet, some seconds);
- not older than the moment this end was opened. That keeps out what was accepted before a restart and is still of
  now, where the state file is missing or behind;
- not more than ``FRESH_S`` older than this end's real time, and not more than ``MOST_AHEAD_S`` after it: a packet
  from the far future that a tracker's wrong clock has signed does not keep out what it says when the clock is right.

MAVLink also raises its own timestamp to any that it accepts. That is left out: one tracker could then push the
controller's to the end of time, and silence it for every other.
"""

import time
from collections.abc import Callable, Sequence
from pathlib import Path

from ...errors import InputError
from .real_time import RealTime
from .rejection import Reason, RejectedError
from .state_file import SENT, StateFile, names_of, sender_name

UNIX_TIME_OF_2015_NS = 1_420_070_400 * 10**9
UNIT_NS = 10_000
UNITS_PER_S = 10**9 // UNIT_NS
LARGEST = 2**48 - 1
"""In the year 2104."""
FRESH_S = 2.0
"""A signature that is older is stale. The clocks of both ends agree to a second."""
MOST_AHEAD_S = 60.0
"""A signature that is further ahead is refused."""


class Timestamps:
    """What was sent last, and the newest accepted of each sender, in 10 us since 2015.

    Args:
        senders: the system ids that are listened to.
        state_path: where to remember; None remembers nothing beyond this process.
        wall_time_ns, monotonic_ns: see ``RealTime``.

    Raises:
        InputError: the state file cannot be made or used, is not this end's, or another process uses it; or the clock
            is behind what is in it.
    """

    def __init__(
        self,
        senders: Sequence[int],
        state_path: Path | None = None,
        wall_time_ns: Callable[[], int] = time.time_ns,
        monotonic_ns: Callable[[], int] = time.monotonic_ns,
    ) -> None:
        self._real_time = RealTime(wall_time_ns, monotonic_ns)
        self._opened = self._now()
        self._state = None if state_path is None else StateFile(state_path, names_of(senders))
        newest = self._state.read() if self._state else {}
        self._sent = newest.get(SENT, 0)
        self._accepted = {sender: newest.get(str(sender), 0) for sender in senders}
        self.skew_s: dict[int, float] = {}
        """By sender: how much the newest accepted signature was ahead of this end's real time when it came."""
        try:
            self._require_clock()
        except InputError:
            self.close()
            raise

    @property
    def state_errors(self) -> int:
        """How often the state file could not be written: then it remembers less than it should."""
        return self._state.errors if self._state else 0

    def next_to_send(self) -> int:
        """The timestamp of the next packet."""
        now = self._now()
        # What was signed while the clock was further ahead nobody has accepted.
        was_ahead = _seconds(self._sent - now) > MOST_AHEAD_S
        self._sent = min(now if was_ahead else max(self._sent + 1, now), LARGEST)
        if self._state:
            self._state.write(SENT, self._sent)
        return self._sent

    def accept(self, sender: int, timestamp: int) -> None:
        """Accept a packet whose signature is already known to be right.

        Raises:
            RejectedError: replayed, too old or too far ahead.
        """
        newest, now = self._accepted[sender], self._now()
        if timestamp <= newest:
            raise RejectedError(Reason.REPLAYED, _seconds(timestamp - newest))
        # A clock that was ahead when this end was opened, and is put right, must not keep everybody out.
        self._opened = min(self._opened, now)
        skew_s = _seconds(timestamp - now)
        if timestamp < self._opened or skew_s < -FRESH_S:
            raise RejectedError(Reason.TOO_OLD, skew_s)
        if skew_s > MOST_AHEAD_S:
            raise RejectedError(Reason.TOO_FAR_AHEAD, skew_s)
        if skew_s <= FRESH_S:
            self._real_time.confirm()
        self._accepted[sender], self.skew_s[sender] = timestamp, skew_s
        if self._state:
            self._state.write(str(sender), timestamp)

    def close(self) -> None:
        """Give the state file back."""
        if self._state:
            self._state.close()

    def _require_clock(self) -> None:
        """Until real time is there, nobody would accept what this end sends, or this end nothing of a sender's."""
        newest = [("this end", self._sent, FRESH_S)]
        newest += [(sender_name(sender), timestamp, MOST_AHEAD_S) for sender, timestamp in self._accepted.items()]
        for who, timestamp, allowed_s in newest:
            behind_s = _seconds(timestamp - self._opened)
            if behind_s > allowed_s:
                raise InputError(
                    f"this machine's clock is {behind_s:.1f} s behind what {who} has signed last: set it; if it is "
                    "right now and was ahead then, swarmchase keys reset forgets that (docs/link.md)"
                )

    def _now(self) -> int:
        return max(self._real_time.now_ns() - UNIX_TIME_OF_2015_NS, 0) // UNIT_NS


def _seconds(units: int) -> float:
    return units / UNITS_PER_S
