"""The examples of other people's learning run from their first line to their last, on as little as they can."""

import re
import runpy
import sys
from pathlib import Path

import pytest

EXAMPLES = Path(__file__).parents[2] / "examples"
NUMBER = r"(\d+\.\d|nan)"


@pytest.mark.filterwarnings("ignore::DeprecationWarning")  # TorchRL's own, about itself
@pytest.mark.parametrize(
    ("library", "words", "lines"),
    [
        (
            "stable_baselines3",
            "stable_baselines3_ppo.py --steps 64 --steps-per-update 8 --episodes 2",
            [f"untrained: {NUMBER} movements", f"trained:   {NUMBER} movements"],
        ),
        ("torch", "cleanrl_ppo.py --steps 256 --chases 8", [f"update 1: {NUMBER} movements"]),
        ("torchrl", "torchrl_ppo.py --frames 64 --frames-per-batch 64", [f"batch 1: {NUMBER} movements"]),
    ],
)
def test_it_trains(
    library: str, words: str, lines: list[str], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip(library, reason=f"{library} is not installed")
    name, *options = words.split()
    monkeypatch.setattr(sys, "argv", [name, *options])
    runpy.run_path(str(EXAMPLES / name), run_name="__main__")
    told = capsys.readouterr().out.splitlines()
    assert len(told) == len(lines)
    assert all(re.fullmatch(line, said) for line, said in zip(lines, told, strict=True))
