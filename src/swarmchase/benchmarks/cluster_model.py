"""What an update costs on a cluster, and what that says for more agents than are there.

N agents go round and round: compute a gradient on a core of their own, hand it in, get fresh parameters. In between
they queue: for the network in and out of the head, for its raylet and for the global agent's process, which serve one
at a time. How many updates a second that gives is the mean value analysis of a closed queueing network (M. Reiser and
S. S. Lavenberg, J. ACM 27(2), 1980), exact for exponential service times; real ones vary less, so that near saturation
it promises a little too little.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import nnls

BITS_A_BYTE = 8


@dataclass(frozen=True)
class UpdateCost:
    """What one update costs, in seconds unless its name says otherwise."""

    agent_fixed_s: float
    """Of the agent's core, however little it plays."""
    agent_step_s: float
    """Of the agent's core for each movement of each chase."""
    global_agent_s: float
    """Of the global agent's process: unpack, Adam, pack."""
    raylet_s: float
    """Of the raylet on the global agent's node: it moves the messages."""
    delay_s: float
    """Of the way there and back beyond these, with nobody else on it."""
    message_bytes: int
    """A gradient; the parameters are as many."""

    def agent_s(self, chases_per_agent: int, update_interval: int) -> float:
        """Of the agent's core, with so many chases and T movements."""
        return self.agent_fixed_s + self.agent_step_s * chases_per_agent * update_interval

    def network_s(self, bits_per_s: float) -> float:
        """Of the head's network in each direction."""
        return BITS_A_BYTE * self.message_bytes / bits_per_s

    def demands_s(self, bits_per_s: float | None) -> dict[str, float]:
        """What an update asks of everything that all agents share; without a network where there is none."""
        shared = {"global agent": self.global_agent_s, "raylet": self.raylet_s}
        if bits_per_s is None:
            return shared
        return shared | {"network in": self.network_s(bits_per_s), "network out": self.network_s(bits_per_s)}


@dataclass(frozen=True)
class Prediction:
    """What so many agents do."""

    agents: int
    chases_per_agent: int
    update_interval: int
    updates_per_s: float
    steps_per_s: float
    """Movements of chases."""
    updates_behind: float
    """Mean staleness of a gradient: all the others' updates of one round."""
    busiest: str
    """What saturates first."""
    busy_share: float
    """Of its time."""


def predicted(
    cost: UpdateCost, agents: int, chases_per_agent: int, update_interval: int, bits_per_s: float | None
) -> Prediction:
    """Agents on a core each, all on other machines than the global agent, joined by a network."""
    demands_s = cost.demands_s(bits_per_s)
    updates_per_s = throughput(agents, cost.agent_s(chases_per_agent, update_interval) + cost.delay_s, demands_s)
    busiest = max(demands_s, key=lambda name: demands_s[name])
    return Prediction(
        agents,
        chases_per_agent,
        update_interval,
        updates_per_s,
        updates_per_s * chases_per_agent * update_interval,
        agents - 1.0,
        busiest,
        updates_per_s * demands_s[busiest],
    )


def throughput(customers: int, think_s: float, demands_s: Mapping[str, float]) -> float:
    """Rounds a second of all customers together: mean value analysis, customer by customer."""
    waiting = dict.fromkeys(demands_s, 0.0)
    rate = 0.0
    for number in range(1, customers + 1):
        stay_s = {name: demand_s * (1 + waiting[name]) for name, demand_s in demands_s.items()}
        rate = number / (think_s + sum(stay_s.values()))
        waiting = {name: rate * stay for name, stay in stay_s.items()}
    return rate


def saturating_agents(cost: UpdateCost, chases_per_agent: int, update_interval: int, bits_per_s: float | None) -> float:
    """Where the two asymptotes of the throughput meet: agents beyond so many mostly wait."""
    demands_s = cost.demands_s(bits_per_s)
    round_s = cost.agent_s(chases_per_agent, update_interval) + cost.delay_s + sum(demands_s.values())
    return round_s / max(demands_s.values())


def on_few_cores(cost: UpdateCost, agents: int, chases_per_agent: int, update_interval: int, cores: int) -> float:
    """Updates a second where agents, global agent and raylets share the cores of one machine: the lower of what the
    agents' rounds and what the cores allow."""
    agent_s = cost.agent_s(chases_per_agent, update_interval)
    # Both nodes of such a cluster have a raylet, and each message passes both.
    work_s = agent_s + cost.global_agent_s + 2 * cost.raylet_s
    alone = throughput(agents, agent_s + cost.delay_s, cost.demands_s(None))
    return min(alone, cores / work_s)


def fitted_line(x: Sequence[float | int], y: Sequence[float]) -> tuple[float, float]:
    """Intercept and slope, neither below zero, of the line with the smallest squares of relative errors."""
    values = np.asarray(y, dtype=np.float64)
    terms = np.stack([np.ones_like(values), np.asarray(x, dtype=np.float64)], axis=1)
    intercept, slope = nnls(terms / values[:, None], np.ones_like(values))[0]
    return float(intercept), float(slope)
