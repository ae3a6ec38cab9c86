"""The worlds of the robustness table and those drawn for training: what departs, how far and how often."""

import dataclasses

import numpy as np
import pytest

from swarmchase.batch.streams import chase_keys
from swarmchase.scenario import Scenario, paper_scenario
from swarmchase.world.departures import DEPARTURE_SHARE, DEPARTURES, departed, drawn_world
from swarmchase.world.environment import Environment

TOLD = paper_scenario(sampling_hz=20.0, spatial_correlation=0.3, transmit_power_dbm=17.0, rician_k=4.0)
"""Differs from Table I in what departures could mistake for its own."""

NUM_WORLDS = 2000
RANGES = {
    "transmit_power_dbm": (11, 23),
    "path_loss_exponent": (2, 3.2),
    "rician_k": (0, 10),
    "doppler_spread_hz": (0.5, 5),
    "spatial_correlation": (0, 0.95),
    "start_distance_m": (60, 150),
    "missing_sample_share": (0, 0.3),
    "receiver_offset_db": (0, 3),
}
"""Of what may be anything between two ends."""
OTHERS = {"silent_trackers": {1, 2}, "los_phase": {"independent"}}
"""What may depart to one of a few."""


def changes(world: Scenario, told: Scenario = TOLD) -> dict[str, object]:
    """The fields in which a world is not what is told."""
    names = (constant.name for constant in dataclasses.fields(Scenario))
    return {name: getattr(world, name) for name in names if getattr(world, name) != getattr(told, name)}


@pytest.fixture(scope="module")
def worlds() -> list[Scenario]:
    return [drawn_world(TOLD, 3, number) for number in range(NUM_WORLDS)]


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("as told", {}),
        ("6 dB weaker", {"transmit_power_dbm": 11}),
        ("6 dB stronger", {"transmit_power_dbm": 23}),
        ("path loss exponent 2.0", {"path_loss_exponent": 2}),
        ("path loss exponent 3.2", {"path_loss_exponent": 3.2}),
        ("K = 0", {"rician_k": 0}),
        ("K = 10", {"rician_k": 10}),
        ("Doppler spread 0.5 Hz", {"doppler_spread_hz": 0.5}),
        ("Doppler spread 5 Hz", {"doppler_spread_hz": 5}),
        ("rho = 0.1", {"spatial_correlation": 0.1}),
        ("rho = 0.5", {"spatial_correlation": 0.5}),
        ("rho = 0.9", {"spatial_correlation": 0.9}),
        ("independent LOS phases", {"los_phase": "independent"}),
        ("start at 60 m", {"start_distance_m": 60}),
        ("start at 150 m", {"start_distance_m": 150}),
        ("start at 300 m", {"start_distance_m": 300}),
        ("one tracker silent", {"silent_trackers": 1}),
        ("two trackers silent", {"silent_trackers": 2}),
        ("20 % of samples missing", {"missing_sample_share": 0.2}),
        ("receivers off by up to 3 dB", {"receiver_offset_db": 3}),
        ("receivers off by up to 6 dB", {"receiver_offset_db": 6}),
        ("one receiver off by 20 dB", {"wrong_trackers": 1}),
        ("one receiver stuck", {"stuck_trackers": 1}),
        ("whole decibels", {"receiver_step_db": 1}),
        (
            "off by 3 dB, exponent 3.0, 3 dB weaker, K = 1, whole decibels",
            {
                "receiver_offset_db": 3,
                "path_loss_exponent": 3.0,
                "transmit_power_dbm": TOLD.transmit_power_dbm - 3,
                "rician_k": 1,
                "receiver_step_db": 1,
            },
        ),
        ("shadowing of 3 dB", {"shadowing_db": 3}),
        (
            "shadowing of 3 dB, off by 3 dB, exponent 2.2, 10 % missing, whole decibels",
            {
                "shadowing_db": 3,
                "receiver_offset_db": 3,
                "path_loss_exponent": 2.2,
                "missing_sample_share": 0.1,
                "receiver_step_db": 1,
            },
        ),
    ],
)
def test_a_departure_changes_what_its_name_says_and_nothing_else(name: str, expected: dict[str, object]) -> None:
    assert changes(departed(TOLD, name)) == expected


def test_every_departure_is_in_the_table_above_and_can_be_chased_in() -> None:
    parameters = test_a_departure_changes_what_its_name_says_and_nothing_else.pytestmark[0].args[1]
    assert list(DEPARTURES) == [name for name, _ in parameters]
    for name in DEPARTURES:
        assert Environment(departed(TOLD, name)).reset(chase_keys(0, 1)).rssi_dbm.shape == (1, 50, 6)


def test_a_departure_from_table_i_that_is_none() -> None:
    """rho is 0.9 and the transmit power 23 dBm in Table I."""
    assert departed(paper_scenario(), "rho = 0.9") == paper_scenario()
    assert changes(departed(paper_scenario(), "6 dB weaker"), paper_scenario()) == {"transmit_power_dbm": 17}


def test_drawn_worlds_depart_only_in_what_they_may_and_within_its_range(worlds: list[Scenario]) -> None:
    for world in worlds:
        for name, value in changes(world).items():
            if name in OTHERS:
                assert value in OTHERS[name]
            else:
                low, high = RANGES[name]
                assert low <= value <= high, name


def test_each_thing_departs_in_the_stated_share_of_the_worlds(worlds: list[Scenario]) -> None:
    """Of 2000 worlds: a standard error of one per cent each, and as many departures as that of ten things together."""
    departures = [changes(world) for world in worlds]
    for name in [*RANGES, *OTHERS]:
        share = np.mean([name in departure for departure in departures])
        assert share == pytest.approx(DEPARTURE_SHARE, abs=0.04), name
    number = np.array([len(departure) for departure in departures])
    assert number.mean() == pytest.approx(10 * DEPARTURE_SHARE, abs=0.13)
    # One departs whatever the others do: binomial, n p (1 - p).
    assert number.var() == pytest.approx(10 * DEPARTURE_SHARE * (1 - DEPARTURE_SHARE), rel=0.15)


@pytest.mark.parametrize(
    ("name", "median"),
    [
        ("transmit_power_dbm", 17),
        ("path_loss_exponent", 2.6),
        ("rician_k", 2.5),  # 10 / 4: the square of one half
        ("doppler_spread_hz", 0.5 * 10**0.5),
        ("spatial_correlation", 0.475),
        ("start_distance_m", 105),
        ("missing_sample_share", 0.15),
        ("receiver_offset_db", 1.5),
    ],
)
def test_the_whole_of_a_range_is_drawn_from(worlds: list[Scenario], name: str, median: float) -> None:
    """About 500 departures of each: their median to about 3 % of the range, and both ends nearly reached."""
    low, high = RANGES[name]
    values = np.array([departure[name] for departure in map(changes, worlds) if name in departure], dtype=float)
    assert np.median(values) == pytest.approx(median, abs=0.09 * (high - low))
    assert values.min() < low + 0.03 * (high - low)
    assert values.max() > high - 0.03 * (high - low)


def test_both_numbers_of_silent_trackers_are_as_frequent(worlds: list[Scenario]) -> None:
    numbers = [world.silent_trackers for world in worlds if world.silent_trackers > 0]
    assert np.mean(np.array(numbers) == 1) == pytest.approx(0.5, abs=0.09)


def test_a_world_is_that_of_its_seed_and_number(worlds: list[Scenario]) -> None:
    assert [drawn_world(TOLD, 3, number) for number in range(50)] == worlds[:50]
    assert drawn_world(TOLD, 3, 1999) == worlds[1999]
    assert [drawn_world(TOLD, 4, number) for number in range(50)] != worlds[:50]
    assert len(set(worlds)) > 0.8 * NUM_WORLDS  # .75^10 = 5.6 % depart in nothing


def test_a_world_s_departures_are_the_same_whatever_is_told(worlds: list[Scenario]) -> None:
    """Power is relative to what is told; the rest is not."""
    told = paper_scenario(transmit_power_dbm=23.0)
    for number in range(100):
        world = drawn_world(told, 3, number)
        for name, value in changes(worlds[number]).items():
            expected = value + 6 if name == "transmit_power_dbm" else value
            assert getattr(world, name) == pytest.approx(expected)
