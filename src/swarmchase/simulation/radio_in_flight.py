"""The target and its transmissions where trackers listen while they fly: the behaviour and the radio of the world, from
moment to moment of a live chase.

The target rests and transmits until the service says when its first window begins (``announce``): from there on it
flies, and the chase's own time runs. A target that does not look at the swarm thus flies as in the evaluation; what is
heard of it differs as the trackers' ways do.

A fault plan may have it land or fall silent for a while, or put another transmitter beside it, whose power adds up with
that of the target in every receiver.
"""

import math
from collections import deque
from dataclasses import replace

import torch

from ..batch.array_types import Float, Tensor
from ..errors import InputError
from ..flight import FLIGHT_STEP_S, first_within_s, least_m
from ..live.link.messages import Metres
from ..live.service.following import FOLLOWING_M
from ..scenario import Scenario
from ..world.behaviours import load_behaviour
from ..world.behaviours.protocol import Swarm, Target
from ..world.environment import require_world
from ..world.radio import Radio, RadioState
from ..world.target import draw_start_m
from .fault_plan import TargetFault

JUST_NOW_S = 1.25
"""Who was within the success radius so long ago has just reached the target, which flies on: two intervals are judged,
after what was heard in them was waited for."""
SHORTEST_DECISION_S = 0.1
"""The service steps twice in it."""
STEP_NS = round(FLIGHT_STEP_S * 1e9)
SINKING_MPS = 2.0
"""Of a target that lands."""
SECOND_CHASE = 1 << 40
"""Added to the chase's number: fading of another transmitter is another one."""


def require_flight(scenario: Scenario) -> None:
    """Refuse a moving world that the simulated site, or the live service, has not.

    Raises:
        InputError: it is such a world.
    """
    require_world(scenario)
    if scenario.continuity != "in_flight":
        raise InputError(
            f"continuity = {scenario.continuity!r} is refused in flight: what a simulated site plays is 'in_flight'"
        )
    if scenario.decision_s < SHORTEST_DECISION_S:
        raise InputError(
            f"decision_s = {scenario.decision_s:g} is refused: a live chase needs at least {SHORTEST_DECISION_S:g}"
        )
    if scenario.tracker_acceleration_mps2 is None:
        raise InputError("tracker_acceleration_mps2 = None is refused in flight: no vehicle turns at once")


class RadioInFlight:
    """Of one chase. The swarm starts around the origin; metres are of the frame that all share.

    Raises:
        InputError: a behaviour that nobody knows, or fields of the scenario that do not go together.
    """

    def __init__(self, scenario: Scenario, seed: int, chase: int, second_m: float | None = None) -> None:
        keys = [(seed, chase)]
        self._success_radius_m, self._period_ns = scenario.success_radius_m, round(1e9 / scenario.sampling_hz)
        self._behaviour, self._radio = load_behaviour(scenario), Radio(scenario)
        self._before: Target = self._behaviour.begin(keys, draw_start_m(scenario, keys))
        self._after = self._before
        """The target at the beginning and at the end of the step that is being flown."""
        self._steps = 0
        """That it has flown."""
        self._target_m, self._state = self._before.position_m, self._radio.begin(keys)
        self._since_ns: int | None = None
        self._began_ns: int | None = None
        """The chase's own time began one period before its first sample."""
        self._waited_ns: int | None = None
        """When the first sample before the chase was taken."""
        # A silence that is told by the chase's own time is none before it, and none of another transmitter.
        always = replace(scenario, silence_s=0.0, silence_at_s=None)
        self._timeless_radio = self._radio if scenario.silence_at_s is None else Radio(always)
        self._waiting = self._timeless_radio.begin([(seed, chase)])
        self._second_m: Tensor | None = None
        self._second = self._timeless_radio.begin([(seed, chase + SECOND_CHASE)])
        if second_m is not None:
            self._second_m = self._before.position_m + torch.tensor([[second_m, 0.0, 0.0]], dtype=torch.float64)
        lowest_m = 0.0 if scenario.lowest_altitude_m is None else scenario.lowest_altitude_m
        self._ground_m = lowest_m - scenario.start_altitude_m
        self._swarm: Swarm | None = None
        self._offset_m: Tensor | None = None
        """From the target to the centre at the last sample."""
        self._now_s = 0.0
        self.reached_s = self.least_distance_m = float("inf")
        """When the centre first was within the success radius, since the chase began, and how near it has been."""
        self._near: deque[tuple[float, float]] = deque()
        """When samples were taken just now, and how near the centre was before each."""
        self._samples = self._samples_near = 0
        """Since it was reached, and of them those in which the centre was as near as one that follows."""

    @property
    def target_m(self) -> Metres:
        """Where the target is."""
        x_m, y_m, z_m = self._target_m[0].tolist()
        return x_m, y_m, z_m

    @property
    def target_mps(self) -> Metres:
        """How fast it flies."""
        x_mps, y_mps, z_mps = self._after.velocity_mps[0].tolist()
        return x_mps, y_mps, z_mps

    @property
    def now_s(self) -> float:
        """Of the chase's own time, at the last sample."""
        return self._now_s

    @property
    def is_reached(self) -> bool:
        """Whether the centre has just been within the success radius."""
        return self.just_now_m <= self._success_radius_m

    @property
    def just_now_m(self) -> float:
        """How near the centre was to the target in the last ``JUST_NOW_S``; infinite before the first sample."""
        return min(
            (distance_m for time_s, distance_m in self._near if self._now_s - time_s <= JUST_NOW_S), default=math.inf
        )

    @property
    def following_share(self) -> float | None:
        """Of the time since the target was first reached, in which the centre was as near as one that follows; None
        before.
        """
        return self._samples_near / self._samples if self._samples else None

    def announce(self, since_ns: int, center_m: Metres) -> None:
        """The controller's first window is of what is sampled from this moment on. What it says later changes nothing:
        the target flies on, whoever listens.
        """
        self._since_ns = since_ns if self._since_ns is None else self._since_ns

    def heard_dbm(
        self,
        time_ns: int,
        position_m: Float[Tensor, "tracker 3"],
        swarm: Swarm,
        faults: frozenset[TargetFault] = frozenset(),
    ) -> list[float]:
        """What the receivers at these places report of the sample taken now; NaN where that is nothing.

        Args:
            swarm: as the target sees it from now on [1, 3].
            faults: what the target does instead of what it would.
        """
        if self._since_ns is None or time_ns < self._since_ns:
            self._waited_ns = time_ns if self._waited_ns is None else self._waited_ns
            since_s = (time_ns - self._waited_ns) / 1e9
            self._waiting, levels_dbm = _heard(self._timeless_radio, self._waiting, since_s, self._target_m, position_m)
        else:
            self._began_ns = time_ns - self._period_ns if self._began_ns is None else self._began_ns
            self._fly(time_ns - self._began_ns, self._swarm or swarm, TargetFault.LANDS in faults)
            self._now_s = (time_ns - self._began_ns) / 1e9
            self._state, levels_dbm = _heard(self._radio, self._state, self._now_s, self._target_m, position_m)
            self._judge(swarm.center_m - self._target_m)
        self._swarm = swarm
        if TargetFault.MUTE in faults:
            levels_dbm = [math.nan] * len(levels_dbm)
        if self._second_m is None:
            return levels_dbm
        second_s = time_ns / 1e9
        self._second, second_dbm = _heard(self._timeless_radio, self._second, second_s, self._second_m, position_m)
        return [_sum_dbm(*both) for both in zip(levels_dbm, second_dbm, strict=True)]

    def _fly(self, after_ns: int, swarm: Swarm, lands: bool) -> None:
        """Have the target fly until so long after the chase's beginning, straight within a step."""
        while self._steps * STEP_NS < after_ns:
            step_s = torch.full((1,), FLIGHT_STEP_S, dtype=torch.float64)
            self._before = self._after
            self._after = self._landing() if lands else self._behaviour.fly(self._after, step_s, swarm)
            self._steps += 1
        share = 1 - (self._steps * STEP_NS - after_ns) / STEP_NS
        self._target_m = torch.lerp(self._before.position_m, self._after.position_m, share)

    def _landing(self) -> Target:
        """The target a step later, sinking straight down, or on the ground."""
        sunk_m = min(max(float(self._after.position_m[0, 2]) - self._ground_m, 0.0), SINKING_MPS * FLIGHT_STEP_S)
        down = torch.tensor([[0.0, 0.0, -1.0]], dtype=torch.float64)
        velocity_mps = down * (sunk_m / FLIGHT_STEP_S)
        return replace(self._after, position_m=self._after.position_m + sunk_m * down, velocity_mps=velocity_mps)

    def _judge(self, offset_m: Float[Tensor, "chase 3"]) -> None:
        """How near the centre has been since the last sample."""
        before_m = offset_m if self._offset_m is None else self._offset_m
        way_m = torch.stack([before_m, offset_m], dim=1)
        between_s = torch.tensor([[self._now_s - self._period_ns / 1e9, self._now_s]], dtype=torch.float64)
        near_m = float(least_m(way_m)[0])
        self.least_distance_m = min(self.least_distance_m, near_m)
        self.reached_s = min(self.reached_s, float(first_within_s(way_m, between_s, self._success_radius_m)[0]))
        self._near.append((self._now_s, near_m))
        while self._now_s - self._near[0][0] > JUST_NOW_S:
            self._near.popleft()
        if math.isfinite(self.reached_s):
            self._samples += 1
            self._samples_near += float(offset_m.norm()) <= FOLLOWING_M
        self._offset_m = offset_m


def _heard(
    radio: Radio, state: RadioState, time_s: float, transmitter_m: Tensor, position_m: Tensor
) -> tuple[RadioState, list[float]]:
    at_s = torch.tensor([[time_s]], dtype=torch.float64)
    rssi_dbm, state = radio.heard_dbm(state, at_s, transmitter_m[:, None], position_m[None, None])
    levels_dbm: list[float] = rssi_dbm[0, 0].tolist()
    return state, levels_dbm


def _sum_dbm(one_dbm: float, other_dbm: float) -> float:
    """Of two powers, of which one that is NaN is nothing."""
    powers_mw = [10 ** (level_dbm / 10) for level_dbm in (one_dbm, other_dbm) if not math.isnan(level_dbm)]
    return 10 * math.log10(sum(powers_mw)) if powers_mw else math.nan
