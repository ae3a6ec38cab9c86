"""Controllers: one file each, all behind ``protocol.Controller``. ``load_controller`` finds one by name or path."""

from pathlib import Path
from typing import get_args

from ..errors import InputError
from ..recurrent_network import WINDOW_SAMPLES, RecurrentNetwork
from ..scenario import Scenario
from .gradient import GradientController
from .learned import ActionChoice, LearnedController
from .multilateration import MultilaterationController
from .oracle import OracleController
from .particle import ParticleController
from .protocol import Controller
from .random import RandomController
from .shipped import chosen_weights, shipped_families
from .weights import load_weights

__all__ = ["ActionChoice", "Controller", "chosen_weights", "load_controller"]


def load_controller(
    name_or_path: str | Path, scenario: Scenario, action_choice: ActionChoice | None = None
) -> Controller:
    """A controller by name (``paper``, ``paper-a3c``, ``random``, ``oracle``) or from a weights file.

    Of a family of trained controllers it is the one trained nearest to the scenario's F and rho (``chosen_weights``).
    ``action_choice`` says how a learned controller turns its policies into actions; None takes what its weights
    file says.

    Raises:
        InputError: an unknown name, or a file that is missing, damaged or does not match.
    """
    name = str(name_or_path)
    if name == "random":
        return RandomController(scenario)
    if name == "oracle":
        return OracleController(scenario)
    if name in ("particle", "particle-unknown-power"):
        return ParticleController(scenario, power_is_known=name == "particle")
    if name in ("multilateration", "multilateration-unknown-power"):
        return MultilaterationController(scenario, power_is_known=name == "multilateration")
    if name == "gradient":
        return GradientController(scenario)
    chosen = chosen_weights(name, scenario)
    path = Path(name_or_path) if chosen is None else chosen.path
    if chosen is None and not (path.suffix == ".safetensors" or path.is_file()):
        names = ", ".join(["random", "oracle", *shipped_families()])
        raise InputError(
            f"no controller {name!r}; there are {names}, or give the path of a weights file (.safetensors)"
        )
    networks, configuration = load_weights(path)
    if isinstance(networks, RecurrentNetwork) and scenario.window_samples != WINDOW_SAMPLES:
        raise InputError(
            f"{name} needs windows of {WINDOW_SAMPLES} samples; the scenario has {scenario.window_samples}"
        )
    filed_choice = configuration.get("action_choice", "sampled")
    if filed_choice not in get_args(ActionChoice):
        allowed = " or ".join(map(repr, get_args(ActionChoice)))
        raise InputError(f"weights file {path} says action_choice = {filed_choice!r}; allowed is {allowed}")
    return LearnedController(scenario, networks, name, action_choice or filed_choice)
