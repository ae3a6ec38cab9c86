"""What is installed on a node: all must have the same, or they would compute something else.

A node may lack this very package, so that what looks is sent there whole and stands on the standard library alone.
"""

import hashlib
import importlib.metadata
import importlib.util
import platform
from pathlib import Path

from ..errors import InputError

PACKAGE = "swarmchase"
DIGITS = 12
"""Of a digest, as people compare them."""


def installed() -> dict[str, str | None]:
    """Version by name of what the results depend on, None where it is missing; of this package also a digest of its
    code and weights, since two versions under development may have one number."""
    found: dict[str, str | None] = {"Python": platform.python_version()}
    for name in ("swarmchase", "torch", "numpy"):
        try:
            found[name] = importlib.metadata.version(name).split("+")[0]  # +cpu, +cu130: the same on a CPU
        except importlib.metadata.PackageNotFoundError:
            found[name] = None
    spec = importlib.util.find_spec("swarmchase")
    if spec is None or not spec.submodule_search_locations:
        return found | {"swarmchase": None}
    folder = Path(spec.submodule_search_locations[0])
    digest = hashlib.sha256()
    for path in sorted(folder.rglob("*")):
        if path.suffix in (".py", ".safetensors"):
            digest.update(path.relative_to(folder).as_posix().encode() + b"\0" + path.read_bytes())
    return found | {"code of swarmchase": digest.hexdigest()[:DIGITS]}


def require_same_software(node: str, there: dict[str, str | None], here: dict[str, str | None]) -> None:
    """Compare what ``installed`` found.

    Raises:
        InputError: a node without the package, or with another version of anything.
    """
    if there[PACKAGE] is None:
        raise InputError(f"node {node} has no {PACKAGE}: pip install '{PACKAGE}[cluster]=={here[PACKAGE]}' there")
    for name, version in here.items():
        if there.get(name) != version:
            raise InputError(
                f"node {node} has {name} {there.get(name)}, and this machine {version}: install the same on all nodes"
            )
