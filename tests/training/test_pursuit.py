"""Training of ``pursuit`` in its own flights: what a lesson is, what is rewarded, that it learns, that it resumes
exactly."""

import dataclasses
import json
from pathlib import Path

import pytest
import torch

from swarmchase.cli import main
from swarmchase.errors import InputError
from swarmchase.networks.pursuit import PursuitNetwork
from swarmchase.networks.weights import load_weights
from swarmchase.training import learner, pursuit
from swarmchase.training.pursuit import (
    CHASES_A_LESSON,
    DISCOUNT,
    EARLY_EXPLORATION,
    TRACE,
    Lesson,
    PursuitSettings,
    Turn,
    advantages,
    exploration_at,
    is_reinforced,
    learning_rate_at,
    lesson_scenario,
    policy_loss,
)
from swarmchase.training.pursuit_run import train_pursuit

SMALL = PursuitSettings(lessons=("flight:hover:0:20", "rough:flee:5:20"), flights=8, intervals=4, max_updates=6)


def test_a_lesson_is_a_scenario_a_behaviour_a_speed_and_a_frequency() -> None:
    scenario = lesson_scenario("rough:flee:8:100")
    assert (scenario.behaviour, scenario.target_speed_mps, scenario.sampling_hz) == ("flee", 8.0, 100.0)
    assert scenario.receiver_floor_dbm == -95.0


@pytest.mark.parametrize(
    ("lesson", "refusal"),
    [
        ("flight:flee:8", "needed is scenario:behaviour:target_speed_mps:sampling_hz"),
        ("flight:flee:fast:20", "needed is scenario:behaviour:target_speed_mps:sampling_hz"),
        ("nowhere:flee:8:20", "no scenario 'nowhere'"),
        ("flight:hide:8:20", "hide"),
        ("flight:flee:-8:20", "target_speed_mps"),
        ("paper:hover:0:20", "in paper trackers stop to listen"),
    ],
)
def test_what_is_no_lesson_is_refused(lesson: str, refusal: str) -> None:
    with pytest.raises(InputError, match=refusal):
        PursuitSettings(lessons=(lesson,))


@pytest.mark.parametrize(("flights", "lessons"), [(1, SMALL.lessons), (5, SMALL.lessons)])
def test_every_lesson_needs_as_many_flights(flights: int, lessons: tuple[str, ...]) -> None:
    with pytest.raises(InputError, match=f"{flights} flights for 2 lessons are refused"):
        PursuitSettings(lessons=lessons, flights=flights)


def test_without_a_lesson_there_is_nothing_to_learn() -> None:
    with pytest.raises(InputError, match="no lessons"):
        PursuitSettings(lessons=())


def test_a_seed_beyond_what_can_be_drawn_with_is_refused() -> None:
    with pytest.raises(InputError, match="seed"):
        PursuitSettings(seed=2**62)


def test_what_happens_when_in_a_training() -> None:
    settings = PursuitSettings(supervised_share=0.5, exploration=0.2, learning_rate=1e-3, max_updates=100)
    assert [is_reinforced(settings, update) for update in (0, 49, 50, 99)] == [False, False, True, True]
    assert exploration_at(settings, 0) == EARLY_EXPLORATION
    assert exploration_at(settings, 49) == pytest.approx(0.254)
    assert exploration_at(settings, 50) == 0.2
    rates = [learning_rate_at(settings, update) for update in (0, 50, 100)]
    assert rates == pytest.approx([1e-3, 5.05e-4, 1e-5])


def test_advantages_by_hand() -> None:
    """Two intervals; the first chase goes on after them, the second reaches its target in the first."""
    turn = Turn(
        estimate_loss=[],
        log_probability=[],
        value=[torch.tensor([1.0, 2.0]), torch.tensor([3.0, 4.0])],
        reward=[torch.tensor([0.5, 6.0]), torch.tensor([-0.5, 0.0])],
        is_reached=[torch.tensor([False, True]), torch.tensor([False, True])],
        counts=[torch.tensor([True, True]), torch.tensor([True, False])],
    )
    last = torch.tensor([5.0, 1.0])
    second = [-0.5 + DISCOUNT * 5 - 3, 0.0 - 4]
    first = [0.5 + DISCOUNT * 3 - 1 + DISCOUNT * TRACE * second[0], 6.0 - 2.0]
    assert torch.allclose(advantages(turn, last), torch.tensor([first, second]))


def test_what_won_becomes_more_probable() -> None:
    log_probability = torch.zeros(2, requires_grad=True)
    policy_loss(torch.tensor([2.0, -1.0]), log_probability).backward()  # type: ignore[no-untyped-call]
    assert log_probability.grad is not None
    better, worse = (-log_probability.grad).tolist()
    assert better > 0 > worse


def test_flights_that_are_over_are_replaced() -> None:
    network = PursuitNetwork(torch.Generator().manual_seed(0))
    lesson = Lesson(lesson_scenario("flight:flee:8:20"), 40, network, 1, 2, "cpu")
    generator = torch.Generator().manual_seed(0)
    for _ in range(4):
        lesson.turn_loss(10, 0.2, True, False, generator)
    tensors, document = lesson.pack("it")
    # The first flights are taken to be of all ages up to 400 intervals: in 40 intervals about a tenth of them end.
    begun = int((tensors["it.age"] < 40).sum())
    assert 1 <= begun <= 15
    assert document["next_chase"] == 2 * CHASES_A_LESSON + 40 + begun


def test_who_has_the_target_is_rewarded_no_more(monkeypatch: pytest.MonkeyPatch) -> None:
    """Beside it, all have it after the first interval: nothing of the others counts."""
    counted: list[int] = []
    monkeypatch.setattr(
        pursuit, "policy_loss", lambda advantage, probability: counted.append(len(advantage)) or 0 * probability.sum()
    )
    scenario = dataclasses.replace(
        lesson_scenario("flight:hover:0:20"), start_distance_m=0.1, farthest_start_m=0.2, success_radius_m=50.0
    )
    lesson = Lesson(scenario, 6, PursuitNetwork(torch.Generator().manual_seed(0)), 1, 0, "cpu")
    lesson.turn_loss(5, 0.2, True, False, torch.Generator().manual_seed(0))
    assert counted == [6]


def _estimate_loss(network: PursuitNetwork) -> float:
    """Of flights that no training sees."""
    lesson = Lesson(lesson_scenario("flight:hover:0:100"), 64, network, 99, 0, "cpu")
    with torch.inference_mode():
        return float(lesson.turn_loss(6, 0.2, False, False, torch.Generator().manual_seed(0)))


def test_it_learns_where_a_target_is(tmp_path: Path) -> None:
    """Untrained networks place targets anywhere; a few updates teach about how far they are."""
    settings = PursuitSettings(
        lessons=("flight:hover:0:100",), flights=24, intervals=4, max_updates=40, supervised_share=1.0
    )
    result = train_pursuit(dataclasses.replace(settings, learning_rate=3e-3), tmp_path)
    trained, _ = load_weights(result.weights)
    assert isinstance(trained, PursuitNetwork)
    assert _estimate_loss(trained) < _estimate_loss(PursuitNetwork(torch.Generator().manual_seed(0))) - 1


def test_it_goes_on_exactly_where_it_was(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pursuit, "LONGEST_INTERVALS", 7)  # flights end on either side of the break
    whole = train_pursuit(SMALL, tmp_path / "whole")
    monkeypatch.setattr(learner, "CHECKPOINT_INTERVAL", 3)
    monkeypatch.setattr(learner, "TOLD_INTERVAL", 2)

    class _BrokenError(Exception):
        pass

    def progress(update: int, _loss: float) -> None:
        if update == 4:
            raise _BrokenError

    with pytest.raises(_BrokenError):
        train_pursuit(SMALL, tmp_path / "parts", progress=progress)
    resumed = train_pursuit(SMALL, tmp_path / "parts", resume=True)
    assert (resumed.updates, resumed.stopped) == (6, "finished")
    one, other = (load_weights(result.weights)[0].state_dict() for result in (whole, resumed))
    for name, tensor in one.items():
        assert torch.equal(tensor, other[name]), name


def test_it_begins_with_a_file_and_says_which(tmp_path: Path) -> None:
    first = train_pursuit(SMALL, tmp_path / "first")
    second = train_pursuit(SMALL, tmp_path / "second", start=first.weights)
    _, configuration = load_weights(second.weights)
    assert len(configuration["settings"]["start_sha256"]) == 64
    with pytest.raises(InputError, match="other options: start_sha256"):
        train_pursuit(SMALL, tmp_path / "second", resume=True)


def test_it_does_not_begin_with_other_networks(tmp_path: Path) -> None:
    main(["train", "windows", "--folder", str(tmp_path / "windows"), "--updates", "1", "--worlds", "2"])
    with pytest.raises(InputError, match="holds networks of the form windows; needed is pursuit"):
        train_pursuit(SMALL, tmp_path / "run", start=tmp_path / "windows" / "best.safetensors")


def test_the_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    options = ["--updates", "2", "--flights", "4", "--lessons", "flight:flee:8:20", "field:waypoints:5:20"]
    main(["train", "pursuit", "--folder", str(tmp_path), *options, "--json"])
    told = json.loads(capsys.readouterr().out)
    assert (told["updates"], told["stopped"]) == (2, "finished")
    _, configuration = load_weights(Path(told["weights"]))
    assert configuration["settings"]["lessons"] == ["flight:flee:8:20", "field:waypoints:5:20"]
