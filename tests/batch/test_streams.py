"""Random streams: named by a key, the same anywhere, resumable, and distributed as they claim."""

import json
import math

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import norm

from swarmchase.batch.streams import ChaseStreams, chase_keys
from swarmchase.errors import InputError


@pytest.mark.parametrize(
    ("seed", "num_chases", "first_chase", "keys"),
    [
        (7, 3, 0, [(7, 0), (7, 1), (7, 2)]),
        (7, 2, 5, [(7, 5), (7, 6)]),
        (0, 0, 5, []),
    ],
)
def test_keys_are_the_seed_and_a_running_number(
    seed: int, num_chases: int, first_chase: int, keys: list[tuple[int, int]]
) -> None:
    assert chase_keys(seed, num_chases, first_chase) == keys


def test_a_negative_seed_is_refused() -> None:
    with pytest.raises(InputError, match=r"seed = -1 is refused: allowed is at least 0"):
        chase_keys(-1, 1)


def first_normals(seed: int, chase: int, purpose: str = "fading") -> list[float]:
    return ChaseStreams.of([(seed, chase)], purpose).standard_normal(4)[0].tolist()  # type: ignore[arg-type]


def test_a_stream_is_its_seed_chase_and_purpose() -> None:
    """The same three give the same numbers; change any one and all numbers change."""
    assert first_normals(1, 2) == first_normals(1, 2)
    different = [
        first_normals(1, 2),
        first_normals(2, 2),
        first_normals(2, 1),
        first_normals(1, 3),
        first_normals(1, 2, "target"),
        first_normals(1, 2, "policy"),
    ]
    numbers = [number for four in different for number in four]
    assert len(set(numbers)) == 24


def test_neighbouring_streams_are_uncorrelated() -> None:
    """Chases 0..199 of one seed, 2000 normals each: 19 900 correlations of standard deviation 1 / sqrt(2000)."""
    values = ChaseStreams.of(chase_keys(0, 200), "fading").standard_normal(2000).numpy()
    correlation = np.corrcoef(values)[np.triu_indices(200, 1)]
    assert np.sqrt((correlation**2).mean()) == pytest.approx(1 / math.sqrt(2000), rel=0.05)
    assert np.abs(correlation).max() < 5 / math.sqrt(2000)


def test_normals_are_normal() -> None:
    values = np.sort(ChaseStreams.of(chase_keys(1, 200), "fading").standard_normal(6, 333).double().numpy().ravel())
    empirical = (np.arange(len(values)) + 0.5) / len(values)
    assert np.abs(empirical - norm.cdf(values)).max() <= 0.003  # 400 k samples
    assert values.mean() == pytest.approx(0, abs=0.005)
    assert values.var() == pytest.approx(1, abs=0.01)
    assert (values**4).mean() == pytest.approx(3, abs=0.05)
    assert (np.abs(values) > 3).mean() == pytest.approx(2 * norm.sf(3), rel=0.1)  # .0027


def test_the_normals_of_one_draw_are_uncorrelated() -> None:
    """Also those that share a radius or an angle: no pair of 20 places in a draw correlates, nor do their squares."""
    streams = ChaseStreams.of(chase_keys(2, 400), "fading")
    values = torch.cat([streams.standard_normal(20) for _ in range(100)]).numpy()
    for samples in (values, values**2):
        correlation = np.corrcoef(samples.T)[np.triu_indices(20, 1)]
        assert np.abs(correlation).max() < 0.02  # 4 / sqrt(40 000)


def test_normals_are_box_muller_of_the_bits() -> None:
    """Number by number in scalar arithmetic: 3 words are 6 halves, the first 3 radii and the last 3 angles."""
    words = np.random.SFC64(np.random.SeedSequence(5, spawn_key=(1, 8))).random_raw(3)
    halves = [half for word in words.tolist() for half in (word & 0xFFFFFFFF, word >> 32)]
    radius = [math.sqrt(-2 * math.log((half + 0.5) / 2**32)) for half in halves[:3]]
    angle_rad = [2 * math.pi * half / 2**32 for half in halves[3:]]
    expected = [r * math.cos(a) for r, a in zip(radius, angle_rad, strict=True)]
    expected += [r * math.sin(a) for r, a in zip(radius, angle_rad, strict=True)]
    assert ChaseStreams.of([(5, 8)], "fading").standard_normal(5)[0].tolist() == pytest.approx(expected[:5], abs=2e-6)


@pytest.mark.parametrize("seed", [0, 1, 2**32 - 1, 2**32, 2**62 + 7, 2**128 - 1, 2**128])
@pytest.mark.parametrize("number", [1, 40])
def test_a_stream_begins_as_numpys_seed_sequence_says(seed: int, number: int) -> None:
    """Many of one run are begun together, few and those of other numbers one by one."""
    for first in (0, 2**32 - number, 2**32 - 1):
        keys = chase_keys(seed, number, first)
        streams = ChaseStreams.of(keys, "policy")
        for (_, chase), position in zip(keys, streams.positions(), strict=True):
            theirs = np.random.SFC64(np.random.SeedSequence(seed, spawn_key=(2, chase))).state["state"]["state"]
            assert position["state"]["state"] == theirs.tolist()


def test_streams_of_several_runs_are_begun_beside_one_another() -> None:
    keys = [(seed, chase) for seed in (3, 4) for chase in range(20)]
    apart = [ChaseStreams.of([key], "world").positions()[0] for key in keys]
    assert ChaseStreams.of(keys, "world").positions() == apart
    assert ChaseStreams.of([], "world").positions() == []


def test_uniforms_are_uniform() -> None:
    values = np.sort(ChaseStreams.of(chase_keys(1, 200), "policy").uniform(1000).numpy().ravel())
    assert values[0] >= 0
    assert values[-1] < 1
    assert np.abs((np.arange(len(values)) + 0.5) / len(values) - values).max() <= 0.003


def drawn(streams: ChaseStreams, draws: list[tuple[str, int]]) -> list[torch.Tensor]:
    return [getattr(streams, kind)(size) for kind, size in draws]


DRAWS = st.lists(st.tuples(st.sampled_from(["standard_normal", "uniform"]), st.integers(1, 9)), max_size=5)


@settings(max_examples=50, deadline=None)
@given(before=DRAWS, after=DRAWS)
def test_a_stream_resumes_exactly_from_its_position(
    before: list[tuple[str, int]], after: list[tuple[str, int]]
) -> None:
    """Through JSON, whatever was drawn before."""
    streams = ChaseStreams.of(chase_keys(3, 3), "fading")
    drawn(streams, before)
    resumed = ChaseStreams.at(json.loads(json.dumps(streams.positions())), len(streams))
    for one, other in zip(drawn(streams, after), drawn(resumed, after), strict=True):
        assert torch.equal(one, other)


@settings(max_examples=50, deadline=None)
@given(draws=DRAWS, rows=st.lists(st.integers(0, 5), min_size=1, unique=True))
def test_a_stream_does_not_care_about_its_company(draws: list[tuple[str, int]], rows: list[int]) -> None:
    keys = chase_keys(3, 6)
    together = drawn(ChaseStreams.of(keys, "fading"), draws)
    apart = drawn(ChaseStreams.of([keys[row] for row in rows], "fading"), draws)
    for one, other in zip(together, apart, strict=True):
        assert torch.equal(one[rows], other)


def test_large_batches_are_drawn_in_blocks_without_a_seam() -> None:
    together = ChaseStreams.of(chase_keys(3, 300), "fading").standard_normal(3, 5)
    for chase in (0, 127, 128, 255, 256, 299):
        assert torch.equal(ChaseStreams.of([(3, chase)], "fading").standard_normal(3, 5)[0], together[chase])


def test_selected_and_joined_streams_go_on_where_they_are() -> None:
    """Chases a b c draw once; then (c, a) and a fresh d draw: c and a give their second numbers, d its first."""
    a, b, c, d = chase_keys(3, 4)
    streams = ChaseStreams.of([a, b, c], "fading")
    streams.standard_normal(4)
    mixed = streams.select([2, 0]).followed_by(ChaseStreams.of([d], "fading"))
    assert len(mixed) == 3
    second = mixed.standard_normal(4)
    for row, (key, earlier) in enumerate([(c, 1), (a, 1), (d, 0)]):
        alone = ChaseStreams.of([key], "fading")
        for _ in range(earlier):
            alone.standard_normal(4)
        assert torch.equal(second[row], alone.standard_normal(4)[0])
    untouched = ChaseStreams.of([b], "fading")
    untouched.standard_normal(4)
    assert torch.equal(streams.select([1]).standard_normal(4), untouched.standard_normal(4))


def test_global_generators_are_neither_read_nor_set() -> None:
    torch_state, numpy_state = torch.get_rng_state(), np.random.get_state()  # noqa: NPY002
    before = first_normals(1, 2)
    assert torch.equal(torch.get_rng_state(), torch_state)
    assert np.array_equal(np.random.get_state()[1], numpy_state[1])  # noqa: NPY002
    with torch.random.fork_rng():
        torch.manual_seed(99)
        assert first_normals(1, 2) == before
