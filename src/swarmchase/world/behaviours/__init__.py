"""What targets do: one file each, all behind ``protocol.Behaviour``. ``load_behaviour`` finds one by name or path."""

import difflib
from collections.abc import Callable
from importlib.metadata import entry_points
from pathlib import Path

import torch

from ...errors import InputError
from ...ranges import shown
from ...scenario import Scenario
from .circle import Circle
from .flee import Flee
from .hover import Hover
from .jink import Jink
from .protocol import Behaviour, Swarm, Target
from .stop_and_go import StopAndGo
from .straight import Straight
from .track import Track
from .wander import Wander
from .waypoints import Waypoints

__all__ = ["Behaviour", "Swarm", "Target", "behaviour_names", "load_behaviour"]

PLUG_INS = "swarmchase.behaviours"
"""The group of entry points in which other packages offer theirs: callables that take a scenario and a device."""

_OWN: dict[str, Callable[[Scenario, torch.device | str], Behaviour]] = {
    "hover": Hover,
    "straight": Straight,
    "waypoints": Waypoints,
    "wander": Wander,
    "circle": Circle,
    "stop-and-go": StopAndGo,
    "flee": Flee,
    "jink": Jink,
}


def behaviour_names() -> list[str]:
    """What ``load_behaviour`` knows by name, other packages' last."""
    return list(dict.fromkeys([*_OWN, *sorted(entry_points(group=PLUG_INS).names)]))


def load_behaviour(scenario: Scenario, device: torch.device | str = "cpu") -> Behaviour:
    """What the targets of this scenario do: ``scenario.behaviour`` is one of ``behaviour_names``, or a track's path.

    Raises:
        InputError: an unknown name, a file that is no track, a plug-in that cannot be loaded, or a scenario that the
            behaviour cannot fly in.
    """
    name = scenario.behaviour
    if name in _OWN:
        return _OWN[name](scenario, device)
    if Path(name).suffix.lower() == ".csv":
        return Track(scenario, device)
    for plug_in in entry_points(group=PLUG_INS, name=name):
        try:
            made = plug_in.load()(scenario, device)
        except (ImportError, AttributeError, TypeError) as error:
            raise InputError(f"behaviour {shown(name)} of {plug_in.value} cannot be loaded: {error}") from error
        if not isinstance(made, Behaviour):
            raise InputError(f"behaviour {shown(name)} of {plug_in.value} has not all of begin, fly and is_still")
        return made
    near = difflib.get_close_matches(name, behaviour_names(), n=1)
    raise InputError(
        f"no behaviour {shown(name)}{f' (did you mean {near[0]}?)' if near else ''}; there are "
        f"{', '.join(behaviour_names())}, or give the path of a track (.csv)"
    )
