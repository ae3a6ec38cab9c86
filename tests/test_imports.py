"""Imports go one way, along the data's way; read from the source, so that imports inside functions count, too."""

import ast
import functools
import subprocess
import sys
from pathlib import Path

import pytest

import swarmchase

PACKAGE = Path(swarmchase.__file__).parent

ROOMS = [
    # A module imports of its own room and of the rooms before it, never of one behind it.
    {
        "swarmchase",
        "errors",
        "files",
        "memory",
        "array_types",
        "scenario",
        "streams",
        "batching",
        "tensor_files",
        "robustness",
    },
    {"target", "channel", "receivers", "fading_law", "formation", "observation"},
    {"environment"},
    {"networks"},
    {"gated_network", "fading_network"},
    {"controllers"},
    {"live"},
    {"simulation"},
    {"chases"},
    {"training"},
    {"evaluation"},
    {"chase_log"},
    {"paper_results"},
    {"blocks"},
    {"cluster"},
    {"reproduction", "comparison"},
    {"results_report", "comparison_report"},
    {"figures"},
    {"paper_figures"},
    {"comparison_figures"},
    {"cluster_figures"},
    {"gym", "gym_registration"},
    {"benchmarks"},
    {"commands"},
    {"cli"},
    {"__main__"},
]

FORBIDDEN = [
    # Earlier on the way, and yet not to be known.
    ("controllers", {"environment", "target", "channel", "receivers"}),  # what flies must not depend on the simulator
    ("gated_network", {"environment", "target", "channel", "formation", "receivers"}),
    ("fading_network", {"environment", "target", "channel", "formation", "receivers"}),
    ("networks", {"environment", "target", "channel", "formation"}),
    ("paper_figures", {"environment", "controllers", "networks", "chases", "training", "evaluation", "reproduction"}),
    ("figures", {"environment", "controllers", "networks", "chases", "training", "evaluation", "chase_log"}),
    ("live", {"environment", "target", "channel", "receivers", "fading_law"}),
    ("gym", {"networks", "controllers", "training", "evaluation"}),
]
EXCEPTIONS = {("controllers.oracle", "target")}
"""The oracle knows the target: that is what it is for."""

TRAINING_MACHINE = {"torch", "numpy", "scipy", "rich", "safetensors", "matplotlib"}
"""All that a GPU box without a network has, beside the standard library."""


def module_name(path: Path) -> str:
    """``training.losses``; the package itself is ``swarmchase``."""
    parts = path.relative_to(PACKAGE).with_suffix("").parts
    parts = parts[:-1] if parts[-1] == "__init__" else parts
    return ".".join(parts) or "swarmchase"


def project_modules() -> dict[str, Path]:
    return {module_name(path): path for path in sorted(PACKAGE.rglob("*.py"))}


MODULES = project_modules()


def room(module: str) -> str:
    return module.split(".", maxsplit=1)[0]


@functools.cache
def imports(module: str) -> tuple[set[str], set[str]]:
    """(modules of this package, top-level names of others) that a module imports anywhere in its source."""
    own: set[str] = set()
    foreign: set[str] = set()
    path = MODULES[module]
    package = [] if module == "swarmchase" else module.split(".")
    package = package if path.name == "__init__.py" else package[:-1]
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            base = package[: len(package) - (node.level - 1)] if node.level else []
            start = [*(["swarmchase", *base] if node.level else []), *([node.module] if node.module else [])]
            names = [".".join([*start, alias.name]) for alias in node.names]
        else:
            continue
        for name in names:
            top, _, rest = name.partition(".")
            if top == "swarmchase":
                own.add(known(rest))
            else:
                foreign.add(top)
    return own - {module}, foreign


def known(name: str) -> str:
    """The module that ``from it import that`` names: the longest part that is a module."""
    parts = name.split(".")
    for length in range(len(parts), 0, -1):
        if ".".join(parts[:length]) in MODULES:
            return ".".join(parts[:length])
    return "swarmchase"


def test_walker_sees_what_is_there() -> None:
    """The tests below would pass on nothing at all."""
    assert imports("environment")[0] >= {"channel", "formation", "target", "scenario"}
    assert imports("training.losses") == (
        {"array_types", "errors", "fading_network", "observation", "scenario", "training.rollout"},
        {"dataclasses", "math", "typing", "torch"},
    )
    assert "networks" in imports("controllers.learned")[0]
    assert "training.a3c" in imports("commands.train")[0]  # inside a function
    assert "pyarrow" in imports("evaluation")[1]


def test_every_module_has_a_room() -> None:
    named = set().union(*ROOMS)
    assert {room(module) for module in MODULES} == named, "name the new room, at its place on the data's way"


@pytest.mark.parametrize("module", [module for module in MODULES if module != "swarmchase"])
def test_imports_go_one_way(module: str) -> None:
    place = {name: index for index, names in enumerate(ROOMS) for name in names}
    ahead = {other for other in imports(module)[0] if place[room(other)] > place[room(module)]}
    assert ahead == set()


@pytest.mark.parametrize(("importer", "rooms"), FORBIDDEN)
def test_rooms_that_must_not_know_each_other(importer: str, rooms: set[str]) -> None:
    known_rooms = {
        (module, room(other))
        for module in MODULES
        if room(module) == importer
        for other in imports(module)[0]
        if (module, room(other)) not in EXCEPTIONS
    }
    assert {(module, other) for module, other in known_rooms if other in rooms} == set()


def test_nothing_imports_the_command_line() -> None:
    importers = {module for module in MODULES if imports(module)[0] & {"cli", "__main__"}}
    assert importers == {"__main__"}


def test_there_are_no_circles() -> None:
    seen: set[str] = set()

    def visit(module: str, path: tuple[str, ...]) -> None:
        assert module not in path, f"circle: {' -> '.join([*path, module])}"
        if module in seen:
            return
        # A package's own __init__ is imported before its modules anyway.
        inner = {other for other in imports(module)[0] if other != "swarmchase" and not module.startswith(f"{other}.")}
        for other in inner:
            visit(other, (*path, module))
        seen.add(module)

    for module in MODULES:
        if module != "swarmchase":
            visit(module, ())


def test_training_imports_only_what_a_training_machine_has() -> None:
    waiting = {module for module in MODULES if room(module) == "training"}
    needed: set[str] = set()
    while waiting:
        needed |= waiting
        waiting = set().union(*(imports(module)[0] for module in waiting)) - needed - {"swarmchase"}
    foreign = {
        (module, name)
        for module in needed
        for name in imports(module)[1]
        if name not in TRAINING_MACHINE | sys.stdlib_module_names
    }
    assert foreign == {("array_types", "jaxtyping")}  # in a try: plain tensors without it


def test_training_runs_where_nothing_else_is_installed(tmp_path: Path) -> None:
    program = (
        "import sys\n"
        "for name in ('tyro', 'gymnasium', 'pyarrow', 'tensorboard', 'jaxtyping', 'beartype'):\n"
        "    sys.modules[name] = None\n"
        "from pathlib import Path\n"
        "from swarmchase.scenario import paper_scenario\n"
        "from swarmchase.training.a3c import train_a3c\n"
        "from swarmchase.training.settings import TrainingSettings\n"
        "settings = TrainingSettings(num_agents=1, max_updates=2, evaluation_interval=1, evaluation_chases=1)\n"
        "result = train_a3c(paper_scenario(max_movements=3), settings, Path(sys.argv[1]), 'deterministic')\n"
        "print(result.updates, result.stopped)\n"
    )
    ran = subprocess.run(
        [sys.executable, "-c", program, str(tmp_path / "run")], capture_output=True, text=True, check=False
    )
    assert (ran.stdout, ran.returncode) == ("2 finished\n", 0), ran.stderr
