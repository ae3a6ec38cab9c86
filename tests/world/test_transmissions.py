"""A target that pauses, and gaps: shares, lengths, and one chain of turns however it is looked at."""

import math

import numpy as np
import pytest
import torch

from swarmchase.batch.streams import ChaseStreams, chase_keys
from swarmchase.errors import InputError
from swarmchase.scenario import Scenario, paper_scenario
from swarmchase.world.alternation import Alternation
from swarmchase.world.transmissions import Transmissions


def transmits(scenario: Scenario, time_s: torch.Tensor, seed: int = 2) -> torch.Tensor:
    transmissions = Transmissions(scenario)
    state = transmissions.begin(ChaseStreams.of(chase_keys(seed, len(time_s)), "transmissions"))
    return transmissions.at(state, time_s)[0]


def clock_s(num_chases: int, num_samples: int, sampling_hz: float) -> torch.Tensor:
    return (torch.arange(num_samples, dtype=torch.float64) / sampling_hz).expand(num_chases, -1)


def lengths_s(is_on: np.ndarray, sampling_hz: float) -> np.ndarray:
    """Of the times on that have begun and ended, row after row."""
    found = []
    for row in is_on:
        turn = np.flatnonzero(np.diff(row.astype(int)))
        begins = turn[0 if not row[turn[0]] else 1 :] if len(turn) else turn
        found += np.diff(begins)[::2].tolist()
    return np.array(found) / sampling_hz


def test_a_target_without_pauses_has_nothing_to_draw() -> None:
    assert not Transmissions(paper_scenario()).pauses
    assert not Transmissions(paper_scenario(frame_s=3, between_silences_s=5)).pauses
    assert Transmissions(paper_scenario(transmit_duty=0.9)).pauses
    assert Transmissions(paper_scenario(silence_s=0.1)).pauses


@pytest.mark.parametrize(("duty", "frame_s"), [(0.4, 0.2), (0.2, 1.0), (0.95, 0.5)])
def test_frames_have_their_share_their_mean_length_and_forget(duty: float, frame_s: float) -> None:
    """400 flights of 100 s at 100 Hz; the autocovariance is p (1 - p) exp(-tau / (m (1 - p)))."""
    on = transmits(paper_scenario(transmit_duty=duty, frame_s=frame_s), clock_s(400, 10_000, 100.0)).numpy()
    cycles = 400 * 100 * duty / frame_s
    assert on.mean() == pytest.approx(duty, abs=5 * frame_s / duty / math.sqrt(cycles) / 4)
    assert on[:, 0].mean() == pytest.approx(duty, abs=4 * math.sqrt(duty * (1 - duty) / 400))
    length_s = lengths_s(on, 100.0)
    # A turn is seen at the next sample, and a pause shorter than 10 ms is not always seen.
    assert length_s.mean() == pytest.approx(frame_s + 0.01 * (0.5 + frame_s / (frame_s / duty - frame_s) / 2), rel=0.06)
    assert length_s.std() == pytest.approx(length_s.mean(), rel=0.06)
    deviation = on - duty
    for lag in (1, 10, 40):
        expected = duty * (1 - duty) * math.exp(-lag / 100 / (frame_s * (1 - duty)))
        assert (deviation[:, lag:] * deviation[:, :-lag]).mean() == pytest.approx(expected, abs=0.012)


def test_long_silences_come_as_often_and_last_as_long_as_the_scenario_says() -> None:
    """1,000 flights of 600 s: 9,000 silences of 4 s, 60 s apart."""
    silent = ~transmits(paper_scenario(silence_s=4.0, between_silences_s=60.0), clock_s(1_000, 6_000, 10.0)).numpy()
    assert silent.mean() == pytest.approx(4 / 64, abs=0.003)
    assert lengths_s(silent, 10.0).mean() == pytest.approx(4.05, abs=0.2)
    begun = (silent[:, 1:] & ~silent[:, :-1]).sum()
    assert begun == pytest.approx(1_000 * 600 / 64, rel=0.05)


def test_one_silence_begins_and_ends_when_the_scenario_says() -> None:
    time_s = clock_s(3, 400, 10.0)
    on = transmits(paper_scenario(silence_s=20.0, silence_at_s=14.0), time_s)
    assert torch.equal(on, (time_s < 14.0) | (time_s >= 34.0))
    frames = transmits(paper_scenario(transmit_duty=0.4), time_s)
    assert torch.equal(
        transmits(paper_scenario(transmit_duty=0.4, silence_s=20.0, silence_at_s=14.0), time_s), frames & on
    )


def test_a_silence_that_begins_and_lasts_no_time_is_refused() -> None:
    with pytest.raises(InputError, match=r"^silence_at_s = 14 is refused: silence_s, .* must be greater than 0$"):
        Transmissions(paper_scenario(silence_at_s=14.0))


def test_frames_and_silences_are_independent() -> None:
    both = transmits(
        paper_scenario(transmit_duty=0.5, silence_s=5.0, between_silences_s=5.0), clock_s(2_000, 400, 10.0)
    )
    assert both.double().mean().item() == pytest.approx(0.25, abs=0.015)


@pytest.mark.parametrize("sampling_hz", [10.0, 100.0])
def test_a_flight_is_the_same_in_pieces_and_in_any_batch(sampling_hz: float) -> None:
    scenario = paper_scenario(transmit_duty=0.4, silence_s=1.0, between_silences_s=3.0)
    time_s = clock_s(9, 200, sampling_hz)
    whole = transmits(scenario, time_s)
    transmissions = Transmissions(scenario)
    for rows in ([0], [8, 3], list(range(9))):
        keys = [chase_keys(2, 9)[row] for row in rows]
        state = transmissions.begin(ChaseStreams.of(keys, "transmissions"))
        pieces = []
        for first, end in ((0, 1), (1, 77), (77, 78), (78, 200)):
            piece, state = transmissions.at(state, time_s[rows, first:end])
            pieces.append(piece)
        assert torch.equal(torch.cat(pieces, dim=1), whole[rows])


def test_turns_by_hand() -> None:
    """Half of the time on, a second each: after ln 2 / 2 s the chance to have forgotten is a half."""
    alternation = Alternation(0.5, 1.0)
    state = alternation.begin(torch.tensor([[0.49, 0.51]]).double())
    assert state.is_on.tolist() == [[True, False]]
    time_s = torch.tensor([[1.0, 2, 3, 3]]).double() * math.log(2) / 2
    # On below .25, off from .75 on, else as before; at the same time nothing turns.
    uniform = torch.tensor([[[0.26, 0.74], [0.76, 0.24], [0.74, 0.26], [0.0, 0.999]]]).double()
    is_on, state = alternation.at(state, time_s, uniform)
    assert is_on.tolist() == [[[True, False], [False, True], [False, True], [False, True]]]
    assert state.is_on.tolist() == [[False, True]]
    assert state.time_s.tolist() == [time_s[0, -1].item()]


@pytest.mark.parametrize(("share", "expected"), [(0.0, False), (1.0, True)])
def test_never_and_always(share: float, expected: bool) -> None:
    alternation = Alternation(share, 1.0)
    uniform = ChaseStreams.of(chase_keys(1, 20), "world").uniform(50, 3)
    is_on, _ = alternation.at(alternation.begin(uniform[:, 0]), clock_s(20, 50, 10.0), uniform)
    assert (is_on == expected).all()
