"""Controllers: one file each, all behind ``protocol.Controller``. ``load_controller`` finds one by name or path."""

from pathlib import Path
from typing import get_args

from ..errors import InputError
from ..scenario import Scenario
from .learned import ActionChoice, LearnedController
from .oracle import OracleController
from .protocol import Controller
from .random import RandomController
from .weights import load_weights

__all__ = ["ActionChoice", "Controller", "load_controller"]

WEIGHTS_FOLDER = Path(__file__).parent.parent / "weights"
"""Trained controllers that come with the package, one file a name."""


def shipped_weights() -> dict[str, Path]:
    """Names and files of the trained controllers that come with the package."""
    return {path.stem: path for path in sorted(WEIGHTS_FOLDER.glob("*.safetensors"))}


def load_controller(
    name_or_path: str | Path, scenario: Scenario, action_choice: ActionChoice | None = None
) -> Controller:
    """A controller by name (``paper``, ``random``, ``oracle``) or from a weights file.

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
    shipped = shipped_weights()
    path = shipped.get(name, Path(name_or_path))
    if name not in shipped and not (path.suffix == ".safetensors" or path.is_file()):
        names = ", ".join(["random", "oracle", *shipped])
        raise InputError(
            f"no controller {name!r}; there are {names}, or give the path of a weights file (.safetensors)"
        )
    networks, configuration = load_weights(path)
    filed_choice = configuration.get("action_choice", "sampled")
    if filed_choice not in get_args(ActionChoice):
        allowed = " or ".join(map(repr, get_args(ActionChoice)))
        raise InputError(f"weights file {path} says action_choice = {filed_choice!r}; allowed is {allowed}")
    return LearnedController(scenario, networks, name, action_choice or filed_choice)
