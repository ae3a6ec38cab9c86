"""A local agent: its own copy of the networks, its own chases, one rollout and its gradient at a time (Algorithm 1)."""

from dataclasses import dataclass, replace
from typing import Any

import torch
from numpy.typing import NDArray

from ..batch.array_types import Bool, Float, Int
from ..batch.selection import join_chases, pack, select_chases, unpack
from ..batch.streams import ChaseKey, ChaseStreams
from ..errors import InputError
from ..networks.actor_critic import NETWORK_NAMES
from ..networks.forms import new_networks
from ..scenario import Scenario
from ..world.departures import drawn_world
from ..world.environment import Environment, State
from .losses import rollout_loss
from .parameters import FlatNetworks
from .rollout import Rollout, collect
from .settings import TrainingSettings, training_seed
from .symmetry import mirrored

NEAREST_START = 1 / 40
"""Share of the distance at which a chase with a varied start may begin."""


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
class ChasesInPlay:
    """Where an agent stands in its chases: a batch as in ``swarmchase.batch.selection``."""

    number: Int[torch.Tensor, "chase"]
    """Number of each chase in the training."""
    state: State
    memory: Float[torch.Tensor, "chase memory"]
    """What the networks remember of each chase."""
    streams: ChaseStreams
    """Each chase's own random numbers for sampling actions."""
    movements: Int[torch.Tensor, "chase"]
    """Movements made in each chase."""
    reward_m: Float[torch.Tensor, "chase 4"]
    """Sums of R^d, R^x, R^y, R^z over each chase so far, float64."""
    reached: Bool[torch.Tensor, "chase"]
    """Ended at the target in the last rollout."""
    truncated: Bool[torch.Tensor, "chase"]
    """Ended at MAX_STEPS in the last rollout."""


@dataclass(frozen=True)
class AgentSnapshot:
    """An agent's progress, as a file or a message between processes can hold it."""

    arrays: dict[str, NDArray[Any]]
    streams: dict[str, Any]


class LocalAgent:
    """One of N agents with C chases each; C is 1 in the paper.

    Agent i begins with the chases i C ... i C + C - 1 of the training seed, and each that ends is followed by the one
    N C further on. The process trainer, the deterministic schedule and the cluster all run this same class.
    """

    def __init__(
        self, scenario: Scenario, settings: TrainingSettings, index: int, local: FlatNetworks | None = None
    ) -> None:
        """``local`` are its own copy of the networks; agents that take turns may share one, on any device."""
        self.local = FlatNetworks(new_networks(settings)) if local is None else local
        self._device = self.local.vector.device
        choices_m = scenario.displacement_choices_m
        if settings.mirrored and tuple(-metres for metres in reversed(choices_m)) != choices_m:
            raise InputError(f"mirrored is refused: displacement_choices_m = {choices_m} are not symmetric about 0")
        self._index = index
        self._settings = settings
        self._told = scenario
        seed = training_seed(settings.seed)
        self._environment = Environment(
            drawn_world(scenario, seed, index) if settings.varied_world else scenario, self._device
        )
        first = index * settings.chases_per_agent
        self.progress = self._begun(list(range(first, first + settings.chases_per_agent)))

    @property
    def passes_per_rollout(self) -> int:
        """Gradients to be made of each rollout."""
        return self._settings.passes_per_rollout

    def play(self) -> Rollout:
        """Play up to T movements with the local networks."""
        before = self.progress
        rollout, state, memory = collect(
            self._environment,
            self.local.networks,
            before.state,
            before.memory,
            before.streams,
            self._settings.update_interval,
            self._settings.spacing_exploration,
        )
        self.progress = replace(
            before,
            state=state,
            memory=memory,
            movements=before.movements + rollout.valid.sum(dim=0),
            reward_m=before.reward_m + (rollout.reward_m * rollout.valid[..., None]).double().sum(dim=0),
            reached=rollout.reached,
            truncated=rollout.truncated,
        )
        if self._settings.mirrored:
            return mirrored(rollout, (before.streams.uniform(3) < 0.5).to(self._device))
        return rollout

    def compute_gradient(self, rollout: Rollout) -> None:
        """Leave the gradient of a rollout's losses in ``local.gradient``."""
        self.local.gradient.zero_()
        loss = rollout_loss(self.local.networks, rollout, self._settings.losses)
        loss.sum().backward()  # type: ignore[no-untyped-call]
        if self._settings.max_gradient_norm is not None:
            norm = torch.linalg.vector_norm(self.local.gradient)
            self.local.gradient *= (self._settings.max_gradient_norm / norm).clamp(max=1)

    def finished_chases(self, update: int) -> list[FinishedChase]:
        """The chases that the last rollout ended; the next ones then stand in their place."""
        progress = self.progress
        rows = (progress.reached | progress.truncated).nonzero()[:, 0].tolist()
        if not rows:
            return []
        finished = [self._finished(row, update) for row in rows]
        stride = self._settings.num_agents * self._settings.chases_per_agent
        following = self._begun([int(progress.number[row]) + stride for row in rows])
        num_chases = len(progress.number)
        order = [num_chases + rows.index(row) if row in rows else row for row in range(num_chases)]
        self.progress = select_chases(join_chases(progress, following), order)
        return finished

    def snapshot(self) -> AgentSnapshot:
        """Where this agent stands between two rollouts."""
        tensors, positions = pack(self.progress, self._prefix)
        return AgentSnapshot({name: tensor.cpu().numpy().copy() for name, tensor in tensors.items()}, positions)

    def restore(self, snapshot: AgentSnapshot) -> None:
        """Go on where a snapshot was taken.

        Raises:
            InputError: the snapshot lacks something, or is not this agent's.
        """
        tensors = {name: torch.from_numpy(array).to(self._device) for name, array in snapshot.arrays.items()}
        progress = unpack(self.progress, self._prefix, tensors, snapshot.streams)
        self._require_own(progress)
        self.progress = progress

    def _require_own(self, progress: ChasesInPlay) -> None:
        """Each of its chases is followed by the one N C further on; what was heard may be missing (NaN), and nothing
        else."""
        further = progress.number - self.progress.number
        stride = self._settings.num_agents * self._settings.chases_per_agent
        state = progress.state
        known = (state.target_position_m, state.center_m, state.spacing_m, state.path_length_m, progress.memory)
        if ((progress.number < 0) | (further % stride != 0) | (progress.movements < 0)).any() or not all(
            part.isfinite().all() for part in (*known, progress.reward_m)
        ):
            raise InputError(f"resume state of {self._prefix} is not of its chases, or holds what is no number")

    @property
    def _prefix(self) -> str:
        return f"agent{self._index}"

    def _begun(self, numbers: list[int]) -> ChasesInPlay:
        keys: list[ChaseKey] = [(training_seed(self._settings.seed), number) for number in numbers]
        nothing = torch.zeros(len(keys), dtype=torch.bool, device=self._device)
        streams = ChaseStreams.of(keys, "policy")
        return ChasesInPlay(
            number=torch.tensor(numbers, device=self._device),
            state=self._environment.reset(keys, _nearness(streams) if self._settings.varied_start else None),
            memory=self.local.networks.begin(self._told, len(keys)).to(self._device),
            streams=streams,
            movements=torch.zeros(len(keys), dtype=torch.int64, device=self._device),
            reward_m=torch.zeros(len(keys), len(NETWORK_NAMES), dtype=torch.float64, device=self._device),
            reached=nothing,
            truncated=nothing,
        )

    def _finished(self, row: int, update: int) -> FinishedChase:
        progress = self.progress
        d, x, y, z = progress.reward_m[row].tolist()
        return FinishedChase(
            agent=self._index,
            chase=int(progress.number[row]),
            update=update,
            movements=int(progress.movements[row]),
            reached=bool(progress.reached[row]),
            reward_m=(d, x, y, z),
        )


def _nearness(streams: ChaseStreams) -> Float[torch.Tensor, "chase"]:
    """1 for half of the chases, log-uniform from a fortieth to 1 for the others."""
    uniform = streams.uniform(1)[:, 0]
    return NEAREST_START ** (2 * uniform - 1).clamp(min=0)
