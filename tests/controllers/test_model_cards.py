"""Every family of weights has a card in its folder, as model hubs take it, and the card says what the files say."""

import re

import pytest

from model_card import files_table
from swarmchase.controllers.shipped import WEIGHTS_FOLDER, shipped_families


@pytest.mark.parametrize("family", shipped_families())
def test_the_card_is_of_its_files(family: str) -> None:
    card = (WEIGHTS_FOLDER / family / "README.md").read_text(encoding="utf-8")
    head = re.match(r"---\n(.*?)\n---\n\n# (.*)\n", card, flags=re.DOTALL)
    assert head, "a hub reads what stands between --- at the top"
    fields = dict(re.findall(r"^([a-z_]+): (\S+)$", head[1], flags=re.MULTILINE))
    assert fields == {"license": "apache-2.0", "library_name": "swarmchase", "pipeline_tag": "reinforcement-learning"}
    assert head[2].startswith(f"{family}: ")
    section = card.partition("## Files\n\n")[2].partition("\n\n## ")[0]
    assert section == files_table(family)
    assert f"swarmchase evaluate --controller {family}" in card


def test_no_card_is_of_weights_that_are_not_there() -> None:
    assert {path.parent.name for path in WEIGHTS_FOLDER.glob("*/README.md")} == set(shipped_families())
