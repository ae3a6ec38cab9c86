"""Where the target starts: anywhere around the swarm's start (Section IV), or where the scenario's limits leave it."""

import math
from collections.abc import Sequence

import torch

from ..batch.array_types import Float, Tensor
from ..batch.streams import ChaseKey, ChaseStreams
from ..errors import InputError
from ..flight import length
from ..scenario import Scenario
from .behaviours.steering import Band


def draw_start_m(scenario: Scenario, keys: Sequence[ChaseKey]) -> Float[Tensor, "chase 3"]:
    """Targets uniform on the sphere of radius |O_0 - U| = 100 m around the centre's start, float64.

    With ``farthest_start_m`` the radius is uniform between ``start_distance_m`` and that. Where elevation or altitude
    are limited, targets are uniform on what the limits leave of their sphere, in the same bearing as without them.

    Raises:
        InputError: the limits leave no place at some distance.
    """
    streams = ChaseStreams.of(keys, "target")
    towards = streams.standard_normal(3).double()
    towards_length = length(towards)[:, None]
    distance_m = _distance_m(scenario, streams)
    band = Band.of(scenario)
    if scenario.highest_elevation_deg == 90.0 and not band.is_limited:
        return distance_m * towards / towards_length
    return _within_m(scenario, band, towards / towards_length, distance_m)


def _distance_m(scenario: Scenario, streams: ChaseStreams) -> Float[Tensor, "chase 1"]:
    """Uniform between the nearest and the farthest; where these are one, nothing is drawn."""
    nearest_m, farthest_m = scenario.start_distance_m, scenario.farthest_start_m
    if farthest_m is None:
        return torch.full((len(streams), 1), nearest_m, dtype=torch.float64)
    if farthest_m < nearest_m:
        raise InputError(
            f"farthest_start_m = {farthest_m:g} is refused: allowed is at least start_distance_m = {nearest_m:g}"
        )
    return nearest_m + (farthest_m - nearest_m) * streams.uniform(1)


def _within_m(
    scenario: Scenario, band: Band, towards: Float[Tensor, "chase 3"], distance_m: Float[Tensor, "chase 1"]
) -> Float[Tensor, "chase 3"]:
    """The place so far away in this direction, after the sphere was squeezed between elevations and altitudes.

    The height of a place that is uniform on a sphere is uniform (Archimedes), and so it is on any belt of it.
    """
    highest_m = distance_m * math.sin(math.radians(scenario.highest_elevation_deg))
    lowest_m, highest_m = (-highest_m).clamp_min(band.lowest_m), highest_m.clamp_max(band.highest_m)
    if (lowest_m > highest_m).any():
        raise InputError(
            "no start is within lowest_altitude_m, highest_altitude_m and highest_elevation_deg "
            f"{distance_m[lowest_m > highest_m][0].item():.0f} m from a swarm at start_altitude_m = "
            f"{scenario.start_altitude_m:g}"
        )
    z_m = torch.lerp(lowest_m, highest_m, (towards[:, 2:] + 1) / 2)
    bearing = towards[:, :2] / length(towards[:, :2])[:, None]
    return torch.cat([bearing * (distance_m.square() - z_m.square()).clamp_min(0.0).sqrt(), z_m], dim=1)
