"""Training of what ``adaptive`` reads windows with: the fading in them, in worlds that nobody told it of.

No chase is flown for it. In every step it reads the first few windows of many chases, each in a world of its own, and
the loss is what the simulator knows of the fading there: - log of the density that the network gave it.
"""

import dataclasses
import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch

from ..batch.array_types import Bool, Float, Int, Tensor
from ..batch.tensor_files import load_tensors, save_tensors
from ..channel.fading_worlds import FASTEST, SLOWEST, FadingWorlds, WorldsFading
from ..errors import InputError
from ..networks.actor_critic import PAPER_WINDOW_SAMPLES
from ..networks.weights import save_weights
from ..networks.windows import HeardWindows, WindowsLaw, WindowsNetwork
from ..observation import mean_power_dbm
from ..processes.stop_request import StopRequest
from ..ranges import AT_LEAST_ONE, AT_LEAST_ZERO, POSITIVE, ranged, require_ranges

TABLE_SHARE = 0.5
"""Each of K, Doppler spread and correlation is one of the paper's in so many of the worlds."""
TABLE_SPEEDS = (0.1, 0.05, 0.02, 0.01)
TABLE_CORRELATIONS = (0.1, 0.5, 0.9)
TABLE_K = 3.0
LARGEST_K = 15.0
NO_LINE_OF_SIGHT_SHARE = 0.08
INDEPENDENT_SHARE = 0.2
MISSING_SHARE, MOST_MISSING = 0.3, 0.7
STEPS_SHARE = 0.25
SILENT_SHARE = 0.2
NOISY_SHARE, MOST_NOISE_DB = 0.25, 1.5
MOST_BYTES = 64 * 2**20


@dataclass(frozen=True, kw_only=True)
class WindowsSettings:
    """A training of a ``WindowsNetwork``."""

    worlds: int = ranged(64, AT_LEAST_ONE)
    chases_per_world: int = ranged(2, AT_LEAST_ONE)
    windows: int = ranged(24, AT_LEAST_ONE)
    """At most, of a chase."""
    learning_rate: float = ranged(2e-3, POSITIVE)
    """At first; it falls linearly to a thousandth."""
    max_gradient_norm: float = ranged(1.0, POSITIVE)
    max_updates: int = ranged(20_000, AT_LEAST_ONE)
    checkpoint_interval: int = ranged(500, AT_LEAST_ONE)
    seed: int = ranged(0, AT_LEAST_ZERO)

    def __post_init__(self) -> None:
        require_ranges(self)


def drawn_worlds(number: int, generator: torch.Generator, device: torch.device | str) -> FadingWorlds:
    """Worlds of fading, half of each thing as in Table I."""

    def uniform() -> Float[Tensor, "world"]:
        return torch.rand(number, generator=generator, device=device)

    def from_table(values: tuple[float, ...], otherwise: Float[Tensor, "world"]) -> Float[Tensor, "world"]:
        table = torch.tensor(values, device=device)[(uniform() * len(values)).long()]
        return torch.where(uniform() < TABLE_SHARE, table, otherwise)

    slow, fast = math.log(2 * SLOWEST), math.log(FASTEST)
    k = torch.where(uniform() < NO_LINE_OF_SIGHT_SHARE / TABLE_SHARE, 0.0, LARGEST_K * uniform().square())
    return FadingWorlds(
        doppler_per_sample=from_table(TABLE_SPEEDS, (slow + (fast - slow) * uniform()).exp()),
        rician_k=from_table((TABLE_K,), k),
        spatial_correlation=from_table(TABLE_CORRELATIONS, 0.98 * uniform()),
        los_is_common=(uniform() >= INDEPENDENT_SHARE).float(),
    )


def reported_db(
    fading_db: Float[Tensor, "chase window sample 6"], generator: torch.Generator
) -> Float[Tensor, "chase window sample 6"]:
    """What receivers make of it: noise, steps of 1 dB, missing samples, silent ones, each in some chases."""
    num_chases, device = len(fading_db), fading_db.device

    def chosen(share: float) -> Bool[Tensor, "chase 1 1 1"]:
        return torch.rand(num_chases, 1, 1, 1, generator=generator, device=device) < share

    def uniform(*shape: int) -> Tensor:
        return torch.rand(shape, generator=generator, device=device)

    noise_db = torch.where(chosen(NOISY_SHARE), MOST_NOISE_DB * uniform(num_chases, 1, 1, 1), 0.0)
    noisy_db = fading_db + noise_db * torch.randn(fading_db.shape, generator=generator, device=device)
    place_db = uniform(num_chases, fading_db.shape[1], 1, 6)
    stepped_db = (noisy_db + place_db).round() - place_db
    heard_db = torch.where(chosen(STEPS_SHARE), stepped_db, noisy_db)
    share = torch.where(chosen(MISSING_SHARE), MOST_MISSING * uniform(num_chases, 1, 1, 1), 0.0)
    heard_db = heard_db.masked_fill(uniform(*fading_db.shape) < share, math.nan)
    silent = torch.where(chosen(SILENT_SHARE), 1 + (2 * uniform(num_chases, 1, 1, 1)).long(), 0)
    return heard_db.masked_fill(torch.arange(6, device=device) < silent, math.nan)


def windows_loss(
    network: WindowsNetwork, heard_db: Float[Tensor, "chase window sample 6"], number: Int[Tensor, "chase"]
) -> Float[Tensor, ""]:
    """- log density of the mean powers' fading in the first ``number`` windows of each chase, a window's mean."""
    num_chases, num_windows = heard_db.shape[:2]
    flat = heard_db.flatten(0, 1)
    fading_db = mean_power_dbm(flat).view(num_chases, num_windows, 6)
    heard = network.heard(flat)
    own, together = (part.view(num_chases, num_windows, *part.shape[1:]) for part in (heard.own, heard.together))
    counts = torch.arange(num_windows, device=heard_db.device) < number[:, None]
    nats = negative_log_density(network.law(HeardWindows(own, together), counts), fading_db)
    return ((nats * counts).sum(dim=1) / number).mean()


def negative_log_density(law: WindowsLaw, fading_db: Float[Tensor, "*window 6"]) -> Float[Tensor, "*window"]:
    """Of these fadings, but for a constant; what is NaN was not heard."""
    counts = fading_db.isfinite()
    precision = torch.where(counts, law.apart_db.square().reciprocal(), 0.0)
    error_db = torch.where(counts, fading_db - law.mean_db, 0.0)
    variance = law.together_db.square()
    grows = 1 + variance * precision.sum(dim=-1)
    squared = (precision * error_db.square()).sum(dim=-1)
    squared = squared - variance / grows * (precision * error_db).sum(dim=-1).square()
    log_determinant = grows.log() + torch.where(counts, 2 * law.apart_db.log(), 0.0).sum(dim=-1)
    return (squared + log_determinant) / 2


def train_windows(
    settings: WindowsSettings,
    folder: Path,
    resume: bool = False,
    device: str = "cpu",
    progress: Callable[[int, float], None] | None = None,
    request: StopRequest | None = None,
) -> Path:
    """Train, and return the weights file in ``folder``.

    Raises:
        InputError: the folder holds a run and ``resume`` is false, or holds none, or one of other settings.
    """
    state_path = folder / "resume.safetensors"
    if state_path.exists() != resume:
        raise InputError(
            f"{folder} holds {'a run: give --resume to go on with it' if not resume else 'no run to resume'}"
        )
    folder.mkdir(parents=True, exist_ok=True)
    generator = torch.Generator(device)
    generator.manual_seed(settings.seed)
    network = WindowsNetwork(torch.Generator().manual_seed(settings.seed)).to(device)
    optimizer = torch.optim.Adam(network.parameters(), lr=settings.learning_rate)
    first = _restored(state_path, settings, network, optimizer, generator) if resume else 0
    fading = WorldsFading(PAPER_WINDOW_SAMPLES, device)
    running = math.nan
    update = first
    while update < settings.max_updates and not (request is not None and request.made):
        for group in optimizer.param_groups:
            group["lr"] = settings.learning_rate * (1 - 0.999 * update / settings.max_updates)
        num_chases = settings.worlds * settings.chases_per_world
        worlds = drawn_worlds(settings.worlds, generator, device)
        fading_db = fading.drawn_db(worlds, settings.chases_per_world * settings.windows, generator)
        by_chase_db = fading_db.transpose(2, 3).reshape(num_chases, settings.windows, PAPER_WINDOW_SAMPLES, 6)
        drawn = torch.rand(num_chases, generator=generator, device=device)
        number = (settings.windows + 0.99) ** drawn
        loss = windows_loss(network, reported_db(by_chase_db, generator), number.long())
        optimizer.zero_grad()
        loss.backward()  # type: ignore[no-untyped-call]
        torch.nn.utils.clip_grad_norm_(network.parameters(), settings.max_gradient_norm)
        optimizer.step()
        update += 1
        if update % 20 == 0:
            nats = float(loss.detach())
            running = nats if math.isnan(running) else 0.98 * running + 0.02 * nats
            if progress is not None:
                progress(update, running)
        if update % settings.checkpoint_interval == 0:
            _save(state_path, settings, update, network, optimizer, generator)
    _save(state_path, settings, update, network, optimizer, generator)
    configuration = {"settings": dataclasses.asdict(settings), "update": update}
    path = folder / "best.safetensors"
    save_weights(path, network.cpu(), configuration, torch.float16)
    return path


def _save(
    path: Path,
    settings: WindowsSettings,
    update: int,
    network: WindowsNetwork,
    optimizer: torch.optim.Adam,
    generator: torch.Generator,
) -> None:
    tensors = {f"network.{name}": value.detach().cpu() for name, value in network.state_dict().items()}
    for number, state in optimizer.state_dict()["state"].items():
        tensors |= {f"adam.{number}.{name}": value.cpu() for name, value in state.items()}
    document = {"settings": dataclasses.asdict(settings), "update": update, "generator": generator.get_state().tolist()}
    save_tensors(path, tensors, document)


def _restored(
    path: Path,
    settings: WindowsSettings,
    network: WindowsNetwork,
    optimizer: torch.optim.Adam,
    generator: torch.Generator,
) -> int:
    tensors, document = load_tensors(path, "resume file", MOST_BYTES)
    if document.get("settings") != dataclasses.asdict(settings):
        raise InputError(f"{path} is of a run with other settings")
    network.load_state_dict({name[8:]: value for name, value in tensors.items() if name.startswith("network.")})
    state: dict[int, dict[str, Any]] = {}
    for name, value in tensors.items():
        if name.startswith("adam."):
            _, number, part = name.split(".")
            state.setdefault(int(number), {})[part] = value
    optimizer.load_state_dict({**optimizer.state_dict(), "state": state})
    generator.set_state(torch.tensor(document["generator"], dtype=torch.uint8))
    return int(document["update"])
