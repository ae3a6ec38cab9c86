"""``ListenInFlight`` in the live service: trackers that never stop to listen, and a decision every ``decision_s``.

The formation is flown as in the environment: its velocity goes to displacement / ``decision_s`` as fast as the
scenario's acceleration permits. What is sent are positions along the way: each tracker is told the place where it comes
to rest, braking evenly, if it hears nothing more, that is v^2 / 2 b ahead of where it should be now. A vehicle that
brakes in time for it is, on the way, as fast as the formation; one that hears nothing more stops by itself.

The cross turns as the controller says, as far as those that fly ahead of it keep up (``CLOSING_MPS``) and while nobody
is without news; each is told the place that is its own when it comes to rest.

Set-points go on only if all keep apart, whoever of them stops (``flight_separation``); where they may not, those that
are too near move apart, and the formation turns less, flies on straight or brakes; where not even that is free, they
stay, by which all brake. The formation keeps inside the fence, goes round those that are not commanded, and waits for
who has fallen behind, as one does that has heard nothing for a second: with several of them it would fall apart.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...errors import InputError
from ...scenario import NUM_TRACKERS, Scenario
from .flight_separation import Seen, least_apart_m, longest_free, those_behind
from .flown_windows import FlownWindows
from .formation_motion import FormationMotion
from .going_round import PAIRS, SHORTEST_MPS, others_mps, ways_apart, ways_aside
from .orders import KEPT_S, LONGEST_VALID_S, Braking, Onward, Orders, Told
from .pace import Window
from .safety import ROOM_M, Move, SafetyFilter, SafetyLimits, is_clear
from .sample_window import Flags, Levels, Point, Points
from .separation import ROUNDING_M, Traffic
from .set_point_stream import INTRUSION_M, LONGEST_STEP_S
from .shortening import shortened, shortened_each
from .swarm import Swarm

BRAKING_SHARE = 0.8
"""Of the scenario's acceleration, with which set-points count: the rest is for turning and wind."""
CLOSING_MPS = 2.0
"""With which a tracker that is not in its place comes there at least, beside the formation's own speed. No faster do
they go round, either."""
MOST_BEHIND_M = 4.5
"""Who is further from its place has fallen behind."""
FEWEST_IN_PLACE = 4
"""While fewer are in their places the formation waits for those who have fallen behind,"""
WAITS_S = 5.0
"""for each no longer than this until it has been in its place again."""
MOST_AHEAD_M = 4.0
"""No set-point is further from where its tracker comes to rest as it flies now: enough to speed it up, and too little
for it to be taken for one that is astray."""
FRESH_S = 0.4
"""What was seen longer ago tells where a tracker may be, not that it is astray."""
VALID_S = (LONGEST_VALID_S, 1.0, 0.5, 0.2, 0.0)
"""For so long set-points may be valid without news: the longest by which all keep apart."""
FEWER_VALID_S = (LONGEST_VALID_S, 0.5, 0.0)
"""The same, where many ways are compared."""
TURN_SHARES = (1.0, 0.5)
"""Of its acceleration with which the formation may turn, where it may not at once."""
UNHEARD_S = 0.25
"""Who is known to have obeyed nothing for so long may not have heard that all turn."""
CALM_S = 2.0
"""The cross turns only while this has been nobody's case for so long: one that goes on without news while the others
turn comes into their ways."""


class ListenInFlight:
    """Asked at every step: ``window`` for what an interval brought, then ``pursue`` for what is decided of it, and
    ``advance`` for the set-points. All moments are nanoseconds of the controller's clock.

    Raises:
        InputError: the scenario does not limit the acceleration: no vehicle turns at once.
    """

    def __init__(self, scenario: Scenario, swarm: Swarm, limits: SafetyLimits) -> None:
        if scenario.tracker_acceleration_mps2 is None:
            raise InputError("tracker_acceleration_mps2 = None is refused in flight: no vehicle turns at once")
        self._swarm, self._limits = swarm, limits
        self._filter = SafetyFilter(limits, scenario.spacing_choices_m)
        self._decision_s = scenario.decision_s
        self._windows = FlownWindows(scenario, swarm)
        self._speed_mps = min(limits.highest_speed_mps, scenario.tracker_speed_mps)
        braking = Braking(BRAKING_SHARE * scenario.tracker_acceleration_mps2, scenario.tracker_acceleration_mps2)
        self._braking, self._motion = braking, FormationMotion(braking, np.zeros(3), np.zeros(3), 0.0)
        self._wanted_mps, self._wanted_spacing_m = np.zeros(3), 0.0
        self._stops = False
        """Whether all brake until they rest."""
        self._flies_apart = True
        """Whether all were far enough apart with set-points that are valid for longest."""
        self._in_the_way = np.zeros(NUM_TRACKERS, dtype=np.bool_)
        """Who keeps whom from flying on, so that all stand."""
        self._unheard_ns = 0
        """When somebody last was without news."""
        self._behind_s = np.zeros(NUM_TRACKERS)
        """So long each has not been in its place."""
        self._excused_m = np.zeros(NUM_TRACKERS)
        """So much further from where it is told to come to rest each may be, since it has heard nothing for a while."""
        self._told = Told()
        self.has_begun = False

    @property
    def formation(self) -> Move | None:
        """Where it should be now; None before the first."""
        return Move(self._motion.center_m, self._motion.spacing_m, (), "") if self.has_begun else None

    @property
    def turned_rad(self) -> float:
        """How far the cross has turned."""
        return self._motion.turned_rad

    @property
    def window_since_ns(self) -> int:
        """When the first interval began, of this chase."""
        return self._windows.since_ns

    def stand(self, formation: Move, now_ns: int) -> None:
        """The trackers are around this centre, or come to rest ahead of it, and are listened to from soon on."""
        rest_m = formation.center_m + self._braking.rest_m(self._motion.velocity_mps)
        self._motion = FormationMotion(self._braking, rest_m, np.zeros(3), formation.spacing_m, self._motion.rest_rad)
        self.has_begun = True
        self.stop()
        self._stops = False
        self._windows.begin(now_ns)

    def stop(self) -> None:
        """Brake, and stay where that ends."""
        self._stops, self._wanted_mps, self._wanted_spacing_m = True, np.zeros(3), self._motion.spacing_m

    def window(self, now_ns: int) -> Window | None:
        """What was heard in the interval that has ended, once it is there or was waited for; None before that."""
        if not self._windows.is_due(now_ns):
            return None
        rest_m = self._fresh_rest_m()
        return self._windows.take(now_ns, self._motion, self._heard_m(rest_m), rest_m, self._excused_m)

    def pursue(self, displacement_m: Point, spacing_m: float, turn_rad: float = 0.0) -> str:
        """From now on fly so that the centre moves so far in an interval, with this spacing at its end, and the cross
        turns so far; returns in which way limits change where and how wide it flies, else nothing.
        """
        least_m, most_m = self._filter.spacing_range_m()
        if least_m > most_m:
            self._wanted_mps, self._motion = np.zeros(3), replace(self._motion, turn_rad_per_s=0.0)
            return "all stay where they are: the fence has no room for the formation"
        self._wanted_spacing_m = min(max(spacing_m, least_m), most_m)
        fastest_rad_per_s = CLOSING_MPS / max(self._motion.spacing_m, self._wanted_spacing_m)
        is_calm = self._swarm.now_ns - self._unheard_ns >= CALM_S * 1e9
        turn_rad_per_s = min(max(turn_rad / self._decision_s, -fastest_rad_per_s), fastest_rad_per_s) * is_calm
        self._motion = replace(self._motion, turn_rad_per_s=turn_rad_per_s)
        told_mps = displacement_m / self._decision_s
        within_mps = self._within_fence_mps(shortened(told_mps, self._speed_mps), self._motion)
        self._wanted_mps = self._around_mps(within_mps)
        in_the_way = ", ".join(map(str, np.flatnonzero(self._in_the_way)))
        changes = [
            (self._wanted_spacing_m != spacing_m, f"spacing {self._wanted_spacing_m:.3g} m, not {spacing_m:.3g} m"),
            (np.linalg.norm(told_mps) > self._speed_mps * (1 + 1e-6), f"no faster than {self._speed_mps:g} m/s"),
            (_differs(within_mps, shortened(told_mps, self._speed_mps)), "aside or slower to keep the fence"),
            (_differs(self._wanted_mps, within_mps), "aside or slower to keep the separation"),
            (self._in_the_way.any(), f"all stand: trackers {in_the_way} are in each other's way"),
        ]
        return "; ".join(words for changed, words in changes if changed)

    def _within_fence_mps(self, velocity_mps: Point, motion: FormationMotion) -> Point:
        """This velocity, on each axis no faster than it comes to rest before the fence."""
        reach_m = motion.spacing_m + ROOM_M
        speed_mps = max(float(np.linalg.norm(velocity_mps)), 1e-9)
        step_m = np.abs(motion.velocity_mps) * self._decision_s / 2
        up_m = np.maximum(self._limits.high_m - reach_m - motion.center_m - step_m, 0.0)
        down_m = np.maximum(motion.center_m - self._limits.low_m - reach_m - step_m, 0.0)
        most = 2 * self._braking.nominal_mps2 / speed_mps
        return np.asarray(np.clip(velocity_mps, -most * down_m, most * up_m))

    def _around_mps(self, velocity_mps: Point) -> Point:
        """This velocity, or one next to it that leads nobody to those that are not commanded; else none."""
        obstacles_m, places_m = self._swarm.obstacles_m(), self._swarm.places_now_m()
        places_m = np.where(self._swarm.stream.commanded[:, None], places_m, np.nan)
        if not len(obstacles_m):
            return velocity_mps
        for other_mps in others_mps(velocity_mps):
            end_m = places_m + other_mps * self._decision_s + self._braking.rest_m(other_mps)
            if is_clear(places_m, end_m, obstacles_m, self._limits.minimum_separation_m, ROOM_M):
                return other_mps
        return np.zeros(3)

    def advance(self, elapsed_s: float) -> None:
        """Let the formation fly on for this long, as far as it may, and the set-points with it."""
        stream, swarm = self._swarm.stream, self._swarm
        elapsed_s, stream.onward = min(max(elapsed_s, 0.0), LONGEST_STEP_S), None
        if not self.has_begun or elapsed_s == 0.0 or not stream.commanded.any():
            return
        self._excused_m = self._excused_after_m(elapsed_s)
        if self._has_not_heard()[stream.commanded].any():
            self._unheard_ns, self._motion = swarm.now_ns, replace(self._motion, turn_rad_per_s=0.0)
        seen = Seen(swarm.traffic(), swarm.position_ages_s())
        older = self._told.older(swarm.now_ns, swarm.obeyed_ns())
        self._in_the_way = np.zeros(NUM_TRACKERS, dtype=np.bool_)
        brakes = self._stops or self._waits(swarm.places_now_m(), elapsed_s)
        wanted = self._way(None if brakes else self._wanted_mps, elapsed_s)
        # Most of the time all are far enough apart with those that are valid for longest.
        if self._flies_apart:
            least_m = self._least_apart_m(seen, [wanted], VALID_S[:1], older)
            self._flies_apart = bool((least_m >= self._limits.minimum_separation_m).all())
        if self._flies_apart:
            self._go(wanted, np.full(NUM_TRACKERS, LONGEST_VALID_S))
        else:
            least_m = self._least_apart_m(seen, [wanted], VALID_S, older)
            self._flies_apart = bool((least_m[1] >= self._limits.minimum_separation_m).all())
            if not (
                self._go_free(seen, least_m, wanted, VALID_S, older)
                or self._go_another_way(seen, brakes, least_m, elapsed_s, older)
            ):
                self._stay(seen, brakes, least_m, elapsed_s, older)
        self._told.note(swarm.now_ns, stream.set_point_m, stream.onward)
        self._windows.note_turned(swarm.now_ns, self._motion.turned_rad)

    def _go_another_way(
        self, seen: Seen, brakes: bool, wanted_least_m: Levels, elapsed_s: float, older: Orders
    ) -> bool:
        """Where it may not go as it is wanted to: the same, or turning less, or slower; in each case those that are too
        near to one another further apart. While one of them has not heard of late, which flies straight on, all do
        rather than to brake. Whether any of it is free.
        """
        in_the_way, motion = self._keeps_apart(wanted_least_m), self._motion
        are_led = all(self._swarm.stream.commanded[tracker[in_the_way]].all() for tracker in PAIRS)
        aside_m = CLOSING_MPS * elapsed_s * ways_apart(in_the_way, self._swarm.places_now_m())
        aside = _Aside(aside_m, stays=not are_led)
        wanted = [] if brakes else [self._way(self._wanted_mps, elapsed_s, aside, share) for share in TURN_SHARES]
        unheard = any(self._has_not_heard()[tracker[in_the_way]].any() for tracker in PAIRS)
        straight = [self._way(motion.velocity_mps, elapsed_s, aside)] if unheard and not brakes else []
        if motion.speed_mps > SHORTEST_MPS:
            ways = [*wanted, *straight, self._way(None, elapsed_s, aside)]
        else:
            # Those that stand go round each other instead, but not round one that is not led.
            ways = [] if are_led else wanted
        if not ways:
            return False
        *longer_s, shortest_s = FEWER_VALID_S
        before_m, *ways_m = self._least_apart_m(seen, ways, [shortest_s], older)
        for way, way_m in zip(ways, ways_m, strict=True):
            if longest_free(before_m, way_m[None], self._limits.minimum_separation_m) is not None:
                longer_m = self._least_apart_m(seen, [way], longer_s, older)
                return self._go_free(seen, np.vstack([longer_m, way_m]), way, FEWER_VALID_S, older)
        return False

    def _has_not_heard(self) -> Flags:
        """Who is not known to have obeyed anything of late [tracker]."""
        oldest_ns = self._swarm.now_ns - UNHEARD_S * 1e9
        return np.array([time_ns is None or time_ns < oldest_ns for time_ns in self._swarm.obeyed_ns()])

    def _excused_after_m(self, elapsed_s: float) -> Levels:
        """As far as each has flown on since it last heard anything: all others may have turned back meanwhile. When it
        hears again it comes nearer as those do that are not in their places.
        """
        speed_mps = np.linalg.norm(self._swarm.traffic().velocity_mps, axis=1)
        step_m = np.where(self._has_not_heard(), speed_mps, -CLOSING_MPS) * elapsed_s
        return np.clip(self._excused_m + step_m, 0.0, KEPT_S * self._speed_mps)

    def _stay(self, seen: Seen, brakes: bool, wanted_least_m: Levels, elapsed_s: float, older: Orders) -> None:
        """The set-points stay: by that all brake, and the formation with them. Those who come too near to somebody are
        led further apart; where all stand, those in each other's way go round each other.
        """
        stream, before_m, now_m = self._swarm.stream, self._swarm.stream.set_point_m, self._swarm.places_now_m()
        self._motion = self._motion.braked(elapsed_s)
        separation_m = self._limits.minimum_separation_m
        too_near = wanted_least_m[0] < separation_m - INTRUSION_M
        apart_m = self._further_apart_m(seen, too_near, elapsed_s, older) if too_near.any() else None
        if apart_m is not None:
            stream.set_point_m = apart_m
            stream.pulled_back += 1
        elif not brakes and self._motion.speed_mps <= SHORTEST_MPS:
            is_in_the_way = self._keeps_apart(wanted_least_m)
            self._in_the_way[np.concatenate([tracker[is_in_the_way] for tracker in PAIRS])] = True
            # Nobody would move any more otherwise.
            ways = ways_aside(is_in_the_way, now_m, separation_m)
            aside_m = [self._aside_m(way, elapsed_s) for way in ways]
            stream.set_point_m = self._first_free(seen, np.stack([before_m, *aside_m]), older)

    def _further_apart_m(self, seen: Seen, too_near: Flags, elapsed_s: float, older: Orders) -> Points | None:
        """Set-points by which those that come too near to each other [pair] stop as soon as they can, or move apart:
        whichever keeps them further apart. None where neither does so better than those of before, as where somebody
        was last seen long ago: it would stop at a place that it is not on its way to.
        """
        before_m, now_m = self._swarm.stream.set_point_m, self._swarm.places_now_m()
        pulled_back_m = self._pulled_back_m(too_near, seen.traffic, now_m)
        choices_m = np.stack([before_m, pulled_back_m, self._aside_m(ways_apart(too_near, now_m), elapsed_s)])
        least_m = self._least_at_rest_m(seen, choices_m, older).min(axis=1)
        best = int(least_m.argmax())
        return choices_m[best] if least_m[best] > least_m[0] + ROUNDING_M else None

    def _aside_m(self, way: Points, elapsed_s: float) -> Points:
        """The set-points of before, each moved on this way [tracker, 3]."""
        before_m = self._swarm.stream.set_point_m
        return self._fenced_m(before_m + CLOSING_MPS * elapsed_s * way, before_m)

    def _keeps_apart(self, least_m: Levels) -> Flags:
        """Which pairs the last of these sets brings too near, or nearer than the first [pair]."""
        return np.asarray((least_m[-1] < self._limits.minimum_separation_m) & (least_m[-1] < least_m[0] - ROUNDING_M))

    def _way(
        self, wanted_mps: Point | None, elapsed_s: float, aside: "_Aside | None" = None, turn_share: float = 1.0
    ) -> "_Way":
        """How the formation goes on for this long, to fly so fast or, told None, to brake; those that are not in their
        places come nearer to them, and aside.

        Args:
            turn_share: Of its acceleration.
        """
        before_m, rest_m, motion = self._swarm.stream.set_point_m, self._rest_m(), self._motion
        closing_mps = max(CLOSING_MPS, self._speed_mps - motion.speed_mps)
        offset_m = before_m - motion.goals_m
        nearer_m = _nearer(offset_m, closing_mps * elapsed_s)
        if aside is not None:
            goes_aside = aside.way_m.any(axis=1, keepdims=True)
            nearer_m = np.where(goes_aside & aside.stays, offset_m, nearer_m) + aside.way_m
        if wanted_mps is None:
            motion, moves_mps = motion.braked(elapsed_s), np.zeros(3)
        else:
            within_mps = self._within_fence_mps(wanted_mps, motion)
            motion = motion.flown(within_mps, self._wanted_spacing_m, elapsed_s, turn_share)
            moves_mps = motion.goals_mps(self._within_fence_mps(wanted_mps, motion))
        led_m = rest_m + shortened_each(motion.goals_m + nearer_m - rest_m, MOST_AHEAD_M)
        return _Way(motion, self._fenced_m(led_m, before_m), moves_mps)

    def _least_apart_m(
        self, seen: Seen, ways: "Sequence[_Way]", valid_s: Sequence[float | Levels], older: Orders
    ) -> Levels:
        """How near each two come by the set-points of before, by which all brake; then by those of each way, valid for
        shorter and shorter [set, pair].
        """
        before_m = self._swarm.stream.set_point_m
        rest_m, velocity_mps, valids_s = [before_m], [np.zeros((NUM_TRACKERS, 3))], [np.zeros(NUM_TRACKERS)]
        for way in ways:
            inside_s = self._inside_s(way.rest_m, way.moves_mps)
            rest_m += [way.rest_m] * len(valid_s)
            velocity_mps += [np.tile(way.moves_mps, (NUM_TRACKERS, 1))] * len(valid_s)
            valids_s += [np.minimum(seconds, inside_s) for seconds in valid_s]
        since_s = np.zeros((len(rest_m), NUM_TRACKERS))
        orders = Orders(np.array(rest_m), np.array(velocity_mps), np.array(valids_s), since_s)
        return least_apart_m(seen, orders, older, self._braking, self._limits.minimum_separation_m)

    def _go_free(self, seen: Seen, least_m: Levels, way: "_Way", valid_s: tuple[float, ...], older: Orders) -> bool:
        """Go this way, with set-points that are valid for as long as all keep apart; whether they do at all.

        Args:
            least_m: As ``_least_apart_m`` has it.
        """
        separation_m = self._limits.minimum_separation_m
        chosen = longest_free(least_m[0], least_m[1:], separation_m)
        if chosen is None:
            return False
        way_valid_s = np.array(valid_s)[chosen]
        if chosen.any():
            # One that flies ahead and hears nothing would otherwise brake, and have all brake behind it.
            those = those_behind(self._swarm.places_now_m(), self._motion.velocity_mps)
            behind = longest_free(least_m[0], least_m[1:], separation_m, those)
            assert behind is not None
            if (behind < chosen).any():
                longer_s = np.array(valid_s)[behind]
                longer_m = self._least_apart_m(seen, [way], [longer_s], older)
                if longest_free(longer_m[0], longer_m[1:], separation_m) is not None:
                    way_valid_s = longer_s
        self._go(way, way_valid_s)
        return True

    def _go(self, way: "_Way", valid_s: Levels) -> None:
        """Go this way, with set-points that are valid for so long [tracker]."""
        self._motion, self._swarm.stream.set_point_m = way.motion, way.rest_m
        if np.linalg.norm(way.moves_mps) > SHORTEST_MPS:
            inside_s = self._inside_s(way.rest_m, way.moves_mps)
            self._swarm.stream.onward = Onward(way.moves_mps, np.minimum(valid_s, inside_s), self._braking)

    def _inside_s(self, rest_m: Points, moves_mps: Point) -> Levels:
        """For how long these places may move on inside the fence [tracker]."""
        room_m = np.where(moves_mps > 0, self._limits.high_m - rest_m, rest_m - self._limits.low_m)
        left_s = np.maximum(room_m, 0.0) / np.maximum(np.abs(moves_mps), 1e-9)
        return np.asarray(np.nan_to_num(left_s).min(axis=1))

    def _fenced_m(self, point_m: Points, before_m: Points) -> Points:
        """Inside the fence, or no further out than before."""
        low_m, high_m = np.minimum(self._limits.low_m, before_m), np.maximum(self._limits.high_m, before_m)
        return np.asarray(np.clip(point_m, low_m, high_m))

    def _heard_m(self, rest_m: Points) -> Points:
        """Of all set-points that each may have heard last, where they are now: the one next to where it comes to rest
        [tracker, 3]; NaN where it is not commanded. Who flies on by an older one is not astray, nor is one that has
        heard nothing for so long that it holds by itself: then there is none.
        """
        set_point_m, now_ns, obeyed_ns = self._swarm.stream.set_point_m, self._swarm.now_ns, self._swarm.obeyed_ns()
        nearest_m = self._told.nearest_m(now_ns, obeyed_ns, rest_m)
        holds = np.array([time_ns is not None and now_ns - time_ns > KEPT_S * 1e9 for time_ns in obeyed_ns])
        told_m = np.where(np.isfinite(set_point_m) & np.isfinite(nearest_m), nearest_m, set_point_m)
        return np.where(holds[:, None], np.nan, told_m)

    def _fresh_rest_m(self) -> Points:
        """The same as ``_rest_m``; NaN where it was not seen of late: who says nothing contradicts nobody."""
        is_fresh = self._swarm.position_ages_s() <= FRESH_S
        return np.where(is_fresh[:, None], self._rest_m(), np.nan)

    def _rest_m(self) -> Points:
        """Where each tracker comes to rest, as it flies now [tracker, 3]."""
        return np.asarray(self._swarm.places_now_m() + self._braking.rest_m(self._swarm.traffic().velocity_mps))

    def _waits(self, now_m: Points, elapsed_s: float) -> bool:
        """Whether the formation waits for those that count and are not in their places."""
        is_behind = np.linalg.norm(now_m - self._motion.places_m, axis=1) > MOST_BEHIND_M
        self._behind_s = np.where(is_behind, self._behind_s + elapsed_s, 0.0)
        counted = self._swarm.counted()
        num_awaited = int((is_behind & (self._behind_s < WAITS_S))[counted].sum())
        return num_awaited > max(len(counted) - FEWEST_IN_PLACE, 0)

    def _first_free(self, seen: Seen, set_points_m: Points, older: Orders) -> Points:
        """The first of these [set, tracker, 3], after that of before, by which nobody comes too near, nor nearer than
        by that; else that.
        """
        separation_m = self._limits.minimum_separation_m
        least_m = self._least_at_rest_m(seen, set_points_m, older)
        frees = (
            longest_free(least_m[0], least_m[number : number + 1], separation_m) for number in range(1, len(least_m))
        )
        number = next((number for number, free in enumerate(frees, start=1) if free is not None), 0)
        return np.asarray(set_points_m[number])

    def _least_at_rest_m(self, seen: Seen, set_points_m: Points, older: Orders) -> Levels:
        """How near each two come by sets of set-points that do not move on [set, pair]."""
        nothing = np.zeros(set_points_m.shape[:2])
        orders = Orders(set_points_m, np.zeros_like(set_points_m), nothing, nothing)
        return least_apart_m(seen, orders, older, self._braking, self._limits.minimum_separation_m)

    def _pulled_back_m(self, too_near: Flags, traffic: Traffic, now_m: Points) -> Points:
        """Those who come too near to somebody [pair] stop as soon as they can."""
        set_point_m = self._swarm.stream.set_point_m
        speed_mps = np.linalg.norm(traffic.velocity_mps, axis=1, keepdims=True)
        stop_m = now_m + traffic.velocity_mps * speed_mps / (2 * self._braking.most_mps2)
        is_shorter = np.linalg.norm(stop_m - now_m, axis=1) < np.linalg.norm(set_point_m - now_m, axis=1)
        is_shorter &= np.isin(np.arange(NUM_TRACKERS), [tracker[too_near] for tracker in PAIRS])
        return np.where(is_shorter[:, None], self._fenced_m(stop_m, set_point_m), set_point_m)


@dataclass(frozen=True, eq=False)
class _Aside:
    """Who goes which way in a step beside that of the formation."""

    way_m: Points
    """[tracker, 3]"""
    stays: bool
    """Whether those that do come no nearer to their places meanwhile."""


@dataclass(frozen=True, eq=False)
class _Way:
    """That a formation may go in a step."""

    motion: FormationMotion
    """At its end."""
    rest_m: Points
    """The set-points then,"""
    moves_mps: Point
    """and how they move on."""


def _nearer(offset_m: Points, step_m: float) -> Points:
    """These offsets, each so much shorter."""
    length_m = np.linalg.norm(offset_m, axis=1, keepdims=True)
    return np.asarray(offset_m * np.maximum(0.0, 1.0 - step_m / np.maximum(length_m, 1e-12)))


def _differs(one_mps: Point, other_mps: Point) -> bool:
    return float(np.linalg.norm(one_mps - other_mps)) > SHORTEST_MPS
