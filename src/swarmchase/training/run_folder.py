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
from ..files import require_writable_folder, write_text_atomically
from ..scenario import Scenario
from .agent import AgentSnapshot, FinishedChase
from .evaluator import AuxiliaryEvaluation
from .global_agent import SharedParameters
from .settings import TrainingSettings

RESUME_FILE = "resume.safetensors"
LOG_FILE = "training.jsonl"
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


class RunFolder:
    """The folder of one run."""

    def __init__(self, folder: Path, scenarios: Sequence[Scenario], settings: TrainingSettings) -> None:
        require_writable_folder(folder)
        self.folder = folder
        worlds = [scenario.to_dict() for scenario in scenarios]
        self._identity = {"format": FORMAT, "scenarios": worlds, "settings": settings.to_dict()}

    @property
    def has_resume_point(self) -> bool:
        """Whether there is a run to go on with."""
        return (self.folder / RESUME_FILE).exists()

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
        """Read the resume file.

        Raises:
            InputError: damaged, or of a run with another scenario or other settings.
        """
        path = self.folder / RESUME_FILE
        tensors, document = load_tensors(path, "resume file")
        for name, value in self._identity.items():
            if document.get(name) != json.loads(json.dumps(value)):
                raise InputError(
                    f"resume file {path} belongs to a run with another {name}: "
                    "choose another folder or give the same options"
                )
        try:
            parameters = SharedParameters(
                **{part.name: tensors[f"global.{part.name}"] for part in dataclasses.fields(SharedParameters)}
            )
            agents = [
                AgentSnapshot(
                    {name: tensor.numpy() for name, tensor in tensors.items() if name.startswith(f"agent{index}.")},
                    streams,
                )
                for index, streams in enumerate(document["agents"])
            ]
            best = None if document["best"] is None else AuxiliaryEvaluation(**document["best"])
            return ResumePoint(parameters, agents, best, document["environment_steps"], document["seconds"])
        except (KeyError, TypeError) as error:
            raise InputError(f"resume file {path} is incomplete: {error}") from error


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
            try:
                lines = self._path.read_text(encoding="utf-8").splitlines(keepends=True)
                whole = [(line, json.loads(line)) for line in lines if line.endswith("\n")]
                kept = [line for line, entry in whole if entry["update"] <= update or entry["kind"] == "fault"]
            except (OSError, ValueError, LookupError, TypeError) as error:
                raise InputError(f"training log {self._path} is damaged: move it away ({error})") from error
            write_text_atomically(self._path, "".join(kept))


def read_log(folder: Path, kind: str) -> list[dict[str, Any]]:
    """The lines of one kind ("chase", "evaluation", "gradient" or "fault") of a run's log; a killed run's last may be
    half a line, which is passed over.
    """
    with open(folder / LOG_FILE, encoding="utf-8") as file:
        whole = (json.loads(line) for line in file if line.endswith("\n"))
        return [line for line in whole if line["kind"] == kind]


def _tensorboard(folder: Path, resume_update: int) -> Any:
    """A TensorBoard writer, or None where TensorBoard is not installed (a training machine with torch alone).

    What an interrupted run plotted after ``resume_update`` is purged: it will be made again.
    """
    try:
        from torch.utils.tensorboard import SummaryWriter
    except ModuleNotFoundError:
        return None
    return SummaryWriter(str(folder / "tensorboard"), purge_step=resume_update + 1)
