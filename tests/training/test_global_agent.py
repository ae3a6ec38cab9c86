"""The shared Adam against torch's own, alone and under two processes; flat parameters."""

import contextlib

import pytest
import torch

from swarmchase.networks.actor_critic import SwarmNetworks
from swarmchase.training.global_agent import GlobalAgent, LearningRate, SharedParameters
from swarmchase.training.parameters import ALIGNMENT, FlatNetworks

CONSTANT = LearningRate(1e-3, 1e-3, 1000)
LENGTH = 200_000
UPDATES_EACH = 100
WAIT_S = 120


def gradient(number, length=LENGTH):
    return torch.randn(length, generator=torch.Generator().manual_seed(number))


def start_vector(length=LENGTH):
    return gradient(99, length)


def new_agent(length=64, learning_rate=CONSTANT, max_updates=1000):
    shared = SharedParameters.start(start_vector(length))
    return GlobalAgent(shared, contextlib.nullcontext(), learning_rate, max_updates), shared


def serial_adam(vector, gradients, rates=None):
    """torch's own Adam, state left to itself."""
    parameter = torch.nn.Parameter(vector.clone())
    adam = torch.optim.Adam([parameter], lr=1e-3, fused=True)
    for step, one in enumerate(gradients):
        adam.param_groups[0]["lr"] = 1e-3 if rates is None else rates[step]
        parameter.grad = one.clone()
        adam.step()
    return parameter.detach(), adam.state[parameter]


def assert_is_serial(shared, vector, gradients, rates=None):
    expected, state = serial_adam(vector, gradients, rates)
    assert torch.equal(shared.vector, expected)
    assert torch.equal(shared.first_moment, state["exp_avg"])
    assert torch.equal(shared.second_moment, state["exp_avg_sq"])
    assert int(shared.updates) == int(state["step"]) == len(gradients)


def test_its_updates_are_those_of_torchs_adam_bit_for_bit():
    agent, shared = new_agent()
    gradients = [gradient(number, 64) for number in range(10)]
    for one in gradients:
        assert agent.update(one)
    assert agent.updates == 10
    assert_is_serial(shared, start_vector(64), gradients)


def test_a_constant_gradient_stays_constant():
    """1, 1, 1 and not 1, 2, 3: Adam's step for a constant gradient is the learning rate, every time."""
    agent, shared = new_agent(learning_rate=LearningRate(0.1, 0.1, 1000))
    shared.vector.zero_()
    ones = torch.ones(64)
    for update in range(1, 4):
        agent.update(ones)
        assert torch.equal(ones, torch.ones(64))
        # (1 - .9^k) of the gradient itself: were it to accumulate, the moments would be those of 1, 2, 3.
        torch.testing.assert_close(shared.first_moment, torch.full((64,), 1 - 0.9**update))
        torch.testing.assert_close(shared.second_moment, torch.full((64,), 1 - 0.999**update))
        torch.testing.assert_close(shared.vector, torch.full((64,), -0.1 * update))


def test_a_constant_gradient_stays_constant_in_flat_networks():
    flat = FlatNetworks(SwarmNetworks(torch.Generator().manual_seed(0)))
    for _ in range(3):
        flat.gradient.zero_()
        sum(parameter.sum() for parameter in flat.networks.parameters()).backward()
        for parameter in flat.networks.parameters():
            assert torch.equal(parameter.grad, torch.ones_like(parameter))
        assert flat.gradient.sum() == 1_470_488


@pytest.mark.parametrize(
    ("rate", "update", "expected"),
    [
        (LearningRate(1e-5, 1e-5, 100), 0, 1e-5),
        (LearningRate(1e-5, 1e-5, 100), 77, 1e-5),
        # Linear from 4 to 1 over 3 updates, and it stays there.
        (LearningRate(4.0, 1.0, 3), 0, 4),
        (LearningRate(4.0, 1.0, 3), 1, 3),
        (LearningRate(4.0, 1.0, 3), 2, 2),
        (LearningRate(4.0, 1.0, 3), 3, 1),
        (LearningRate(4.0, 1.0, 3), 30, 1),
    ],
)
def test_learning_rate_by_hand(rate, update, expected):
    assert rate.at(update) == pytest.approx(expected)


def test_each_update_has_its_own_learning_rate():
    agent, shared = new_agent(learning_rate=LearningRate(0.4, 0.1, 3))
    gradients = [gradient(number, 64) for number in range(5)]
    for one in gradients:
        agent.update(one)
    assert_is_serial(shared, start_vector(64), gradients, rates=[LearningRate(0.4, 0.1, 3).at(k) for k in range(5)])


def test_nothing_is_applied_after_the_last_update():
    agent, shared = new_agent(max_updates=2)
    assert [agent.update(gradient(number, 64)) for number in range(4)] == [True, True, False, False]
    assert agent.finished
    assert_is_serial(shared, start_vector(64), [gradient(0, 64), gradient(1, 64)])


def test_it_goes_on_from_a_snapshot_as_if_nothing_had_been():
    agent, shared = new_agent()
    agent.update(gradient(0, 64))
    copy = agent.snapshot()
    again = GlobalAgent(copy, contextlib.nullcontext(), CONSTANT, 1000)
    agent.update(gradient(1, 64))
    assert int(copy.updates) == 1
    again.update(gradient(1, 64))
    for name in ("vector", "first_moment", "second_moment", "updates"):
        assert torch.equal(getattr(shared, name), getattr(copy, name)), name


def test_synchronising_copies_the_global_parameters():
    local = FlatNetworks(SwarmNetworks())
    other = SwarmNetworks(torch.Generator().manual_seed(3))
    shared = SharedParameters.start(FlatNetworks(other).vector)
    agent = GlobalAgent(shared, contextlib.nullcontext(), CONSTANT, 10)
    agent.synchronise(local)
    for name, tensor in local.networks.state_dict().items():
        assert torch.equal(tensor, other.state_dict()[name])
    # A copy, not an alias: what the agent does to its own stays its own, and the global update comes with the next.
    local.vector.add_(1)
    before = shared.vector.clone()
    agent.update(torch.ones_like(before))
    assert not torch.equal(shared.vector, before)
    assert torch.equal(FlatNetworks(other).vector, before)


def test_flat_networks_are_views_of_one_aligned_vector():
    networks = SwarmNetworks(torch.Generator().manual_seed(1))
    before = {name: tensor.clone() for name, tensor in networks.state_dict().items()}
    flat = FlatNetworks(networks)
    for name, tensor in networks.state_dict().items():
        assert torch.equal(tensor, before[name])
        assert (tensor.data_ptr() - flat.vector.data_ptr()) % (4 * ALIGNMENT) == 0
    flat.vector.mul_(2)
    for name, tensor in networks.state_dict().items():
        assert torch.equal(tensor, 2 * before[name])
    flat.gradient.fill_(7)
    assert all((parameter.grad == 7).all() for parameter in networks.parameters())


def worker(rank, plain_lock, outer_lock, same, apart, order):
    """Hands in the same gradient again and again, then its own ones while it writes down whose turn it was."""
    torch.set_num_threads(1)
    agent = GlobalAgent(same, plain_lock, CONSTANT, 10_000)
    for _ in range(UPDATES_EACH):
        agent.update(gradient(7))
    agent = GlobalAgent(apart, outer_lock, CONSTANT, 10_000)
    for number in range(UPDATES_EACH):
        with outer_lock:
            order[agent.updates] = rank
            agent.update(gradient(1000 * rank + number))


@pytest.fixture(scope="module")
def after_two_processes():
    context = torch.multiprocessing.get_context("spawn")
    plain_lock, outer_lock = context.Lock(), context.RLock()
    same, apart = SharedParameters.start(start_vector()), SharedParameters.start(start_vector())
    order = torch.zeros(2 * UPDATES_EACH, dtype=torch.int64).share_memory_()
    processes = [
        context.Process(target=worker, args=(rank, plain_lock, outer_lock, same, apart, order), daemon=True)
        for rank in (1, 2)
    ]
    for process in processes:
        process.start()
    for process in processes:
        process.join(WAIT_S)
    exit_codes = [process.exitcode for process in processes]
    for process in processes:
        process.kill()
    assert exit_codes == [0, 0]
    return same, apart, order


def test_two_processes_with_one_gradient_are_one_serial_adam_bit_for_bit(after_two_processes):
    same, _, _ = after_two_processes
    assert_is_serial(same, start_vector(), [gradient(7)] * (2 * UPDATES_EACH))


def test_two_processes_are_a_serial_adam_in_the_order_they_came_bit_for_bit(after_two_processes):
    _, apart, order = after_two_processes
    assert sorted(order.tolist()) == [1] * UPDATES_EACH + [2] * UPDATES_EACH
    made = {1: 0, 2: 0}
    gradients = []
    for rank in order.tolist():
        gradients.append(gradient(1000 * rank + made[rank]))
        made[rank] += 1
    assert_is_serial(apart, start_vector(), gradients)
