"""What a chase in flight is doing: pursuing, following or searching, or whether it has reached its target; and where it
flies where that is not what the controller says.
"""

import numpy as np

from ...controllers.belief import Belief
from ...scenario import Scenario
from .capture import CaptureJudge
from .chase_state import ChaseState
from .following import Following
from .pace import Window
from .safety import SafetyLimits
from .sample_window import Point
from .search import Loss, Spiral
from .second_look import SecondLook
from .second_transmitter import SecondTransmitter
from .settings import ServiceSettings

END_GAME_M = 10.0
"""Where it is known so well where a target is that is pursued, the swarm flies to where that will be, for a decision is
carried out late: it brakes before the target as if it followed, since at full speed it is passed by 3 m as often as by
2, to be turned round for. Half the longest axis of the belief's region."""
FLEES_MPS, FLEES_COS = 1.0, 0.7
"""But one that flies away from the swarm, at least so fast and within 45 degrees of straight away, is flown at at full
speed: whoever keeps as near to one that flees as it is believed to be keeps its distance from it."""
CAUGHT = "most of the belief and the levels are those of a target within the radius"


class FlightCourse:
    """Of one chase. ``take`` is told every window, then ``flown`` which way the swarm flies."""

    def __init__(self, scenario: Scenario, settings: ServiceSettings, limits: SafetyLimits) -> None:
        self._scenario, self._limits = scenario, limits
        self._follows = settings.follow
        self._judge = CaptureJudge(scenario, settings.reached_windows, settings.minimum_trackers)
        self._second = SecondTransmitter(scenario)
        self._second_look = SecondLook(scenario, limits)
        self._loss = Loss()
        self.following = Following(scenario)
        """Since the target was first reached."""
        self.is_followed = False
        """Whether it has been reached, and is to be followed."""
        self._spiral: Spiral | None = None
        self.state = ChaseState.PURSUING

    @property
    def newest_share(self) -> float | None:
        """As ``CaptureJudge.newest_share``."""
        return self._judge.newest_share

    @property
    def hears_two(self) -> bool:
        """Whether what is heard does not fit one transmitter: nothing counts as reached by itself then. Once a target
        is followed it has been said which one it is.
        """
        return self._second.is_heard and not self.is_followed

    @property
    def looks_again(self) -> bool:
        """Whether the swarm flies around the target, to hear whether two transmit, instead of staying with it."""
        return self.state is ChaseState.PURSUING and self.hears_two and self._second_look.is_on

    def forget(self) -> None:
        """The swarm has paused, or it was not reached after all: judge by windows to come alone."""
        self.state = ChaseState.PURSUING if self.state is ChaseState.REACHED else self.state
        self._judge.forget()
        self._loss.forget()

    def declare_reached(self) -> None:
        """By the operator's word: where the swarm is to follow it does from now on, and ends where it does already."""
        is_first = self._follows and self.state is not ChaseState.FOLLOWING
        self.is_followed |= is_first
        self.state = ChaseState.FOLLOWING if is_first else ChaseState.REACHED

    def take(self, window: Window, origin_m: Point, belief: Belief | None) -> str:
        """A window, and what is believed after it; returns why the state is another now, else nothing.

        Args:
            origin_m: Of the belief's frame.
        """
        assert window.time_s is not None
        before = self.state
        is_caught = belief is not None and self._judge.is_reached(window, origin_m, belief)
        self._second.take(window, origin_m, belief, is_caught)
        self._loss.take(float(window.time_s[-1]), bool(np.isfinite(window.rssi_dbm).any()), belief)
        if self.is_followed and before is not ChaseState.REACHED and belief is not None:
            self.following.count(float(np.linalg.norm(belief.mean_m[0].numpy() + origin_m - window.center_m)))
        reason = self._next(is_caught)
        if before is not ChaseState.SEARCHING and self.state is ChaseState.SEARCHING:
            middle_m = window.center_m if belief is None else belief.mean_m[0].numpy() + origin_m
            self._spiral = Spiral(self._scenario, self._limits, middle_m)
        return reason if self.state is not before else ""

    def _next(self, is_caught: bool) -> str:
        """Go on to the next state; returns why."""
        if self.is_followed and 0 < self._scenario.follow_s <= self.following.seconds:
            self.state = ChaseState.REACHED
            return f"it was followed for {self.following.seconds:g} s"
        if self._loss.reason:
            self.state = ChaseState.SEARCHING
            return f"the target is lost: {self._loss.reason}"
        if self.state is ChaseState.SEARCHING:
            self.state = ChaseState.PURSUING
            return "the target is found again"
        if is_caught and self.state is ChaseState.PURSUING and self.hears_two:
            self._second_look.begin()
        elif is_caught and self.state is ChaseState.PURSUING:
            self.is_followed = self._follows
            self.state = ChaseState.FOLLOWING if self._follows else ChaseState.REACHED
        return CAUGHT

    def flown(
        self,
        told_m: Point,
        spacing_m: float,
        window: Window,
        origin_m: Point,
        center_m: Point,
        since_s: float,
        target: Belief | None,
    ) -> tuple[Point, float]:
        """Displacement and spacing of the next interval, the controller having said these.

        Args:
            origin_m: Of the frame of ``target``.
            center_m: Where the centre is now, in that frame.
            since_s: The window ended so long ago.
            target: What is believed of it after that window.
        """
        if target is not None and self.state is not ChaseState.SEARCHING:
            target_mps = np.zeros(3) if target.velocity_mps is None else target.velocity_mps[0].numpy()
            target_m = target.mean_m[0].numpy() + target_mps * since_s
            if self.looks_again:
                here_m, there_m = center_m + origin_m, target_m + origin_m
                return self._second_look.displacement_m(there_m, target_mps, here_m, spacing_m), spacing_m
            way_m = self.following.displacement_m(target_m, target_mps, center_m)
            if self.state is ChaseState.FOLLOWING:
                return way_m, spacing_m
            if float(target.radius_m[0]) <= END_GAME_M:
                offset_m = target_m - center_m
                return self._ahead_m(offset_m, target_mps) if _flees(offset_m, target_mps) else way_m, spacing_m
        if self._searches_blindly(window):
            assert self._spiral is not None
            return self._spiral.displacement_m(window.center_m), self._spiral.spacing_m
        return told_m, spacing_m

    def _ahead_m(self, offset_m: Point, target_mps: Point) -> Point:
        """At full speed to where a target at this offset will be half way through the interval."""
        way_m = offset_m + target_mps * self._scenario.decision_s / 2
        longest_m = self._scenario.tracker_speed_mps * self._scenario.decision_s
        return np.asarray(way_m * (longest_m / max(float(np.linalg.norm(way_m)), 1e-9)))

    def _searches_blindly(self, window: Window) -> bool:
        return self.state is ChaseState.SEARCHING and not np.isfinite(window.rssi_dbm).any()


def _flees(offset_m: Point, target_mps: Point) -> bool:
    """Whether a target at this offset from the swarm flies away from it."""
    speed_mps = float(np.linalg.norm(target_mps))
    away_mps = float(offset_m @ target_mps) / max(float(np.linalg.norm(offset_m)), 1e-9)
    return speed_mps >= FLEES_MPS and away_mps >= FLEES_COS * speed_mps
