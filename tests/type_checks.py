"""Types are checked at every call of the package while the tests run, and the axes of tensors where there are any."""

from importlib.util import find_spec
from pkgutil import iter_modules

import jaxtyping
from beartype import BeartypeConf
from beartype.claw import beartype_package

PLAIN = ["live", "simulation"]
"""Rooms without axes, whose loops run for minutes of a chase: a call checked for axes, too, costs ten times as much."""
EXCEPTION = "swarmchase.simulation.radio"
"""It has some."""

spec = find_spec("swarmchase")
assert spec is not None
AXES = [
    EXCEPTION,
    *(f"swarmchase.{one.name}" for one in iter_modules(spec.submodule_search_locations) if one.name not in PLAIN),
]


def check_types() -> None:
    """Of all that is imported from now on."""
    jaxtyping.install_import_hook(AXES, "beartype.beartype")
    for room in PLAIN:
        configuration = BeartypeConf(claw_is_pep526=False, claw_skip_package_names=(EXCEPTION,))
        beartype_package(f"swarmchase.{room}", conf=configuration)
