"""The global agent: the shared parameters of the four networks, and one shared Adam over them.

Where agents are processes all of its state lies in shared memory, so that any of them can hand in a gradient under the
lock; the result is that of one serial Adam.
"""

import dataclasses
from contextlib import AbstractContextManager
from dataclasses import dataclass

import torch
from torch.optim.adam import adam

from ..processes.shared_memory import share
from .parameters import FlatNetworks


@dataclass(frozen=True)
class SharedParameters:
    """What all agents share."""

    vector: torch.Tensor
    """theta^d, theta^x, theta^y, theta^z as one flat vector, float32."""
    first_moment: torch.Tensor
    second_moment: torch.Tensor
    updates: torch.Tensor
    """Updates made so far: Adam's step, a float32 scalar (exact to 16.7 million)."""

    @classmethod
    def start(cls, vector: torch.Tensor) -> "SharedParameters":
        """Before the first update."""
        return cls(vector.clone(), torch.zeros_like(vector), torch.zeros_like(vector), torch.zeros(()))

    def on(self, device: str) -> "SharedParameters":
        """The same on the device of a single process."""
        return SharedParameters(**{part.name: getattr(self, part.name).to(device) for part in dataclasses.fields(self)})

    def share(self) -> None:
        """Move all of it to memory that several processes see.

        Raises:
            InputError: there is no room.
        """
        for part in dataclasses.fields(self):
            share(getattr(self, part.name))


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
            self._step(gradient, self._learning_rate.at(self.updates))
            return True

    @torch.no_grad()
    def _step(self, gradient: torch.Tensor, learning_rate: float) -> None:
        """As ``torch.optim.Adam(fused=True)``, whose making alone loads torch's compiler: seconds in every process."""
        adam(
            [self._shared.vector],
            [gradient],
            [self._shared.first_moment],
            [self._shared.second_moment],
            [],
            [self._shared.updates],
            fused=True,
            amsgrad=False,
            beta1=0.9,
            beta2=0.999,
            lr=learning_rate,
            weight_decay=0.0,
            eps=1e-8,
            maximize=False,
        )
