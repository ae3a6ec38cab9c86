"""Worlds that differ from the scenario a controller is told: what to compare in, and what to train in."""

import dataclasses
import math
from collections.abc import Callable, Mapping
from typing import Any

from ..batch.streams import ChaseStreams, chase_keys
from ..scenario import Scenario

DEPARTURE_SHARE = 0.25
"""In a drawn world each thing departs from the scenario with this probability."""

DEPARTURES: Mapping[str, Mapping[str, Any]] = {
    "as told": {},
    "6 dB weaker": {"transmit_power_dbm": -6.0},
    "6 dB stronger": {"transmit_power_dbm": 6.0},
    "path loss exponent 2.0": {"path_loss_exponent": 2.0},
    "path loss exponent 3.2": {"path_loss_exponent": 3.2},
    "K = 0": {"rician_k": 0.0},
    "K = 10": {"rician_k": 10.0},
    "Doppler spread 0.5 Hz": {"doppler_spread_hz": 0.5},
    "Doppler spread 5 Hz": {"doppler_spread_hz": 5.0},
    "rho = 0.1": {"spatial_correlation": 0.1},
    "rho = 0.5": {"spatial_correlation": 0.5},
    "rho = 0.9": {"spatial_correlation": 0.9},
    "independent LOS phases": {"los_phase": "independent"},
    "start at 60 m": {"start_distance_m": 60.0},
    "start at 150 m": {"start_distance_m": 150.0},
    "start at 300 m": {"start_distance_m": 300.0},
    "one tracker silent": {"silent_trackers": 1},
    "two trackers silent": {"silent_trackers": 2},
    "20 % of samples missing": {"missing_sample_share": 0.2},
    "receivers off by up to 3 dB": {"receiver_offset_db": 3.0},
    "receivers off by up to 6 dB": {"receiver_offset_db": 6.0},
    "one receiver off by 20 dB": {"wrong_trackers": 1},
    "one receiver stuck": {"stuck_trackers": 1},
    "whole decibels": {"receiver_step_db": 1.0},
    "off by 3 dB, exponent 3.0, 3 dB weaker, K = 1, whole decibels": {
        "receiver_offset_db": 3.0,
        "path_loss_exponent": 3.0,
        "transmit_power_dbm": -3.0,
        "rician_k": 1.0,
        "receiver_step_db": 1.0,
    },
    "shadowing of 3 dB": {"shadowing_db": 3.0},
    "shadowing of 3 dB, off by 3 dB, exponent 2.2, 10 % missing, whole decibels": {
        "shadowing_db": 3.0,
        "receiver_offset_db": 3.0,
        "path_loss_exponent": 2.2,
        "missing_sample_share": 0.1,
        "receiver_step_db": 1.0,
    },
}
"""The worlds of the robustness table by name; the transmit power is relative to the scenario's. Shadowing's correlation
falls to 1 / e over the scenario's ``shadowing_distance_m``, 20 m."""

_DRAWN: Mapping[str, Callable[[Scenario, float], Any]] = {
    # What a departing field is, of a number drawn uniformly from [0, 1).
    "transmit_power_dbm": lambda told, share: told.transmit_power_dbm + 12 * share - 6,
    "path_loss_exponent": lambda _told, share: 2 + 1.2 * share,
    "rician_k": lambda _told, share: 10 * share**2,
    "doppler_spread_hz": lambda _told, share: 0.5 * math.pow(10, share),
    "spatial_correlation": lambda _told, share: 0.95 * share,
    "los_phase": lambda _told, _share: "independent",
    "start_distance_m": lambda _told, share: 60 + 90 * share,
    "silent_trackers": lambda _told, share: 1 + int(2 * share),
    "missing_sample_share": lambda _told, share: 0.3 * share,
    "receiver_offset_db": lambda _told, share: 3 * share,
}


def departed(told: Scenario, name: str) -> Scenario:
    """The world of ``DEPARTURES`` of this name."""
    changes = dict(DEPARTURES[name])
    if "transmit_power_dbm" in changes:
        changes["transmit_power_dbm"] += told.transmit_power_dbm
    return dataclasses.replace(told, **changes)


def drawn_world(told: Scenario, seed: int, number: int) -> Scenario:
    """World ``number`` of a seed: each thing may depart from what is told, within the ranges of the table."""
    streams = ChaseStreams.of(chase_keys(seed, 1, number), "world")
    departs, share = streams.uniform(2, len(_DRAWN))[0].tolist()
    changes = {
        name: draw(told, share[place])
        for place, (name, draw) in enumerate(_DRAWN.items())
        if departs[place] < DEPARTURE_SHARE
    }
    return dataclasses.replace(told, **changes)
