"""Types are checked in the calls of the package while the tests run, and the axes of tensors where there are any.

In each test the first calls of a function are: in a loop the others are like these.
"""

import dataclasses
import functools
from collections.abc import Callable
from importlib.util import find_spec
from pkgutil import iter_modules
from types import CodeType
from typing import Any

import jaxtyping
from beartype import beartype

PLAIN = ["live", "simulation"]
"""Rooms without axes."""
EXCEPTIONS = ("swarmchase.simulation.radio", "swarmchase.simulation.radio_in_flight")
"""These have some."""
UNCHECKED = {
    f"swarmchase.{name}"
    for name in (
        "live.clock",
        "live.tracker.vehicles.simulated",
        "simulation.fault_plan",
        "simulation.faulty_path",
        "simulation.receivers_gone_wrong",
        "simulation.vehicles_gone_wrong",
        "simulation.virtual_chase",
        "simulation.virtual_network",
    )
}
"""Arithmetic on coordinates, and what the simulation alone asks about every sample and datagram of a chase: many
millions of calls, at which mypy looks."""
MOST_CALLS = 4
"""Of one function that are checked for axes in one test."""
MOST_PLAIN_CALLS = 100
"""Of one function without axes: its checks cost a tenth."""

spec = find_spec("swarmchase")
assert spec is not None
AXES = [
    *EXCEPTIONS,
    *(f"swarmchase.{one.name}" for one in iter_modules(spec.submodule_search_locations) if one.name not in PLAIN),
]
_jaxtyped = jaxtyping.jaxtyped


@dataclasses.dataclass
class _Calls:
    """Of one function, however often it is made anew inside another."""

    code: CodeType
    most: int
    left: int


_calls: dict[int, _Calls] = {}


def check_types() -> None:
    """Of all that is imported from now on."""
    jaxtyping.jaxtyped = _at_first
    jaxtyping.install_import_hook([*AXES, *(f"swarmchase.{room}" for room in PLAIN)], "beartype.beartype")


def check_types_anew() -> None:
    """A test begins."""
    for calls in _calls.values():
        calls.left = calls.most


def _at_first(thing: Any = None, **options: Any) -> Any:
    """As ``jaxtyped``, which the import hook writes above every function and class; in the first calls."""
    if thing is None:
        return functools.partial(_at_first, **options)
    if thing.__module__ in UNCHECKED:
        return thing
    plain = thing.__module__.split(".")[1] in PLAIN and thing.__module__ not in EXCEPTIONS
    checks, most = (beartype, MOST_PLAIN_CALLS) if plain else (functools.partial(_jaxtyped, **options), MOST_CALLS)
    if not isinstance(thing, type):
        return _checked_at_first(thing, checks, most)
    made = vars(thing).get("__init__")
    if dataclasses.is_dataclass(thing) and made is not None and not hasattr(made, "__wrapped__"):
        thing.__init__ = _checked_at_first(made, checks, most)
    return thing


def _checked_at_first(function: Any, checks: Callable[[Any], Any], most: int) -> Any:
    code = function.__code__
    # Not by the code itself, which is equal to that of another dataclass with the same fields.
    calls = _calls.setdefault(id(code), _Calls(code, most, most))
    checked: Any = None

    @functools.wraps(function)
    def call(*values: Any, **named: Any) -> Any:
        nonlocal checked
        if not calls.left:
            return function(*values, **named)
        calls.left -= 1
        if checked is None:
            checked = checks(function)
        return checked(*values, **named)

    return call
