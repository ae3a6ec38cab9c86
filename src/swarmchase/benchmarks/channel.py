"""RSSI windows a second on one core, beside pyphysim and CommPy.

Everybody does the same job: one window is 6 trackers x 50 samples of correlated Rician fading with the line of sight
added, on top of the path loss, in dBm. The peers run in the fastest form their public interface allows: many windows
a call, one generator for all (ours keeps one random stream a chase), results left in memory in their own order.
What they lack is added with whole-array numpy, and costs them less than a tenth of their time.

Every sampler runs at the batch size that suits it best. The samplers take turns, and a ratio is the median over the
turns of two rates measured one right after the other. Time is CPU time of the process, so that other work on the
machine disturbs little; with one thread it is what a free core would need.

Beside them stands what fading in flight costs over windows drawn anew, for as many samples of as many chases: from one
decision to the next while all fly at 10 m/s, no peer has that.

The peers come with ``pip install swarmchase[benchmark]``. pyphysim pins old versions of packages it needs elsewhere;
its fading generators run with ``pip install --no-deps pyphysim==0.7.2 && pip install numba`` too.
"""

import contextlib
import importlib.metadata
import platform
import statistics
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch

from ..batch.streams import chase_keys
from ..channel.fading import Fading, window_time_s
from ..channel.fading_process import fading_process
from ..channel.propagation import path_loss_db
from ..scenario import NUM_TRACKERS, Scenario, paper_scenario
from ..world.radio import rssi_dbm

if TYPE_CHECKING:
    from rich.table import Table

SAMPLING_HZ = (10, 20, 50, 100)
"""The sampling frequencies of the paper."""
PYPHYSIM_RAYS = 8
"""pyphysim's default number of rays: few, which is to its advantage here and to the disadvantage of its statistics."""
DISTANCE_M = 100.0
FLIGHTS = {"20": 10, "100": 50}
"""Samples of half a second between two decisions, by sampling frequency in hertz."""
FLYING_CHASES = 256
FLYING_MPS = 10.0
"""Of every tracker as the target sees it."""

Draw = Callable[[], Any]
"""Draws one batch of windows, [window, sample, tracker] in dBm, as a tensor or a numpy array."""
Prepare = Callable[[Scenario, int], Draw]
"""Everything that is done once: a sampler for this scenario and this many windows a call."""


def swarmchase_windows(scenario: Scenario, batch: int) -> Draw:
    """Ours: exact Jakes covariance, every window of another chase with its own random stream."""
    fading = fading_process(scenario)
    state = fading.begin(chase_keys(1, batch))
    distance_m = _distance_m(batch)[:, None]
    time_s = window_time_s(scenario, torch.zeros(batch, dtype=torch.float64))
    return lambda: rssi_dbm(scenario, distance_m, fading.gain(state, time_s)[0])


def pyphysim_windows(scenario: Scenario, batch: int) -> Draw:
    """pyphysim: its generator draws all trackers of all windows in one call; we correlate, add line of sight, take dB.

    Setting its ``shape`` draws the phases of new, independent processes, and is cheaper than a new generator.
    """
    from pyphysim.channels.fading_generators import JakesSampleGenerator

    shape = (batch, NUM_TRACKERS)
    generator = JakesSampleGenerator(
        scenario.doppler_spread_hz, 1 / scenario.sampling_hz, PYPHYSIM_RAYS, shape, np.random.RandomState(1)
    )
    # The amplitude of the scattered part is folded into the matrix, so that it costs nothing.
    root = np.linalg.cholesky(_tracker_covariance(scenario)) / np.sqrt(scenario.rician_k + 1)
    mean_dbm = _mean_dbm(scenario, batch)

    def draw() -> Any:
        generator.shape = shape
        generator.generate_more_samples(scenario.window_samples)
        channel = root @ generator.get_samples()
        channel += _los_amplitude(scenario)
        return (_power_db(channel) + mean_dbm[:, :, None]).transpose(0, 2, 1)

    return draw


def commpy_windows(scenario: Scenario, batch: int) -> Draw:
    """CommPy: its 1 x 6 MIMO channel knows R and K. It has no Doppler: every sample is an independent channel use.

    Its own noise cannot be switched off, only set to zero; it draws it all the same.
    """
    from commpy.channels import MIMOFlatChannel

    scattered_power = np.array([[1 / (scenario.rician_k + 1)]])
    line_of_sight = np.full((NUM_TRACKERS, 1), _los_amplitude(scenario), dtype=np.complex128)
    channel = MIMOFlatChannel(1, NUM_TRACKERS, 0.0, (line_of_sight, scattered_power, _tracker_covariance(scenario)))
    symbols = np.ones(batch * scenario.window_samples)
    mean_dbm = _mean_dbm(scenario, batch)

    def draw() -> Any:
        channel.propagate(symbols)
        gains = channel.channel_gains.reshape(batch, scenario.window_samples, NUM_TRACKERS)
        return _power_db(gains) + mean_dbm[:, None, :]

    return draw


def fading_in_flight(scenario: Scenario, num_samples: int) -> Draw:
    """The fading of the next samples of a flight, call after call; a scenario may draw it anew each time."""
    fading: Fading[Any] = fading_process(scenario)
    state = fading.begin(chase_keys(1, FLYING_CHASES))
    time_s = torch.arange(1, num_samples + 1, dtype=torch.float64).expand(FLYING_CHASES, -1) / scenario.sampling_hz
    moved_m = torch.full((*time_s.shape, NUM_TRACKERS), FLYING_MPS / scenario.sampling_hz, dtype=torch.float64)
    flown_s = 0.0

    def draw() -> Any:
        nonlocal state, flown_s
        h, state = fading.gain(state, time_s + flown_s, moved_m)
        flown_s += num_samples / scenario.sampling_hz
        return h

    return draw


OURS = "swarmchase"
SAMPLERS: dict[str, Prepare] = {
    OURS: swarmchase_windows,
    "pyphysim": pyphysim_windows,
    "commpy": commpy_windows,
}
_DISTRIBUTION = {OURS: "swarmchase", "pyphysim": "pyphysim", "commpy": "scikit-commpy"}


def measure(
    turn_s: float = 0.1,
    repeats: int = 7,
    sampling_hz: tuple[int, ...] = SAMPLING_HZ,
    batch_sizes: tuple[int, ...] = (16, 256, 1024),
) -> dict[str, Any]:
    """Windows a second of every sampler that can be imported, and ours over each peer's.

    Each sampler has ``repeats`` turns of ``turn_s`` seconds of CPU time at each sampling frequency.
    """
    refused = {name: reason for name in SAMPLERS if (reason := _why_not(SAMPLERS[name]))}
    names = [name for name in SAMPLERS if name not in refused]
    rates: dict[str, dict[str, list[float]]] = {name: {} for name in names}
    batches: dict[str, dict[str, int]] = {name: {} for name in names}
    with _one_thread(), torch.inference_mode():
        for frequency_hz in sampling_hz:
            scenario = paper_scenario(sampling_hz=frequency_hz)
            draws = {}
            for name in names:
                batch, draws[name] = _fastest(SAMPLERS[name], scenario, batch_sizes, turn_s)
                batches[name][str(frequency_hz)] = batch
                rates[name][str(frequency_hz)] = []
            for _ in range(repeats):
                for name, draw in draws.items():
                    batch = batches[name][str(frequency_hz)]
                    rates[name][str(frequency_hz)].append(_windows_per_s(draw, batch, turn_s))
        in_flight = {at: _cost_in_flight(float(at), samples, turn_s, repeats) for at, samples in FLIGHTS.items()}
    return {
        "benchmark": "channel",
        "cpu": _cpu_name(),
        "threads": 1,
        "clock": "CPU time of the process",
        "versions": {name: importlib.metadata.version(_DISTRIBUTION[name]) for name in names}
        | {"python": platform.python_version(), "numpy": np.__version__, "torch": torch.__version__},
        "window": f"{NUM_TRACKERS} trackers x {paper_scenario().window_samples} samples, RSSI in dBm",
        "repeats": repeats,
        "batch_windows": batches,
        "windows_per_s": {name: {at: statistics.median(turns) for at, turns in rates[name].items()} for name in names},
        **{f"ratio_to_{peer}": _ratio(rates[OURS], rates[peer]) for peer in names if peer != OURS},
        "in_flight_cost_over_drawn_windows": in_flight,
        "not_measured": refused,
        "notes": {
            "pyphysim": f"{PYPHYSIM_RAYS} rays; correlation, line of sight and dB added in numpy",
            "commpy": "has no Doppler: its samples are independent in time, whatever the sampling frequency",
        },
    }


def table(result: dict[str, Any]) -> "Table":
    """What ``measure`` found, for people."""
    from rich.table import Table

    shown = Table(title=f"Channel: windows per second on one core ({result['cpu']})", caption=result["window"])
    shown.add_column("sampling frequency [Hz]", justify="right")
    rates = result["windows_per_s"]
    for name in rates:
        shown.add_column(f"{name} {result['versions'][name]}", justify="right")
    peers = [name for name in rates if name != OURS]
    for peer in peers:
        shown.add_column(f"ratio to {peer}", justify="right")
    for frequency_hz in rates[OURS]:
        cells = [f"{rates[name][frequency_hz]:,.0f}" for name in rates]
        cells += [f"{result[f'ratio_to_{peer}'][frequency_hz]:.1f}" for peer in peers]
        shown.add_row(frequency_hz, *cells)
    costs = result["in_flight_cost_over_drawn_windows"]
    shown.caption = f"{shown.caption}\nfading in flight costs " + ", ".join(
        f"{cost:.1f} times as much as drawn windows at {at} Hz ({FLIGHTS[at]} samples a call)"
        for at, cost in costs.items()
    )
    for name, reason in result["not_measured"].items():
        shown.caption = f"{shown.caption}\n{name} is not measured: {reason}"
    return shown


def _windows_per_s(draw: Draw, batch: int, turn_s: float) -> float:
    num_windows = 0
    begin_s = time.process_time()
    while (elapsed_s := time.process_time() - begin_s) < turn_s:
        draw()
        num_windows += batch
    return num_windows / elapsed_s


def _cost_in_flight(sampling_hz: float, num_samples: int, turn_s: float, repeats: int) -> float:
    """CPU time of a sample of fading in flight over that of a sample of a window drawn anew."""
    drawn, in_flight = (
        fading_in_flight(paper_scenario(sampling_hz=sampling_hz, continuity=continuity), num_samples)
        for continuity in ("independent", "in_flight")
    )
    drawn()
    in_flight()
    return statistics.median(
        _windows_per_s(drawn, FLYING_CHASES, turn_s) / _windows_per_s(in_flight, FLYING_CHASES, turn_s)
        for _ in range(repeats)
    )


def _fastest(prepare: Prepare, scenario: Scenario, batch_sizes: tuple[int, ...], trial_s: float) -> tuple[int, Draw]:
    """The batch size with the highest rate in two short trials, and the sampler for it; the first call warms up."""
    draws = {batch: prepare(scenario, batch) for batch in batch_sizes}
    for draw in draws.values():
        draw()
    rate = {batch: max(_windows_per_s(draw, batch, trial_s) for _ in range(2)) for batch, draw in draws.items()}
    fastest = max(rate, key=rate.__getitem__)
    return fastest, draws[fastest]


def _ratio(ours: dict[str, list[float]], theirs: dict[str, list[float]]) -> dict[str, float]:
    return {
        at: statistics.median(our / their for our, their in zip(turns, theirs[at], strict=True))
        for at, turns in ours.items()
    }


def _why_not(prepare: Prepare) -> str:
    """Why a sampler cannot be measured here, in one line; empty if it can."""
    try:
        prepare(paper_scenario(), 1)()
    except (
        Exception
    ) as error:  # a peer may fail in any way with a numpy it does not know; the others are still measured
        return f"{type(error).__name__}: {error}".splitlines()[0]
    return ""


@contextlib.contextmanager
def _one_thread() -> Iterator[None]:
    """One thread in torch and, if threadpoolctl is installed, in numpy's BLAS.

    Without it, set OMP_NUM_THREADS=1 before Python starts; the matrices here are too small for BLAS to use a second.
    """
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        with contextlib.ExitStack() as stack:
            with contextlib.suppress(ModuleNotFoundError):
                stack.enter_context(importlib.import_module("threadpoolctl").threadpool_limits(1))
            yield
    finally:
        torch.set_num_threads(before)


def _cpu_name() -> str:
    with contextlib.suppress(OSError):
        for line in Path("/proc/cpuinfo").read_text().splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or platform.machine()


def _distance_m(batch: int) -> torch.Tensor:
    return torch.full((batch, NUM_TRACKERS), DISTANCE_M, dtype=torch.float64)


def _mean_dbm(scenario: Scenario, batch: int) -> Any:
    return (scenario.transmit_power_dbm - path_loss_db(scenario, _distance_m(batch))).numpy()


def _tracker_covariance(scenario: Scenario) -> Any:
    covariance = np.full((NUM_TRACKERS, NUM_TRACKERS), scenario.spatial_correlation)
    np.fill_diagonal(covariance, 1)
    return covariance


def _los_amplitude(scenario: Scenario) -> float:
    return float(np.sqrt(scenario.rician_k / (scenario.rician_k + 1)))


def _power_db(channel: Any) -> Any:
    """Two squares are cheaper than numpy's hypot in ``abs``."""
    power = channel.real**2
    power += channel.imag**2
    return 10 * np.log10(power, out=power)
