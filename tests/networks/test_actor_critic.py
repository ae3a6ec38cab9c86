"""The four networks against Table I, a hand-written forward pass and pencil and paper; batches change nothing."""

import math

import numpy as np
import pytest
import torch

from swarmchase.batch.streams import ChaseStreams, chase_keys
from swarmchase.controllers.learned import LearnedController
from swarmchase.formation import action_from_choice
from swarmchase.networks.actor_critic import NETWORK_NAMES, SwarmNetworks, greedy_choice, input_map, sampled_choice
from swarmchase.observation import Observation
from swarmchase.scenario import paper_scenario
from swarmchase.world.environment import Environment

LEVEL_DBM = -60.0


def new_networks(seed=0):
    return SwarmNetworks(torch.Generator().manual_seed(seed)).eval()


def windows(num_chases, **world):
    """First windows of as many chases, each with its target in a direction of its own."""
    return Environment(paper_scenario(**world)).reset(chase_keys(3, num_chases)).rssi_dbm


@pytest.fixture(scope="module")
def networks():
    return new_networks()


def test_each_network_is_table_one(networks):
    """3 LSTM layers of 128 features, 2 linear layers of 128, 5 choices and a value."""
    layer = {"weight_hh": (512, 128), "bias_ih": (512,), "bias_hh": (512,)}
    shapes = {f"lstm.{name}_l{k}": shape for k in range(3) for name, shape in layer.items()}
    shapes |= {"lstm.weight_ih_l0": (512, 6), "lstm.weight_ih_l1": (512, 128), "lstm.weight_ih_l2": (512, 128)}
    shapes |= {"linear.0.weight": (128, 128), "linear.0.bias": (128,)}
    shapes |= {"linear.2.weight": (128, 128), "linear.2.bias": (128,)}
    shapes |= {"policy_head.weight": (5, 128), "policy_head.bias": (5,)}
    shapes |= {"value_head.weight": (1, 128), "value_head.bias": (1,)}
    expected = {f"by_name.{name}.{part}": shape for name in "dxyz" for part, shape in shapes.items()}
    assert {name: tuple(tensor.shape) for name, tensor in networks.state_dict().items()} == expected
    # 4 * 128 * (6 + 128 + 2) + 2 * 4 * 128 * (128 + 128 + 2) = 333,824 in the LSTM,
    # 2 * 128 * 129 + 6 * 129 = 33,798 after it.
    one_by_one = [sum(p.numel() for p in network.parameters()) for network in networks.by_name.values()]
    assert one_by_one == [333_824 + 33_798] * 4 == [367_622] * 4
    assert sum(p.numel() for p in networks.parameters()) == 1_470_488


def test_the_networks_share_nothing(networks):
    addresses = [p.untyped_storage().data_ptr() for p in networks.parameters()]
    assert len(set(addresses)) == len(addresses)
    rssi_dbm = windows(3)
    before_logits, before_value = networks(rssi_dbm)
    for index, name in enumerate(NETWORK_NAMES):
        changed = new_networks()
        with torch.no_grad():
            for parameter in changed.by_name[name].parameters():
                parameter.add_(0.01)
        logits, value = changed(rssi_dbm)
        same = [torch.equal(logits[:, k], before_logits[:, k]) for k in range(4)]
        assert same == [k != index for k in range(4)]
        assert [torch.equal(value[:, k], before_value[:, k]) for k in range(4)] == same


def test_the_forward_pass_is_that_of_the_textbook():
    """LSTM, two ReLU layers and two heads written out in float64; the value head counts in tens of metres."""
    networks = new_networks(5)
    rssi_dbm = windows(2, window_samples=7)
    logits, value = networks(rssi_dbm)
    parameters = {name: tensor.double() for name, tensor in networks.state_dict().items()}
    for index, name in enumerate(NETWORK_NAMES):
        p = {part.removeprefix(f"by_name.{name}."): tensor for part, tensor in parameters.items()}
        weight, bias = input_map(max(0, index - 1))
        sequence = list((rssi_dbm.double() @ weight.double().T + bias.double()).unbind(1))
        for layer in range(3):
            hidden = cell = torch.zeros(2, 128, dtype=torch.float64)
            for step, given in enumerate(sequence):
                gates = given @ p[f"lstm.weight_ih_l{layer}"].T + p[f"lstm.bias_ih_l{layer}"]
                gates = gates + hidden @ p[f"lstm.weight_hh_l{layer}"].T + p[f"lstm.bias_hh_l{layer}"]
                i, f, g, o = gates.chunk(4, dim=1)
                cell = f.sigmoid() * cell + i.sigmoid() * g.tanh()
                hidden = o.sigmoid() * cell.tanh()
                sequence[step] = hidden
        features = sequence[-1]
        for layer in (0, 2):
            features = (features @ p[f"linear.{layer}.weight"].T + p[f"linear.{layer}.bias"]).clamp(min=0)
        expected = features @ p["policy_head.weight"].T + p["policy_head.bias"]
        torch.testing.assert_close(logits[:, index].double(), expected, rtol=1e-4, atol=1e-5)
        expected = 10 * (features @ p["value_head.weight"][0] + p["value_head.bias"])
        torch.testing.assert_close(value[:, index].double(), expected, rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize(
    ("first_axis", "above_level_db", "mapped"),
    [
        # -60 dBm everywhere is the middle of everything.
        (0, [0, 0, 0, 0, 0, 0], [0, 0, 0, 0, 0, 0]),
        # 3 dB between the trackers at +x and -x: 1 on the own axis of the x network ...
        (0, [1.5, -1.5, 0, 0, 0, 0], [1, 0, 0, 0, 0, 0]),
        # ... on the third of y (whose axes are y, z, x) and on the second of z (z, x, y).
        (1, [1.5, -1.5, 0, 0, 0, 0], [0, 0, 1, 0, 0, 0]),
        (2, [1.5, -1.5, 0, 0, 0, 0], [0, 1, 0, 0, 0, 0]),
        # The target on the other side.
        (0, [-3, 3, 0, 0, 0, 0], [-2, 0, 0, 0, 0, 0]),
        (0, [0, 0, 0, 0, -3, 3], [0, 0, -2, 0, 0, 0]),
        # 10 dB louder everywhere is one unit of level.
        (1, [10, 10, 10, 10, 10, 10], [0, 0, 0, 1, 0, 0]),
        # A pair 3 dB above the others: 1 on its contrast, and the mean of six is 1 dB higher.
        (0, [3, 3, 0, 0, 0, 0], [0, 0, 0, 0.1, 1, 0]),
        # The second axis: -(3 + 0) / 2 / 3 against the own one, 3 / 3 against the third.
        (0, [0, 0, 3, 3, 0, 0], [0, 0, 0, 0.1, -0.5, 1]),
        (0, [0, 0, 0, 0, 3, 3], [0, 0, 0, 0.1, -0.5, -1]),
        # Only the tracker at +z is 6 dB louder, seen by the z network: differences 6 / 3, level 1 / 10, contrast 3 / 3.
        (2, [0, 0, 0, 0, 6, 0], [2, 0, 0, 0.1, 1, 0]),
    ],
)
def test_input_map_with_a_pencil(first_axis, above_level_db, mapped):
    weight, bias = input_map(first_axis)
    given = torch.tensor(above_level_db, dtype=torch.float32) + LEVEL_DBM
    assert (weight @ given + bias).tolist() == pytest.approx(mapped, abs=1e-5)


@pytest.mark.parametrize("first_axis", [0, 1, 2])
def test_input_map_loses_nothing(first_axis):
    weight, bias = input_map(first_axis)
    rssi_dbm = torch.tensor([-61.0, -75.5, -48.0, -90.0, -33.25, -60.0])
    back = torch.linalg.solve(weight.double(), (weight @ rssi_dbm + bias - bias).double())
    assert back.tolist() == pytest.approx(rssi_dbm.tolist(), abs=1e-3)
    assert torch.linalg.cond(weight) < 20


def test_x_y_and_z_are_images_of_one_another():
    """With the weights of x in all of them, y sees in a turned window what x saw in the window itself."""
    networks = new_networks(2)
    for name in ("d", "y", "z"):
        networks.by_name[name].load_state_dict(networks.by_name["x"].state_dict())
    rssi_dbm = windows(16, window_samples=10)
    logits, value = networks(rssi_dbm)
    # The columns of x go to y, those of y to z, those of z to x.
    turned_dbm = rssi_dbm[:, :, [4, 5, 0, 1, 2, 3]]
    turned_logits, turned_value = networks(turned_dbm)
    for axis, image in [(1, 2), (2, 3), (3, 1)]:
        torch.testing.assert_close(turned_logits[:, image], logits[:, axis], rtol=0, atol=2e-5)
        torch.testing.assert_close(turned_value[:, image], value[:, axis], rtol=0, atol=2e-4)
        assert (logits[:, image] - logits[:, axis]).abs().max() > 0.01
    # The spacing network looks from x.
    assert torch.equal(logits[:, 0], logits[:, 1])


def spread_over_directions(networks):
    """Mean standard deviation of the last LSTM features over targets all around, 100 m away, without fading."""
    rssi_dbm = windows(64, rician_k=1e12)
    with torch.no_grad():
        spreads = []
        for index, network in enumerate(networks.by_name.values()):
            weight, bias = input_map(max(0, index - 1))
            hidden, _ = network.lstm(rssi_dbm @ weight.T + bias)
            spreads.append(hidden[:, -1].std(dim=0).mean().item())
    return spreads


def test_a_new_network_hears_where_the_target_is():
    """Its features vary by tenths from one direction to another, those of torch's own initial weights by nothing."""
    with torch.random.fork_rng():
        torch.manual_seed(0)
        usual = SwarmNetworks()
        for part in usual.modules():
            if hasattr(part, "reset_parameters"):
                part.reset_parameters()
    ours, theirs = spread_over_directions(new_networks()), spread_over_directions(usual)
    assert min(ours) > 0.1
    assert max(theirs) < 0.001


def test_a_new_network_is_that_of_its_generator_and_leaves_the_global_one_alone():
    state = torch.random.get_rng_state()
    one, same, other = new_networks(1), new_networks(1), new_networks(2)
    assert torch.equal(torch.random.get_rng_state(), state)
    for name, tensor in one.state_dict().items():
        assert torch.equal(tensor, same.state_dict()[name])
        is_constant = ("bias" in name and "lstm" not in name) or "bias_hh" in name
        assert torch.equal(tensor, other.state_dict()[name]) == is_constant, name


@pytest.fixture(scope="module")
def controller(networks):
    return LearnedController(paper_scenario(), networks, "new")


def observed(rssi_dbm):
    return Observation(rssi_dbm, torch.zeros(*rssi_dbm.shape, 3, dtype=torch.float64))


@pytest.fixture(scope="module")
def many(controller):
    """256 windows and the logits they get together."""
    rssi_dbm = windows(256)
    return rssi_dbm, controller.policy_logits(observed(rssi_dbm))


@pytest.mark.parametrize("num_chases", [*range(1, 21), 64, 100])
def test_a_row_does_not_depend_on_its_batch_bit_for_bit(controller, many, num_chases):
    rssi_dbm, logits = many
    shuffled = np.random.default_rng(num_chases).permutation(256)
    for rows in (shuffled[:num_chases], shuffled[-num_chases:]):
        assert torch.equal(controller.policy_logits(observed(rssi_dbm[rows])), logits[rows])


def test_a_row_does_not_depend_on_its_place_bit_for_bit(controller, many):
    rssi_dbm, logits = many
    rows = np.random.default_rng(0).permutation(256)
    assert torch.equal(controller.policy_logits(observed(rssi_dbm[rows])), logits[rows])


@pytest.mark.parametrize("action_choice", ["greedy", "sampled"])
def test_decide_is_the_policies_choice(networks, many, action_choice):
    scenario = paper_scenario()
    controller = LearnedController(scenario, networks, "new", action_choice)
    rssi_dbm, logits = many[0][:3], many[1][:3]
    memory = controller.begin(3, seed=8, first_chase=5)
    streams = ChaseStreams.of([(8, 5), (8, 6), (8, 7)], "policy")
    for _ in range(3):
        action, memory = controller.decide(observed(rssi_dbm), memory)
        uniform = streams.uniform(4)
        choice = greedy_choice(logits) if action_choice == "greedy" else sampled_choice(logits, uniform)
        expected = action_from_choice(scenario, choice)
        assert torch.equal(action.spacing_m, expected.spacing_m)
        assert torch.equal(action.displacement_m, expected.displacement_m)


def logits_of(*probabilities):
    return torch.tensor(probabilities).log().expand(1, 4, 5)


def test_greedy_choice_by_hand():
    logits = torch.tensor([[[1.0, 2, 3, 4, 5], [0, 0, 9, 0, 0], [-1, -2, -3, -4, -5], [0, 7, 0, 6, 0]]])
    assert greedy_choice(logits).tolist() == [[4, 2, 0, 1]]


@pytest.mark.parametrize(
    ("uniform", "choice"),
    # Cumulated 1/2, 3/4, 7/8, 15/16, 1.
    [
        *[(0, 0), (0.499, 0), (0.501, 1), (0.749, 1), (0.751, 2)],
        *[(0.874, 2), (0.876, 3), (0.937, 3), (0.938, 4), (1 - 2**-53, 4)],
    ],
)
def test_sampled_choice_by_hand(uniform, choice):
    logits = logits_of(1 / 2, 1 / 4, 1 / 8, 1 / 16, 1 / 16)
    assert sampled_choice(logits, torch.full((1, 4), uniform, dtype=torch.float64)).tolist() == [[choice] * 4]


@pytest.mark.parametrize("only", range(5))
@pytest.mark.parametrize("uniform", [0.0, 0.5, 1 - 2**-53])
def test_sampled_choice_never_takes_the_impossible(only, uniform):
    logits = logits_of(*(float(choice == only) for choice in range(5)))
    assert sampled_choice(logits, torch.full((1, 4), uniform, dtype=torch.float64)).tolist() == [[only] * 4]


def test_each_network_takes_its_own_uniform_and_its_own_policy():
    logits = torch.stack([logits_of(0.2, 0.2, 0.2, 0.2, 0.2)[0], logits_of(0.9, 0, 0, 0, 0.1)[0]])
    uniform = torch.tensor([[0.1, 0.3, 0.5, 0.99], [0.1, 0.3, 0.91, 0.99]], dtype=torch.float64)
    assert sampled_choice(logits, uniform).tolist() == [[0, 1, 2, 4], [0, 0, 4, 4]]


def test_sampled_choices_are_as_frequent_as_their_policy_says():
    """Effect size w = sqrt(sum (q - p)^2 / p): 0.006 is expected of 100,000 samples, 0.1 is called small."""
    generator = np.random.default_rng(0)
    logits = torch.from_numpy(generator.normal(0, 1.5, (1, 4, 5)).astype(np.float32))
    choice = sampled_choice(logits.expand(100_000, -1, -1), torch.from_numpy(generator.random((100_000, 4))))
    for network in range(4):
        probability = logits[0, network].double().softmax(dim=0).numpy()
        frequency = np.bincount(choice[:, network], minlength=5) / 100_000
        assert math.sqrt(((frequency - probability) ** 2 / probability).sum()) < 0.02


def test_every_tracker_and_the_windows_first_half_are_heard(networks):
    rssi_dbm = windows(1)
    logits, _ = networks(rssi_dbm)
    for tracker in range(6):
        louder = rssi_dbm.clone()
        louder[:, :25, tracker] += 3
        assert (networks(louder)[0] - logits).abs().amax(dim=(0, 2)).min() > 1e-4
