"""The batched trainer: the same as A3C with one worker, exact to resume, fair to several scenarios, and it learns."""

import dataclasses
import json
import signal
from pathlib import Path
from typing import Any

import pytest
import torch
from safetensors.torch import load_file

from swarmchase.batch.streams import chase_keys
from swarmchase.cli import main
from swarmchase.commands.train import TrainBatchedCommand
from swarmchase.errors import InputError
from swarmchase.formation import action_from_choice
from swarmchase.networks.actor_critic import SwarmNetworks, SymmetricNetworks, with_policy_scale
from swarmchase.networks.forms import continued_networks, deployed, new_networks
from swarmchase.networks.weights import load_weights, save_weights
from swarmchase.scenario import Scenario, load_scenario, paper_scenario
from swarmchase.training.a3c import train_a3c
from swarmchase.training.agent import NEAREST_START, LocalAgent
from swarmchase.training.batched import train_batched
from swarmchase.training.evaluator import measured
from swarmchase.training.global_agent import SharedParameters
from swarmchase.training.losses import LossSettings
from swarmchase.training.parameters import FlatNetworks
from swarmchase.training.rollout import Rollout
from swarmchase.training.run import TrainingStatus
from swarmchase.training.run_folder import read_log
from swarmchase.training.settings import PRESETS, TrainingSettings, training_seed
from swarmchase.training.symmetry import mirrored
from swarmchase.world.environment import (
    Environment,
    State,
    counterfactual_reward_m,
    distance_reduction_m,
    unfaded_dbm,
)
from swarmchase.world.radio import rssi_dbm

WORLD = paper_scenario(window_samples=3, start_distance_m=8.0, max_movements=12)
OTHER = dataclasses.replace(WORLD, sampling_hz=100.0, spatial_correlation=0.1)
EASY = paper_scenario(start_distance_m=8.0, max_movements=20, rician_k=1e6, window_samples=4)
SMALL = {
    "max_updates": 8,
    "seed": 5,
    "evaluation_interval": 4,
    "evaluation_chases": 2,
    "checkpoint_interval": 3,
    "num_agents": 1,
    "chases_per_agent": 4,
}


def preset(name: str, **changes: Any) -> TrainingSettings:
    return dataclasses.replace(PRESETS[name], **{**SMALL, **changes})


def train(
    folder: Path,
    settings: TrainingSettings,
    scenarios: list[Scenario] | None = None,
    resume: bool = False,
    interrupt_at: int | None = None,
) -> dict[str, Any]:
    """Everything that a run leaves and that does not depend on the clock."""

    left_to_interrupt = 0 if interrupt_at is None else 1

    def progress(status: TrainingStatus) -> None:
        nonlocal left_to_interrupt
        if left_to_interrupt and status.updates >= (interrupt_at or 0):
            left_to_interrupt = 0  # a second one would end it at once
            signal.raise_signal(signal.SIGINT)

    train_batched(scenarios or [WORLD], settings, folder, resume, progress)
    log = [json.loads(line) for line in (folder / "training.jsonl").read_text().splitlines()]
    return {
        **{name: tensor.numpy().tobytes() for name, tensor in load_file(folder / "resume.safetensors").items()},
        "log": [{name: value for name, value in line.items() if name != "seconds"} for line in log],
    }


@pytest.mark.parametrize("name", ["paper", "a2c"])
def test_it_is_a3c_with_one_worker_and_the_same_chases_parameter_by_parameter(tmp_path: Path, name: str) -> None:
    settings = preset(name, precision="float32", learning_rate=1e-3)
    batched = train(tmp_path / "batched", settings)
    train_a3c(WORLD, settings, tmp_path / "a3c", "deterministic")
    a3c = load_file(tmp_path / "a3c" / "resume.safetensors")
    assert {name: tensor.numpy().tobytes() for name, tensor in a3c.items()} == {
        name: value for name, value in batched.items() if name != "log"
    }


@pytest.mark.parametrize("name", ["a2c", "ppo", "all-actions", "counterfactual"])
def test_a_run_interrupted_and_resumed_is_the_undisturbed_one_bit_for_bit(tmp_path: Path, name: str) -> None:
    """Between two checkpoints, and after an evaluation."""
    settings, scenarios = preset(name), [WORLD, OTHER]
    whole = train(tmp_path / "whole", settings, scenarios)
    train(tmp_path / "parts", settings, scenarios, interrupt_at=5)
    assert train(tmp_path / "parts", settings, scenarios, resume=True) == whole
    weights = [(tmp_path / folder / "best.safetensors").read_bytes() for folder in ("whole", "parts")]
    assert weights[0] == weights[1]


def test_scenarios_take_turns_and_are_evaluated_one_by_one(tmp_path: Path) -> None:
    settings = preset("counterfactual", max_updates=6, evaluation_interval=6)
    train(tmp_path, settings, [WORLD, OTHER, WORLD])
    # Each of three agents has made two rollouts of two movements with four chases.
    left = load_file(tmp_path / "resume.safetensors")
    moved = [left[f"agent{agent}.state.movements"] for agent in range(3)]
    assert all((movements <= 4).all() and (movements > 0).any() for movements in moved)
    [evaluation] = read_log(tmp_path, "evaluation")
    assert len(evaluation["p90_by_scenario"]) == 3
    assert evaluation["movements_p90"] == pytest.approx(sum(evaluation["p90_by_scenario"]) / 3)
    assert evaluation["p90_by_scenario"][0] == evaluation["p90_by_scenario"][2]
    _, configuration = load_weights(tmp_path / "best.safetensors")
    assert configuration["scenarios"] == [scenario.to_dict() for scenario in (WORLD, OTHER, WORLD)]
    assert (configuration["schedule"], configuration["action_choice"]) == ("batched", "greedy")


def test_ppo_makes_several_updates_of_a_rollout(tmp_path: Path) -> None:
    train(tmp_path, preset("ppo", passes_per_rollout=3, max_updates=6, evaluation_interval=3))
    # 6 updates are two rollouts of five movements.
    assert load_file(tmp_path / "resume.safetensors")["agent0.state.movements"].max() <= 10
    evaluations = read_log(tmp_path, "evaluation")
    assert [line["update"] for line in evaluations] == [3, 6]
    assert [line["environment_steps"] <= rollouts * 5 * 4 for rollouts, line in enumerate(evaluations, 1)] == [True] * 2


def test_it_begins_from_a_weights_file_and_decides_as_that_does(tmp_path: Path) -> None:
    path = tmp_path / "start.safetensors"
    networks = SwarmNetworks(torch.Generator().manual_seed(1))
    for name in ("y", "z"):
        networks.by_name[name].load_state_dict(networks.by_name["x"].state_dict())
    save_weights(path, networks, {})
    window_dbm = -60 + torch.randn(5, 3, 6, generator=torch.Generator().manual_seed(2))
    for name in ("counterfactual", "a2c"):
        settings = preset(name, initial_weights=str(path), precision="float32")
        begun = continued_networks(settings, load_weights(path)[0])
        torch.testing.assert_close(begun.policy_logits(window_dbm), networks.policy_logits(window_dbm))
        train(tmp_path / name, settings)
    with pytest.raises(InputError, match="nowhere"):
        train(tmp_path / "none", preset("a2c", initial_weights=str(tmp_path / "nowhere.safetensors")))
    assert not (tmp_path / "none").exists()


def test_one_network_cannot_go_on_for_three_that_differ(tmp_path: Path) -> None:
    path = tmp_path / "start.safetensors"
    save_weights(path, SwarmNetworks(torch.Generator().manual_seed(1)), {})
    with pytest.raises(InputError, match="symmetric off"):
        train(tmp_path / "run", preset("counterfactual", initial_weights=str(path)))
    train(tmp_path / "run", preset("counterfactual", initial_weights=str(path), symmetric=False))


def test_the_last_networks_are_evaluated_whatever_the_interval(tmp_path: Path) -> None:
    train(tmp_path / "batched", preset("a2c", max_updates=5, evaluation_interval=3))
    assert [line["update"] for line in read_log(tmp_path / "batched", "evaluation")] == [3, 5]


def symmetric(policy_scale: float = 1.0) -> tuple[SymmetricNetworks, SwarmNetworks]:
    """One network for three axes, and the four networks it stands for."""
    trained = SymmetricNetworks(SwarmNetworks(torch.Generator().manual_seed(3), policy_scale))
    return trained, trained.separate()


@pytest.mark.parametrize("policy_scale", [1.0, 20.0])
def test_one_network_for_three_axes_decides_as_the_four_it_stands_for(policy_scale: float) -> None:
    trained, four = symmetric(policy_scale)
    window_dbm = -60 + 5 * torch.randn(7, 50, 6, generator=torch.Generator().manual_seed(4))
    for mine, theirs in zip(trained(window_dbm), four(window_dbm), strict=True):
        torch.testing.assert_close(mine, theirs, rtol=1e-4, atol=1e-4)
    logits = four.policy_logits(window_dbm)
    torch.testing.assert_close(trained.policy_logits(window_dbm), logits, rtol=1e-4, atol=1e-4)
    torch.testing.assert_close(deployed(trained).policy_logits(window_dbm), logits, rtol=1e-4, atol=1e-4)
    assert deployed(trained).policy_scale == 1
    assert logits.std() > 0.01 * policy_scale


def test_the_three_views_of_one_network_are_permutations_of_the_window() -> None:
    """What x decides of a window, y decides of the same window with the axes in turn."""
    trained, _ = symmetric()
    window_dbm = -60 + 5 * torch.randn(4, 50, 6, generator=torch.Generator().manual_seed(5))
    logits = trained.policy_logits(window_dbm)
    turned = trained.policy_logits(window_dbm[:, :, [2, 3, 4, 5, 0, 1]])  # y, z, x stand in the places of x, y, z
    torch.testing.assert_close(turned[:, 1:], logits[:, [2, 3, 1]], rtol=1e-4, atol=1e-4)


def test_a_policy_scale_is_moved_and_not_lost() -> None:
    networks = SwarmNetworks(torch.Generator().manual_seed(6), policy_scale=20.0)
    window_dbm = torch.full((1, 50, 6), -60.0)
    moved = with_policy_scale(networks, 1.0)
    torch.testing.assert_close(
        moved.policy_logits(window_dbm), networks.policy_logits(window_dbm), rtol=1e-4, atol=1e-4
    )
    assert not torch.equal(moved.by_name["x"].policy_head.weight, networks.by_name["x"].policy_head.weight)


def test_the_counterfactual_rewards_are_those_of_the_choices_when_they_are_made() -> None:
    environment = Environment(WORLD)
    state = environment.reset(chase_keys(3, 9))
    known_m = counterfactual_reward_m(WORLD, state)
    assert known_m.shape == (9, 3, 5)
    for choice in range(5):
        following, outcome = environment.step(state, action_from_choice(WORLD, torch.full((9, 4), choice)))
        torch.testing.assert_close(outcome.reward_m[:, 1:], known_m[:, :, choice])
        assert torch.equal(outcome.reward_m, distance_reduction_m(state, following))


def test_a_mirrored_rollout_is_that_of_the_mirrored_world() -> None:
    """Mirrored targets, heard without fading, chased with mirrored choices: the same windows, rewards and choices."""
    scenario = dataclasses.replace(WORLD, rician_k=1e12)
    environment = Environment(scenario)
    axes = torch.tensor([[True, False, False], [False, True, True], [False, False, False], [True, True, True]])
    start = environment.reset(chase_keys(8, 4))
    sign = torch.where(axes, -1.0, 1.0).double()
    turned = environment.reset(chase_keys(8, 4))
    target = dataclasses.replace(turned.target, position_m=start.target_position_m * sign)
    turned = dataclasses.replace(turned, target=target)
    choice = torch.tensor([[4, 0, 1, 2], [3, 4, 3, 1], [2, 0, 4, 3], [4, 1, 0, 4]])
    turned_choice = choice.clone()
    turned_choice[:, 1:] = torch.where(axes, 4 - choice[:, 1:], choice[:, 1:])

    def one_step(state: State, chosen: torch.Tensor) -> Rollout:
        following, outcome = environment.step(state, action_from_choice(scenario, chosen))
        return Rollout(
            rssi_dbm=following.rssi_dbm[None].expand(2, -1, -1, -1),
            tracker_position_m=torch.zeros(2, 4, 6, 3),
            memory=torch.zeros(4, 0),
            choice=chosen[None],
            logits=torch.arange(20.0).view(1, 1, 4, 5).expand(1, 4, 4, 5),
            reward_m=outcome.reward_m.float()[None],
            counterfactual_reward_m=counterfactual_reward_m(scenario, state).float()[None],
            unfaded_dbm=unfaded_dbm(scenario, following).float()[None],
            valid=torch.ones(1, 4, dtype=torch.bool),
            reached=outcome.reached,
            truncated=outcome.truncated,
        )

    seen, world = mirrored(one_step(start, choice), axes), one_step(turned, turned_choice)
    torch.testing.assert_close(seen.rssi_dbm, world.rssi_dbm, atol=1e-3, rtol=0)
    assert torch.equal(seen.choice, world.choice)
    torch.testing.assert_close(seen.reward_m, world.reward_m)
    torch.testing.assert_close(seen.unfaded_dbm, world.unfaded_dbm)
    torch.testing.assert_close(seen.counterfactual_reward_m, world.counterfactual_reward_m)
    assert seen.logits[0, 0, 1].tolist() == [9, 8, 7, 6, 5]
    assert seen.logits[0, 0, 0].tolist() == [0, 1, 2, 3, 4]
    assert seen.logits[0, 0, 2].tolist() == [10, 11, 12, 13, 14]


def test_a_mirror_needs_displacements_that_are_symmetric() -> None:
    lopsided = dataclasses.replace(WORLD, displacement_choices_m=(-4.0, -2.0, 0.0, 2.0, 5.0))
    with pytest.raises(InputError, match="not symmetric about 0"):
        LocalAgent(lopsided, preset("counterfactual"), 0)


def test_a_varied_start_is_at_the_full_distance_in_half_of_the_chases() -> None:
    settings = preset("counterfactual", chases_per_agent=2_000)
    agent = LocalAgent(dataclasses.replace(WORLD, start_distance_m=100.0), settings, 0)
    distance_m = agent.progress.state.target_position_m.norm(dim=1)
    far = (distance_m > 99.999).double().mean().item()
    assert abs(far - 0.5) < 5 * (0.25 / 2000) ** 0.5
    near = distance_m[distance_m < 99.999]
    assert near.min() >= 100 * NEAREST_START - 1e-6
    # Log-uniform: half of them below the geometric mean of the ends, sqrt(2.5 * 100).
    assert abs((near < 250**0.5).double().mean().item() - 0.5) < 5 * (0.25 / 1000) ** 0.5


def test_what_is_heard_at_a_varied_start_is_heard_from_there() -> None:
    scenario = dataclasses.replace(WORLD, rician_k=1e9, start_distance_m=100.0)
    environment = Environment(scenario)
    state = environment.reset(chase_keys(1, 3), nearness=torch.tensor([1.0, 0.5, 0.1]))
    offset_m = state.observation().tracker_position_m[:, 0] - state.target_position_m[:, None]
    expected = rssi_dbm(scenario, offset_m.norm(dim=2)[:, None], torch.ones(3, 6, 2, 3) * 0.5**0.5)
    torch.testing.assert_close(state.rssi_dbm, expected, atol=0.01, rtol=0)


def test_bfloat16_gives_nearly_the_gradient_of_float32() -> None:
    """A direction apart by less than a tenth: what a small batch's own noise is many times over."""
    gradients = []
    for precision in ("float32", "bfloat16"):
        settings = preset("counterfactual", precision=precision, chases_per_agent=32)
        agent = LocalAgent(paper_scenario(), settings, 0)
        agent.local.networks.load_state_dict(new_networks(settings, torch.Generator().manual_seed(0)).state_dict())
        other = LocalAgent(paper_scenario(), preset("counterfactual", precision="float32", chases_per_agent=32), 0)
        agent.compute_gradient(other.play())
        gradients.append(agent.local.gradient.clone())
    cosine = torch.nn.functional.cosine_similarity(gradients[0], gradients[1], dim=0)
    assert 0.99 < cosine < 1 - 1e-9
    assert gradients[0].dtype == gradients[1].dtype == torch.float32


def test_a_long_gradient_is_shortened_and_a_short_one_is_not() -> None:
    for limit, shortened in ((1e-3, True), (1e6, False)):
        settings = preset("a2c", max_gradient_norm=limit, precision="float32")
        agent = LocalAgent(WORLD, settings, 0)
        agent.local.networks.load_state_dict(new_networks(settings, torch.Generator().manual_seed(0)).state_dict())
        agent.compute_gradient(agent.play())
        assert (agent.local.gradient.norm().item() == pytest.approx(limit, rel=1e-4)) == shortened


def test_the_spacing_explores_as_often_as_it_is_told() -> None:
    counts = []
    for share in (0.0, 0.5, 1.0):
        agent = LocalAgent(WORLD, preset("counterfactual", spacing_exploration=share, chases_per_agent=1_000), 0)
        rollout = agent.play()
        likeliest = rollout.logits[0, :, 0].argmax(dim=-1)
        counts.append((rollout.choice[0, :, 0] != likeliest).double().mean().item())
    # Any one of five is the likeliest in a fifth of the cases.
    assert counts[0] == 0
    assert abs(counts[1] - 0.4) < 0.08
    assert abs(counts[2] - 0.8) < 0.08


@pytest.fixture(scope="module")
def untrained_movements() -> float:
    """Of the first networks, hardly a chase of which reaches the target in 20 movements."""
    settings = preset("a2c", evaluation_chases=20)
    start = FlatNetworks(new_networks(settings, torch.Generator().manual_seed(training_seed(settings.seed))))
    return measured([EASY], settings, SharedParameters.start(start.vector)).movements_mean


@pytest.mark.parametrize(
    ("name", "rollouts", "chases", "learning_rate"),
    [("a2c", 30, 24, 4e-3), ("ppo", 14, 24, 3e-3), ("all-actions", 40, 24, 3e-3), ("counterfactual", 15, 16, 3e-3)],
)
def test_every_objective_learns(
    tmp_path: Path, untrained_movements: float, name: str, rollouts: int, chases: int, learning_rate: float
) -> None:
    """The target 8 m away and no fading; 0.3 to 0.6 of the movements were seen with five seeds."""
    updates = rollouts * PRESETS[name].passes_per_rollout
    changes = {"chases_per_agent": chases, "learning_rate": learning_rate, "evaluation_chases": 20}
    settings = preset(name, max_updates=updates, evaluation_interval=updates, checkpoint_interval=updates, **changes)
    train_batched([EASY], settings, tmp_path)
    [learned] = read_log(tmp_path, "evaluation")
    assert learned["movements_mean"] < 0.7 * untrained_movements


def test_the_papers_networks_are_trained_in_flight(tmp_path: Path) -> None:
    """An update, and an evaluation that counts what was not reached in four decisions."""
    settings = preset("a2c", max_updates=1, num_agents=2, evaluation_interval=1, evaluation_chases=2)
    flight = dataclasses.replace(load_scenario("flight"), behaviour="jink", max_movements=4)
    train_batched([flight], settings, tmp_path)
    (evaluation,) = read_log(tmp_path, "evaluation")
    assert (evaluation["success_rate"], evaluation["movements_mean"]) == (0, 5)


@pytest.mark.parametrize(
    ("arguments", "refusal"),
    [
        ({"scenarios": []}, "no scenario"),
        ({"num_threads": 0}, "threads = 0"),
        ({"device": "cuda"}, "no GPU"),
        ({"device": "gpu"}, "device = 'gpu' is refused: allowed is cpu"),
        (
            {"scenarios": [paper_scenario(), load_scenario("flight")], "settings": preset("recurrent")},
            "the form fading needs windows of 50 samples; the scenario has 10",
        ),
    ],
)
def test_what_cannot_be_trained_is_refused(tmp_path: Path, arguments: dict[str, Any], refusal: str) -> None:
    if arguments.get("device") == "cuda" and torch.cuda.is_available():
        pytest.skip("there is a GPU")
    with pytest.raises(InputError, match=refusal):
        train_batched(**{"scenarios": [WORLD], "settings": preset("a2c"), "folder": tmp_path, **arguments})
    assert not any(tmp_path.iterdir())


@pytest.mark.parametrize(
    "changes",
    [
        {"passes_per_rollout": 0},
        {"max_gradient_norm": 0.0},
        {"spacing_exploration": 1.5},
        {"spacing_exploration": 0.1, "losses": LossSettings(objective="ppo")},
        {"passes_per_rollout": 2, "losses": LossSettings(objective="all_actions")},
        {"update_interval": 1, "losses": LossSettings(objective="counterfactual")},
    ],
)
def test_settings_that_cannot_be_meant_are_refused(changes: dict[str, Any]) -> None:
    with pytest.raises(InputError, match=next(iter(changes))):
        TrainingSettings(**changes)


def test_the_command_trains_every_pair_of_settings(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    world = tmp_path / "world.toml"
    WORLD.save_toml(world)
    assert TrainBatchedCommand(folder=tmp_path, scenario=str(world)).scenarios() == [WORLD]
    words = "train batched --sampling-hz 10 100 --spatial-correlation 0.9 0.1 --preset counterfactual --updates 4"
    small = "--chases-per-agent 3 --evaluation-interval 4 --evaluation-chases 2 --threads 1 --json"
    main([*words.split(), *small.split(), "--scenario", str(world), "--folder", str(tmp_path / "run")])
    result = json.loads(capsys.readouterr().out)
    assert (result["updates"], result["stopped"]) == (4, "finished")
    assert len(result["best"]["p90_by_scenario"]) == 4
    _, configuration = load_weights(tmp_path / "run" / "best.safetensors")
    pairs = [(one["sampling_hz"], one["spatial_correlation"]) for one in configuration["scenarios"]]
    assert pairs == [(10.0, 0.9), (100.0, 0.9), (10.0, 0.1), (100.0, 0.1)]
