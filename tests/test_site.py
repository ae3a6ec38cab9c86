"""The documentation as a site: it is built without a warning, its notebooks and examples run, every figure is on its
page.
"""

import importlib.util
import json
import os
import re
import shlex
import subprocess
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from swarmchase.cli import _parsed

ROOT = Path(__file__).parent.parent
DOCS = ROOT / "docs"
TAUGHT = [DOCS / "tutorial.md", *sorted((DOCS / "guides").glob("*.md"))]
NOTEBOOKS = sorted((DOCS / "notebooks").glob("*.ipynb"))


def name_of(path: Path) -> str:
    return str(path.relative_to(DOCS))


@pytest.fixture(scope="module")
def run_notebooks() -> ModuleType:
    """The script that keeps what they print."""
    script = importlib.util.spec_from_file_location("run_notebooks", DOCS / "run_notebooks.py")
    assert script is not None
    assert script.loader is not None
    module = importlib.util.module_from_spec(script)
    script.loader.exec_module(module)
    return module


def words_of(outputs: list[dict[str, Any]]) -> list[str]:
    """Pictures are of the same size at most."""
    return ["".join(one.get("text", one.get("data", {}).get("text/plain", "a picture"))) for one in outputs]


@pytest.mark.parametrize("path", NOTEBOOKS, ids=name_of)
def test_notebooks_print_what_they_keep(path: Path, run_notebooks: ModuleType) -> None:
    notebook = json.loads(path.read_text(encoding="utf-8"))
    kept = [words_of(cell["outputs"]) for cell in notebook["cells"] if cell["cell_type"] == "code"]
    assert [words_of(outputs) for outputs in run_notebooks.run_cells(notebook)] == kept
    assert any(kept)


@pytest.mark.parametrize("path", TAUGHT, ids=name_of)
def test_python_of_tutorial_and_guides_runs(path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The blocks of a page one after another."""
    names: dict[str, Any] = {"__name__": path.stem}
    blocks = re.findall(r"```python\n(.*?)```", path.read_text(encoding="utf-8"), flags=re.DOTALL)
    assert blocks
    for block in blocks:
        exec(compile(block, str(path), "exec"), names)
    assert capsys.readouterr().out.count("\n") >= 2


def commands() -> list[str]:
    """Those of the pages, with what their user types."""
    text = "\n".join(path.read_text(encoding="utf-8") for path in TAUGHT)
    return re.findall(r"^    (swarmchase .*)$", text, flags=re.MULTILINE)


@pytest.mark.parametrize("command", commands())
def test_commands_of_tutorial_and_guides_are_commands(command: str) -> None:
    _parsed(shlex.split(command)[1:])


def test_every_figure_has_its_place_on_the_page_of_figures() -> None:
    page = (DOCS / "figures.md").read_text(encoding="utf-8")
    shown = re.findall(r"^!\[[^\]]+\]\(([^)]+)\)$", page, flags=re.MULTILINE)
    assert sorted(shown) == sorted(name_of(path) for path in [*DOCS.glob("*.png"), *DOCS.glob("figures/*.png")])


def test_the_site_is_built_without_a_warning(tmp_path: Path) -> None:
    pytest.importorskip("mkdocs", reason="the site needs: pip install -e '.[docs]'")
    pytest.importorskip("mkdocstrings", reason="the site needs: pip install -e '.[docs]'")
    words = [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(tmp_path / "site")]
    environment = {**os.environ, "NO_MKDOCS_2_WARNING": "1", "PYTHONWARNINGS": ""}
    ran = subprocess.run(words, cwd=ROOT, env=environment, check=False, capture_output=True, text=True, timeout=280)
    # Not --quiet: then nobody counts the warnings.
    assert (ran.returncode, re.findall("(?:WARNING|ERROR).*", ran.stderr)) == (0, []), ran.stderr
    assert "Documentation built" in ran.stderr
    site = tmp_path / "site"
    reference = (site / "reference" / "first.html").read_text(encoding="utf-8")
    # From the docstring, with its example.
    assert "Table I of the paper, with the named fields changed" in reference
    assert 'id="swarmchase.controllers.load_controller"' in reference
    assert "claims" in (site / "notebooks" / "belief.html").read_text(encoding="utf-8")
    # What pages link to beside them is there.
    assert (site / "repository" / "examples" / "cleanrl_ppo.py").is_file()
    assert (site / "repository" / "src" / "swarmchase" / "weights" / "index.html").is_file()
