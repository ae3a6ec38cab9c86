"""Imports go one way, along the data's way; read from the source, so that imports inside functions count, too."""

import ast
import functools
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

import swarmchase

PACKAGE = Path(swarmchase.__file__).parent

FORBIDDEN = [
    # Rooms, and what must not be known there, not even through others.
    ("networks", {"world", "simulation"}, set()),  # what flies must not depend on the simulator
    ("controllers", {"world", "simulation"}, set()),
    ("live", {"world", "simulation"}, set()),
    ("live.link", set(), {"torch", "numpy"}),  # a tracker's companion computer has neither
    ("live.tracker", set(), {"torch", "numpy"}),
    ("tracker_alone", set(), {"torch", "numpy"}),
    ("reports", {"world", "networks", "controllers", "training", "cluster", "simulation"}, {"torch"}),
    ("gym", {"networks", "controllers", "training", "evaluation"}, set()),
    ("batch", {"channel", "world"}, set()),
    ("channel", {"world"}, set()),
]

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
    """The folder a module lies in. The package's own modules and those beside the rooms of ``live`` are one each."""
    folder = module if MODULES[module].name == "__init__.py" else module.rpartition(".")[0]
    return module if folder in ("", "live") else folder


def lies_in(module: str, name: str) -> bool:
    return module == name or module.startswith(f"{name}.")


def only_for_types(node: ast.AST) -> list[ast.stmt]:
    """The lines of an ``if TYPE_CHECKING:``; what is imported there is known, and need not be installed."""
    if isinstance(node, ast.If) and isinstance(node.test, ast.Name) and node.test.id == "TYPE_CHECKING":
        return node.body
    return []


@functools.cache
def imports(module: str) -> tuple[set[str], set[str]]:
    """(modules of this package, top-level names of others) that a module imports anywhere in its source."""
    own: set[str] = set()
    foreign: set[str] = set()
    path = MODULES[module]
    package = [] if module == "swarmchase" else module.split(".")
    package = package if path.name == "__init__.py" else package[:-1]
    tree = ast.parse(path.read_text(encoding="utf-8"))
    for_types = {inner for node in ast.walk(tree) for line in only_for_types(node) for inner in ast.walk(line)}
    for node in ast.walk(tree):
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
            elif node not in for_types:
                foreign.add(top)
    return own - {module}, foreign


def known(name: str) -> str:
    """The module that ``from it import that`` names: the longest part that is a module."""
    parts = name.split(".")
    for length in range(len(parts), 0, -1):
        if ".".join(parts[:length]) in MODULES:
            return ".".join(parts[:length])
    return "swarmchase"


def needed_by(modules: set[str]) -> set[str]:
    """These modules and all that they import, directly or through others, the packages they lie in included."""
    needed: set[str] = set()
    waiting = set(modules)
    while waiting:
        needed |= waiting
        following = set().union(*(imports(module)[0] | packages_of(module) for module in waiting))
        waiting = following - needed - {"swarmchase"}
    return needed


def packages_of(module: str) -> set[str]:
    """The packages around a module: their __init__ is imported with it."""
    parts = module.split(".")
    return {".".join(parts[:length]) for length in range(1, len(parts))}


def circle(graph: dict[str, set[str]]) -> list[str]:
    """One of the graph's circles, or nothing."""
    done: set[str] = set()

    def visit(node: str, path: tuple[str, ...]) -> list[str]:
        if node in path:
            return [*path[path.index(node) :], node]
        if node not in done:
            for following in sorted(graph[node]):
                if found := visit(following, (*path, node)):
                    return found
            done.add(node)
        return []

    return next((found for node in sorted(graph) if (found := visit(node, ()))), [])


def test_walker_sees_what_is_there() -> None:
    """The tests below would pass on nothing at all."""
    assert imports("world.environment")[0] >= {"channel.propagation", "formation", "world.target", "scenario"}
    assert imports("training.losses")[0] >= {"batch.array_types", "observation", "training.rollout"}
    assert imports("training.losses")[1] >= {"dataclasses", "typing", "torch"}
    assert "training.a3c" in imports("commands.train")[0]  # inside a function
    assert {"world.receivers", "scenario"} <= needed_by({"commands.evaluate"})  # through others
    rooms = {room(module) for module in MODULES}
    assert rooms >= {"batch", "world", "live.link", "live.tracker.sources", "live.audience", "scenario"}
    assert not rooms & {"live.link.messages", "world.target"}
    assert circle({"a": {"b"}, "b": {"c"}, "c": {"b"}}) == ["b", "c", "b"]
    assert circle({"a": {"b", "c"}, "b": {"c"}, "c": set()}) == []


def test_rooms_import_only_rooms_below_them() -> None:
    """There is an order of the rooms in which every import goes one way: the graph of their imports has no circle."""
    assert circle(room_imports()) == []


def room_imports() -> dict[str, set[str]]:
    """Which other rooms each room imports."""
    graph: dict[str, set[str]] = {room(module): set() for module in MODULES if module != "swarmchase"}
    for module in set(MODULES) - {"swarmchase"}:
        graph[room(module)] |= {room(other) for other in imports(module)[0] - {"swarmchase"}} - {room(module)}
    return graph


def shown_name(name: str) -> str:
    """As the document writes a room: ``live/link/`` or ``scenario.py``."""
    return name.replace(".", "/") + ("/" if MODULES[name].name == "__init__.py" else ".py")


def what_it_is_for(name: str) -> str:
    docstring = ast.get_docstring(ast.parse(MODULES[name].read_text(encoding="utf-8"))) or ""
    return " ".join(docstring.split("\n\n", maxsplit=1)[0].split()).replace("``", "")


def test_the_document_shows_the_rooms_in_their_order() -> None:
    text = (Path(__file__).parents[1] / "docs" / "method.md").read_text(encoding="utf-8")
    section = text.partition("## The rooms of the code\n")[2].partition("\n## ")[0]
    listed = dict(re.findall(r"^\| `([^`]+)` \| (.+) \|$", section, flags=re.MULTILINE))
    listed.pop("weights/")  # files alone
    graph = room_imports()
    assert listed == {shown_name(name): what_it_is_for(name) for name in graph}
    place = {name: number for number, name in enumerate(listed)}
    too_low = {
        (name, other)
        for name, imported in graph.items()
        for other in imported
        if place[shown_name(other)] > place[shown_name(name)]
    }
    assert too_low == set()


def test_modules_import_one_another_one_way() -> None:
    # A package's own __init__ is imported before its modules anyway.
    graph = {
        module: {other for other in imports(module)[0] if other != "swarmchase" and not lies_in(module, other)}
        for module in MODULES
    }
    assert circle(graph) == []


@pytest.mark.parametrize(("name", "rooms", "libraries"), FORBIDDEN, ids=lambda value: value if value else "")
def test_rooms_that_must_not_know_each_other(name: str, rooms: set[str], libraries: set[str]) -> None:
    inside = {module for module in MODULES if lies_in(module, name)}
    assert inside, "no such room any more"
    needed = needed_by(inside)
    assert {module for module in needed for one in rooms if lies_in(module, one)} == set()
    assert {(module, one) for module in needed for one in imports(module)[1] & libraries} == set()


def test_the_trackers_own_distribution_holds_what_it_imports() -> None:
    """And nothing else: by the list in its pyproject.toml."""
    needed = needed_by(
        {"tracker_alone"}
        | {module for module in MODULES if lies_in(module, "live.link") or lies_in(module, "live.tracker")}
    )
    files = {MODULES[module] for module in needed} | {PACKAGE / "__init__.py"} | {*(PACKAGE / "scenarios").iterdir()}
    project = Path(__file__).parents[1] / "tracker"
    build = tomllib.loads((project / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["hatch"]["build"]
    modules = "swarmchase_tracker/modules/swarmchase/"
    listed = [PACKAGE / name.removeprefix(modules) for name in build["only-include"] if name.startswith(modules)]
    held = [file for place in listed for file in (place.rglob("*") if place.is_dir() else [place])]
    assert {file for file in held if file.suffix in {".py", ".toml"}} == files


def test_nothing_imports_the_command_line() -> None:
    importers = {module for module in MODULES if imports(module)[0] & {"cli", "__main__"}}
    assert importers == {"__main__"}


def test_training_imports_only_what_a_training_machine_has() -> None:
    needed = needed_by({module for module in MODULES if lies_in(module, "training")})
    foreign = {
        (module, name)
        for module in needed
        for name in imports(module)[1]
        if name not in TRAINING_MACHINE | sys.stdlib_module_names
    }
    assert foreign == {("batch.array_types", "jaxtyping")}  # in a try: plain tensors without it


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
        "print('torch._dynamo' in sys.modules)\n"  # its compiler, which takes longer to load than all the rest
    )
    ran = subprocess.run(
        [sys.executable, "-c", program, str(tmp_path / "run")], capture_output=True, text=True, check=False
    )
    assert (ran.stdout, ran.returncode) == ("2 finished\nFalse\n", 0), ran.stderr
