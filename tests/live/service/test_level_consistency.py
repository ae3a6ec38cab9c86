"""Whose levels contradict the others': windows are the environment's."""

import numpy as np
import pytest

from swarmchase.batch.streams import chase_keys
from swarmchase.live.service.level_consistency import LevelConsistency
from swarmchase.scenario import paper_scenario
from swarmchase.world.environment import Environment

LIAR = 2
EVERYBODY = np.ones(6, dtype=bool)
DISTANCES_M = (2.0, 5.0, 9.0, 15.0, 40.0, 100.0)


def windows(sampling_hz: int, distance_m: float, number: int, **changes: float) -> tuple[np.ndarray, np.ndarray]:
    """[window, sample, tracker] with the centre so far from the target, and the trackers' places [tracker, 3]."""
    scenario = paper_scenario(sampling_hz=sampling_hz, start_distance_m=distance_m, **changes)
    state = Environment(scenario).reset(chase_keys(7, number))
    return state.rssi_dbm.double().numpy(), state.observation().tracker_position_m[0, -1].numpy()


@pytest.mark.parametrize("sampling_hz", [10, 100])
@pytest.mark.parametrize("spatial_correlation", [0.1, 0.9])
def test_nobody_honest_contradicts(sampling_hz: int, spatial_correlation: float) -> None:
    """Even with receivers that are 3 dB off, which nobody has told: not one of 1,800 levels at all distances."""
    judge = LevelConsistency(paper_scenario(sampling_hz=sampling_hz, spatial_correlation=spatial_correlation))
    found = 0
    for distance_m in DISTANCES_M:
        changes = {"spatial_correlation": spatial_correlation, "receiver_offset_db": 3.0}
        rssi_dbm, position_m = windows(sampling_hz, distance_m, 50, **changes)
        found += sum(int(judge.contradicts(window_dbm, position_m, EVERYBODY).sum()) for window_dbm in rssi_dbm)
    assert found == 0


@pytest.mark.parametrize("level_dbm", [-200.0, 20.0])
@pytest.mark.parametrize("others", [range(6), [0, 2, 3, 5]])
def test_a_level_that_the_channel_cannot_give_is_found_at_every_distance(level_dbm: float, others: list[int]) -> None:
    """With five that are honest, or three; and of them nobody is taken for a liar."""
    judge = LevelConsistency(paper_scenario(sampling_hz=10))
    for distance_m in DISTANCES_M:
        rssi_dbm, position_m = windows(10, distance_m, 20)
        rssi_dbm[:, :, LIAR] = level_dbm
        rssi_dbm[:, :, [one for one in range(6) if one not in others]] = np.nan
        for window_dbm in rssi_dbm:
            assert np.flatnonzero(judge.contradicts(window_dbm, position_m, EVERYBODY)).tolist() == [LIAR]


@pytest.mark.parametrize("level_dbm", [-200.0, 20.0])
def test_two_of_five_make_nobody_else_look_wrong(level_dbm: float) -> None:
    """Also when one of them is known already, and its word counts no more."""
    judge = LevelConsistency(paper_scenario(sampling_hz=10))
    rssi_dbm, position_m = windows(10, 60.0, 20)
    rssi_dbm[:, :, [LIAR, 5]], rssi_dbm[:, :, 0] = level_dbm, np.nan
    for window_dbm in rssi_dbm:
        for counts in (EVERYBODY, np.arange(6) != LIAR):
            assert np.flatnonzero(judge.contradicts(window_dbm, position_m, counts)).tolist() == [LIAR, 5]


def test_20_db_too_many_are_found_while_the_target_is_far() -> None:
    judge = LevelConsistency(paper_scenario(sampling_hz=10))
    rssi_dbm, position_m = windows(10, 100.0, 50)
    rssi_dbm[:, :, LIAR] += 20.0
    for window_dbm in rssi_dbm:
        assert np.flatnonzero(judge.contradicts(window_dbm, position_m, EVERYBODY)).tolist() == [LIAR]


def test_of_three_nobody_can_say_who_is_wrong() -> None:
    rssi_dbm, position_m = windows(10, 100.0, 1)
    rssi_dbm[:, :, [0, 1, 3]], rssi_dbm[:, :, LIAR] = np.nan, 20.0
    assert not LevelConsistency(paper_scenario(sampling_hz=10)).contradicts(rssi_dbm[0], position_m, EVERYBODY).any()
