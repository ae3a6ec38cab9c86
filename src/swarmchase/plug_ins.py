"""What other packages add without a fork, by entry points: controllers, fading, behaviours, sources and vehicles.

A package that says in its pyproject.toml

    [project.entry-points."swarmchase.controllers"]
    homing = "my_package:Homing"

adds a controller ``homing`` to every command. ``examples/plugin`` is one, with something of each group. Names of this
package come first: nobody replaces them.
"""

import functools
import sys
from collections.abc import Iterator, Sequence
from importlib.metadata import EntryPoint, EntryPoints, entry_points
from typing import Any, Literal

from .errors import InputError

Group = Literal["controllers", "fading", "behaviours", "sources", "vehicles"]
NOUNS: dict[Group, str] = {
    "controllers": "controller",
    "fading": "fading",
    "behaviours": "behaviour",
    "sources": "source",
    "vehicles": "vehicle",
}


class NamesWith(Sequence[str]):
    """This package's names, and those that other packages add to them when they are asked for."""

    def __init__(self, own: Sequence[str], group: Group) -> None:
        self._own, self._group = own, group

    def __contains__(self, name: object) -> bool:
        return name in self._own or name in plug_in_names(self._group)

    def __iter__(self) -> Iterator[str]:
        return iter(dict.fromkeys([*self._own, *plug_in_names(self._group)]))

    def __len__(self) -> int:
        return len(list(iter(self)))

    def __getitem__(self, place: Any) -> Any:
        return list(self)[place]


def plug_in_names(group: Group) -> list[str]:
    """What other packages offer, in alphabetical order."""
    return sorted(_offers(group, tuple(sys.path)).names)


def load_plug_in(group: Group, name: str, kind: type) -> Any:
    """What a package offers under this name.

    Raises:
        InputError: no package offers it or several do, it cannot be imported, or it is not of this kind.
    """
    offer = _offer(group, name)
    loaded = _loaded(offer, group)
    if not isinstance(loaded, kind):
        raise InputError(f"{NOUNS[group]} {name!r} of {offer.value} is no {kind.__name__}")
    return loaded


def made_by_plug_in(group: Group, name: str, protocol: type, *arguments: Any) -> Any:
    """What a package's callable of this name makes of these arguments.

    Raises:
        InputError: as ``load_plug_in``; it does not take the arguments; what it makes is not of the protocol.
    """
    offer = _offer(group, name)
    try:
        made = _loaded(offer, group)(*arguments)
    except TypeError as error:
        raise InputError(f"{NOUNS[group]} {name!r} of {offer.value} cannot be made: {error}") from error
    if not isinstance(made, protocol):
        raise InputError(f"{NOUNS[group]} {name!r} of {offer.value} has not all of {', '.join(_members(protocol))}")
    return made


def _offer(group: Group, name: str) -> EntryPoint:
    offers = list({offer.value: offer for offer in _offers(group, tuple(sys.path)).select(name=name)}.values())
    if len(offers) != 1:
        packages = f"several packages: {', '.join(offer.value for offer in offers)}" if offers else "no package"
        raise InputError(f"{NOUNS[group]} {name!r} is offered by {packages}")
    return offers[0]


def _loaded(offer: EntryPoint, group: Group) -> Any:
    try:
        return offer.load()
    except (ImportError, AttributeError) as error:
        raise InputError(f"{NOUNS[group]} {offer.name!r} of {offer.value} cannot be loaded: {error}") from error


@functools.cache
def _offers(group: Group, _path: tuple[str, ...]) -> EntryPoints:
    """Looked for once: it reads a file of every package on the path."""
    return entry_points(group=f"swarmchase.{group}")


def _members(protocol: type) -> list[str]:
    named = {
        name
        for kind in protocol.__mro__
        if getattr(kind, "_is_protocol", False)
        for name in (*vars(kind), *vars(kind).get("__annotations__", {}))
    }
    return sorted(name for name in named if not name.startswith("_"))
