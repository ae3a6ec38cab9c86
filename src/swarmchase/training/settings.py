"""What defines an A3C run, and the named presets."""

import dataclasses
import math
from dataclasses import dataclass, field
from typing import Any, Literal

from ..errors import InputError
from .losses import LossSettings

Schedule = Literal["processes", "deterministic"]
"""Asynchronous processes, or the same agents in turn in one process: bit-reproducible."""


MOST_UPDATES = 2**24
"""Adam counts its updates in float32, which is exact up to here."""


@dataclass(frozen=True, kw_only=True)
class A3CSettings:
    """An A3C run. The defaults are Table I.

    Raises:
        InputError: a number outside its range.
    """

    num_agents: int = 8
    """Number of local agents (Table I)."""
    chases_per_agent: int = 1
    """Chases a local agent plays at a time; its gradient is their average. The paper's agents play one."""
    update_interval: int = 5
    """T, movements between two updates (Table I)."""
    learning_rate: float = 1e-5
    """Adam's learning rate (Table I)."""
    final_learning_rate: float | None = None
    """Falls linearly to this over the run; None keeps it constant, as in the paper."""
    losses: LossSettings = field(default_factory=LossSettings)
    """Discount, entropy bonus, value loss and the cut at MAX_STEPS."""
    max_updates: int = 200_000
    """Updates of the global networks; the paper's EPISODES are not stated."""
    seed: int = 0
    """Seed of the training's chases, initial weights and actions."""
    evaluation_interval: int = 5_000
    """Updates between two evaluations by the auxiliary agent."""
    evaluation_chases: int = 200
    """Fixed chases of such an evaluation."""
    stop_at_p90: float | None = None
    """Training stops when the 90th percentile of movements in an evaluation is at most this; None never stops it."""
    checkpoint_interval: int = 2_000
    """Updates between two checkpoints."""

    def __post_init__(self) -> None:
        for name in (
            "num_agents",
            "chases_per_agent",
            "update_interval",
            "max_updates",
            "evaluation_interval",
            "evaluation_chases",
            "checkpoint_interval",
        ):
            if getattr(self, name) < 1:
                raise InputError(f"{name} = {getattr(self, name)} is refused: allowed is at least 1")
        if self.max_updates > MOST_UPDATES:
            raise InputError(f"max_updates = {self.max_updates} is refused: allowed is at most {MOST_UPDATES}")
        if not 0 < self.learning_rate < math.inf:
            raise InputError(f"learning_rate = {self.learning_rate} is refused: allowed is greater than 0")
        if self.final_learning_rate is not None and not 0 <= self.final_learning_rate < math.inf:
            raise InputError(f"final_learning_rate = {self.final_learning_rate} is refused: allowed is at least 0")
        if self.seed < 0:
            raise InputError(f"seed = {self.seed} is refused: allowed is at least 0")

    def to_dict(self) -> dict[str, Any]:
        """Every setting as JSON can hold it."""
        return dataclasses.asdict(self)


PRESETS: dict[str, A3CSettings] = {
    "paper": A3CSettings(),
    "fast": A3CSettings(
        chases_per_agent=8,
        losses=LossSettings(discount=0.5),
        learning_rate=2e-4,
        final_learning_rate=1e-5,
        max_updates=6_000,
        evaluation_interval=500,
        checkpoint_interval=500,
    ),
}
"""``paper`` is Table I exactly. ``fast`` has its agents, networks, T and losses, and three changes: each agent plays
eight chases at a time, the learning rate falls from twenty times the paper's to the paper's, and the discount is 0.5.

The rewards of a chase add up to the distance won, whatever the way. With a discount of 0.99 a wrong movement near the
target that the next one takes back costs next to nothing and is hardly ever unlearned; with 0.5 it costs what it is.
"""


def a3c_preset(name: str) -> A3CSettings:
    """The settings of a named preset.

    Raises:
        InputError: no such preset.
    """
    if name not in PRESETS:
        raise InputError(f"no preset {name!r}; there are {', '.join(PRESETS)}")
    return PRESETS[name]


def training_seed(seed: int) -> int:
    """The seed of a training's chases, far from any that a person types: an evaluation never meets them."""
    return (1 << 62) + seed
