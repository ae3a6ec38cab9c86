"""Types are checked at every call of the package while the tests run, and the axes of tensors where there are any."""

import jaxtyping
from beartype import BeartypeConf
from beartype.claw import beartype_package

AXES = [
    f"swarmchase.{room}"
    for room in (
        "batch",
        "channel",
        "controllers",
        "formation",
        "networks",
        "observation",
        "simulation.radio",
        "training",
        "world",
    )
]
"""Here arguments have axes, which are checked with the types. It costs each call ten times as much, so that elsewhere
beartype alone checks types."""


def check_types() -> None:
    """Of all that is imported from now on."""
    jaxtyping.install_import_hook(AXES, "beartype.beartype")
    beartype_package("swarmchase", conf=BeartypeConf(claw_is_pep526=False, claw_skip_package_names=tuple(AXES)))
