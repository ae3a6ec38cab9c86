"""A local agent: its own copy of the networks, its own chase, one rollout and one gradient at a time (Algorithm 1)."""

from dataclasses import dataclass
from typing import Any

import torch
from numpy.typing import NDArray

from ..batching import pack, unpack
from ..environment import Environment, State
from ..networks import SwarmNetworks
from ..scenario import Scenario
from ..streams import ChaseKey, ChaseStreams
from .losses import LossSettings, rollout_loss
from .parameters import FlatNetworks
from .rollout import Rollout, collect


@dataclass(frozen=True)
class FinishedChase:
    """What the training log keeps of one chase."""

    agent: int
    chase: int
    update: int
    """Global updates made when it ended."""
    movements: int
    reached: bool
    reward_m: tuple[float, float, float, float]
    """Sum of R^d, R^x, R^y, R^z over the chase."""


@dataclass(frozen=True)
class _Progress:
    """The part of an agent that is a batch of one chase."""

    state: State
    streams: ChaseStreams


@dataclass(frozen=True)
class AgentSnapshot:
    """Where an agent stands in its chase, as a file or a message between processes can hold it."""

    arrays: dict[str, NDArray[Any]]
    document: dict[str, Any]


class LocalAgent:
    """One of N agents. Agent i takes the chases i, i + N, i + 2N, ... of the training seed.

    The process trainer, the deterministic schedule and the cluster all run this same class.
    """

    def __init__(
        self, index: int, num_agents: int, seed: int, scenario: Scenario, settings: LossSettings, update_interval: int
    ) -> None:
        self.local = FlatNetworks(SwarmNetworks())
        self._index = index
        self._num_agents = num_agents
        self._seed = seed
        self._environment = Environment(scenario)
        self._settings = settings
        self._update_interval = update_interval
        self._begin_chase(index)

    chase: int
    """Number of the chase it is in."""
    state: State
    streams: ChaseStreams
    """The chase's own random numbers for sampling actions."""
    reward_m: tuple[float, float, float, float]
    """Sums of R^d, R^x, R^y, R^z over the chase so far."""

    def compute_gradient(self) -> int:
        """Play up to T movements and leave their losses' gradient in ``local.gradient``; returns the movements made."""
        rollout, self.state = collect(
            self._environment, self.local.networks, self.state, self.streams, self._update_interval
        )
        self.local.gradient.zero_()
        rollout_loss(self.local.networks, rollout, self._settings).sum().backward()  # type: ignore[no-untyped-call]
        self._count(rollout)
        return len(rollout.choice)

    def finished_chase(self, update: int) -> FinishedChase | None:
        """The chase that the last rollout ended, if it did; the next chase then stands ready."""
        if not self._ended:
            return None
        finished = FinishedChase(
            self._index, self.chase, update, int(self.state.movements), self._reached, self.reward_m
        )
        self._begin_chase(self.chase + self._num_agents)
        return finished

    def snapshot(self) -> AgentSnapshot:
        """Where this agent stands between two rollouts."""
        tensors, positions = pack(self._progress(), self._prefix)
        arrays = {name: tensor.numpy().copy() for name, tensor in tensors.items()}
        return AgentSnapshot(arrays, {"chase": self.chase, "reward_m": self.reward_m, "streams": positions})

    def restore(self, snapshot: AgentSnapshot) -> None:
        """Go on with a chase where a snapshot left it.

        Raises:
            InputError: the snapshot lacks something.
        """
        tensors = {name: torch.from_numpy(array) for name, array in snapshot.arrays.items()}
        progress = unpack(self._progress(), self._prefix, tensors, snapshot.document["streams"])
        self.state, self.streams = progress.state, progress.streams
        self.chase = snapshot.document["chase"]
        d, x, y, z = snapshot.document["reward_m"]
        self.reward_m = (d, x, y, z)

    @property
    def _prefix(self) -> str:
        return f"agent{self._index}"

    def _progress(self) -> _Progress:
        return _Progress(self.state, self.streams)

    def _begin_chase(self, chase: int) -> None:
        keys: list[ChaseKey] = [(self._seed, chase)]
        self.chase = chase
        self.state = self._environment.reset(keys)
        self.streams = ChaseStreams.of(keys, "policy")
        self.reward_m = (0.0, 0.0, 0.0, 0.0)
        self._ended = self._reached = False

    def _count(self, rollout: Rollout) -> None:
        won_m = rollout.reward_m.double().sum(dim=(0, 1)).tolist()
        d, x, y, z = (before + won for before, won in zip(self.reward_m, won_m, strict=True))
        self.reward_m = (d, x, y, z)
        self._reached = bool(rollout.reached)
        self._ended = self._reached or bool(rollout.truncated)
