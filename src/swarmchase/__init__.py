"""Chase an unauthorised UAV with a swarm of six trackers that hear only its signal strength.

    from swarmchase import Observation, load_controller, paper_scenario

Names are imported when they are first used, so that ``import swarmchase`` itself is fast.
"""

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .controllers import Controller as Controller
    from .controllers import load_controller as load_controller
    from .errors import InputError as InputError
    from .evaluation.chases import run_chases as run_chases
    from .evaluation.table import Evaluation as Evaluation
    from .evaluation.table import evaluate as evaluate
    from .formation import Action as Action
    from .observation import Observation as Observation
    from .scenario import Scenario as Scenario
    from .scenario import load_scenario as load_scenario
    from .scenario import paper_scenario as paper_scenario
    from .world.environment import Environment as Environment

__version__ = "0.3.0"

_HOME = {
    "Action": "formation",
    "Controller": "controllers",
    "Environment": "world.environment",
    "Evaluation": "evaluation.table",
    "InputError": "errors",
    "Observation": "observation",
    "Scenario": "scenario",
    "evaluate": "evaluation.table",
    "load_controller": "controllers",
    "load_scenario": "scenario",
    "paper_scenario": "scenario",
    "run_chases": "evaluation.chases",
}

__all__ = [  # noqa: PLE0604 (the names below are made by __getattr__)
    "__version__",
    *_HOME,
]


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module 'swarmchase' has no attribute {name!r}")
    return getattr(importlib.import_module(f".{_HOME[name]}", __name__), name)
