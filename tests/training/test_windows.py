"""Training of the network that reads windows: what it learns from, that it learns, and that it resumes exactly."""

import json
from pathlib import Path

import pytest
import torch

from swarmchase.channel.fading_worlds import WorldsFading
from swarmchase.cli import main
from swarmchase.errors import InputError
from swarmchase.networks.weights import load_weights
from swarmchase.networks.windows import WindowsNetwork
from swarmchase.training import learner
from swarmchase.training.windows import TABLE_K, TABLE_SHARE, WindowsSettings, drawn_worlds, reported_db, windows_loss
from swarmchase.training.windows_run import train_windows

SMALL = WindowsSettings(worlds=8, chases_per_world=1, windows=4, max_updates=60, learning_rate=5e-3)


def test_half_of_the_worlds_are_of_the_table_and_the_others_lie_within_their_ranges() -> None:
    worlds = drawn_worlds(4000, torch.Generator().manual_seed(0), "cpu")
    assert (worlds.rician_k == TABLE_K).float().mean() == pytest.approx(TABLE_SHARE, abs=0.03)
    assert (worlds.rician_k == 0).float().mean() == pytest.approx(0.08, abs=0.02)
    assert 0.0005 < worlds.doppler_per_sample.min() < 0.002
    assert 0.7 < worlds.doppler_per_sample.max() <= 1
    assert 0 <= worlds.spatial_correlation.min() < 0.05
    assert 0.9 < worlds.spatial_correlation.max() < 1
    assert worlds.los_is_common.mean() == pytest.approx(0.8, abs=0.03)


def test_receivers_lose_round_and_fall_silent_in_some_chases_and_the_level_stays() -> None:
    fading_db = 3 * torch.randn(2000, 2, 50, 6, generator=torch.Generator().manual_seed(1))
    heard_db = reported_db(fading_db, torch.Generator().manual_seed(2))
    is_missing = heard_db.isnan()
    silent = is_missing.all(dim=2).all(dim=1).sum(dim=1)
    assert (silent > 0).float().mean() == pytest.approx(0.2, abs=0.04)
    assert silent.max() == 2
    some_missing = is_missing.any(dim=3).any(dim=2).any(dim=1) & (silent == 0)
    assert some_missing.float().mean() == pytest.approx(0.3 * 0.8, abs=0.04)
    untouched = (heard_db == fading_db).all(dim=3).all(dim=2).all(dim=1)
    assert untouched.float().mean() == pytest.approx(0.75 * 0.75 * 0.7 * 0.8, abs=0.04)
    assert (heard_db - fading_db).nanmean() == pytest.approx(0, abs=0.02)


def _loss_nats(network: WindowsNetwork) -> float:
    """Of chases that no training sees."""
    generator = torch.Generator().manual_seed(99)
    fading_db = WorldsFading(50).drawn_db(drawn_worlds(60, generator, "cpu"), 4, generator).transpose(2, 3)
    with torch.inference_mode():
        return float(windows_loss(network, fading_db, torch.full((60,), 4)))


def test_it_learns_and_goes_on_exactly_where_it_was(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    whole = train_windows(SMALL, tmp_path / "whole")
    monkeypatch.setattr(learner, "CHECKPOINT_INTERVAL", 30)

    class _BrokenError(Exception):
        pass

    def progress(update: int, _loss_nats: float) -> None:
        if update == 40:
            raise _BrokenError

    with pytest.raises(_BrokenError):
        train_windows(SMALL, tmp_path / "parts", progress=progress)
    resumed = train_windows(SMALL, tmp_path / "parts", resume=True)
    assert (resumed.updates, resumed.stopped) == (60, "finished")
    one, _ = load_weights(whole.weights)
    other, configuration = load_weights(resumed.weights)
    for name, tensor in one.state_dict().items():
        assert torch.equal(tensor, other.state_dict()[name]), name
    assert configuration["update"] == 60
    assert isinstance(one, WindowsNetwork)
    assert _loss_nats(one) < _loss_nats(WindowsNetwork(torch.Generator().manual_seed(0))) - 0.7


@pytest.mark.parametrize(
    ("change", "resume", "refusal"),
    [
        ({}, False, "holds a run: give --resume"),
        ({"worlds": 7}, True, "other options: worlds = 2 there and 7 here; give the same"),
        # Its learning rates depend on its length.
        ({"max_updates": 2}, True, "other options: updates = 1 there and 2 here; give the same"),
    ],
)
def test_a_folder_is_one_run(tmp_path: Path, change: dict[str, int], resume: bool, refusal: str) -> None:
    train_windows(WindowsSettings(worlds=2, windows=2, max_updates=1), tmp_path)
    settings = WindowsSettings(**{"worlds": 2, "windows": 2, "max_updates": 1, **change})
    with pytest.raises(InputError, match=refusal):
        train_windows(settings, tmp_path, resume)


def test_an_empty_folder_has_nothing_to_resume_and_there_is_no_other_device(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="holds no run to resume"):
        train_windows(SMALL, tmp_path, resume=True)
    with pytest.raises(InputError, match="device = 'tpu' is refused"):
        train_windows(SMALL, tmp_path, device="tpu")


def test_the_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    main(["train", "windows", "--folder", str(tmp_path), "--updates", "2", "--worlds", "2", "--json"])
    told = json.loads(capsys.readouterr().out)
    assert told["updates"] == 2
    assert told["stopped"] == "finished"
    assert Path(told["weights"]).is_file()
