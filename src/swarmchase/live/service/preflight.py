"""What is looked at before the trackers are led: it must pass, or the operator overrides it in words.

Who is not heard of is not looked at: how many trackers there must be is another question. What nobody can say holds up
nothing. A fence that nobody gave is not overridden: nobody but the operator knows what lies around real vehicles.
"""

import math
from collections.abc import Iterator, Sequence

from ...scenario import Scenario
from ..link.messages import Metres, TrackerMode
from .chase_state import PreflightCheck, TrackerSnapshot
from .formation_estimate import ASTRAY_M
from .limit_values import LimitValues

LEAST_POSITION_HZ, LEAST_POSITION_HZ_IN_FLIGHT = 4.0, 10.0
"""A vehicle of 5 m/s, or in flight of 10 m/s, flies more than a metre between two positions where they are rarer."""
MOST_CLOCK_AHEAD_S = 1.0
"""What a clock that is further ahead is sent, it takes for older than it is."""
FENCE = ("fence_west_m", "fence_east_m", "fence_south_m", "fence_north_m")


def preflight(
    scenario: Scenario,
    limits: LimitValues,
    trackers: Sequence[TrackerSnapshot],
    clocks_ahead_s: Sequence[float | None],
) -> tuple[PreflightCheck, ...]:
    """All checks, those of one tracker after those of another, then those of all.

    Args:
        clocks_ahead_s: Of each tracker, how far its clock is ahead of this machine's; None where nobody knows.
    """
    there = {number: tracker for number, tracker in enumerate(trackers) if not tracker.is_lost}
    least_hz = LEAST_POSITION_HZ if scenario.pace == "stop_and_listen" else LEAST_POSITION_HZ_IN_FLIGHT
    of_trackers = [
        check
        for number, tracker in there.items()
        for check in _of_tracker(number, tracker, limits, clocks_ahead_s[number], least_hz)
    ]
    altitudes = [] if not there else [_altitudes(scenario, list(there.values()))]
    return (*of_trackers, *altitudes, *_limits(limits, list(there.values())))


def failing(checks: Sequence[PreflightCheck], overridden: bool) -> list[PreflightCheck]:
    """What still holds up the start."""
    return [one for one in checks if one.passed is False and not (overridden and one.may_be_overridden)]


def beyond_the_fence(scenario: Scenario, limits: LimitValues, center_m: Metres) -> str:
    """Where a target as far away as the scenario has it may be out of reach from this start; empty: nowhere."""
    reach_m = scenario.start_distance_m - scenario.success_radius_m
    x_m, y_m, z_m = center_m
    rooms_m = {
        "west": x_m - limits.fence_west_m,
        "east": limits.fence_east_m - x_m,
        "south": y_m - limits.fence_south_m,
        "north": limits.fence_north_m - y_m,
        "below": z_m - limits.lowest_altitude_m,
        "above": limits.highest_altitude_m - z_m,
    }
    sides = [f"{room_m:.0f} m {side}" for side, room_m in rooms_m.items() if room_m < reach_m]
    if not sides:
        return ""
    return f"the target may be {scenario.start_distance_m:g} m away, and the limits end {', '.join(sides)}"


def in_words(checks: Sequence[PreflightCheck]) -> str:
    """For a line on a console."""
    return ", ".join(
        f"{'' if one.tracker is None else f'tracker {one.tracker} '}{one.name} ({one.text})" for one in checks
    )


def _of_tracker(
    number: int, tracker: TrackerSnapshot, limits: LimitValues, clock_ahead_s: float | None, least_hz: float
) -> Iterator[PreflightCheck]:
    vehicle = tracker.vehicle
    if vehicle is not None:
        yield PreflightCheck("armed", vehicle.is_armed, "armed" if vehicle.is_armed else "not armed", number)
        in_the_air = {True: "in the air", False: "on the ground", None: "does not say whether it is in the air"}
        yield PreflightCheck("airborne", vehicle.is_airborne, in_the_air[vehicle.is_airborne], number)
    obeys = None if tracker.mode is None else tracker.mode is not TrackerMode.MANUAL
    mode = "no heartbeat yet" if tracker.mode is None else tracker.mode.name.lower()
    yield PreflightCheck("mode", obeys, mode, number)
    if vehicle is not None and not vehicle.is_simulated:
        yield _position_rate(number, tracker, least_hz)
    inside = tracker.position_m is not None and _is_inside(limits, tracker.position_m)
    yield PreflightCheck("inside the fence", inside, "inside" if inside else "outside the fence", number)
    yield PreflightCheck("place", not tracker.left_out, tracker.left_out or "where the others put it", number)
    is_heard = math.isfinite(tracker.rssi_age_s) and not tracker.is_silent
    heard = f"{1 - tracker.missing_share:.0%} of the last samples" if is_heard else "nothing heard"
    yield PreflightCheck("levels", is_heard, heard, number)
    if clock_ahead_s is not None:
        agrees = clock_ahead_s <= MOST_CLOCK_AHEAD_S
        yield PreflightCheck("clock", agrees, f"{clock_ahead_s:+.1f} s of this machine's", number)


def _position_rate(number: int, tracker: TrackerSnapshot, least_hz: float) -> PreflightCheck:
    """Of the autopilot's telemetry: a simulated vehicle has none."""
    if tracker.position_hz is None:
        return PreflightCheck("positions", False, "only one yet", number)
    often = tracker.position_hz >= least_hz
    return PreflightCheck("positions", often, f"{tracker.position_hz:.1f} a second", number)


def _is_inside(limits: LimitValues, position_m: Metres) -> bool:
    x_m, y_m, z_m = position_m
    return (
        limits.fence_west_m <= x_m <= limits.fence_east_m
        and limits.fence_south_m <= y_m <= limits.fence_north_m
        and limits.lowest_altitude_m <= z_m <= limits.highest_altitude_m
    )


def _altitudes(scenario: Scenario, trackers: Sequence[TrackerSnapshot]) -> PreflightCheck:
    """The widest formation is two spacings high; each may be astray."""
    z_m = [tracker.position_m[2] for tracker in trackers if tracker.position_m is not None]
    most_m = 2 * max(scenario.spacing_choices_m) + 2 * ASTRAY_M
    low_m, high_m = min(z_m, default=math.nan), max(z_m, default=math.nan)
    text = f"{low_m:.1f} to {high_m:.1f} m; a formation is at most {most_m:.0f} m high"
    return PreflightCheck("altitudes", high_m - low_m <= most_m, text)


def _limits(limits: LimitValues, trackers: Sequence[TrackerSnapshot]) -> list[PreflightCheck]:
    """Real vehicles need a fence and a lowest altitude of their own place: the defaults are of no place."""
    if all(tracker.vehicle is not None and tracker.vehicle.is_simulated for tracker in trackers):
        return []
    default = LimitValues()
    missing = [] if any(getattr(limits, name) != getattr(default, name) for name in FENCE) else ["--fence-..-m"]
    if limits.lowest_altitude_m == default.lowest_altitude_m:
        missing.append("--lowest-altitude-m")
    text = f"real vehicles need {' and '.join(missing)}" if missing else "given"
    return [PreflightCheck("limits", not missing, text, may_be_overridden=False)]
