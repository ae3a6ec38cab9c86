"""The global agent: the shared parameters of the four networks, and one shared Adam over them.

All of its state lies in shared memory, so that any process can hand in a gradient under the lock; the result
is that of one serial Adam. Adam's state is filled in beforehand: left to itself each process would make its own.
"""

import dataclasses
from contextlib import AbstractContextManager
from dataclasses import dataclass

import torch

from .parameters import FlatNetworks


@dataclass(frozen=True)
class SharedParameters:
    """What all processes share; every tensor lies in shared memory."""

    vector: torch.Tensor
    """theta^d, theta^x, theta^y, theta^z as one flat vector, float32."""
    first_moment: torch.Tensor
    second_moment: torch.Tensor
    updates: torch.Tensor
    """Updates made so far: Adam's step, a float32 scalar (exact to 16.7 million)."""

    @classmethod
    def start(cls, vector: torch.Tensor) -> "SharedParameters":
        """Before the first update."""
        return cls(vector.clone(), torch.zeros_like(vector), torch.zeros_like(vector), torch.zeros(())).shared()

    def shared(self, device: str = "cpu") -> "SharedParameters":
        """The same tensors where all agents reach them: in shared memory, or on the device of a single process."""
        if device != "cpu":
            moved = {part.name: getattr(self, part.name).to(device) for part in dataclasses.fields(self)}
            return SharedParameters(**moved)
        for tensor in (self.vector, self.first_moment, self.second_moment, self.updates):
            tensor.share_memory_()  # type: ignore[no-untyped-call]
        return self


@dataclass(frozen=True)
class LearningRate:
    """The learning rate as a function of the updates made: linear from ``start`` to ``end`` over ``updates``."""

    start: float
    end: float
    updates: int

    def at(self, update: int) -> float:
        """The rate of this update, counted from 0."""
        return self.start + (self.end - self.start) * min(1.0, update / self.updates)


class GlobalAgent:
    """Applies gradients in the order they arrive, one at a time."""

    def __init__(
        self,
        shared: SharedParameters,
        lock: AbstractContextManager[object],
        learning_rate: LearningRate,
        max_updates: int,
    ) -> None:
        self._shared = shared
        self._lock = lock
        self._learning_rate = learning_rate
        self._max_updates = max_updates
        self._parameter = torch.nn.Parameter(shared.vector)
        self._adam = torch.optim.Adam([self._parameter], lr=learning_rate.start, fused=True)
        self._adam.state[self._parameter] = {
            "step": shared.updates,
            "exp_avg": shared.first_moment,
            "exp_avg_sq": shared.second_moment,
        }

    @property
    def updates(self) -> int:
        """Updates made so far by all agents."""
        return int(self._shared.updates)

    @property
    def finished(self) -> bool:
        """Whether the last update has been made."""
        return self.updates >= self._max_updates

    def synchronise(self, local: FlatNetworks) -> None:
        """Copy the global parameters to an agent's own."""
        with self._lock:
            local.vector.copy_(self._shared.vector)

    def snapshot(self) -> SharedParameters:
        """A consistent copy of everything, for a checkpoint or an evaluation."""
        with self._lock:
            return SharedParameters(
                self._shared.vector.clone(),
                self._shared.first_moment.clone(),
                self._shared.second_moment.clone(),
                self._shared.updates.clone(),
            )

    def update(self, gradient: torch.Tensor) -> bool:
        """theta <- Adam(theta, gradient); False where the last update had already been made."""
        with self._lock:
            if self.finished:
                return False
            self._adam.param_groups[0]["lr"] = self._learning_rate.at(self.updates)
            self._parameter.grad = gradient
            self._adam.step()
            return True
