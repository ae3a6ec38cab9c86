"""What a form of network is to the rest of the package: how its networks are asked, and how they come into being.

A form is one file in this folder with its networks and a ``Form``, and one line in ``networks.forms``. Networks are
asked in one of two ways: they decide (``DecidingNetworks``), or they say what fading to expect in a window
(``ExpectingNetwork``).
"""

from abc import ABC, abstractmethod
from typing import ClassVar, Generic, Protocol, TypeVar, runtime_checkable

import torch
from torch import nn

from ..batch.array_types import Float, Tensor
from ..scenario import Scenario


class HearingNetworks(nn.Module):
    """Networks that hear a chase window by window and carry one vector from each to the next."""

    form: ClassVar[str]
    """Name of their ``Form``."""
    memory_features: int
    """Length of what they carry."""
    batch_multiple: int
    """A chase's result does not depend on its batch, bit for bit, where that has a multiple of so many chases: what
    adds up the products of matrices has other sums for a rest. Other batches are to be padded."""

    def begin(self, scenario: Scenario, num_chases: int) -> Float[Tensor, "chase memory"]:
        """What they carry before the first window, with what they are told of the scenario."""
        raise NotImplementedError


class DecidingNetworks(HearingNetworks):
    """Networks with a policy each for spacing, x, y and z."""

    def decide(
        self,
        rssi_dbm: Float[Tensor, "chase sample 6"],
        tracker_position_m: Float[Tensor, "chase 6 3"],
        memory: Float[Tensor, "chase memory"],
    ) -> tuple[Float[Tensor, "chase 4 5"], Float[Tensor, "chase memory"]]:
        """Logits of the four policies, and the memory for the next window. A missing sample is NaN."""
        raise NotImplementedError

    def decide_in_sequence(
        self,
        rssi_dbm: Float[Tensor, "step chase sample 6"],
        tracker_position_m: Float[Tensor, "step chase 6 3"],
        memory: Float[Tensor, "chase memory"],
    ) -> Float[Tensor, "step chase 4 5"]:
        """Logits of the four policies at every step of a rollout that began with ``memory``."""
        raise NotImplementedError


class ExpectingNetwork(HearingNetworks):
    """A network that says how much fading in dB to expect in each tracker's mean power in a window."""

    def forward(
        self, rssi_dbm: Float[Tensor, "chase sample 6"], told: Float[Tensor, "chase memory"]
    ) -> Float[Tensor, "chase 6"]:
        """In dB; ``told`` is what ``begin`` gave. A missing sample is NaN."""
        raise NotImplementedError


@runtime_checkable
class FormSettings(Protocol):
    """What of a training's settings its networks' form depends on."""

    @property
    def form(self) -> str:
        """Name of the ``Form``."""

    @property
    def policy_scale(self) -> float:
        """What the policy heads' outputs are multiplied by."""

    @property
    def symmetric(self) -> bool:
        """Whether x, y and z are one network."""

    @property
    def precision(self) -> str:
        """Of the networks' products: the name of a torch type."""


Filed = TypeVar("Filed", bound=HearingNetworks)
Trained = TypeVar("Trained", bound=HearingNetworks)


class Form(ABC, Generic[Filed, Trained]):
    """One form of network, as weights files hold it (``Filed``) and as it is trained (``Trained``)."""

    name: ClassVar[str]
    """In a training's settings and in refusals."""
    file_format: ClassVar[str]
    """Of its weights files."""
    objectives: ClassVar[frozenset[str]]
    """Of ``training.losses.Objective``: those that it can be trained with."""
    why_no_other_objective: ClassVar[str]
    """In the words of a refusal."""
    own_settings: ClassVar[frozenset[str]] = frozenset()
    """Those of symmetric, mirrored and precision that may be set for it."""
    window_samples: ClassVar[int | None]
    """Samples of the windows that it takes; None for any number."""
    filed: type[Filed]
    """Called without arguments it makes networks for a file to fill."""

    @abstractmethod
    def new(self, settings: FormSettings, generator: torch.Generator | None) -> Trained:
        """Networks to be trained: drawn anew, or to be filled where there is no ``generator``."""

    @abstractmethod
    def continued(self, settings: FormSettings, start: Filed) -> Trained:
        """Networks to be trained which decide as ``start`` does; they may be ``start`` itself.

        Raises:
            InputError: the settings ask for what ``start`` is not.
        """

    @abstractmethod
    def deployed(self, trained: Trained) -> Filed:
        """Networks of their own that decide as the trained ones do, scales within their weights."""
