"""Simulated seconds of chases in flight, a second and core: the batched world, beside the same world in numpy.

Everybody flies the same chases of scenario ``flight`` to their limit: a target that flees, a swarm that flies at it,
ten flight steps and ten samples of six trackers between two decisions, fading in flight, who was reached when.
``NumpyChase`` is what one would write for one chase: numpy over samples and trackers, plain numbers where there are
only three, since arrays of three cost more than they save. It draws nothing on its way, keeps no streams, and is handed
its start and its fading: what ours does beside that is on ours. Both give the same chase
(tests/benchmarks/test_flight.py).

Beside them stand flights of ``particle`` with all that ``evaluate`` does, by what the target does. Time is CPU time of
the process with one thread, so that other work on the machine disturbs little; the world's subjects take turns.
"""

import dataclasses
import math
import platform
import statistics
import time
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from numpy.typing import NDArray

from ..batch.freed_memory import keep_freed_memory
from ..batch.streams import ChaseKey, chase_keys
from ..channel.fading import DEEPEST_FADE_DB, amplitudes
from ..channel.in_flight import NUM_POINTS, POINTS_PER_CYCLE, InFlight, cubic_table
from ..controllers import load_controller
from ..evaluation.chases import run_chases
from ..flight import FLIGHT_STEP_S
from ..formation import TRACKER_DIRECTION, Action, displacement_towards
from ..scenario import NUM_TRACKERS, SPEED_OF_LIGHT_MPS, Scenario, load_scenario
from ..world.behaviours.steering import VERTICAL_SHARE, Band
from ..world.environment import Environment
from ..world.target import draw_start_m

if TYPE_CHECKING:
    from rich.table import Table

BATCH = 256
FLOWN = "flee"
FLIGHTS_OF = ("waypoints", "flee", "jink")
"""What the targets of the flights of ``particle`` do."""
SAID_FLIGHTS = 10_000
"""So many are told in minutes on two cores."""
_SEED = 1


def flight_scenario(behaviour: str = FLOWN) -> Scenario:
    """``flight``, with targets that do this."""
    return dataclasses.replace(load_scenario("flight"), behaviour=behaviour)


class NumpyChase:
    """One chase of ``flight`` with a target that flees.

    Decisions and samples must fall on flight steps, as they do in ``flight``.
    """

    def __init__(self, scenario: Scenario, key: ChaseKey) -> None:
        fading = InFlight(scenario).begin([key])
        self._scenario = scenario
        self._band = Band.of(scenario)
        self._table = cubic_table().numpy()
        self._point = fading.point[0].numpy()
        self._rotation = fading.rotation[0].numpy() @ np.array([1, 1j])
        self._los_amplitude, _ = amplitudes(scenario)
        self._moment_s = np.linspace(0.0, scenario.decision_s, round(scenario.decision_s / FLIGHT_STEP_S) + 1)
        self._direction = TRACKER_DIRECTION.numpy()
        self._relative_m: NDArray[np.float64] | None = None
        self._spacing_m = scenario.initial_spacing_m
        self.target_m: list[float] = draw_start_m(scenario, [key])[0].tolist()
        self.target_mps = [0.0, 0.0, 0.0]
        self.center_m, self.center_mps = np.zeros(3), np.zeros(3)
        self.time_s = 0.0
        self.reached_s = math.inf
        self.level_dbm = self._flown(np.zeros(3), self._spacing_m)
        self.reached_s = math.inf

    def step(self, displacement_m: NDArray[np.float64], spacing_m: float) -> NDArray[np.float64]:
        """Fly there and listen: the levels, [sample, tracker]."""
        self.level_dbm = self._flown(displacement_m / self._scenario.decision_s, spacing_m)
        return self.level_dbm

    def _flown(self, wanted_mps: NDArray[np.float64], spacing_m: float) -> NDArray[np.float64]:
        center_m, velocity_mps = self._center_at(wanted_mps)
        places_m = center_m.tolist()
        target_m = [self.target_m]
        for place_m in places_m[:-1]:
            self._fly_target(place_m)
            target_m.append(self.target_m)
        offset_m = center_m - np.array(target_m)
        if math.isinf(self.reached_s):
            self.reached_s = self._first_within_s(offset_m)
        spacings_m = np.linspace(self._spacing_m, spacing_m, len(places_m))[1:]
        relative_m = offset_m[1:, None] + spacings_m[:, None, None] * self._direction
        self.center_m, self.center_mps, self._spacing_m = center_m[-1], velocity_mps, spacing_m
        self.time_s += self._scenario.decision_s
        return self._heard_dbm(relative_m)

    def _center_at(self, wanted_mps: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Places at all moments, and the velocity at the end."""
        change_mps = wanted_mps - self.center_mps
        turn_s = math.hypot(*change_mps) / (self._scenario.tracker_acceleration_mps2 or math.inf)
        turning_s = np.minimum(self._moment_s, turn_s)[:, None]
        gained_mps = change_mps * (turning_s / turn_s) if turn_s > 0 else np.zeros((1, 3))
        turned_m = (self.center_mps + gained_mps / 2) * turning_s
        beyond_m = wanted_mps * (self._moment_s[:, None] - turning_s)
        return self.center_m + turned_m + beyond_m, self.center_mps + gained_mps[-1]

    def _fly_target(self, seen_m: list[float]) -> None:
        """Away from there for a flight step, within its limits."""
        speed_mps, most_mps2 = self._scenario.target_speed_mps, self._scenario.target_acceleration_mps2
        away_m = [own - other for own, other in zip(self.target_m, seen_m, strict=True)]
        away = speed_mps / (math.hypot(*away_m) or math.inf)
        change = [away * part - own for part, own in zip(away_m, self.target_mps, strict=True)]
        step_mps = most_mps2 * FLIGHT_STEP_S
        share = min(step_mps / max(math.hypot(*change), 1e-12), 1.0)
        climb_mps, z_m = self.target_mps[2], self.target_m[2]
        most_climb_mps, is_high = self._most_mps(climb_mps, self._band.highest_m - z_m)
        most_sink_mps, is_low = self._most_mps(-climb_mps, z_m - self._band.lowest_m)
        up_mps = max(min(climb_mps + share * change[2], most_climb_mps), -most_sink_mps)
        braking_mps = abs(up_mps - climb_mps)
        if is_high or is_low:
            step_mps = min(step_mps, braking_mps / VERTICAL_SHARE)
        sideways_mps = share * math.hypot(change[0], change[1])
        left_mps = math.sqrt(max(step_mps**2 - braking_mps**2, 0.0))
        share *= min(left_mps / max(sideways_mps, 1e-12), 1.0)
        east_mps, north_mps = (own + share * part for own, part in zip(self.target_mps[:2], change[:2], strict=True))
        self._move_target([east_mps, north_mps, up_mps])

    def _move_target(self, wanted_mps: list[float]) -> None:
        change = [wanted - own for wanted, own in zip(wanted_mps, self.target_mps, strict=True)]
        turn_s = math.hypot(*change) / self._scenario.target_acceleration_mps2
        turning_s = min(turn_s, FLIGHT_STEP_S)
        share = turning_s / turn_s if turn_s > 0 else 1.0
        after = [own + share * part for own, part in zip(self.target_mps, change, strict=True)]
        self.target_m = [
            place + (own + now) * turning_s / 2 + wanted * (FLIGHT_STEP_S - turning_s)
            for place, own, now, wanted in zip(self.target_m, self.target_mps, after, wanted_mps, strict=True)
        ]
        self.target_mps = after

    def _most_mps(self, speed_mps: float, room_m: float) -> tuple[float, bool]:
        """As ``Steering`` has it."""
        braking_mps2 = VERTICAL_SHARE * self._scenario.target_acceleration_mps2
        braking_mps = braking_mps2 * FLIGHT_STEP_S
        safe_mps = math.sqrt(braking_mps**2 + 2 * braking_mps2 * max(room_m, 0.0)) - braking_mps
        must_brake = speed_mps > safe_mps
        return (max(speed_mps - braking_mps, 0.0) if must_brake else safe_mps), must_brake

    def _first_within_s(self, offset_m: NDArray[np.float64]) -> float:
        radius_m = self._scenario.success_radius_m
        before_m, way_m = offset_m[:-1], np.diff(offset_m, axis=0)
        nearing = -(before_m * way_m).sum(axis=1)
        excess = (before_m**2).sum(axis=1) - radius_m**2
        discriminant = nearing**2 - (way_m**2).sum(axis=1) * excess
        share = np.where(excess <= 0, 0.0, excess / (nearing + np.sqrt(np.maximum(discriminant, 0.0))))
        is_there = (excess <= 0) | ((discriminant >= 0) & (nearing > 0) & (share <= 1))
        if not is_there.any():
            return math.inf
        first = int(is_there.argmax())
        return float(self.time_s + self._moment_s[first] + share[first] * FLIGHT_STEP_S)

    def _heard_dbm(self, relative_m: NDArray[np.float64]) -> NDArray[np.float64]:
        """Path loss and fading in flight of the next samples."""
        scenario = self._scenario
        before_m = relative_m[:1] if self._relative_m is None else self._relative_m[None]
        moved_m = np.sqrt((np.diff(relative_m, axis=0, prepend=before_m) ** 2).sum(axis=2))
        self._relative_m = relative_m[-1]
        least = scenario.doppler_spread_hz * POINTS_PER_CYCLE / scenario.sampling_hz
        own = np.maximum(moved_m * (POINTS_PER_CYCLE * scenario.carrier_hz / SPEED_OF_LIGHT_MPS), least).cumsum(axis=0)
        point = np.column_stack([own, own.mean(axis=1)]) + self._point
        self._point = point[-1] % NUM_POINTS
        cell = np.floor(point)
        beyond = point - cell
        value, slope, square, cube = self._table[:, cell.astype(np.int64) % NUM_POINTS]
        process = (((cube * beyond + square) * beyond + slope) * beyond + value) * self._rotation
        fading = process[:, :NUM_TRACKERS] + process[:, NUM_TRACKERS:] + self._los_amplitude
        power = np.maximum(fading.real**2 + fading.imag**2, 10 ** (DEEPEST_FADE_DB / 10))
        distance_m = np.sqrt((relative_m**2).sum(axis=2))
        ratio = np.maximum(distance_m / scenario.reference_distance_m, 1.0)
        mean_dbm = scenario.transmit_power_dbm - scenario.reference_path_loss_db
        return np.asarray(mean_dbm + 10 * np.log10(power) - 10 * scenario.path_loss_exponent * np.log10(ratio))


def fly_numpy(scenario: Scenario, key: ChaseKey, decisions: int) -> NumpyChase:
    """A chase of a swarm that flies at its target at full speed."""
    chase = NumpyChase(scenario, key)
    full_m = scenario.tracker_speed_mps * scenario.decision_s
    for _ in range(decisions):
        way_m = np.array(chase.target_m) - chase.center_m
        chase.step(full_m * way_m / max(math.hypot(*way_m), 1e-12), max(scenario.spacing_choices_m))
    return chase


def fly_batch(environment: Environment, keys: list[ChaseKey], decisions: int) -> Any:
    """The same of a batch: its last state."""
    scenario = environment.scenario
    state = environment.reset(keys)
    spacing_m = torch.full((len(keys),), max(scenario.spacing_choices_m), dtype=torch.float64)
    for _ in range(decisions):
        way_m = state.target_position_m - state.center_m
        state, _ = environment.step(state, Action(spacing_m, displacement_towards(scenario, way_m)))
    return state


def measure(repeats: int = 5, batch: int = BATCH, flights: int = 300, decisions: int | None = None) -> dict[str, Any]:
    """Chase seconds a second of both worlds in ``repeats`` turns, and flights of ``particle`` a second.

    Each turn is ``batch`` chases of ours and four of numpy's, of ``decisions`` each; None is as many as there may be.
    """
    scenario = flight_scenario()
    decisions = scenario.max_movements if decisions is None else decisions
    chase_s = (decisions + 1) * scenario.decision_s
    environment = Environment(scenario)
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    keep_freed_memory()
    try:
        with torch.inference_mode():
            fly_batch(environment, chase_keys(_SEED, batch), 3)
            fly_numpy(scenario, (_SEED, 0), 3)
            turns = [_turn(environment, batch, decisions, first) for first in range(repeats)]
            flown = {behaviour: _flights_per_s(behaviour, flights) for behaviour in FLIGHTS_OF}
    finally:
        torch.set_num_threads(threads)
    return {
        "benchmark": "flight",
        "processor": platform.processor() or platform.machine(),
        "threads": 1,
        "clock": "CPU time of the process",
        "versions": {"python": platform.python_version(), "numpy": np.__version__, "torch": torch.__version__},
        "scenario": scenario.to_dict(),
        "repeats": repeats,
        "batch": batch,
        "chase_s_per_s": {
            "swarmchase": statistics.median(chase_s * batch / ours_s for ours_s, _ in turns),
            "numpy": statistics.median(chase_s / numpy_s for _, numpy_s in turns),
        },
        "ratio_to_numpy": statistics.median(numpy_s * batch / ours_s for ours_s, numpy_s in turns),
        "particle_flights": flights,
        "particle_flights_per_s": flown,
        "minutes_of_10000_flights_on_two_cores": {
            behaviour: SAID_FLIGHTS / rate / 2 / 60 for behaviour, rate in flown.items()
        },
    }


def table(result: dict[str, Any]) -> "Table":
    """What ``measure`` found, for people."""
    from rich.table import Table

    rates = result["chase_s_per_s"]
    shown = Table(title="Flight: on one core", caption=f"numpy: one chase; ratio {result['ratio_to_numpy']:.1f}")
    shown.add_column("")
    shown.add_column("a CPU second", justify="right")
    shown.add_row(f"seconds of chases, batches of {result['batch']}", f"{rates['swarmchase']:,.0f}")
    shown.add_row("seconds of a chase, numpy", f"{rates['numpy']:,.0f}")
    minutes = result["minutes_of_10000_flights_on_two_cores"]
    for behaviour, rate in result["particle_flights_per_s"].items():
        shown.add_row(
            f"flights of particle, {behaviour}", f"{rate:.1f} (10,000 on two cores: {minutes[behaviour]:.0f} min)"
        )
    return shown


def _turn(environment: Environment, batch: int, decisions: int, number: int) -> tuple[float, float]:
    """CPU seconds of a batch of ours and of one of numpy's chases, a median of four."""
    begin_s = time.process_time()
    fly_batch(environment, chase_keys(_SEED, batch, batch * number), decisions)
    ours_s = time.process_time() - begin_s
    numpy_s = []
    for chase in range(4):
        begin_s = time.process_time()
        fly_numpy(environment.scenario, (_SEED, batch * number + chase), decisions)
        numpy_s.append(time.process_time() - begin_s)
    return ours_s, statistics.median(numpy_s)


def _flights_per_s(behaviour: str, flights: int) -> float:
    """Chases of ``particle`` to their end, as ``evaluate`` runs them."""
    scenario = flight_scenario(behaviour)
    begin_s = time.process_time()
    done = list(run_chases(scenario, load_controller("particle", scenario), _SEED, range(flights)))
    return len(done) / (time.process_time() - begin_s)
