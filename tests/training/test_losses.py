"""The losses of Algorithm 1 with a pencil, their gradients against formulas, batches against single chases."""

import math
from dataclasses import fields, replace

import pytest
import torch

from swarmchase.batch.streams import ChaseStreams, chase_keys
from swarmchase.errors import InputError
from swarmchase.networks.actor_critic import SwarmNetworks
from swarmchase.scenario import paper_scenario
from swarmchase.training.losses import (
    LossSettings,
    actor_critic_loss,
    counterfactual_loss,
    lambda_returns,
    rollout_loss,
)
from swarmchase.training.rollout import Rollout, collect
from swarmchase.world.environment import Environment

LN2 = math.log(2)
HALVING = [1 / 2, 1 / 4, 1 / 8, 1 / 16, 1 / 16]
"""A policy whose logarithms are -1, -2, -3, -4, -4 times ln 2."""
HALVING_ENTROPY = (1 / 2 + 2 / 4 + 3 / 8 + 4 / 16 + 4 / 16) * LN2  # 1.875 ln 2
BY_HAND = LossSettings(discount=0.5, entropy_coefficient=0.1)


def per_step(*numbers, chases=1):
    """The same numbers for each network, [step, chase, 4]."""
    return torch.tensor(numbers, dtype=torch.float64)[:, None, None].expand(-1, chases, 4).clone()


@pytest.mark.parametrize(
    ("reward", "valid", "bootstrap", "discount", "returns"),
    [
        # Nothing is discounted: what is still to come.
        ([4, 0, -2], [1, 1, 1], 0, 1.0, [2, -2, -2]),
        # -2 + 8 / 2 = 2, 0 + 2 / 2 = 1, 4 + 1 / 2 = 4.5.
        ([4, 0, -2], [1, 1, 1], 8, 0.5, [4.5, 1, 2]),
        # The same chase ended: -2, 0 - 2 / 2, 4 - 1 / 2.
        ([4, 0, -2], [1, 1, 1], 0, 0.5, [3.5, -1, -2]),
        # Only the next reward counts.
        ([4, 0, -2], [1, 1, 1], 8, 0.0, [4, 0, -2]),
        # Ended after two steps; what came later is not the chase's.
        ([4, 2, -100], [1, 1, 0], 0, 0.5, [5, 2, None]),
        # Cut off after one step with the value of its last window.
        ([4, -100, -100], [1, 0, 0], 6, 0.5, [7, None, None]),
        # One step and the paper's gamma.
        ([1], [1], 1, 0.99, [1.99]),
    ],
)
def test_returns_by_hand(reward, valid, bootstrap, discount, returns):
    found = lambda_returns(
        per_step(*map(float, reward)),
        torch.full((len(reward), 1, 4), 1e6, dtype=torch.float64),  # lambda = 1: no value counts
        torch.tensor(valid, dtype=torch.bool)[:, None],
        torch.full((1, 4), float(bootstrap), dtype=torch.float64),
        LossSettings(discount=discount),
    )
    for step, expected in enumerate(returns):
        if expected is not None:
            assert found[step, 0].tolist() == pytest.approx([expected] * 4)


@pytest.mark.parametrize(
    ("gae_lambda", "valid", "returns"),
    [
        # gamma 1/2, rewards 4, 0, -2, values 1, 3, 3 and 8 after the last.
        (0.0, [1, 1, 1], [4 + 3 / 2, 0 + 3 / 2, -2 + 8 / 2]),
        (0.5, [1, 1, 1], [4 + (1.25 + 3) / 4, 0 + (2 + 3) / 4, 2]),
        # Over after two steps: the 8 is the value after the second.
        (0.5, [1, 1, 0], [4 + (4 + 3) / 4, 0 + 8 / 2, None]),
        (0.0, [1, 1, 0], [4 + 3 / 2, 4, None]),
    ],
)
def test_lambda_returns_by_hand(gae_lambda, valid, returns):
    found = lambda_returns(
        per_step(4.0, 0.0, -2.0),
        per_step(1.0, 3.0, 3.0),
        torch.tensor(valid, dtype=torch.bool)[:, None],
        torch.full((1, 4), 8.0, dtype=torch.float64),
        LossSettings(discount=0.5, gae_lambda=gae_lambda),
    )
    for step, expected in enumerate(returns):
        if expected is not None:
            assert found[step, 0].tolist() == pytest.approx([expected] * 4)


# Three steps by hand: rewards 4, 0, -2, values 1, 3, 3, choices 0, 2, 4 of the halving policy, gamma 1/2, beta 1/10.
# In every case L = 1/3 [ln 2 (1 ADV_0 + 3 ADV_1 + 4 ADV_2) + L_V - 0.1 * 3 * 1.875 ln 2].
ENTROPY_TERM = -0.1 * 3 * HALVING_ENTROPY
N_STEP_RUNNING = ((1 * 3.5 + 3 * -2 + 4 * -1) * LN2 + 3.5 + 2 + 1 + ENTROPY_TERM) / 3
"""V(S_3) = 8: returns 4.5, 1, 2, advantages 3.5, -2, -1."""
N_STEP_ENDED = ((1 * 2.5 + 3 * -4 + 4 * -5) * LN2 + 2.5 + 4 + 5 + ENTROPY_TERM) / 3
"""Returns 3.5, -1, -2, advantages 2.5, -4, -5."""
ONE_STEP_RUNNING = ((1 * 3.5 + 3 * -2 + 4 * -1) * LN2 + 4.5 + 1.5 + 1 + ENTROPY_TERM) / 3
"""Temporal differences 4 + 3/2 - 1 = 4.5, 0 + 3/2 - 3 = -1.5, -2 + 8/2 - 3 = -1; the advantage stays n-step."""
ONE_STEP_ENDED = ((1 * 2.5 + 3 * -4 + 4 * -5) * LN2 + 4.5 + 1.5 + 5 + ENTROPY_TERM) / 3
"""The last difference is -2 + 0 - 3 = -5."""


class ScriptedNetworks(SwarmNetworks):
    """Answers the halving policy, and to each window the value that the test wrote into its first sample."""

    def forward(self, rssi_dbm):
        logits = torch.tensor(HALVING, dtype=torch.float64).log().expand(len(rssi_dbm), 4, 5)
        return logits, rssi_dbm[:, 0, :1].expand(-1, 4)


def scripted_rollout(values, reward, choice, steps, reached=False, truncated=False):
    """One chase of ``steps`` valid steps; ``values`` are V(S_0), V(S_1), ..."""
    return Rollout(
        rssi_dbm=torch.tensor(values, dtype=torch.float64)[:, None, None, None].expand(-1, 1, 2, 6),
        tracker_position_m=torch.zeros(len(values), 1, 6, 3),
        memory=torch.zeros(1, 0),
        choice=torch.tensor(choice)[:, None, None].expand(-1, 1, 4),
        logits=torch.tensor(HALVING, dtype=torch.float64).log().expand(len(reward), 1, 4, 5),
        reward_m=per_step(*reward),
        counterfactual_reward_m=torch.zeros(len(reward), 1, 3, 5, dtype=torch.float64),
        unfaded_dbm=torch.zeros(len(reward), 1, 6, dtype=torch.float64),
        valid=torch.arange(len(reward))[:, None] < steps,
        reached=torch.tensor([reached]),
        truncated=torch.tensor([truncated]),
    )


def together(first, second):
    """Two chases' rollouts as one of a batch of two."""
    ends = ("reached", "truncated", "memory")
    return Rollout(
        **{
            part.name: torch.cat(
                [getattr(first, part.name), getattr(second, part.name)], dim=0 if part.name in ends else 1
            )
            for part in fields(Rollout)
        }
    )


@pytest.mark.parametrize(
    ("ends", "settings", "loss"),
    [
        ({}, BY_HAND, N_STEP_RUNNING),
        ({}, replace(BY_HAND, bootstrap_at_truncation=True), N_STEP_RUNNING),
        ({"reached": True}, BY_HAND, N_STEP_ENDED),
        ({"reached": True}, replace(BY_HAND, bootstrap_at_truncation=True), N_STEP_ENDED),
        ({"truncated": True}, BY_HAND, N_STEP_ENDED),
        ({"truncated": True}, replace(BY_HAND, bootstrap_at_truncation=True), N_STEP_RUNNING),
        ({}, replace(BY_HAND, value_loss="one_step"), ONE_STEP_RUNNING),
        ({"reached": True}, replace(BY_HAND, value_loss="one_step"), ONE_STEP_ENDED),
        ({"truncated": True}, replace(BY_HAND, value_loss="one_step"), ONE_STEP_ENDED),
        (
            {"truncated": True},
            replace(BY_HAND, value_loss="one_step", bootstrap_at_truncation=True),
            ONE_STEP_RUNNING,
        ),
    ],
)
def test_three_steps_by_hand(ends, settings, loss):
    rollout = scripted_rollout([1, 3, 3, 8], (4.0, 0.0, -2.0), [0, 2, 4], steps=3, **ends)
    assert rollout_loss(ScriptedNetworks(), rollout, settings).tolist() == pytest.approx([loss] * 4)


@pytest.mark.parametrize("value_loss", ["n_step", "one_step"])
@pytest.mark.parametrize(
    ("ends", "bootstraps", "last_value"),
    [("reached", False, 0), ("reached", True, 0), ("truncated", False, 0), ("truncated", True, 3)],
)
def test_a_chase_that_ends_within_a_batch_counts_no_further(value_loss, ends, bootstraps, last_value):
    """It ends after its first step: one step with reward 4, V(S_0) = 1, choice 0, and V(S_1) = 3 only where it is
    cut off and keeps its bootstrap. What comes later is absurd and counts nowhere."""
    advantage = 4 + 0.5 * last_value - 1
    alone = 1 * LN2 * advantage + advantage - 0.1 * HALVING_ENTROPY
    short = scripted_rollout([1, 3, 1e6, -1e6], (4.0, 1e6, 1e6), [0, 4, 4], steps=1, **{ends: True})
    running = scripted_rollout([1, 3, 3, 8], (4.0, 0.0, -2.0), [0, 2, 4], steps=3)
    both = together(running, short)
    settings = replace(BY_HAND, value_loss=value_loss, bootstrap_at_truncation=bootstraps)
    other = N_STEP_RUNNING if value_loss == "n_step" else ONE_STEP_RUNNING
    # Each chase is averaged over its own steps, then the chases are averaged.
    loss = rollout_loss(ScriptedNetworks(), both, settings)
    assert loss.tolist() == pytest.approx([(other + alone) / 2] * 4)


def test_each_network_has_its_own_reward_value_and_choice():
    """One step, gamma irrelevant: L = -log pi ADV + |ADV| - beta H with another ADV and another choice in each."""
    rollout = replace(
        scripted_rollout([0, 0], (0.0,), [0], steps=1),
        choice=torch.tensor([[[0, 1, 2, 3]]]),
        reward_m=torch.tensor([[[4.0, 2, 2, -2]]]).double(),
    )
    loss = actor_critic_loss(
        rollout.logits,
        value=torch.tensor([[[0.0, 1, 2, 3]]]).double(),
        rollout=rollout,
        bootstrap_value=torch.zeros(1, 4).double(),
        settings=BY_HAND,
    )
    # Advantages 4, 1, 0, -5; -log pi is 1, 2, 3, 4 ln 2.
    entropy_term = -0.1 * HALVING_ENTROPY
    expected = [4 * LN2 + 4, 2 * LN2 + 1, 0, -20 * LN2 + 5]
    assert loss[:].tolist() == pytest.approx([number + entropy_term for number in expected])


def test_the_defaults_are_table_one():
    assert LossSettings() == LossSettings(
        objective="actor_critic",
        discount=0.99,
        gae_lambda=1.0,
        entropy_coefficient=0.01,
        bootstrap_at_truncation=False,
        value_loss="n_step",
    )


def random_case(seed, steps=3):
    generator = torch.Generator().manual_seed(seed)
    logits = torch.randn(steps, 1, 4, 5, generator=generator, dtype=torch.float64, requires_grad=True)
    value = torch.randn(steps, 1, 4, generator=generator, dtype=torch.float64, requires_grad=True)
    reward = torch.randn(steps, 1, 4, generator=generator, dtype=torch.float64)
    choice = torch.randint(5, (steps, 1, 4), generator=generator)
    bootstrap = torch.randn(1, 4, generator=generator, dtype=torch.float64)
    return logits, value, choice, reward, bootstrap


@pytest.mark.parametrize("value_loss", ["n_step", "one_step"])
@pytest.mark.parametrize("seed", range(3))
def test_gradients_are_those_of_the_formula_written_by_hand(value_loss, seed):
    """d L / d V(S_k) = -sign(error_k) / T: the value learns through V(S_k) alone, neither through the advantage in the
    policy loss nor through the next value. d L / d logits = [ADV (pi - onehot) + beta pi (log pi + H)] / T."""
    logits, value, choice, reward, bootstrap = random_case(seed)
    settings = replace(BY_HAND, value_loss=value_loss)
    rollout = replace(scripted_rollout([0] * 4, (0.0,) * 3, [0] * 3, steps=3), choice=choice, reward_m=reward)
    actor_critic_loss(logits, value, rollout, bootstrap, settings).sum().backward()
    v, r, b = value.detach()[:, 0], reward[:, 0], bootstrap[0]
    g2 = r[2] + 0.5 * b
    g1 = r[1] + 0.5 * g2
    g0 = r[0] + 0.5 * g1
    advantage = torch.stack([g0, g1, g2]) - v
    difference = torch.stack([r[0] + 0.5 * v[1] - v[0], r[1] + 0.5 * v[2] - v[1], g2 - v[2]])
    error = advantage if value_loss == "n_step" else difference
    torch.testing.assert_close(value.grad[:, 0], -error.sign() / 3)
    policy = logits.detach()[:, 0].softmax(-1)
    log_policy, taken = policy.log(), torch.nn.functional.one_hot(choice[:, 0], 5)
    entropy = -(policy * log_policy).sum(-1, keepdim=True)
    by_hand = (advantage[..., None] * (policy - taken) + 0.1 * policy * (log_policy + entropy)) / 3
    torch.testing.assert_close(logits.grad[:, 0], by_hand)


@pytest.mark.parametrize("bootstraps", [False, True])
def test_nothing_flows_through_the_bootstrap(bootstraps):
    """The last window's value is a target: with the chase's own windows' values held, it moves no parameter."""
    networks, rollout = SwarmNetworks(torch.Generator().manual_seed(0)), chases_that_end_apart()[0]
    value_bias = networks.by_name["x"].value_head.bias
    rollout_loss(networks, rollout, LossSettings(bootstrap_at_truncation=bootstraps)).sum().backward()
    # d V / d (bias of the value head) is 10 m: each valid step gives -10 sign(ADV) / T / chases.
    _, values = networks(rollout.rssi_dbm.flatten(0, 1))
    values = values.detach().view(*rollout.rssi_dbm.shape[:2], 4)
    ended = rollout.reached if bootstraps else rollout.reached | rollout.truncated
    expected = 0.0
    for chase in range(3):
        steps = int(rollout.valid[:, chase].sum())
        following = 0.0 if ended[chase] else float(values[steps, chase, 1])
        for step in reversed(range(steps)):
            following = float(rollout.reward_m[step, chase, 1]) + 0.99 * following
            expected -= 10 * math.copysign(1, following - float(values[step, chase, 1])) / steps / 3
    assert value_bias.grad.item() == pytest.approx(expected, abs=1e-4)


def chases_that_end_apart():
    """Three chases as a batch and alone: one reaches its target, one is cut off early, one goes on."""
    scenario = paper_scenario(start_distance_m=6.0, success_radius_m=4.0, max_movements=7, window_samples=3)
    environment, networks = Environment(scenario), SwarmNetworks(torch.Generator().manual_seed(0))

    def batch(rows):
        keys = [chase_keys(4, 1, row)[0] for row in rows]
        state = environment.reset(keys)
        # Movements are counted from where the table has them: the second chase has two left.
        movements = torch.tensor([5 if row == ROWS[1] else 0 for row in rows])
        state = replace(state, movements=movements)
        return collect(environment, networks, state, torch.zeros(len(keys), 0), ChaseStreams.of(keys, "policy"), 5)[0]

    return batch(ROWS), [batch([row]) for row in ROWS]


ROWS = [4, 1, 2]


def in_float64(rollout):
    return replace(
        rollout,
        **{
            name: getattr(rollout, name).double()
            for name in ("rssi_dbm", "logits", "reward_m", "counterfactual_reward_m")
        },
    )


@pytest.mark.parametrize("value_loss", ["n_step", "one_step"])
@pytest.mark.parametrize("bootstraps", [False, True])
def test_a_batchs_gradient_is_the_mean_of_its_chases_gradients(value_loss, bootstraps):
    batch, singles = chases_that_end_apart()
    assert [len(single.choice) for single in singles] == batch.valid.sum(dim=0).tolist()
    assert batch.reached.tolist() == [True, False, False]
    assert batch.truncated.tolist() == [False, True, False]
    assert batch.valid.sum(dim=0)[:2].max() < len(batch.valid) == 5
    settings = LossSettings(value_loss=value_loss, bootstrap_at_truncation=bootstraps)
    networks = SwarmNetworks(torch.Generator().manual_seed(9)).double()

    def gradient(rollout):
        networks.zero_grad()
        rollout_loss(networks, in_float64(rollout), settings).sum().backward()
        return torch.cat([parameter.grad.flatten() for parameter in networks.parameters()])

    mean = sum(gradient(single) for single in singles) / 3
    assert mean.abs().max() > 0.01
    # The weights 1 / (steps * chases) are float32 numbers.
    assert (gradient(batch) - mean).norm() < 1e-6 * mean.norm()


@pytest.mark.parametrize(
    ("setting", "value", "allowed"),
    [
        ("discount", -0.1, "between 0 and 1"),
        ("discount", 1.5, "between 0 and 1"),
        ("discount", float("nan"), "between 0 and 1"),
        ("gae_lambda", 1.01, "between 0 and 1"),
        ("clip_range", 0.0, "greater than 0"),
        ("temperature_m", float("nan"), "greater than 0"),
        ("entropy_coefficient", -1.0, "at least 0"),
        ("entropy_coefficient", float("inf"), "at least 0"),
    ],
)
def test_a_setting_outside_its_range_is_refused(setting, value, allowed):
    with pytest.raises(InputError, match=f"{setting} = {value} is refused: allowed is {allowed}"):
        LossSettings(**{setting: value})


def test_ppo_at_the_policy_that_played_has_the_gradient_of_actor_critic():
    """The ratio is 1: its gradient is that of the logarithm."""
    gradients = []
    for objective in ("actor_critic", "ppo"):
        rollout = scripted_rollout([1, 3, 3, 8], (4.0, 0.0, -2.0), [0, 2, 4], steps=3)
        logits = rollout.logits.clone().requires_grad_()
        value = torch.tensor([1.0, 3, 3]).double()[:, None, None].expand(-1, 1, 4)
        loss = actor_critic_loss(
            logits, value, rollout, torch.zeros(1, 4).double(), replace(BY_HAND, objective=objective)
        )
        loss.sum().backward()
        gradients.append(logits.grad)
    assert gradients[0].abs().max() > 0.1
    torch.testing.assert_close(gradients[0], gradients[1])


@pytest.mark.parametrize(
    ("advantage", "probability", "loss"),
    [
        # It was 1/2; the ratio is twice the probability, and leaves 1 by at most a fifth.
        (2, 0.5, -2.0),
        (2, 0.55, -2.2),
        (2, 0.9, -2.4),
        (2, 0.1, -0.4),
        (-2, 0.9, 3.6),
        (-2, 0.1, 1.6),
        (-2, 0.45, 1.8),
    ],
)
def test_ppo_clips_what_is_earned_and_not_what_is_lost(advantage, probability, loss):
    policy = torch.tensor([probability, *[(1 - probability) / 4] * 4], dtype=torch.float64)
    rollout = scripted_rollout([0, 0], (float(advantage),), [0], steps=1)
    found = actor_critic_loss(
        policy.log().expand(1, 1, 4, 5),
        torch.zeros(1, 1, 4).double(),
        rollout,
        torch.zeros(1, 4).double(),
        LossSettings(objective="ppo", entropy_coefficient=0.0),
    )
    assert (found - abs(advantage)).tolist() == pytest.approx([loss] * 4)  # L_V is |ADV|


def test_all_actions_earn_their_expected_reward_and_the_spacing_its_own():
    """x, y, z: -(4/2 + 2/4 + 0/8 - 2/16 - 4/16) = -2.125; d: 2 ln 2 ADV, choice 1 of the halving policy, ADV = 3."""
    rollout = replace(
        scripted_rollout([0, 0], (3.0,), [1], steps=1),
        counterfactual_reward_m=torch.tensor([4.0, 2, 0, -2, -4]).double().expand(1, 1, 3, 5),
    )
    settings = LossSettings(objective="all_actions", entropy_coefficient=0.0)
    found = actor_critic_loss(
        rollout.logits, torch.zeros(1, 1, 4).double(), rollout, torch.zeros(1, 4).double(), settings
    )
    assert (found - 3).tolist() == pytest.approx([6 * LN2, -2.125, -2.125, -2.125])


def test_counterfactual_regression_by_hand():
    """Two steps, temperature 1/2 m: predictions are half the logits; errors count in units of 4 m."""
    rollout = replace(
        scripted_rollout([0, 0, 0], (1.0, 3.0), [2, 0], steps=2),
        counterfactual_reward_m=torch.tensor([4.0, 2, 0, -2, -4]).double().expand(2, 1, 3, 5),
    )
    logits = torch.zeros(2, 1, 4, 5, dtype=torch.float64)
    logits[0, 0, 0, 2] = 2.0  # the spacing's chosen output says 1 m; the movement after wins 3 m
    logits[1, 0, 0] = 100.0  # the last step's has no movement after it
    logits[:, :, 2] = torch.tensor([8.0, 4, 0, -4, -8])  # y is right
    logits[:, :, 3, 0] = 8.0  # z is right in its first choice alone
    loss = counterfactual_loss(logits, rollout, LossSettings(objective="counterfactual", temperature_m=0.5))
    x = (16 + 4 + 0 + 4 + 16) / 5 / 16
    assert loss.tolist() == pytest.approx([4 / 16, x, 0, (4 + 0 + 4 + 16) / 5 / 16])


def test_counterfactual_regression_leaves_out_what_came_after_a_chases_end():
    long = replace(scripted_rollout([0] * 4, (1.0, 3.0, 2.0), [2, 0, 1], steps=3))
    short = scripted_rollout([0] * 4, (1.0, 1e6, 1e6), [2, 0, 1], steps=1)
    short = replace(
        short,
        counterfactual_reward_m=short.counterfactual_reward_m + torch.tensor([4.0, 1e6, 1e6])[:, None, None, None],
    )
    both = together(long, short)
    settings = LossSettings(objective="counterfactual")
    loss = counterfactual_loss(torch.zeros(3, 2, 4, 5).double(), both, settings)
    # Spacing: only the long chase's two steps are followed, by 3 m and 2 m. Axes: the long one's are right.
    assert loss.tolist() == pytest.approx([(9 + 4) / 2 / 16, *[(0 + 16) / 2 / 16] * 3])
