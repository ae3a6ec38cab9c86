"""What people install: both distributions are built from what a clone looks like after a day's work, each is installed
in an environment of its own, and a live chase goes across the two."""

import email
import importlib.metadata
import json
import os
import subprocess
import sys
import tarfile
import tomllib
import venv
import zipfile
from collections.abc import Iterator
from pathlib import Path
from shutil import copytree, ignore_patterns

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

import swarmchase
from swarmchase.controllers import load_controller, shipped
from swarmchase.errors import InputError
from swarmchase.networks.weights import read_weights
from swarmchase.scenario import paper_scenario

ROOT = Path(__file__).parents[1]
NOT_SOURCE = (".git", "runs", ".venv", "__pycache__", ".*_cache", ".hypothesis")
LEFT_BY_COMMANDS = (
    "swarm.keys",
    "tracker/tracker-0.keys",
    "runs/mine/best.safetensors",
    "reproduction-quick/results.md",
    "chase-output/chase.json",
    "comparison/comparison.parquet",
    "live-output/20260101-000000-seed0-chase0.mcap",
    "dist/swarmchase-0.0.0.tar.gz",
)
GIT = {**os.environ, **{f"GIT_{who}_{what}": "a@b.c" for who in ("AUTHOR", "COMMITTER") for what in ("NAME", "EMAIL")}}
MOST_WHEEL_BYTES = 25_000_000
LIVE = "live --headless --seed 2 --controller paper --start-distance-m 12 --sampling-hz 100 --json --log chase.mcap"


@pytest.fixture(scope="module")
def dist(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder with the sdists and the wheels of both, built by the command that packagers use."""
    source, folder = tmp_path_factory.mktemp("clone") / "swarmchase", tmp_path_factory.mktemp("dist")
    copytree(ROOT, source, symlinks=True, ignore=ignore_patterns(*NOT_SOURCE))
    for name in LEFT_BY_COMMANDS:
        (source / name).parent.mkdir(parents=True, exist_ok=True)
        (source / name).touch()
    for project in (source, source / "tracker"):
        run("-m", "build", "--no-isolation", "--outdir", str(folder), str(project))
    return folder


def run(*words: str, python: str = sys.executable, folder: Path | None = None) -> str:
    """What a Python prints on standard output. It knows nothing of this repository."""
    environment = {name: value for name, value in os.environ.items() if not name.startswith("PYTHON")}
    ran = subprocess.run(
        [python, *words], capture_output=True, text=True, check=False, timeout=200, cwd=folder, env=environment
    )
    assert ran.returncode == 0, ran.stdout + ran.stderr
    return ran.stdout


def wheel_of(dist: Path, name: str) -> Path:
    return dist / f"{name}-{swarmchase.__version__}-py3-none-any.whl"


def metadata_of(wheel: Path) -> "email.message.Message[str, str]":
    with zipfile.ZipFile(wheel) as archive:
        [name] = [one for one in archive.namelist() if one.endswith(".dist-info/METADATA")]
        return email.message_from_bytes(archive.read(name))


def contents(wheel: Path) -> dict[str, bytes]:
    with zipfile.ZipFile(wheel) as archive:
        return {one: archive.read(one) for one in archive.namelist()}


def installed(wheel: Path, extras: set[str], folder: Path) -> Path:
    """An environment with the wheel and what it requires, which is taken from here: no index is asked."""
    venv.create(folder, symlinks=True)
    python = folder / "bin" / "python"
    options = ["--no-deps", "--no-index", "--no-compile", "--quiet"]
    run("-m", "pip", "--python", str(python), "install", *options, str(wheel))
    [packages] = folder.glob("lib/python*/site-packages")
    for distribution in required_by(metadata_of(wheel).get_all("Requires-Dist") or [], extras):
        for file in distribution.files or []:
            place = packages / file.parts[0]
            if file.parts[0] != ".." and not place.exists():
                place.symlink_to(distribution.locate_file(file.parts[0]))
    return python


def required_by(requirements: list[str], extras: set[str]) -> Iterator[importlib.metadata.Distribution]:
    """The distributions that these requirements need, directly or through others."""
    waiting, seen = [(Requirement(one), extras) for one in requirements], set()
    while waiting:
        requirement, wanted = waiting.pop()
        if requirement.marker and not any(requirement.marker.evaluate({"extra": one}) for one in ({""} | wanted)):
            continue
        name = canonicalize_name(requirement.name)
        if (name, frozenset(requirement.extras)) in seen:
            continue
        seen.add((name, frozenset(requirement.extras)))
        distribution = importlib.metadata.distribution(name)
        yield distribution
        waiting += [(Requirement(one), requirement.extras) for one in distribution.requires or []]


@pytest.fixture(scope="module")
def ground_station(dist: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The Python of an environment with swarmchase[live]."""
    return installed(wheel_of(dist, "swarmchase"), {"live"}, tmp_path_factory.mktemp("ground"))


@pytest.fixture(scope="module")
def small_computer(dist: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The Python of an environment with swarmchase-tracker alone."""
    return installed(wheel_of(dist, "swarmchase_tracker"), set(), tmp_path_factory.mktemp("tracker"))


def test_packagers_find_nothing_to_complain_of(dist: Path) -> None:
    files = sorted(dist.iterdir())
    names = [f"{name}-{swarmchase.__version__}" for name in ("swarmchase", "swarmchase_tracker")]
    assert [one.name for one in files] == sorted(f"{n}{end}" for n in names for end in ("-py3-none-any.whl", ".tar.gz"))
    run("-m", "twine", "check", "--strict", *map(str, files))


@pytest.mark.parametrize("name", ["swarmchase", "swarmchase_tracker"])
def test_metadata_says_whose_it_is_and_what_it_needs(dist: Path, name: str) -> None:
    found = metadata_of(wheel_of(dist, name))
    assert (found["Version"], found["License-Expression"]) == (swarmchase.__version__, "Apache-2.0")
    assert found["Author"] == "The swarmchase developers"
    assert found["Requires-Python"] == ">=3.11"
    classifiers = set(found.get_all("Classifier") or [])
    assert "Programming Language :: Python :: 3.11" in classifiers
    assert ("Typing :: Typed" in classifiers) == (f"{name}/py.typed" in contents(wheel_of(dist, name)))


def test_both_ask_for_the_same_versions() -> None:
    """What the tracker needs is what swarmchase[live] needs for the same modules."""
    whole, tracker = (
        tomllib.loads((ROOT / place / "pyproject.toml").read_text(encoding="utf-8"))["project"]
        for place in ("", "tracker")
    )
    extras = whole["optional-dependencies"]
    assert set(tracker["dependencies"]) <= {*whole["dependencies"], *extras["live"]}
    assert tracker["optional-dependencies"].items() <= extras.items()


def test_source_archives_hold_the_source_and_nothing_that_commands_leave(dist: Path) -> None:
    for name in ("swarmchase", "swarmchase_tracker"):
        with tarfile.open(dist / f"{name}-{swarmchase.__version__}.tar.gz") as archive:
            assert all(one.isfile() or one.isdir() for one in archive), "a link would lead out of the archive"
            inside = {one.partition("/")[2] for one in archive.getnames()}
        assert {"LICENSE", "README.md", "pyproject.toml"} <= inside
        assert inside & {one.removeprefix("tracker/") for one in LEFT_BY_COMMANDS} == set()
        assert [one for one in inside if one.endswith(".keys")] == []


def test_no_file_belongs_to_both_wheels_and_the_trackers_modules_are_swarmchases(dist: Path) -> None:
    whole, tracker = contents(wheel_of(dist, "swarmchase")), contents(wheel_of(dist, "swarmchase_tracker"))
    assert whole.keys() & tracker.keys() == set()
    modules = {name.partition("/modules/")[2]: content for name, content in tracker.items() if "/modules/" in name}
    assert "swarmchase/live/tracker/agent.py" in modules
    assert {name: whole[name] for name in modules} == modules


def test_the_wheel_is_small_and_its_weights_are_those_of_the_clone(
    dist: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    wheel = wheel_of(dist, "swarmchase")
    assert wheel.stat().st_size < MOST_WHEEL_BYTES
    own = {one.name: one for family in shipped.shipped_families().values() for one in family}
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(tmp_path, [name for name in archive.namelist() if "/weights/" in name])
    monkeypatch.setattr(shipped, "WEIGHTS_FOLDER", tmp_path / "swarmchase" / "weights")
    packed = {one.name: one for family in shipped.shipped_families().values() for one in family}
    pyproject = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    left_out = pyproject["tool"]["hatch"]["build"]["targets"]["wheel"]["hooks"]["custom"]["left-out"]
    assert packed.keys() == own.keys() >= set(left_out)
    assert {name for name, one in packed.items() if not one.is_here} == set(left_out)
    for name, one in packed.items():
        if one.is_here:
            assert read_weights(one.path) == own[name].path.read_bytes()
        else:
            sampling_hz, spatial_correlation = one.setting or (10.0, 0.9)
            scenario = paper_scenario(sampling_hz=sampling_hz, spatial_correlation=spatial_correlation)
            place = own[name].path.relative_to(ROOT)
            with pytest.raises(InputError, match=rf"^the weights {name} are not in this .* controller: {place}$"):
                load_controller(one.family, scenario)


def test_the_tag_is_of_the_version_that_everything_says(tmp_path: Path) -> None:
    version = swarmchase.__version__
    for name in ("Makefile", "CHANGELOG.md", "CITATION.cff", "src/swarmchase/__init__.py"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_bytes((ROOT / name).read_bytes())

    def command(*words: str) -> "subprocess.CompletedProcess[str]":
        # `make test` tells the makes that it starts to name their folders.
        environment = {name: value for name, value in GIT.items() if not name.startswith("MAKE")}
        return subprocess.run(words, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)

    command("git", "init", "--quiet")
    assert "git status is not clean" in command("make", "tag").stdout
    command("git", "add", ".")
    command("git", "commit", "--quiet", "--message", "all")
    assert command("make", "tag").returncode == 0
    assert command("git", "tag").stdout == f"v{version}\n"
    package = tmp_path / "src" / "swarmchase" / "__init__.py"
    package.write_text(package.read_text().replace(f'"{version}"', '"99.0.0"'))
    assert command("make", "tag").stdout.startswith("CHANGELOG.md has no section of 99.0.0")
    tags = subprocess.run(["git", "tag", "--list", "v*"], cwd=ROOT, capture_output=True, text=True, check=False)
    for tag in tags.stdout.split():
        words = ["git", "show", f"{tag}:src/swarmchase/__init__.py"]
        said = subprocess.run(words, cwd=ROOT, capture_output=True, text=True, check=True).stdout
        assert f'__version__ = "{tag.removeprefix("v")}"' in said


def test_a_trackers_computer_needs_neither_torch_nor_numpy(small_computer: Path, tmp_path: Path) -> None:
    found = "print(*[n for n in ('torch', 'numpy', 'scipy', 'swarmchase') if importlib.util.find_spec(n)])"
    assert run("-c", f"import importlib.util\n{found}", python=str(small_computer)) == "\n"
    program = str(small_computer.parent / "swarmchase-tracker")
    assert run("--version", python=program, folder=tmp_path) == f"swarmchase-tracker {swarmchase.__version__}\n"
    (tmp_path / "tracker.toml").write_text('source = "simulated:-60"\nvehicle = "simulated"\nunsigned = true\n')
    printed = run("--config", "tracker.toml", "--number", "3", "--print-config", python=program, folder=tmp_path)
    assert tomllib.loads(printed)["number"] == 3
    # Another package's source and vehicle, which import swarmchase.
    [packages] = small_computer.parents[1].glob("lib/python*/site-packages")
    options = ["--no-deps", "--no-index", "--no-build-isolation", "--quiet", "--target", str(packages)]
    run("-m", "pip", "install", *options, str(ROOT / "examples" / "plugin"))
    words = [program, "--config", "tracker.toml", "--number", "0", "--source", "beacon:1", "--vehicle", "tripod"]
    ran = subprocess.run(words, capture_output=True, text=True, check=False, cwd=tmp_path)
    assert ran.returncode == 2
    assert ran.stderr == "swarmchase: a tripod needs --position-m: it is where it stands\n"
    words += ["--position-m", "0", "0", "0", "--state-folder", "state"]
    with subprocess.Popen(words, stderr=subprocess.PIPE, text=True, cwd=tmp_path) as flying:
        assert flying.stderr is not None
        assert flying.stderr.readline() == "Tracker 0 dials 127.0.0.1:14550.\n"
        flying.terminate()
        assert flying.wait(60) == 0


def test_a_live_chase_goes_across_both(ground_station: Path, small_computer: Path, tmp_path: Path) -> None:
    """``swarmchase live``, whose six trackers are those of the other environment."""
    (tmp_path / "chase.py").write_text(
        "from swarmchase.simulation import tracker_processes\n"
        f"PROGRAM = {str(small_computer.parent / 'swarmchase-tracker')!r}\n"
        "tracker_processes.child_command = lambda words: [PROGRAM, *words[1:]]\n"
        "if __name__ == '__main__':\n"
        "    from swarmchase.__main__ import main\n"
        "    main()\n"
    )
    told = json.loads(run("chase.py", *LIVE.split(), python=str(ground_station), folder=tmp_path))
    assert (told["state"], told["reached"]) == ("reached", True)
    assert told["movements"] > 0
