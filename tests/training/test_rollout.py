"""What a rollout keeps of a chase, against the chase played movement by movement; local agents from chase to chase."""

import json
from dataclasses import fields, replace

import pytest
import torch

from swarmchase.batch.streams import ChaseStreams, chase_keys
from swarmchase.errors import InputError
from swarmchase.formation import action_from_choice
from swarmchase.networks.actor_critic import SwarmNetworks, sampled_choice
from swarmchase.scenario import paper_scenario
from swarmchase.training.agent import AgentSnapshot, LocalAgent
from swarmchase.training.losses import LossSettings, rollout_loss
from swarmchase.training.rollout import Rollout, collect
from swarmchase.training.settings import TrainingSettings, training_seed
from swarmchase.world.environment import Environment

NEAR = paper_scenario(start_distance_m=6.0, success_radius_m=4.0, max_movements=7, window_samples=3)
"""Chases that end both ways, soon."""
SEED = training_seed(6)


def new_networks(seed=0):
    return SwarmNetworks(torch.Generator().manual_seed(seed))


def start(chases, seed=SEED):
    keys = [chase_keys(seed, 1, chase)[0] for chase in chases]
    return Environment(NEAR), Environment(NEAR).reset(keys), ChaseStreams.of(keys, "policy")


NOTHING = torch.zeros(12, 0)
"""What networks of the paper's form remember of up to twelve chases."""


def by_hand(networks, chase, num_steps, seed=SEED):
    """One chase alone, movement by movement: windows, choices, rewards, and how it ended."""
    environment, state, streams = start([chase], seed)
    windows, choices, rewards, end = [state.rssi_dbm], [], [], ""
    while len(choices) < num_steps and not end:
        with torch.no_grad():
            logits, _ = networks(state.rssi_dbm)
        choices.append(sampled_choice(logits, streams.uniform(4)))
        state, outcome = environment.step(state, action_from_choice(NEAR, choices[-1]))
        windows.append(state.rssi_dbm)
        rewards.append(outcome.reward_m.float())
        end = "reached" if outcome.reached else "truncated" if outcome.truncated else ""
    return torch.stack(windows), torch.stack(choices), torch.stack(rewards), end


@pytest.mark.parametrize("chase", range(12))
@pytest.mark.parametrize("num_steps", [1, 5, 9])
def test_a_rollout_is_the_chase_movement_by_movement(chase, num_steps):
    networks = new_networks()
    environment, state, streams = start([chase])
    rollout, state, _ = collect(environment, networks, state, NOTHING[:1], streams, num_steps)
    windows, choices, rewards, end = by_hand(networks, chase, num_steps)
    assert torch.equal(rollout.rssi_dbm, windows)
    assert torch.equal(rollout.choice, choices)
    assert torch.equal(rollout.reward_m, rewards)
    # Alone it stops where it ends: no step is invalid.
    assert rollout.valid.tolist() == [[True]] * len(choices)
    assert (rollout.reached.tolist(), rollout.truncated.tolist()) == ([end == "reached"], [end == "truncated"])
    assert torch.equal(state.rssi_dbm, windows[-1])
    assert state.movements.tolist() == [len(choices)]


def test_the_chases_above_end_in_every_way():
    ends = [by_hand(new_networks(), chase, 9)[3] for chase in range(12)]
    assert {"reached", "truncated"} == set(ends)
    assert "" in [by_hand(new_networks(), chase, 5)[3] for chase in range(12)]


def test_a_batch_is_its_chases_and_marks_what_came_after_their_end():
    networks, chases = new_networks(), list(range(12))
    environment, state, streams = start(chases)
    rollout, *_ = collect(environment, networks, state, NOTHING, streams, 9)
    assert len(rollout.choice) == 7  # by then every chase has ended, at the latest at MAX_STEPS
    for row, chase in enumerate(chases):
        windows, choices, rewards, end = by_hand(networks, chase, 9)
        steps = len(choices)
        assert rollout.valid[:, row].tolist() == [True] * steps + [False] * (7 - steps)
        assert torch.equal(rollout.choice[:steps, row], choices[:, 0])
        assert torch.equal(rollout.reward_m[:steps, row], rewards[:, 0])
        assert torch.equal(rollout.rssi_dbm[: steps + 1, row], windows[:, 0])
        assert (bool(rollout.reached[row]), bool(rollout.truncated[row])) == (end == "reached", end == "truncated")


def test_two_rollouts_are_one_of_both_lengths():
    networks, (environment, state, streams) = new_networks(), start([2])
    whole, *_ = collect(environment, networks, state, NOTHING[:1], streams, 6)
    _, state, streams = start([2])
    first, state, _ = collect(environment, networks, state, NOTHING[:1], streams, 2)
    second, *_ = collect(environment, networks, state, NOTHING[:1], streams, 4)
    assert torch.equal(torch.cat([first.choice, second.choice]), whole.choice)
    assert torch.equal(torch.cat([first.rssi_dbm, second.rssi_dbm[1:]]), whole.rssi_dbm)
    assert torch.equal(torch.cat([first.reward_m, second.reward_m]), whole.reward_m)


def test_reaching_at_the_last_movement_is_termination_alone():
    """At MAX_STEPS and within the radius: reached, not truncated."""
    chase = next(chase for chase in range(12) if by_hand(new_networks(), chase, 9)[3] == "reached")
    steps = len(by_hand(new_networks(), chase, 9)[1])
    environment, state, streams = start([chase])
    state = replace(state, movements=torch.tensor([7 - steps]))
    rollout, state, _ = collect(environment, new_networks(), state, NOTHING[:1], streams, 9)
    assert state.movements.tolist() == [7]
    assert (rollout.reached.tolist(), rollout.truncated.tolist()) == ([True], [False])


def local_agent(index=0, num_agents=3, interval=2, chases_per_agent=1):
    settings = TrainingSettings(
        num_agents=num_agents, chases_per_agent=chases_per_agent, update_interval=interval, seed=6
    )
    agent = LocalAgent(NEAR, settings, index)
    agent.local.networks.load_state_dict(new_networks().state_dict())
    return agent


def work(agent):
    """One rollout and its gradient; the movements made."""
    rollout = agent.play()
    agent.compute_gradient(rollout)
    return int(rollout.valid.sum())


def test_an_agent_takes_every_nth_chase_and_books_it_as_played():
    agent, finished = local_agent(index=1), []
    for update in range(40):
        movements = work(agent)
        assert 1 <= movements <= 2
        finished.extend(agent.finished_chases(update))
    assert [chase.chase for chase in finished] == [1 + 3 * k for k in range(len(finished))]
    assert len(finished) >= 10
    assert sorted({chase.reached for chase in finished}) == [False, True]
    update = -1
    for chase in finished:
        _, choices, rewards, end = by_hand(new_networks(), chase.chase, 9)
        update += -(-len(choices) // 2)  # a chase of 5 movements takes 3 rollouts of 2
        assert (chase.agent, chase.movements, chase.reached) == (1, len(choices), end == "reached")
        assert chase.update == update
        assert chase.reward_m == pytest.approx(rewards.double().sum(dim=(0, 1)).tolist())


def test_an_agent_with_several_chases_plays_each_as_if_alone():
    """Agent 1 of 3 with two chases each begins with the chases 2 and 3; each is followed by the one 6 further on."""
    agent, finished, movements = local_agent(index=1, chases_per_agent=2), [], 0
    for update in range(40):
        movements += work(agent)
        finished.extend(agent.finished_chases(update))
    numbers = sorted(chase.chase for chase in finished)
    assert {number % 6 for number in numbers} == {2, 3}
    assert len(numbers) == len(set(numbers)) >= 20
    for chase in finished:
        _, choices, rewards, end = by_hand(new_networks(), chase.chase, 9)
        assert (chase.agent, chase.movements, chase.reached) == (1, len(choices), end == "reached")
        assert chase.reward_m == pytest.approx(rewards.double().sum(dim=(0, 1)).tolist())
    assert movements == sum(chase.movements for chase in finished) + int(agent.progress.movements.sum())


def test_the_gradient_of_several_chases_is_the_mean_of_each_alone():
    together = local_agent(num_agents=1, chases_per_agent=3)
    work(together)
    alone = [local_agent(index=index) for index in range(3)]
    for agent in alone:
        work(agent)
    mean = torch.stack([agent.local.gradient for agent in alone]).mean(dim=0)
    torch.testing.assert_close(together.local.gradient, mean, rtol=1e-4, atol=1e-6)
    assert mean.abs().max() > 0.01


def test_an_agents_gradient_is_that_of_its_losses():
    agent = local_agent(interval=3)
    networks, (environment, state, streams) = new_networks(), start([0])
    for _ in range(2):
        work(agent)
        rollout, state, _ = collect(environment, networks, state, NOTHING[:1], streams, 3)
        networks.zero_grad()
        rollout_loss(networks, rollout, LossSettings()).sum().backward()
        for mine, theirs in zip(agent.local.networks.parameters(), networks.parameters(), strict=True):
            torch.testing.assert_close(mine.grad, theirs.grad)
        assert agent.local.gradient.abs().max() > 0


def test_the_same_rollout_again_gives_the_same_gradient_and_not_its_double():
    """The trap of shared gradients: 1, 2, 3 where it should be 1, 1, 1."""
    agent = local_agent()
    before = agent.snapshot()
    gradients = []
    for _ in range(3):
        agent.restore(before)
        work(agent)
        gradients.append(agent.local.gradient.clone())
    assert gradients[0].abs().max() > 0
    assert torch.equal(gradients[1], gradients[0])
    assert torch.equal(gradients[2], gradients[0])


@pytest.mark.parametrize("updates", [0, 1, 3, 8])
def test_a_snapshot_written_down_goes_on_exactly(updates):
    agent = local_agent()
    for update in range(updates):
        work(agent)
        agent.finished_chases(update)
    snapshot = agent.snapshot()
    arrays = {name: array.copy() for name, array in snapshot.arrays.items()}
    restored = local_agent()
    restored.restore(AgentSnapshot(arrays, json.loads(json.dumps(snapshot.streams))))
    for update in range(12):
        assert work(restored) == work(agent)
        assert torch.equal(restored.local.gradient, agent.local.gradient)
        assert restored.finished_chases(update) == agent.finished_chases(update)
        assert torch.equal(restored.progress.number, agent.progress.number)


def test_a_snapshot_does_not_change_with_its_agent():
    agent = local_agent()
    work(agent)
    snapshot = agent.snapshot()
    kept = {name: array.copy() for name, array in snapshot.arrays.items()}, json.dumps(snapshot.streams)
    work(agent)
    assert json.dumps(snapshot.streams) == kept[1]
    for name, array in snapshot.arrays.items():
        assert (array == kept[0][name]).all()


def test_a_snapshot_that_lacks_something_is_refused_by_name():
    agent = local_agent()
    snapshot = agent.snapshot()
    del snapshot.arrays["agent0.state.center_m"]
    with pytest.raises(InputError, match=r"agent0\.state\.center_m"):
        agent.restore(snapshot)


def test_a_rollout_carries_no_graph():
    environment, state, streams = start([0])
    rollout, *_ = collect(environment, new_networks(), state, NOTHING[:1], streams, 3)
    assert not any(getattr(rollout, part.name).requires_grad for part in fields(Rollout))
