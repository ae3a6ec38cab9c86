"""What a training run leaves in its folder: a resume file, a log of chases and evaluations, TensorBoard events."""

import contextlib
import dataclasses
import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import torch

from ..batch.tensor_files import load_tensors, save_tensors
from ..errors import InputError
from ..files import atomic_path, require_writable_folder
from ..locks import LockFile
from ..networks.forms import new_networks
from ..ranges import AT_LEAST_ZERO, SHARE, Range, checked_number
from ..reading import Bounds, DocumentError, opened, parsed_json
from ..scenario import Scenario
from .agent import AgentSnapshot, FinishedChase
from .evaluator import AuxiliaryEvaluation
from .global_agent import SharedParameters
from .parameters import FlatNetworks
from .resumption import as_long, require_same_run
from .settings import TrainingSettings

RESUME_FILE = "resume.safetensors"
LOG_FILE = "training.jsonl"
LOCK_FILE = "training.lock"
MOST_RESUME_BYTES = 4 * 2**30
MOST_LINE_BYTES = 64 * 1024
"""Of the log."""
LINE_BOUNDS = Bounds(most_bytes=MOST_LINE_BYTES, most_values=10_000, is_finite=False)
FORMAT = "swarmchase-resume-2"


_PLOTTED = ("movements_mean", "movements_p90", "success_rate")


@dataclasses.dataclass(frozen=True)
class ResumePoint:
    """Everything a run needs to go on exactly where it was."""

    parameters: SharedParameters
    agents: Sequence[AgentSnapshot]
    best: AuxiliaryEvaluation | None
    environment_steps: int
    seconds: float
    """Wall time spent so far."""


def holds_run(folder: Path) -> bool:
    """Whether there is a run in the folder to go on with."""
    return (folder / RESUME_FILE).exists()


class RunFolder:
    """The folder of one run, which is this process's alone until ``close``.

    Raises:
        InputError: it cannot be written, or another training is at work in it.
    """

    def __init__(self, folder: Path, scenarios: Sequence[Scenario], settings: TrainingSettings) -> None:
        require_writable_folder(folder)
        self.folder = folder
        self._settings = settings
        self._lock = LockFile(
            folder / LOCK_FILE, f"folder {folder} is in use by another training: wait for it, or choose another folder"
        )
        worlds = [scenario.to_dict() for scenario in scenarios]
        self._identity = {"format": FORMAT, "scenarios": worlds, "settings": settings.to_dict()}

    def close(self) -> None:
        """Leave the folder to others."""
        self._lock.close()

    def save(self, point: ResumePoint) -> None:
        """Write the resume file, whole or not at all."""
        parameters = {
            f"global.{part.name}": getattr(point.parameters, part.name).cpu()
            for part in dataclasses.fields(SharedParameters)
        }
        tensors = {name: torch.from_numpy(array) for agent in point.agents for name, array in agent.arrays.items()}
        document = {
            **self._identity,
            "agents": [agent.streams for agent in point.agents],
            "best": None if point.best is None else dataclasses.asdict(point.best),
            "environment_steps": point.environment_steps,
            "seconds": point.seconds,
        }
        save_tensors(self.folder / RESUME_FILE, parameters | tensors, document)

    def load(self) -> ResumePoint:
        """Read the resume file; the run may have been a shorter one, whose length nothing but its end depends on.

        Raises:
            InputError: damaged, or of a run with other scenarios or settings.
        """
        path = self.folder / RESUME_FILE
        tensors, document = load_tensors(path, "resume file", MOST_RESUME_BYTES)
        identity = json.loads(json.dumps(self._identity))
        settings = as_long(document.get("settings"), identity["settings"])
        require_same_run(path, document, {**identity, "settings": settings})
        try:
            return ResumePoint(
                _parameters(tensors, self._settings),
                _agents(tensors, document["agents"], self._settings.num_agents),
                None if document["best"] is None else _evaluation(document["best"]),
                int(checked_number("environment_steps", document["environment_steps"], AT_LEAST_ZERO, whole=True)),
                checked_number("seconds", document["seconds"], AT_LEAST_ZERO),
            )
        except InputError as error:
            raise InputError(f"resume file {path} is refused: {error}") from error
        except (KeyError, TypeError, ValueError) as error:
            raise InputError(f"resume file {path} is incomplete: {error}") from error


def _parameters(tensors: dict[str, torch.Tensor], settings: TrainingSettings) -> SharedParameters:
    """Those of the global agent.

    Raises:
        InputError: they are not those of the run's networks, or no numbers.
    """
    like = SharedParameters.start(FlatNetworks(new_networks(settings)).vector)
    found = SharedParameters(
        **{part.name: tensors[f"global.{part.name}"] for part in dataclasses.fields(SharedParameters)}
    )
    for part in dataclasses.fields(SharedParameters):
        tensor, needed = getattr(found, part.name), getattr(like, part.name)
        if tensor.shape != needed.shape or tensor.dtype != needed.dtype or not tensor.isfinite().all():
            raise InputError(f"global.{part.name} must be {tuple(needed.shape)} finite numbers of {needed.dtype}")
    checked_number("updates", float(found.updates), Range(0, settings.max_updates), whole=True)
    return found


def _agents(tensors: dict[str, torch.Tensor], streams: Any, num_agents: int) -> list[AgentSnapshot]:
    """Each agent looks at its own when it is restored."""
    if not isinstance(streams, list) or len(streams) != num_agents or not all(isinstance(its, dict) for its in streams):
        raise InputError(f"it must hold {num_agents} agents")
    return [
        AgentSnapshot(
            {name: tensor.numpy() for name, tensor in tensors.items() if name.startswith(f"agent{index}.")}, its
        )
        for index, its in enumerate(streams)
    ]


def _evaluation(form: Any) -> AuxiliaryEvaluation:
    if not isinstance(form, dict) or not isinstance(form.get("p90_by_scenario"), list):
        raise InputError("its best evaluation is none")
    evaluation = AuxiliaryEvaluation(**form)
    checked_number("update", evaluation.update, AT_LEAST_ZERO, whole=True)
    checked_number("success_rate", evaluation.success_rate, SHARE)
    for movements in (evaluation.movements_mean, evaluation.movements_p90, *evaluation.p90_by_scenario):
        checked_number("movements", movements, AT_LEAST_ZERO)
    return evaluation


class TrainingLog:
    """One JSON line for every finished chase and every evaluation, and the same numbers for TensorBoard.

    On a cluster also for every gradient and every fault."""

    def __init__(self, folder: Path, resume_update: int) -> None:
        self._path = folder / LOG_FILE
        self._forget_after(resume_update)
        self._file = open(self._path, "a", encoding="utf-8")  # noqa: SIM115 (closed by close())
        self._board = _tensorboard(folder, resume_update)

    def chase(self, chase: FinishedChase) -> None:
        """Log a chase of the training."""
        self._write({"kind": "chase", **dataclasses.asdict(chase)})
        names = ("reward_d_m", "reward_x_m", "reward_y_m", "reward_z_m")
        self._plot(
            "chase", {"movements": chase.movements, **dict(zip(names, chase.reward_m, strict=True))}, chase.update
        )

    def evaluation(self, evaluation: AuxiliaryEvaluation, seconds: float, environment_steps: int) -> None:
        """Log an evaluation by the auxiliary agent."""
        numbers = dataclasses.asdict(evaluation)
        self._write(
            {"kind": "evaluation", **numbers, "seconds": round(seconds, 1), "environment_steps": environment_steps}
        )
        self._plot("evaluation", {name: numbers[name] for name in _PLOTTED}, evaluation.update)
        self.flush()

    def gradient(self, update: int, agent: int, updates_behind: int) -> None:
        """Log a gradient: which update it made, whose it was and how stale."""
        self._write({"kind": "gradient", "update": update, "agent": agent, "updates_behind": updates_behind})
        self._plot("gradient", {"updates_behind": updates_behind}, update)

    def fault(self, update: int, what: str) -> None:
        """Log what went wrong and was got over."""
        self._write({"kind": "fault", "update": update, "what": what})
        self.flush()

    def flush(self) -> None:
        """Hand everything written so far to the operating system.

        Raises:
            InputError: the disk is full.
        """
        with self._full_disk_refused():
            self._file.flush()

    def close(self) -> None:
        """End the log."""
        with self._full_disk_refused():
            self._file.close()
        if self._board is not None:
            self._board.close()

    def _write(self, line: dict[str, Any]) -> None:
        with self._full_disk_refused():
            self._file.write(json.dumps(line) + "\n")

    @contextlib.contextmanager
    def _full_disk_refused(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            raise InputError(f"cannot write {self._path}: {error.strerror or error}") from error

    def _plot(self, group: str, numbers: dict[str, float | int], update: int) -> None:
        if self._board is not None:
            for name, number in numbers.items():
                self._board.add_scalar(f"{group}/{name}", number, update)

    def _forget_after(self, update: int) -> None:
        """Drop what an interrupted run logged after its last checkpoint: it will be made again, but for the faults."""
        if self._path.exists():
            with atomic_path(self._path) as temporary, open(temporary, "wb") as kept:
                for line, entry in _entries(self._path):
                    if entry["update"] <= update or entry["kind"] == "fault":
                        kept.write(line)


def read_log(folder: Path, kind: str) -> list[dict[str, Any]]:
    """The lines of one kind ("chase", "evaluation", "gradient" or "fault") of a run's log; a killed run's last may be
    half a line, which is passed over.

    Raises:
        InputError: there is no log, or it is damaged.
    """
    return [entry for _, entry in _entries(folder / LOG_FILE) if entry["kind"] == kind]


def _entries(path: Path) -> Iterator[tuple[bytes, dict[str, Any]]]:
    """The whole lines of a log, and what each says.

    Raises:
        InputError: it cannot be read, or is damaged.
    """
    with opened(path, "training log") as file:
        while (line := file.readline(MOST_LINE_BYTES)).endswith(b"\n"):
            yield line, _entry(path, line)
        if len(line) == MOST_LINE_BYTES:
            raise InputError(f"training log {path} is damaged: move it away (a line without end)")


def _entry(path: Path, line: bytes) -> dict[str, Any]:
    try:
        entry = parsed_json(line, LINE_BOUNDS)
    except DocumentError as error:
        raise InputError(f"training log {path} is damaged: move it away ({error})") from None
    if not isinstance(entry, dict) or not isinstance(entry.get("update"), int) or "kind" not in entry:
        raise InputError(f"training log {path} is damaged: move it away (a line without update or kind)")
    return entry


def _tensorboard(folder: Path, resume_update: int) -> Any:
    """A TensorBoard writer, or None where TensorBoard is not installed (a training machine with torch alone).

    What an interrupted run plotted after ``resume_update`` is purged: it will be made again.
    """
    try:
        from torch.utils.tensorboard import SummaryWriter
    except ModuleNotFoundError:
        return None
    return SummaryWriter(str(folder / "tensorboard"), purge_step=resume_update + 1)
