"""The README's examples run as they stand."""

import re
from pathlib import Path
from typing import Any

import pytest

README = Path(__file__).parent.parent / "README.md"
EXAMPLES = re.findall(r"```python\n(.*?)```", README.read_text(encoding="utf-8"), flags=re.DOTALL)


@pytest.mark.parametrize("example", EXAMPLES)
def test_python_example_runs(example: str) -> None:
    names: dict[str, Any] = {}
    exec(compile(example, str(README), "exec"), names)
    if "outcome" in names:
        assert int(names["outcome"].reached.sum()) > 0, "after 20 movements some of 64 chases have ended"
    if "env" in names:
        assert names["rssi_dbm"].shape == (50, 6)
        names["env"].close()


def test_there_are_examples() -> None:
    assert len(EXAMPLES) == 2


@pytest.mark.parametrize("link", re.findall(r"\]\(([^)]+)\)", README.read_text(encoding="utf-8")))
def test_links_lead_somewhere(link: str) -> None:
    file, _, anchor = link.partition("#")
    assert (README.parent / file).exists()
    if anchor:
        headings = re.findall(r"^#+ (.*)$", (README.parent / file).read_text(encoding="utf-8"), re.MULTILINE)
        assert anchor in {heading.lower().replace(" ", "-") for heading in headings}
