"""The network of a filter's likelihood: what it may not see, gaps, its loss by hand, and that it narrows the law."""

import dataclasses
import json
import math
import signal

import numpy as np
import pytest
import torch
from safetensors.torch import load_file

from swarmchase.batch.streams import ChaseStreams, chase_keys
from swarmchase.channel.fading import fading_db
from swarmchase.channel.fading_law import fading_law
from swarmchase.channel.fading_process import first_window
from swarmchase.cli import main
from swarmchase.controllers import load_controller, network_controller
from swarmchase.controllers.particle import ParticleController
from swarmchase.errors import InputError
from swarmchase.evaluation.chases import run_chases
from swarmchase.networks.fading import CorrectedPower, FadingNetwork, interpolated
from swarmchase.networks.forms import continued_networks, deployed
from swarmchase.networks.weights import load_weights, save_weights
from swarmchase.observation import mean_power_dbm
from swarmchase.scenario import paper_scenario
from swarmchase.training.batched import train_batched
from swarmchase.training.losses import LEAST_VARIANCE, LossSettings, fading_loss
from swarmchase.training.parameters import FlatNetworks
from swarmchase.training.rollout import collect
from swarmchase.training.run_folder import read_log
from swarmchase.training.settings import PRESETS
from swarmchase.world.environment import Environment, unfaded_dbm

NAN = math.nan
WORLD = paper_scenario(sampling_hz=100.0, spatial_correlation=0.1)


@pytest.fixture(scope="module")
def network():
    return FadingNetwork(torch.Generator().manual_seed(3))


def windows_dbm(scenario, num_windows, seed=1):
    """Windows of pure fading around -60 dBm."""
    return fading_db(first_window(scenario, chase_keys(seed, num_windows))).transpose(1, 2) - 60


@pytest.mark.parametrize(
    ("levels_db", "filled_db"),
    [
        ((1, 2, 3, 4), (1, 2, 3, 4)),
        ((1, NAN, 3, 4), (1, 2, 3, 4)),
        ((0, NAN, NAN, 6), (0, 2, 4, 6)),
        # Before the first and after the last there is no line: as that one.
        ((NAN, NAN, 3, 5), (3, 3, 3, 5)),
        ((1, 7, NAN, NAN), (1, 7, 7, 7)),
        ((NAN, 2, NAN, NAN), (2, 2, 2, 2)),
        ((NAN, NAN, NAN, NAN), (0, 0, 0, 0)),
    ],
)
def test_gaps_are_filled_by_hand(levels_db, filled_db):
    level_db = torch.tensor(levels_db, dtype=torch.float32).view(1, 1, 4).repeat(1, 2, 1)
    level_db[0, 1] = torch.tensor([5.0, NAN, 5.0, 5.0])  # another tracker has its own gap
    found = interpolated(level_db, level_db.isfinite())
    assert found[0, 0].tolist() == list(filled_db)
    assert found[0, 1].tolist() == [5, 5, 5, 5]


@torch.inference_mode()
def test_what_it_expects_does_not_depend_on_the_level(network):
    """Neither a tracker's own nor the others': else it would read the distance, which the filter has to find."""
    rssi_dbm = windows_dbm(WORLD, 20)
    told = network.begin(WORLD, 20)
    expected_db = network(rssi_dbm, told)
    nearer_dbm = rssi_dbm + torch.tensor([0.0, 10.0, -3.0, 1.0, 25.0, -7.5])
    torch.testing.assert_close(network(nearer_dbm, told), expected_db, atol=1e-4, rtol=0)
    assert expected_db.std() > 1e-3


@torch.inference_mode()
@pytest.mark.parametrize("what", ["its own shape", "another tracker's shape", "F", "rho"])
def test_what_it_expects_depends_on(network, what):
    rssi_dbm, told = windows_dbm(WORLD, 20), WORLD
    before = network(rssi_dbm, network.begin(told, 20))[:, 0]
    if what == "F":
        told = dataclasses.replace(told, sampling_hz=10.0)
    elif what == "rho":
        told = dataclasses.replace(told, spatial_correlation=0.9)
    else:
        tracker = 0 if what == "its own shape" else 4
        rssi_dbm = rssi_dbm.clone()
        rssi_dbm[:, :10, tracker] -= 6
    after = network(rssi_dbm, network.begin(told, 20))[:, 0]
    assert ((after - before).abs() > 1e-5).all()


@torch.inference_mode()
def test_a_silent_tracker_counts_nowhere(network):
    """Whatever stands in its place; the others are judged by themselves."""
    rssi_dbm = windows_dbm(WORLD, 20)
    silent_dbm, infinite_dbm = rssi_dbm.clone(), rssi_dbm.clone()
    silent_dbm[..., 2], infinite_dbm[..., 2] = NAN, math.inf
    power = CorrectedPower(network, WORLD)
    found_dbm = power(silent_dbm)
    assert found_dbm[:, 2].isnan().all()
    others = [0, 1, 3, 4, 5]
    assert found_dbm[:, others].isfinite().all()
    assert torch.equal(power(infinite_dbm)[:, others], found_dbm[:, others])
    assert power(torch.full((3, 50, 6), NAN)).isnan().all()


def test_a_level_is_the_same_in_any_batch(network):
    """Bit for bit, gaps or none."""
    rssi_dbm = windows_dbm(WORLD, 256)
    rssi_dbm[torch.rand(rssi_dbm.shape, generator=torch.Generator().manual_seed(2)) < 0.1] = NAN
    power = CorrectedPower(network, WORLD)
    whole = power(rssi_dbm)
    for size in (1, 3, 8, 13, 100):
        assert torch.equal(torch.cat([power(part) for part in rssi_dbm.split(size)]), whole), size


def test_corrected_power_is_the_mean_power_less_what_is_expected(network):
    rssi_dbm = windows_dbm(WORLD, 20)
    with torch.inference_mode():
        expected_dbm = mean_power_dbm(rssi_dbm) - network(rssi_dbm, network.begin(WORLD, 20))
    torch.testing.assert_close(CorrectedPower(network, WORLD)(rssi_dbm), expected_dbm, atol=1e-4, rtol=0)


def test_the_law_is_drawn_once_for_what_it_is_a_function_of(network):
    same, other = FadingNetwork(), FadingNetwork(torch.Generator().manual_seed(4))
    same.load_state_dict(network.state_dict())
    nearer = dataclasses.replace(WORLD, start_distance_m=20.0, path_loss_exponent=3.0)
    law = fading_law(WORLD, CorrectedPower(network, WORLD))
    assert fading_law(nearer, CorrectedPower(same, nearer)) is law
    assert fading_law(WORLD, CorrectedPower(other, WORLD)) is not law
    assert fading_law(WORLD) is not law
    slower = dataclasses.replace(WORLD, doppler_spread_hz=0.5)
    assert fading_law(slower, CorrectedPower(network, slower)) is not law


def rollout_of(network, num_chases, world=WORLD):
    keys = chase_keys(9, num_chases)
    environment = Environment(world)
    streams = ChaseStreams.of(keys, "policy")
    begun = network.begin(WORLD, num_chases)
    return collect(environment, network, environment.reset(keys), begun, streams, 4)


def test_while_it_learns_the_swarm_wanders(network):
    """All choices are as likely: of 4 movements of 500 chases each of five, 2000 draws a network, 400 +- 5 sigma."""
    rollout, *_ = rollout_of(network, 500)
    for which in range(4):
        counts = torch.bincount(rollout.choice[:, :, which].flatten(), minlength=5)
        assert ((counts - 400).abs() < 5 * math.sqrt(2000 * 0.2 * 0.8)).all()


def test_a_rollout_knows_what_would_be_heard_without_fading(network):
    """Against the environment's own windows in a world where nothing fades."""
    steady = dataclasses.replace(WORLD, rician_k=1e12)
    rollout, *_ = rollout_of(network, 5, steady)
    torch.testing.assert_close(rollout.unfaded_dbm, rollout.rssi_dbm[:-1].mean(dim=2), atol=1e-3, rtol=0)
    state = Environment(steady).reset(chase_keys(9, 5))
    assert torch.equal(rollout.unfaded_dbm[0], unfaded_dbm(steady, state).float())


class Knows(FadingNetwork):
    """Expects the true fading but for errors of its own: of all trackers together, and of each."""

    def __init__(self, rollout, together_db, apart_db):
        super().__init__(torch.Generator().manual_seed(1))
        rssi_dbm = rollout.rssi_dbm[:-1].flatten(0, 1)
        true_db = mean_power_dbm(rssi_dbm) - rollout.unfaded_dbm.flatten(0, 1)
        self.expected_db = true_db + together_db[:, None] + apart_db

    def forward(self, rssi_dbm, told):
        return self.expected_db


def test_its_loss_by_hand(network):
    """Together +-2 dB: variance 4. Apart +-1 dB, three trackers of each sign: a sum of squares of 6 over 5."""
    rollout, *_ = rollout_of(network, 4)
    sign = torch.tensor([1.0, -1.0]).repeat(8)
    apart_db = torch.tensor([1.0, -1.0]).repeat(3).expand(16, 6)
    loss = fading_loss(Knows(rollout, 2 * sign, apart_db), rollout)
    by_hand = (5 * math.log(6 / 5 + LEAST_VARIANCE) + math.log(4 + LEAST_VARIANCE)) / 2
    assert loss.item() == pytest.approx(by_hand, abs=1e-4)
    perfect = fading_loss(Knows(rollout, 0 * sign, 0 * apart_db), rollout)
    assert perfect.item() == pytest.approx(3 * math.log(LEAST_VARIANCE), abs=1e-3)


def test_what_was_not_heard_and_what_came_after_the_end_cost_nothing(network):
    rollout, *_ = rollout_of(network, 4)
    sign = torch.tensor([1.0, -1.0]).repeat(8)
    apart_db = torch.tensor([1.0, -1.0]).repeat(3).expand(16, 6).clone()
    whole = fading_loss(Knows(rollout, 2 * sign, apart_db), rollout)
    valid = rollout.valid.clone()
    valid[2:, 1] = False
    ended = dataclasses.replace(rollout, valid=valid)
    wild_db = apart_db.clone()
    wild_db[~valid.flatten()] = 77.0
    torch.testing.assert_close(fading_loss(Knows(ended, 2 * sign, wild_db), ended), whole)
    # One of each pair falls silent: +1 and -1 twice, a sum of squares of 4 over 3.
    rssi_dbm = rollout.rssi_dbm.clone()
    rssi_dbm[..., 4:] = NAN
    silent = dataclasses.replace(rollout, rssi_dbm=rssi_dbm)
    by_hand = (5 * math.log(4 / 3 + LEAST_VARIANCE) + math.log(4 + LEAST_VARIANCE)) / 2
    assert fading_loss(Knows(silent, 2 * sign, apart_db), silent).item() == pytest.approx(by_hand, abs=1e-4)


def test_the_gradient_of_its_loss_is_finite_and_reaches_every_weight(network):
    flat = FlatNetworks(deployed(network))
    rollout, *_ = rollout_of(network, 8)
    fading_loss(flat.networks, rollout).sum().backward()
    assert flat.gradient.isfinite().all()
    for name, parameter in flat.networks.named_parameters():
        assert parameter.grad.abs().max() > 0, name


def test_a_weights_file_of_it_is_a_particle_filter(tmp_path, network):
    path = tmp_path / "it.safetensors"
    save_weights(path, network, {"action_choice": "greedy"}, torch.float16)
    found, _ = load_weights(path)
    assert isinstance(found, FadingNetwork)
    controller = load_controller(path, WORLD)
    assert isinstance(controller, ParticleController)
    assert controller.name == str(path)
    with pytest.raises(InputError, match="needs windows of 50 samples; the scenario has 40"):
        load_controller(path, paper_scenario(window_samples=40))
    again = continued_networks(PRESETS["recurrent"], found)
    assert all(torch.equal(again.state_dict()[name], tensor) for name, tensor in found.state_dict().items())


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"losses": LossSettings()}, "objective = 'actor_critic' is refused: the objective fading is for the form"),
        ({"form": "paper"}, "objective = 'fading' is refused: the objective fading is for the form fading alone"),
        ({"symmetric": True}, "symmetric = True is refused"),
        ({"precision": "bfloat16"}, "precision = 'bfloat16' is refused"),
    ],
)
def test_what_does_not_go_together_is_refused(changes, message):
    with pytest.raises(InputError, match=message):
        dataclasses.replace(PRESETS["recurrent"], **changes)


def test_a_run_interrupted_and_resumed_is_the_undisturbed_one_bit_for_bit(tmp_path):
    settings = dataclasses.replace(
        PRESETS["recurrent"], max_updates=4, evaluation_interval=4, evaluation_chases=2, checkpoint_interval=2
    )
    settings = dataclasses.replace(settings, chases_per_agent=4, update_interval=3)
    world = dataclasses.replace(WORLD, start_distance_m=8.0, max_movements=12)

    def train(folder, resume=False, interrupt_at=None):
        def progress(status):
            if interrupt_at is not None and status.updates >= interrupt_at:
                signal.raise_signal(signal.SIGINT)

        train_batched([world, dataclasses.replace(world, sampling_hz=10.0)], settings, folder, resume, progress)
        lines = [json.loads(line) for line in (folder / "training.jsonl").read_text().splitlines()]
        log = [{key: value for key, value in line.items() if key != "seconds"} for line in lines]
        tensors = load_file(folder / "resume.safetensors")
        return {key: tensor.numpy().tobytes() for key, tensor in tensors.items()}, log

    whole = train(tmp_path / "whole")
    train(tmp_path / "parts", interrupt_at=3)
    assert train(tmp_path / "parts", resume=True) == whole
    assert (tmp_path / "whole/best.safetensors").read_bytes() == (tmp_path / "parts/best.safetensors").read_bytes()


def test_it_learns(tmp_path, capsys):
    """Thirty updates narrow the law from 2.5 dB to below 2 dB (1.8 with three seeds), and chases get shorter by it, to
    0.91 of what they were."""
    words = ["train", "batched", "--preset", "recurrent", "--sampling-hz", "100", "--spatial-correlation", "0.1"]
    words += ["--folder", str(tmp_path / "run"), "--updates", "30", "--chases-per-agent", "64", "--threads", "1"]
    main([*words, "--learning-rate", "4e-3", "--evaluation-interval", "30", "--evaluation-chases", "10"])
    capsys.readouterr()
    [evaluation] = read_log(tmp_path / "run", "evaluation")
    assert evaluation["success_rate"] == 1
    networks, configuration = load_weights(tmp_path / "run" / "best.safetensors")
    assert configuration["settings"]["form"] == "fading"
    raw, learned = fading_law(WORLD), fading_law(WORLD, CorrectedPower(networks, WORLD))
    assert raw.standard_deviation_db == pytest.approx(2.5, abs=0.2)
    assert learned.standard_deviation_db < 2.0
    apart_db = [law.standard_deviation_db * math.sqrt(1 - law.correlation) for law in (raw, learned)]
    assert apart_db[1] < 0.8 * apart_db[0]
    means = [
        np.mean([result.movements for result in run_chases(WORLD, controller, 5, range(100))])
        for controller in (
            load_controller("particle", WORLD),
            network_controller(WORLD, networks, "it", "greedy"),
        )
    ]
    assert means[1] < 0.95 * means[0]
