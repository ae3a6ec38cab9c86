"""When the live service says "reached" over a real radio map: at how many places near an emitter and far from it.

The map is that of ``radio_map``. The swarm hovers around every place, each tracker hears what was recorded at the place
nearest to it, and the judge is told one path loss, the best fit to the mean levels of the whole map. A place counts as
called if any of its windows is: they follow one another as long as the recording lasts.
"""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from ..evaluation.statistics import share_interval
from ..formation import TRACKER_DIRECTION
from ..levels import highest_dbm, is_level
from ..live.service.nearness import NearnessJudge
from ..live.service.settings import OperatorSettings
from ..reports.intervals import shown_share
from ..scenario import Scenario
from .radio_map import fitted_scenario, read_map

if TYPE_CHECKING:
    from rich.table import Table

MOST_WINDOWS = 8
"""Of one recording."""
_BANDS = {"within 2 m": (0.0, 2.0), "2 to 4 m": (2.0, 4.0), "beyond 4 m": (4.0, np.inf), "beyond 7 m": (7.0, np.inf)}

Array = npt.NDArray[np.float64]


def measure(folder: Path) -> dict[str, Any]:
    """The share of the places called reached, by spacing and by the distance of the place from the emitter.

    Raises:
        InputError: there is no such map.
    """
    emitter_m, place_m, rssi_dbm = read_map(folder)
    distance_m = np.linalg.norm(place_m[:, None] - emitter_m, axis=2)
    scenario, deviation_db = fitted_scenario(distance_m, rssi_dbm)
    rows = []
    for spacing_m in scenario.spacing_choices_m:
        called = _called(scenario, spacing_m, place_m, rssi_dbm)
        rows.append(
            {"spacing_m": spacing_m}
            | {
                name: float(called[(distance_m > low) & (distance_m <= high)].mean())
                for name, (low, high) in _BANDS.items()
            }
            | {
                f"{name}_ci95": share_interval(int(there.sum()), len(there))
                for name, (low, high) in _BANDS.items()
                if len(there := called[(distance_m > low) & (distance_m <= high)])
            }
        )
    return {
        "places": len(place_m),
        "emitters": len(emitter_m),
        "level_at_1_m_dbm": scenario.transmit_power_dbm - scenario.reference_path_loss_db,
        "path_loss_exponent": scenario.path_loss_exponent,
        "deviation_db": deviation_db,
        "no_levels_share": float(1 - is_level(rssi_dbm, highest_dbm(scenario)).mean()),
        "pairs": {name: int(((distance_m > low) & (distance_m <= high)).sum()) for name, (low, high) in _BANDS.items()},
        "called_reached": rows,
    }


def _called(scenario: Scenario, spacing_m: float, place_m: Array, rssi_dbm: Array) -> npt.NDArray[np.bool_]:
    """Whether the swarm around each place is told to have reached each emitter [place, emitter]."""
    offset_m = spacing_m * TRACKER_DIRECTION.numpy()
    apart_m = np.linalg.norm(place_m[:, None, None] + offset_m[:, None] - place_m, axis=3)
    heard_at = apart_m.argmin(axis=2)
    length = scenario.window_samples
    windows = min(MOST_WINDOWS, rssi_dbm.shape[2] // length)
    called = np.zeros(rssi_dbm.shape[:2], dtype=np.bool_)
    for place, emitter in np.ndindex(*called.shape):
        judge = NearnessJudge(scenario, OperatorSettings.reached_windows, OperatorSettings.minimum_trackers)
        samples_dbm = rssi_dbm[heard_at[place], emitter].T
        called[place, emitter] = any(
            judge.is_reached(samples_dbm[k * length : (k + 1) * length], offset_m) for k in range(windows)
        )
    return called


def table(result: dict[str, Any]) -> "Table":
    """What ``measure`` returned, for people."""
    from rich.table import Table

    shown = Table(title=f'Places called "reached": {result["places"]} places, {result["emitters"]} emitters')
    shown.add_column("spacing, m")
    for name, pairs in result["pairs"].items():
        shown.add_column(f"{name} ({pairs})", justify="right")
    for row in result["called_reached"]:
        shares = (shown_share(row[name], row.get(f"{name}_ci95")) for name in result["pairs"])
        shown.add_row(f"{row['spacing_m']:g}", *shares)
    return shown
