"""Types are checked in the calls of the package while the tests run, and the axes of tensors where there are any."""

import functools
from collections import Counter
from collections.abc import Callable
from importlib.util import find_spec
from pkgutil import iter_modules
from typing import Any

import jaxtyping
from beartype import BeartypeConf
from beartype.claw import beartype_package

PLAIN = ["live", "simulation"]
"""Rooms without axes, whose loops run for minutes of a chase: a call checked for axes, too, costs ten times as much."""
EXCEPTION = "swarmchase.simulation.radio"
"""It has some."""
ARITHMETIC = "swarmchase.live.tracker.vehicles.simulated"
"""Its calls on coordinates are many millions: mypy looks at them."""
SAMPLE_BY_SAMPLE = [
    f"swarmchase.simulation.{name}"
    for name in ("fault_plan", "faulty_path", "receivers_gone_wrong", "vehicles_gone_wrong", "virtual_network")
]
"""They are asked about every sample and datagram of a chase, by the simulation alone: the same goes for them."""
MOST_CALLS = 10
"""Of one function that are checked for axes in one test: in a loop the others are like these."""

spec = find_spec("swarmchase")
assert spec is not None
AXES = [
    EXCEPTION,
    *(f"swarmchase.{one.name}" for one in iter_modules(spec.submodule_search_locations) if one.name not in PLAIN),
]
_checked: Counter[Any] = Counter()
"""Calls, by function."""
_jaxtyped = jaxtyping.jaxtyped


def check_types() -> None:
    """Of all that is imported from now on."""
    jaxtyping.jaxtyped = _at_first
    jaxtyping.install_import_hook(AXES, "beartype.beartype")
    for room in PLAIN:
        configuration = BeartypeConf(
            claw_is_pep526=False, claw_skip_package_names=(EXCEPTION, ARITHMETIC, *SAMPLE_BY_SAMPLE)
        )
        beartype_package(f"swarmchase.{room}", conf=configuration)


def check_axes_anew() -> None:
    """A test begins."""
    _checked.clear()


def _at_first(thing: Any = None, **options: Any) -> Any:
    """As ``jaxtyped``, which the import hook writes above every function and class; of functions the first calls."""
    if thing is None:
        return functools.partial(_at_first, **options)
    checked: Callable[..., Any] = _jaxtyped(thing, **options)
    if isinstance(thing, type):
        return checked

    @functools.wraps(thing)
    def call(*values: Any, **named: Any) -> Any:
        if _checked[thing] >= MOST_CALLS:
            return thing(*values, **named)
        _checked[thing] += 1
        return checked(*values, **named)

    return call
