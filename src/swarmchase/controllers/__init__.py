"""Controllers: one file each, all behind ``protocol.Controller``. ``load_controller`` finds one by name or path."""

import hashlib
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, get_args

from ..errors import InputError
from ..networks.fading import CorrectedPower
from ..networks.forms import FORMS
from ..networks.protocol import DecidingNetworks, ExpectingNetwork, Form, HearingNetworks
from ..networks.pursuit import PursuitNetwork
from ..networks.weights import checked_weights, read_weights, shared_weights
from ..networks.windows import WindowsNetwork
from ..plug_ins import made_by_plug_in, plug_in_names
from ..ranges import shown
from ..scenario import Scenario
from .adaptive import AdaptiveController
from .adaptive_in_flight import AdaptiveInFlightController
from .gradient import GradientController
from .learned import ActionChoice, LearnedController, require_action_sets
from .moving_particle import MovingParticleController
from .multilateration import MultilaterationController
from .oracle import OracleController
from .particle import ParticleController
from .protocol import Controller
from .pursuit import PursuitController, require_flight
from .random import RandomController
from .shipped import chosen_weights, shipped_families

__all__ = [
    "ActionChoice",
    "Controller",
    "chosen_weights",
    "controller_names",
    "learned_networks",
    "load_controller",
    "network_controller",
    "require_controller",
    "require_fit",
    "weights_path",
    "weights_sha256",
]


_IN_FLIGHT: dict[str, Callable[[Scenario], Controller]] = {
    "adaptive": AdaptiveInFlightController,
    "particle": MovingParticleController,
}
"""What is another controller under the same name where trackers listen while they fly."""
_UNTRAINED: dict[str, Callable[[Scenario], Controller]] = {
    "particle": ParticleController,
    "particle-unknown-power": partial(ParticleController, name="particle-unknown-power", power_is_known=False),
    "multilateration": MultilaterationController,
    "multilateration-unknown-power": partial(MultilaterationController, power_is_known=False),
    "gradient": GradientController,
    "random": RandomController,
    "oracle": OracleController,
    "oracle-intercept": partial(OracleController, name="oracle-intercept", knows_velocity=True),
}


def _untrained(name_or_path: str | Path, scenario: Scenario) -> Callable[[Scenario], Controller] | None:
    """What makes the controller of this name in the scenario's pace, if it needs no weights of ours; else None."""
    name = str(name_or_path)
    if scenario.pace == "listen_in_flight" and name in _IN_FLIGHT:
        return _IN_FLIGHT[name]
    if name not in _UNTRAINED and name not in shipped_families() and name in plug_in_names("controllers"):
        return partial(made_by_plug_in, "controllers", name, Controller)
    return _UNTRAINED.get(name)


def controller_names() -> list[str]:
    """What ``load_controller`` knows by name, other packages' last."""
    return list(dict.fromkeys([*_UNTRAINED, *shipped_families(), *plug_in_names("controllers")]))


def weights_path(name_or_path: str | Path, scenario: Scenario) -> Path | None:
    """The weights file of a trained controller, which need not exist; None for an untrained one.

    Of a family that comes with the package it is the one for the scenario's F and rho (``chosen_weights``).

    Raises:
        InputError: it is one that this installation does not hold.
    """
    if _untrained(name_or_path, scenario) is not None:
        return None
    chosen = chosen_weights(str(name_or_path), scenario)
    if chosen is not None and not chosen.is_here:
        raise InputError(chosen.where_it_is)
    return Path(name_or_path) if chosen is None else chosen.path


def weights_sha256(name_or_path: str | Path, scenario: Scenario) -> str | None:
    """Which weights a trained controller has; None for one that has none.

    Raises:
        InputError: the file cannot be read.
    """
    path = weights_path(name_or_path, scenario)
    return None if path is None else hashlib.sha256(read_weights(path)).hexdigest()


def load_controller(
    name_or_path: str | Path, scenario: Scenario, action_choice: ActionChoice | None = None
) -> Controller:
    """A controller by name (``controller_names``) or from a weights file.

    One chase, window by window; levels and places come from six receivers, or from a simulation:

    >>> from swarmchase import Environment, paper_scenario
    >>> scenario = paper_scenario(sampling_hz=100, spatial_correlation=0.5)
    >>> controller = load_controller("multilateration", scenario)
    >>> controller
    <MultilaterationController 'multilateration', told Scenario(sampling_hz=100.0, spatial_correlation=0.5)>
    >>> state = Environment(scenario).reset([(7, 0)])
    >>> memory = controller.begin(1, seed=7)
    >>> action, memory = controller.decide(state.observation(), memory)
    >>> action.displacement_m.shape
    torch.Size([1, 3])

    ``action_choice`` says how a learned controller turns its policies into actions; None takes what its weights
    file says.

    Raises:
        InputError: an unknown name, or a file that is missing, damaged or does not match.
    """
    name = str(name_or_path)
    untrained = _untrained(name, scenario)
    if untrained is not None:
        return untrained(scenario)
    networks, filed_choice = learned_networks(name_or_path, scenario)
    return network_controller(scenario, networks, name, action_choice or filed_choice)


def learned_networks(name_or_path: str | Path, scenario: Scenario) -> tuple[HearingNetworks, ActionChoice]:
    """The networks of a learned controller, which are not to be changed, and how their weights file says that actions
    are chosen.

    Raises:
        InputError: a controller without networks, an unknown name, or a file that is missing, damaged or does not
            match.
    """
    if _untrained(name_or_path, scenario) is not None:
        raise InputError(
            f"{name_or_path} has no networks in this scenario: {', '.join(shipped_families())} are learned"
        )
    path = _given_weights_path(name_or_path, scenario)
    networks, configuration = shared_weights(path)
    return networks, _filed_action_choice(path, configuration)


def require_controller(name_or_path: str | Path, scenario: Scenario) -> None:
    """Refuse what ``load_controller`` refuses, in the same words, without building the controller.

    Raises:
        InputError: an unknown name, or a file that is missing, damaged or does not match.
    """
    if _untrained(name_or_path, scenario) is not None:
        return
    path = _given_weights_path(name_or_path, scenario)
    form, _, configuration = checked_weights(path)
    _filed_action_choice(path, configuration)
    require_fit(form, scenario, str(name_or_path))


def network_controller(
    scenario: Scenario, networks: HearingNetworks, name: str, action_choice: ActionChoice
) -> Controller:
    """The controller that decides by these networks. One that has a network for its likelihood alone draws nothing:
    ``action_choice`` is not for it.

    Raises:
        InputError: windows of a length, or action sets, that the networks do not take.
    """
    require_fit(FORMS[networks.form], scenario, name)
    if isinstance(networks, ExpectingNetwork):
        return ParticleController(scenario, name, window_power=CorrectedPower(networks, scenario))
    if isinstance(networks, WindowsNetwork):
        return AdaptiveController(scenario, networks, name)
    if isinstance(networks, PursuitNetwork):
        return PursuitController(scenario, networks, name)
    assert isinstance(networks, DecidingNetworks)
    return LearnedController(scenario, networks, name, action_choice)


def _given_weights_path(name_or_path: str | Path, scenario: Scenario) -> Path:
    """The weights file of a controller that is not an untrained one."""
    path = weights_path(name_or_path, scenario)
    assert path is not None
    if not (path.suffix == ".safetensors" or path.is_file()):
        raise InputError(
            f"no controller {str(name_or_path)!r}; there are {', '.join(controller_names())}, "
            "or give the path of a weights file (.safetensors)"
        )
    return path


def _filed_action_choice(path: Path, configuration: dict[str, Any]) -> ActionChoice:
    filed_choice: ActionChoice = configuration.get("action_choice", "sampled")
    if filed_choice not in get_args(ActionChoice):
        allowed = " or ".join(map(repr, get_args(ActionChoice)))
        raise InputError(f"weights file {path} says action_choice = {shown(filed_choice)}; allowed is {allowed}")
    return filed_choice


def require_fit(form: Form[Any, Any], scenario: Scenario, name: str) -> None:
    """Refuse a scenario that networks of this form cannot decide in.

    Raises:
        InputError: windows of another length, action sets that they do not choose from, or another pace.
    """
    if form.window_samples not in (None, scenario.samples_a_decision):
        raise InputError(
            f"{name} needs windows of {form.window_samples} samples; the scenario has {scenario.samples_a_decision}"
        )
    if issubclass(form.filed, DecidingNetworks):
        require_action_sets(scenario, name)
    if issubclass(form.filed, PursuitNetwork):
        require_flight(scenario, name)
