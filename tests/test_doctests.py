"""Examples in docstrings do what they say."""

import doctest
import importlib
import pkgutil
from pathlib import Path

import pytest

import swarmchase
from swarmchase import Observation, load_controller, paper_scenario

SOURCES = Path(swarmchase.__file__).parent


def source_of(module: str) -> str:
    """Of a module, or of a package's own."""
    path = SOURCES.parent.joinpath(*module.split("."))
    return (path / "__init__.py" if path.is_dir() else path.with_suffix(".py")).read_text(encoding="utf-8")


WITH_EXAMPLES = sorted(
    module.name for module in pkgutil.walk_packages([str(SOURCES)], "swarmchase.") if ">>> " in source_of(module.name)
)


@pytest.mark.parametrize("module", WITH_EXAMPLES)
def test_examples(module: str) -> None:
    found = doctest.testmod(importlib.import_module(module), optionflags=doctest.NORMALIZE_WHITESPACE)
    assert found.attempted > 0
    assert found.failed == 0


def test_the_first_names_of_the_package_have_examples() -> None:
    """Those that a newcomer looks at."""
    for name in ("paper_scenario", "load_controller", "Observation", "Action", "Environment", "run_chases"):
        assert ">>> " in getattr(swarmchase, name).__doc__, name


@pytest.mark.parametrize("name", ["adaptive", "particle", "multilateration", "gradient", "oracle", "random"])
def test_a_controller_says_in_a_line_what_it_is_and_was_told(name: str) -> None:
    told = paper_scenario(shadowing_db=2.0)
    shown = repr(load_controller(name, told))
    assert shown.startswith("<")
    assert f" {name!r}, told Scenario(sampling_hz=10.0, spatial_correlation=0.9, shadowing_db=2.0)>" in shown


def test_a_window_in_which_nothing_was_heard_says_so() -> None:
    import torch

    silent = Observation(torch.full((1, 2, 6), torch.nan), torch.zeros(1, 2, 6, 3), torch.zeros(1, 2))
    assert repr(silent) == "Observation(1 chase, 2 samples, 6 trackers: nothing heard, 100 % missing, with times)"


def test_the_package_says_that_it_has_types() -> None:
    assert (SOURCES / "py.typed").exists()
