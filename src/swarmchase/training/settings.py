"""What defines a training run, and the named presets."""

import dataclasses
from dataclasses import dataclass, field
from typing import Any, Literal, get_args

from ..controllers.learned import ActionChoice
from ..errors import InputError
from ..networks.forms import FORMS
from ..ranges import AT_LEAST_ONE, AT_LEAST_ZERO, POSITIVE, SHARE, Range, ranged, require_ranges
from .losses import DISPLACEMENT_SCALE_M, LossSettings

Precision = Literal["float32", "bfloat16"]
A3CSchedule = Literal["processes", "deterministic"]
"""Asynchronous processes, or the same agents in turn in one process: bit-reproducible."""
Schedule = Literal[A3CSchedule, "cluster", "batched"]
"""A3C's, on one machine or on a Ray cluster, or the batched trainer."""

MOST_UPDATES = 2**24
"""Adam counts its updates in float32, which is exact up to here."""


@dataclass(frozen=True, kw_only=True)
class TrainingSettings:
    """A training run. The defaults are Table I.

    Raises:
        InputError: a number outside its range.
    """

    num_agents: int = ranged(8, AT_LEAST_ONE)
    """Number of local agents (Table I)."""
    chases_per_agent: int = ranged(1, AT_LEAST_ONE)
    """Chases a local agent plays at a time; its gradient is their average. The paper's agents play one."""
    update_interval: int = ranged(5, AT_LEAST_ONE)
    """T, movements between two updates (Table I)."""
    learning_rate: float = ranged(1e-5, POSITIVE)
    """Adam's learning rate (Table I)."""
    final_learning_rate: float | None = ranged(None, AT_LEAST_ZERO)
    """Falls linearly to this over the run; None keeps it constant, as in the paper."""
    max_gradient_norm: float | None = ranged(None, POSITIVE)
    """A longer gradient is shortened to this; None never does, as in the paper."""
    passes_per_rollout: int = ranged(1, AT_LEAST_ONE)
    """Updates made from each rollout; more than one is for PPO."""
    form: str = ranged("paper", tuple(FORMS))
    """The form of the networks: one of ``networks.forms.FORMS``."""
    losses: LossSettings = field(default_factory=LossSettings)
    """What is learned: objective, discount, entropy bonus, value loss and the cut at MAX_STEPS."""
    symmetric: bool = False
    """x, y and z are one network that learns from all three views of a window; weights files hold it three times."""
    mirrored: bool = False
    """Each axis of each rollout is learned from as it was or in a mirror, at random."""
    varied_start: bool = False
    """Half of the chases begin nearer to their target, down to a fortieth of the distance, log-uniformly."""
    varied_world: bool = False
    """Each agent plays in a world of its own that departs from what the networks are told (``world.departures``)."""
    spacing_exploration: float | None = ranged(None, SHARE)
    """The spacing is the most likely one but for this share of movements, when it is any one; None samples it."""
    initial_weights: str | None = None
    """Weights file that training begins from; None draws the weights anew."""
    precision: Precision = ranged("float32", get_args(Precision))
    """Of the networks' products; parameters, Adam, channel and losses are float32 either way."""
    max_updates: int = ranged(200_000, Range(1, MOST_UPDATES))
    """Updates of the global networks; the paper's EPISODES are not stated."""
    seed: int = ranged(0, AT_LEAST_ZERO)
    """Seed of the training's chases, initial weights and actions."""
    evaluation_interval: int = ranged(5_000, AT_LEAST_ONE)
    """Updates between two evaluations by the auxiliary agent."""
    action_choice: ActionChoice = ranged("sampled", get_args(ActionChoice))
    """How the networks act in an evaluation, and wherever their weights file is used."""
    evaluation_chases: int = ranged(200, AT_LEAST_ONE)
    """Fixed chases of such an evaluation."""
    stop_at_p90: float | None = None
    """Training stops when the 90th percentile of movements in an evaluation is at most this; None never stops it."""
    checkpoint_interval: int = ranged(2_000, AT_LEAST_ONE)
    """Updates between two checkpoints."""

    def __post_init__(self) -> None:
        require_ranges(self)
        self._require_what_goes_together()

    def _require_what_goes_together(self) -> None:
        if self.passes_per_rollout > 1 and self.losses.objective != "ppo":
            raise InputError(f"passes_per_rollout = {self.passes_per_rollout} is refused: it is for the objective ppo")
        if self.spacing_exploration is not None and self.losses.objective != "counterfactual":
            raise InputError(
                f"spacing_exploration = {self.spacing_exploration} is refused: it is for the objective counterfactual"
            )
        if self.losses.objective == "counterfactual" and self.update_interval < 2:
            raise InputError("update_interval = 1 is refused: counterfactual regression needs a movement to follow")
        form = FORMS[self.form]
        if self.losses.objective not in form.objectives:
            raise InputError(f"objective = {self.losses.objective!r} is refused: {form.why_no_other_objective}")
        for name, value, needed in (
            ("symmetric", self.symmetric, False),
            ("mirrored", self.mirrored, False),
            ("precision", self.precision, "float32"),
        ):
            if value != needed and name not in form.own_settings:
                having = " or ".join(other.name for other in FORMS.values() if name in other.own_settings)
                raise InputError(f"{name} = {value!r} is refused: it is for the form {having}")

    @property
    def policy_scale(self) -> float:
        """What the policy heads' outputs are multiplied by: regression fits rewards in units of four metres."""
        is_regression = self.losses.objective == "counterfactual"
        return DISPLACEMENT_SCALE_M / self.losses.temperature_m if is_regression else 1.0

    def to_dict(self) -> dict[str, Any]:
        """Every setting as JSON can hold it."""
        return dataclasses.asdict(self)


_FAST = TrainingSettings(
    chases_per_agent=8,
    losses=LossSettings(discount=0.5),
    learning_rate=2e-4,
    final_learning_rate=1e-5,
    max_updates=6_000,
    evaluation_interval=500,
    checkpoint_interval=500,
)
_A2C = dataclasses.replace(
    _FAST, num_agents=1, chases_per_agent=32, learning_rate=5e-4, max_gradient_norm=10.0, precision="bfloat16"
)

PRESETS: dict[str, TrainingSettings] = {
    "paper": TrainingSettings(),
    "fast": _FAST,
    "a2c": _A2C,
    "ppo": dataclasses.replace(
        _A2C,
        passes_per_rollout=3,
        losses=LossSettings(objective="ppo", discount=0.5, gae_lambda=0.9),
    ),
    "all-actions": dataclasses.replace(_A2C, losses=LossSettings(objective="all_actions", discount=0.5)),
    "counterfactual": TrainingSettings(
        num_agents=16,
        chases_per_agent=64,
        update_interval=2,
        learning_rate=1e-3,
        final_learning_rate=1e-6,
        max_gradient_norm=1.0,
        losses=LossSettings(objective="counterfactual"),
        symmetric=True,
        mirrored=True,
        varied_start=True,
        spacing_exploration=0.1,
        precision="bfloat16",
        max_updates=2_000,
        action_choice="greedy",
        evaluation_interval=250,
        checkpoint_interval=250,
    ),
    "recurrent": TrainingSettings(
        form="fading",
        num_agents=1,
        chases_per_agent=256,
        update_interval=16,
        learning_rate=2e-3,
        final_learning_rate=1e-6,
        losses=LossSettings(objective="fading"),
        max_updates=4_000,
        action_choice="greedy",
        evaluation_interval=4_000,
        checkpoint_interval=1_000,
    ),
    "gated": TrainingSettings(
        form="gated",
        num_agents=1,
        chases_per_agent=256,
        update_interval=16,
        learning_rate=2e-3,
        final_learning_rate=1e-6,
        max_gradient_norm=1.0,
        losses=LossSettings(objective="counterfactual"),
        varied_start=True,
        spacing_exploration=0.1,
        max_updates=12_000,
        action_choice="greedy",
        evaluation_interval=1_000,
        checkpoint_interval=1_000,
    ),
}
PRESETS["robust"] = dataclasses.replace(
    PRESETS["gated"],
    num_agents=32,
    chases_per_agent=64,
    learning_rate=1e-3,
    max_updates=36_000,
    evaluation_interval=2_000,
    evaluation_chases=100,
    checkpoint_interval=2_000,
    varied_world=True,
)
"""``paper`` is Table I exactly. ``fast`` has its agents, networks, T and losses, and three changes: each agent plays
eight chases at a time, the learning rate falls from twenty times the paper's to the paper's, and the discount is 0.5.

The rewards of a chase add up to the distance won, whatever the way. With a discount of 0.99 a wrong movement near the
target that the next one takes back costs next to nothing and is hardly ever unlearned; with 0.5 it costs what it is.

The others are for the batched trainer: ``a2c`` is ``fast`` with one agent of 32 chases, a higher learning rate, clipped
gradients and bfloat16; ``ppo`` and ``all-actions`` change its objective; ``counterfactual`` regresses the rewards of
all choices and learns fastest by far. It has many agents and looks into the mirror, since one rollout after another is
of the same chases: with 64 in all, whose targets happen to lie more on one side than on the other, it learns to fly to
that side and comes apart. ``recurrent`` trains a filter's likelihood and is evaluated at its end alone: the error falls
with the learning rate to the last update, and by too little to be seen in movements. ``gated`` trains a network with
memory, ``robust`` the same in worlds that differ from what it is told.
"""


def preset(name: str) -> TrainingSettings:
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
