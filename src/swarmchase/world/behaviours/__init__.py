"""What targets do: one file each, all behind ``protocol.Behaviour``. ``load_behaviour`` finds one by name or path."""

from collections.abc import Callable
from pathlib import Path

import torch

from ...errors import InputError
from ...plug_ins import made_by_plug_in, plug_in_names
from ...ranges import meant, shown
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
    return list(dict.fromkeys([*_OWN, *plug_in_names("behaviours")]))


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
    if name in plug_in_names("behaviours"):
        made: Behaviour = made_by_plug_in("behaviours", name, Behaviour, scenario, device)
        return made
    raise InputError(
        f"no behaviour {shown(name)}{meant(name, behaviour_names())}; there are "
        f"{', '.join(behaviour_names())}, or give the path of a track (.csv)"
    )
