"""The network that reads windows: what its words do and do not depend on."""

import math
from pathlib import Path

import pytest
import torch

from swarmchase.channel.fading_worlds import FadingWorlds, WorldsFading
from swarmchase.controllers.shipped import WEIGHTS_FOLDER
from swarmchase.networks.weights import load_weights, save_weights
from swarmchase.networks.windows import HeardWindows, WindowsLaw, WindowsNetwork
from swarmchase.observation import mean_power_dbm
from swarmchase.training.windows import negative_log_density

WINDOWS = 5


@pytest.fixture(scope="module")
def network() -> WindowsNetwork:
    networks, _ = load_weights(WEIGHTS_FOLDER / "adaptive" / "all-channels.safetensors")
    assert isinstance(networks, WindowsNetwork)
    return networks


@pytest.fixture
def rssi_dbm() -> torch.Tensor:
    return -60 + 5 * torch.randn(WINDOWS, 50, 6, generator=torch.Generator().manual_seed(1))


def law(network: WindowsNetwork, rssi_dbm: torch.Tensor, number: int = WINDOWS) -> WindowsLaw:
    with torch.inference_mode():
        heard = network.heard(rssi_dbm)
        counts = torch.arange(WINDOWS)[None] < number
        found = network.law(HeardWindows(heard.own[None], heard.together[None]), counts)
    return WindowsLaw(found.mean_db[0], found.apart_db[0], found.together_db[0])


def assert_same(one: WindowsLaw, other: WindowsLaw) -> None:
    for name in ("mean_db", "apart_db", "together_db"):
        torch.testing.assert_close(getattr(one, name), getattr(other, name), atol=2e-3, rtol=1e-3)


def test_levels_do_not_matter_only_shapes(network: WindowsNetwork, rssi_dbm: torch.Tensor) -> None:
    lifted_dbm = rssi_dbm + torch.linspace(-40, 10, 6) + torch.linspace(-5, 5, WINDOWS)[:, None, None]
    assert_same(law(network, rssi_dbm), law(network, lifted_dbm))


def test_trackers_are_one_like_another(network: WindowsNetwork, rssi_dbm: torch.Tensor) -> None:
    order = torch.tensor([3, 1, 5, 0, 2, 4])
    one, other = law(network, rssi_dbm), law(network, rssi_dbm[..., order])
    assert_same(WindowsLaw(one.mean_db[:, order], one.apart_db[:, order], one.together_db), other)


def test_what_came_first_does_not_matter(network: WindowsNetwork, rssi_dbm: torch.Tensor) -> None:
    one, other = law(network, rssi_dbm), law(network, rssi_dbm.flip(0))
    assert_same(WindowsLaw(one.mean_db.flip(0), one.apart_db.flip(0), one.together_db.flip(0)), other)


def test_windows_that_do_not_count_say_nothing_and_later_ones_are_heeded(
    network: WindowsNetwork, rssi_dbm: torch.Tensor
) -> None:
    others_dbm = torch.cat([rssi_dbm[:2], 3 * rssi_dbm[2:] + 100])
    few, few_of_others = law(network, rssi_dbm, 2), law(network, others_dbm, 2)
    torch.testing.assert_close(few.mean_db[:2], few_of_others.mean_db[:2])
    assert (law(network, others_dbm).apart_db[:2] - few.apart_db[:2]).abs().max() > 0.05


@pytest.mark.parametrize("samples", [1, 10, 50, 200])
def test_a_window_may_have_any_number_of_samples(network: WindowsNetwork, samples: int) -> None:
    rssi_dbm = -60 + 5 * torch.randn(WINDOWS, samples, 6, generator=torch.Generator().manual_seed(1))
    rssi_dbm[1, :, 2] = math.nan
    found = law(network, rssi_dbm)
    assert all(getattr(found, name).isfinite().all() for name in ("mean_db", "apart_db", "together_db"))


def test_what_it_says_of_its_error_is_true(network: WindowsNetwork) -> None:
    """Of slow fading without a line of sight and of fast fading with a strong one, told apart by their shapes alone."""
    worlds = FadingWorlds(
        torch.tensor([0.005, 0.1]), torch.tensor([0.0, 10.0]), torch.tensor([0.5, 0.5]), torch.ones(2)
    )
    fading_db = WorldsFading(50).drawn_db(worlds, 200, torch.Generator().manual_seed(2)).transpose(2, 3)
    for (least_db, most_db), windows_db in zip(((2.5, 6.0), (0.2, 0.6)), fading_db, strict=True):
        with torch.inference_mode():
            heard = network.heard(windows_db)
            counts = torch.ones(20, 10, dtype=torch.bool)
            found = network.law(
                HeardWindows(heard.own.unflatten(0, (20, 10)), heard.together.unflatten(0, (20, 10))), counts
            )
        error_db = mean_power_dbm(windows_db).view(20, 10, 6) - found.mean_db
        said_db = (found.apart_db.square() + found.together_db.square()[..., None]).mean().sqrt()
        assert least_db < error_db.square().mean().sqrt() < most_db
        assert error_db.square().mean().sqrt() == pytest.approx(float(said_db), rel=0.2)


def test_the_density_is_that_of_a_gaussian() -> None:
    generator = torch.Generator().manual_seed(4)
    found = WindowsLaw(
        torch.randn(3, 6, generator=generator),
        1 + torch.rand(3, 6, generator=generator),
        1 + torch.rand(3, generator=generator),
    )
    fading_db = 3 * torch.randn(3, 6, generator=generator)
    fading_db[1, 2:4] = math.nan
    for window in range(3):
        is_heard = fading_db[window].isfinite()
        covariance = found.apart_db[window].square().diag() + found.together_db[window].square()
        gaussian = torch.distributions.MultivariateNormal(
            found.mean_db[window, is_heard], covariance[is_heard][:, is_heard]
        )
        expected = -gaussian.log_prob(fading_db[window, is_heard]) - is_heard.sum() * math.log(2 * math.pi) / 2
        assert negative_log_density(found, fading_db)[window] == pytest.approx(float(expected), abs=1e-4)


def test_its_file_holds_it_all(network: WindowsNetwork, rssi_dbm: torch.Tensor, tmp_path: Path) -> None:
    save_weights(tmp_path / "w.safetensors", network, {"settings": {}})
    again, _ = load_weights(tmp_path / "w.safetensors")
    assert isinstance(again, WindowsNetwork)
    assert_same(law(network, rssi_dbm), law(again, rssi_dbm))
