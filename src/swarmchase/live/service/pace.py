"""The pace of a chase: when the trackers have come to their places, and when what they hear there makes a window.

``StopAndListen`` is the paper's: fly, come to rest, listen, decide. It knows times and places, nothing of controllers
and states; the service asks it at every step and says what comes of the answer.
"""

from dataclasses import dataclass, replace

import numpy as np

from ...scenario import Scenario
from .formation_estimate import claimed_centers_m, median_m
from .safety import Move, formation_m
from .sample_window import Levels, Point, Points
from .settings import ServiceSettings
from .swarm import Swarm

BLOCKED_S = 2.0
"""A way on which not even a small step has been free for so long is given up."""


@dataclass(frozen=True, eq=False)
class Window:
    """What the trackers have heard, and where. Metres are of the shared frame."""

    rssi_dbm: Levels
    """[sample, tracker]; NaN where nothing valid came."""
    position_m: Points
    """[sample, tracker, 3]"""
    center_m: Point
    """Where the controller sees the formation's centre at the end of the window."""
    time_s: Levels | None = None
    """When each sample was taken [sample], since the chase began; None where trackers stop to listen."""

    @property
    def offset_m(self) -> Points:
        """From the centre to each tracker at the end of the window [tracker, xyz]."""
        return np.asarray(self.position_m[-1] - self.center_m)


class StopAndListen:
    """Trackers fly to a formation, settle there and fill a window.

    ``stand`` or ``set_out`` begins; then ``arrival`` is asked until it has come, and ``window`` until it is complete.
    All moments are nanoseconds of the controller's clock.

    Args:
        swarm: Its set-points are told where to go.
        speed_mps: At which it goes there.
    """

    def __init__(self, scenario: Scenario, settings: ServiceSettings, swarm: Swarm, speed_mps: float) -> None:
        self._window_s = scenario.window_s
        self._settings, self._swarm, self._speed_mps = settings, swarm, speed_mps
        self.formation: Move | None = None
        """What is flown to, or held; None before the first."""
        self.is_in_place = True
        """Whether it is held, not flown to."""
        self.window_since_ns = 0
        """The window begins with the first valid sample taken then or later."""
        self._told_ns = 0
        """When the trackers were first told the places that they are now flying to."""
        self._allowed_s = 0.0
        """What the flight may take."""

    def stand(self, formation: Move, now_ns: int) -> None:
        """The trackers stay in this formation: what they hear from now on is listened to."""
        self.formation = formation
        self._settle(now_ns + 1)

    def set_out(self, move: Move, now_ns: int) -> None:
        """Fly along the legs of this move."""
        self.formation, self.is_in_place = replace(move, legs=()), False
        self._swarm.stream.fly(move.legs)
        ways_s = [way_m / self._speed_mps for way_m in self._swarm.stream.ways_m()]
        self._allowed_s = sum(2 * way_s + self._settings.move_allowance_s for way_s in ways_s or [0.0])
        self._told_ns = now_ns

    def arrival(self, now_ns: int, flown_s: float) -> str | None:
        """How the flight has ended, in words; None while it goes on. From then on the trackers are listened to.

        At each corner all wait until everybody has arrived there: who turns first would cut the way that was planned.

        Args:
            flown_s: So long ago they set out.
        """
        stream = self._swarm.stream
        if not (stream.has_arrived or stream.is_at_corner):
            self._told_ns = now_ns  # nothing has been reported after this: nobody has arrived
        arrived_ns = self._swarm.arrived_ns(self._settings.arrival_tolerance_m, self._told_ns)
        since_ns = [time_ns for time_ns in arrived_ns if time_ns is not None]
        late = len(arrived_ns) - len(since_ns)
        if not late and stream.is_at_corner:
            stream.turn()
            self._told_ns = now_ns
        elif not late:
            # The window begins when the last of them reported so, by its own clock.
            self._swarm.end_movement(self._settings.arrival_tolerance_m)
            self._settle(max(since_ns))
            return "arrived"
        elif flown_s > self._allowed_s:
            self._swarm.stream.stop()
            self._swarm.end_movement(self._settings.arrival_tolerance_m)
            return self._give_up(f"{late} trackers have not arrived in time", now_ns)
        elif stream.blocked_s > BLOCKED_S:
            return self._give_up("another tracker has come into the way", now_ns)
        return None

    def stop(self) -> None:
        """Stay at the set-points of now."""
        self._swarm.stream.stop()

    def advance(self, elapsed_s: float) -> None:
        """Let the set-points go on for this long."""
        self._swarm.stream.advance(elapsed_s, self._swarm.traffic())

    def _give_up(self, why: str, now_ns: int) -> str:
        """End the flight here."""
        self._swarm.stream.stop()
        self._settle(now_ns + 1)
        return why

    def window(self, now_ns: int) -> Window | None:
        """What the trackers have heard since they settled, missing samples and all once it took too long; None while
        there is more to come.
        """
        begins_ns = self._swarm.first_valid_ns(self.window_since_ns)
        allowance_s = self._settings.sampling_allowance_s
        is_complete = begins_ns is not None and self._swarm.has_window(begins_ns, allowance_s)
        begins_ns = self.window_since_ns if begins_ns is None else begins_ns
        if not is_complete and (now_ns - begins_ns) / 1e9 < self._window_s + allowance_s:
            return None
        assert self.formation is not None
        rssi_dbm, position_m = self._swarm.heard(begins_ns)
        center_m = self._center_m(self.formation, self._swarm.counted_positions_m(position_m[-1]))
        place_m = np.broadcast_to(formation_m(center_m, self.formation.spacing_m), position_m.shape)
        return Window(*self._swarm.window(rssi_dbm, position_m, place_m), center_m)

    def _settle(self, since_ns: int) -> None:
        """From this moment on the trackers brake and swing; then samples count."""
        self.is_in_place = True
        self.window_since_ns = since_ns + round(self._settings.settle_s * 1e9)

    def _center_m(self, formation: Move, position_m: Points) -> Point:
        """The median of what those in these places [tracker, 3] say of the centre, unless that is where it should be
        but for a tolerance, which must not make the formation wander.
        """
        if not np.isfinite(position_m).any():
            return formation.center_m
        seen_m = median_m(claimed_centers_m(position_m, formation.spacing_m))
        off_m = np.linalg.norm(seen_m - formation.center_m)
        return formation.center_m if off_m <= self._settings.arrival_tolerance_m else seen_m
