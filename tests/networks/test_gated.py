"""The network with memory: a rollout is its movements one by one, gaps change what they should, and it learns."""

import dataclasses
import json
import signal

import pytest
import torch
from safetensors.torch import load_file

from swarmchase.batch.streams import ChaseStreams, chase_keys
from swarmchase.cli import main
from swarmchase.controllers import load_controller
from swarmchase.controllers.condition import Condition
from swarmchase.controllers.learned import LearnedController
from swarmchase.errors import InputError
from swarmchase.formation import tracker_position_m
from swarmchase.networks.actor_critic import PAPER_WINDOW_SAMPLES, SwarmNetworks
from swarmchase.networks.forms import continued_networks, deployed
from swarmchase.networks.gated import GatedNetwork
from swarmchase.networks.weights import load_weights, save_weights
from swarmchase.observation import Observation
from swarmchase.scenario import paper_scenario
from swarmchase.training.agent import LocalAgent
from swarmchase.training.batched import train_batched
from swarmchase.training.losses import LossSettings
from swarmchase.training.rollout import collect
from swarmchase.training.run_folder import read_log
from swarmchase.training.settings import PRESETS, training_seed
from swarmchase.world.departures import drawn_world
from swarmchase.world.environment import Environment

WORLD = paper_scenario(start_distance_m=8.0, max_movements=12)
SMALL = {
    "max_updates": 8,
    "seed": 5,
    "evaluation_interval": 4,
    "evaluation_chases": 4,
    "checkpoint_interval": 2,
    "num_agents": 2,
    "chases_per_agent": 4,
    "update_interval": 3,
}


@pytest.fixture(scope="module")
def network():
    return GatedNetwork(torch.Generator().manual_seed(3))


def heard(num_steps, num_chases, seed=1):
    """Windows of chases that nobody steers, and where they were heard."""
    generator = torch.Generator().manual_seed(seed)
    rssi_dbm = -60 + 4 * torch.randn(num_steps, num_chases, PAPER_WINDOW_SAMPLES, 6, generator=generator)
    centers_m = 4 * torch.randn(num_steps, num_chases, 3, generator=generator).cumsum(dim=0)
    spacing_m = torch.full((num_steps * num_chases,), 5.0)
    positions_m = tracker_position_m(centers_m.flatten(0, 1).double(), spacing_m.double()).float()
    return rssi_dbm, positions_m.view(num_steps, num_chases, 6, 3)


def one_by_one(network, rssi_dbm, positions_m, memory):
    every = []
    for window_dbm, position_m in zip(rssi_dbm, positions_m, strict=True):
        logits, memory = network.decide(window_dbm, position_m, memory)
        every.append(logits)
    return torch.stack(every), memory


@torch.inference_mode()
def test_a_sequence_is_its_movements_one_by_one(network):
    rssi_dbm, positions_m = heard(7, 5)
    begun = network.begin(WORLD, 5)
    logits, _ = one_by_one(network, rssi_dbm, positions_m, begun)
    torch.testing.assert_close(network.decide_in_sequence(rssi_dbm, positions_m, begun), logits)
    # From the middle on, with the memory that it had there.
    _, there = one_by_one(network, rssi_dbm[:4], positions_m[:4], begun)
    torch.testing.assert_close(network.decide_in_sequence(rssi_dbm[4:], positions_m[4:], there), logits[4:])


@torch.inference_mode()
@pytest.mark.parametrize("what", ["an earlier window", "where the trackers were", "F", "rho"])
def test_it_decides_from_more_than_the_window(network, what):
    rssi_dbm, positions_m = heard(3, 4)
    told = paper_scenario()
    before = network.decide_in_sequence(rssi_dbm, positions_m, network.begin(told, 4))[-1]
    if what == "an earlier window":
        rssi_dbm = torch.cat([rssi_dbm[:1] + torch.tensor([3.0, 0, 0, 0, 0, 0]), rssi_dbm[1:]])
    elif what == "where the trackers were":
        positions_m = positions_m + torch.tensor([10.0, 0, 0])
    else:
        told = paper_scenario(sampling_hz=100) if what == "F" else paper_scenario(spatial_correlation=0.1)
    after = network.decide_in_sequence(rssi_dbm, positions_m, network.begin(told, 4))[-1]
    assert ((after - before).abs().amax(dim=(1, 2)) > 1e-4).all()


@torch.inference_mode()
def test_missing_samples_take_their_tracker_s_mean_power(network):
    rssi_dbm, positions_m = heard(1, 2)
    rssi_dbm[0, :, :, 2] = -60.0  # a tracker that hears a constant says the same with gaps
    whole, _ = network.decide(rssi_dbm[0], positions_m[0], network.begin(WORLD, 2))
    share = GatedNetwork.share_position
    holed = rssi_dbm.clone()
    holed[0, 1, 10:30, 2] = torch.nan
    features, gaps = network._heard(rssi_dbm), network._heard(holed)
    changed = (features != gaps)[0, 1].nonzero()[:, 0].tolist()
    assert changed == [share + 2]
    assert gaps[0, 1, share + 2] == pytest.approx(0.6)
    logits, _ = network.decide(holed[0], positions_m[0], network.begin(WORLD, 2))
    assert torch.equal(logits[0], whole[0])
    assert not torch.equal(logits[1], whole[1])


@torch.inference_mode()
@pytest.mark.parametrize("value", [float("nan"), float("inf"), float("-inf")])
def test_silence_is_no_level(network, value):
    """A silent tracker is taken to hear what the others do, whatever stands in its place, and is marked."""
    rssi_dbm, positions_m = heard(1, 3)
    rssi_dbm[..., 4] = value
    logits, memory = network.decide(rssi_dbm[0], positions_m[0], network.begin(WORLD, 3))
    assert logits.isfinite().all()
    assert memory.isfinite().all()
    assert network._heard(rssi_dbm)[..., GatedNetwork.share_position + 4].tolist() == [[0, 0, 0]]


@pytest.mark.parametrize("scale", [1.0, 20.0])
@torch.inference_mode()
def test_another_policy_scale_decides_the_same(network, scale):
    rssi_dbm, positions_m = heard(2, 3)
    scaled = network.with_policy_scale(scale)
    begun = network.begin(WORLD, 3)
    torch.testing.assert_close(
        scaled.decide_in_sequence(rssi_dbm, positions_m, begun),
        network.decide_in_sequence(rssi_dbm, positions_m, begun),
    )
    assert scaled.policy_scale == scale


def controller_of(network, world=WORLD):
    return LearnedController(world, network, "new", "greedy")


def test_the_controller_carries_the_memory(network):
    """What it does after three movements is what the network says of all three windows."""
    environment, controller = Environment(WORLD), controller_of(network)
    state, memory = environment.reset(chase_keys(2, 9)), controller.begin(9, 2)
    windows_dbm, positions_m = [], []
    for _ in range(3):
        windows_dbm.append(state.rssi_dbm)
        positions_m.append(tracker_position_m(state.center_m, state.spacing_m).float())
        action, memory = controller.decide(state.observation(), memory)
        state, _ = environment.step(state, action)
    with torch.inference_mode():
        logits = network.decide_in_sequence(torch.stack(windows_dbm), torch.stack(positions_m), network.begin(WORLD, 9))
    choices_m = torch.tensor(WORLD.displacement_choices_m, dtype=torch.float64)
    assert torch.equal(action.displacement_m, choices_m[logits[-1, :, 1:].argmax(dim=-1)])


def test_a_window_of_nothing_is_held_through_and_forgotten(network):
    state, controller = Environment(WORLD).reset(chase_keys(2, 9)), controller_of(network)
    _, memory = controller.decide(state.observation(), controller.begin(9, 2))
    deaf = dataclasses.replace(state.observation(), rssi_dbm=torch.full_like(state.rssi_dbm, torch.nan))
    action, after = controller.decide(deaf, memory)
    assert action.displacement_m.abs().max() == 0
    assert torch.equal(after.network_memory, memory.network_memory)
    assert after.condition.tolist() == [Condition.DEAF] * 9
    assert memory.condition.tolist() == [Condition.TRACKING] * 9


def test_a_chase_is_the_same_alone_and_in_a_batch(network):
    controller = controller_of(network)
    observation = Environment(WORLD).reset(chase_keys(2, 40)).observation()
    action, memory = controller.decide(observation, controller.begin(40, 2))
    for rows in (range(1), range(3), range(5, 21)):
        part = Observation(observation.rssi_dbm[rows], observation.tracker_position_m[rows])
        alone, its_memory = controller.decide(part, controller.begin(len(rows), 2, rows[0]))
        assert torch.equal(alone.displacement_m, action.displacement_m[rows])
        assert torch.equal(its_memory.network_memory, memory.network_memory[rows])


def test_a_weights_file_says_which_network_it_holds(tmp_path, network):
    path = tmp_path / "it.safetensors"
    save_weights(path, network, {"action_choice": "greedy"}, torch.float16)
    found, _ = load_weights(path)
    assert isinstance(found, GatedNetwork)
    for name, tensor in network.state_dict().items():
        assert torch.equal(found.state_dict()[name], tensor.half().float()), name
    with pytest.raises(InputError, match="needs windows of 50 samples; the scenario has 40"):
        load_controller(path, paper_scenario(window_samples=40))


def test_a_rollout_begins_where_the_last_one_ended(network):
    """Two rollouts of two movements are one of four: windows, choices and memory go on."""
    environment, keys = Environment(WORLD), chase_keys(4, 3)

    def begun():
        return environment.reset(keys), network.begin(WORLD, 3), ChaseStreams.of(keys, "policy")

    state, memory, streams = begun()
    whole, *_ = collect(environment, network, state, memory, streams, 4, 0.1)
    state, memory, streams = begun()
    first, state, memory = collect(environment, network, state, memory, streams, 2, 0.1)
    second, *_ = collect(environment, network, state, memory, streams, 2, 0.1)
    assert torch.equal(torch.cat([first.choice, second.choice]), whole.choice)
    assert torch.equal(second.memory, memory)
    torch.testing.assert_close(torch.cat([first.logits, second.logits]), whole.logits)
    with torch.inference_mode():
        again = network.decide_in_sequence(second.rssi_dbm[:-1], second.tracker_position_m[:-1], second.memory)
    torch.testing.assert_close(again, second.logits)


@pytest.mark.parametrize("name", ["gated", "robust"])
def test_a_run_interrupted_and_resumed_is_the_undisturbed_one_bit_for_bit(tmp_path, name):
    settings = dataclasses.replace(PRESETS[name], **SMALL)

    def train(folder, resume=False, interrupt_at=None):
        def progress(status):
            if interrupt_at is not None and status.updates >= interrupt_at:
                signal.raise_signal(signal.SIGINT)

        train_batched([WORLD, dataclasses.replace(WORLD, sampling_hz=100.0)], settings, folder, resume, progress)
        lines = [json.loads(line) for line in (folder / "training.jsonl").read_text().splitlines()]
        log = [{key: value for key, value in line.items() if key != "seconds"} for line in lines]
        tensors = load_file(folder / "resume.safetensors")
        return {key: tensor.numpy().tobytes() for key, tensor in tensors.items()}, log  # bytes: NaN is not NaN

    whole = train(tmp_path / "whole")
    train(tmp_path / "parts", interrupt_at=5)
    assert train(tmp_path / "parts", resume=True) == whole
    assert (tmp_path / "whole/best.safetensors").read_bytes() == (tmp_path / "parts/best.safetensors").read_bytes()


def test_robust_agents_play_in_worlds_they_are_not_told_of():
    settings = dataclasses.replace(PRESETS["robust"], **SMALL)
    agents = [LocalAgent(WORLD, settings, index) for index in range(6)]
    worlds = [agent._environment.scenario for agent in agents]
    assert worlds == [drawn_world(WORLD, training_seed(5), index) for index in range(6)]
    assert len(set(worlds)) > 1
    for agent in agents:
        assert torch.equal(agent.progress.memory, agent.local.networks.begin(WORLD, 4))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"losses": LossSettings()}, "objective = 'actor_critic' is refused: the form gated has no critic"),
        ({"symmetric": True}, "symmetric = True is refused"),
        ({"mirrored": True}, "mirrored = True is refused"),
        ({"precision": "bfloat16"}, "precision = 'bfloat16' is refused"),
    ],
)
def test_what_it_cannot_do_is_refused(changes, message):
    changes = {"spacing_exploration": None, **changes} if "losses" in changes else changes
    with pytest.raises(InputError, match=message):
        dataclasses.replace(PRESETS["gated"], **changes)


def test_training_goes_on_from_a_weights_file_of_its_own_form_alone(network):
    settings = PRESETS["gated"]
    rssi_dbm, positions_m = heard(2, 3)
    begun = network.begin(WORLD, 3)
    continued = continued_networks(settings, network)
    with torch.inference_mode():
        logits = network.decide_in_sequence(rssi_dbm, positions_m, begun)
        torch.testing.assert_close(continued.decide_in_sequence(rssi_dbm, positions_m, begun), logits)
        torch.testing.assert_close(deployed(continued).decide_in_sequence(rssi_dbm, positions_m, begun), logits)
    assert (continued.policy_scale, deployed(continued).policy_scale) == (20, 1)
    with pytest.raises(InputError, match="these initial weights are of the form paper, and gated is to be trained"):
        continued_networks(settings, SwarmNetworks(torch.Generator().manual_seed(1)))


def test_it_learns(tmp_path, capsys):
    """From 12 m away, two seconds of training: new networks reach next to nothing, trained ones nearly all."""
    world = paper_scenario(start_distance_m=12.0, max_movements=30)
    world.save_toml(tmp_path / "world.toml")
    words = ["train", "batched", "--preset", "gated", "--scenario", str(tmp_path / "world.toml")]
    words += ["--folder", str(tmp_path / "run"), "--updates", "40", "--chases-per-agent", "32", "--threads", "1"]
    words += ["--learning-rate", "4e-3"]
    main([*words, "--evaluation-chases", "50", "--evaluation-interval", "20"])
    first, *_, last = read_log(tmp_path / "run", "evaluation")
    assert last["success_rate"] >= 0.98
    assert last["movements_mean"] < 7
    _, configuration = load_weights(tmp_path / "run" / "best.safetensors")
    assert configuration["settings"]["form"] == "gated"
    assert first["update"] == 20
    capsys.readouterr()
