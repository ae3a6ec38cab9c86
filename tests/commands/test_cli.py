"""The command as people and scripts use it: one JSON object, one line of refusal, nothing left behind."""

import contextlib
import itertools
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any, get_args

import matplotlib.image
import pyarrow.parquet as pq
import pytest
import torch
from PIL import Image, ImageSequence

from swarmchase.cli import main
from swarmchase.commands import options, train
from swarmchase.commands.catalogue import COMMANDS
from swarmchase.controllers import ActionChoice, controller_names
from swarmchase.evaluation.table import evaluate
from swarmchase.evaluation.tables import read_rows
from swarmchase.networks.actor_critic import SwarmNetworks
from swarmchase.networks.weights import save_weights
from swarmchase.scenario import paper_scenario
from swarmchase.training.settings import A3CSchedule, Precision

COMMAND = [sys.executable, "-m", "swarmchase"]


def run(*words: str, folder: Path | None = None, **how: Any) -> "subprocess.CompletedProcess[str]":
    how = {"capture_output": True} | how
    return subprocess.run([*COMMAND, *words], text=True, cwd=folder, timeout=120, check=False, **how)


def refused(words: list[str], capsys: pytest.CaptureFixture[str]) -> str:
    """The one line that these words end in; exit code 2 and a silent standard output are checked."""
    with pytest.raises(SystemExit) as end:
        main(words)
    output = capsys.readouterr()
    assert (end.value.code, output.out) == (2, "")
    assert output.err.startswith("swarmchase: ")
    assert output.err.count("\n") == 1
    assert output.err.endswith("\n")
    return output.err.removeprefix("swarmchase: ").rstrip("\n")


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


# --- help and speed --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("command", ["", *COMMANDS])
def test_help_answers_on_standard_output(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as end:
        main([*command.split(), "--help"])
    output = capsys.readouterr()
    assert (end.value.code, output.err) == (0, "")
    assert output.out.startswith(f"usage: swarmchase {command}".rstrip())
    if command:
        assert "--" in output.out
    else:
        assert all(name in output.out for name in COMMANDS)


def test_help_and_the_package_itself_import_nothing_slow() -> None:
    heavy = ("torch", "gymnasium", "matplotlib", "scipy", "pyarrow", "numpy")
    program = (
        "import sys\n"
        "import swarmchase\n"
        "print([name for name in sys.argv[1:] if name in sys.modules])\n"
        "import swarmchase.cli\n"
        "print([name for name in sys.argv[1:] if name in sys.modules])\n"
        "swarmchase.cli.main(['--help'])\n"
    )
    ran = subprocess.run([sys.executable, "-c", program, *heavy], capture_output=True, text=True, check=True)
    assert ran.stdout.splitlines()[:2] == ["[]", "[]"]


def test_names_of_the_package_are_those_of_their_homes() -> None:
    import swarmchase
    from swarmchase.observation import Observation
    from swarmchase.world.environment import Environment

    assert swarmchase.Environment is Environment
    assert swarmchase.Observation is Observation
    assert all(getattr(swarmchase, name) is not None for name in swarmchase.__all__)
    with pytest.raises(AttributeError, match="no attribute 'Drone'"):
        swarmchase.__getattr__("Drone")


def test_options_offer_what_the_package_knows() -> None:
    """Written twice, since importing them would need torch for --help."""
    assert get_args(options.ActionChoice) == get_args(ActionChoice)
    assert get_args(train.Schedule) == get_args(A3CSchedule)
    assert get_args(train.Precision) == get_args(Precision)
    assert sorted(options.CONTROLLERS) == sorted(controller_names())


def test_installed_command_is_this_package() -> None:
    installed = shutil.which("swarmchase", path=str(Path(sys.executable).parent))
    assert installed is not None
    ran = subprocess.run([installed, "nothing"], capture_output=True, text=True, check=False)
    assert (ran.returncode, ran.stdout) == (2, "")
    assert ran.stderr == "swarmchase: no command 'nothing'; see: swarmchase --help\n"


# --- what the commands answer ----------------------------------------------------------------------------------------


def test_chase_tells_logs_draws_and_prints_one_object(tmp_path: Path) -> None:
    ran = run("chase", "--controller", "oracle", "--seed", "3", "--chase", "5", "--json", folder=tmp_path)
    assert ran.returncode == 0, ran.stderr
    document = json.loads(ran.stdout)
    assert ran.stdout == json.dumps(document) + "\n"
    chase = evaluate(paper_scenario(), "oracle", episodes=6, seed=3).chases[5]
    assert (document["movements"], document["reached"]) == (chase.movements, True)
    assert (document["seed"], document["chase"], document["controller"]) == (3, 5, "oracle")
    told = [line for line in ran.stderr.splitlines() if " dBm  " in line]
    assert len(told) == chase.movements + 1  # the start and every movement
    assert max(map(len, ran.stderr.splitlines())) <= 80
    assert told[-1].endswith("reached")
    assert "Traceback" not in ran.stderr
    made = tmp_path / "chase-output"
    assert sorted(path.name for path in made.iterdir()) == ["chase.json", "chase.png"]
    log = json.loads((made / "chase.json").read_text())
    assert {name: value for name, value in log.items() if name != "moments"} == document
    assert (made / "chase.png").read_bytes().startswith(b"\x89PNG\r\n\x1a\n")
    height, width, _ = matplotlib.image.imread(made / "chase.png").shape
    assert width > height > 600


@pytest.mark.parametrize("while_importing", ["tyro", "rich"])
def test_ctrl_c_before_the_command_is_known_ends_it_without_a_word(while_importing: str, tmp_path: Path) -> None:
    """What it imports first is interrupted in its midst."""
    (tmp_path / f"{while_importing}.py").write_text(
        "import os, signal\nos.kill(os.getpid(), signal.SIGINT)\nraise AssertionError\n"
    )
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(tmp_path), *sys.path])}
    ran = subprocess.run(
        [sys.executable, "-m", "swarmchase", "live"], capture_output=True, text=True, env=environment, check=False
    )
    assert (ran.returncode, ran.stdout, ran.stderr) == (-signal.SIGINT, "", "")


def test_a_chase_by_the_clock_is_told_by_the_second_and_filmed(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Four movements: at 0.5, 1.5 and 2.5 s there is a line, at 1 and 2 s there is none."""
    words = "chase --scenario flight --behaviour flee --target-speed-mps 5 --max-movements 4 --controller oracle"
    main([*words.split(), "--seed", "2", "--json", "--animation", "films/chase.gif"])
    printed = capsys.readouterr()
    document = json.loads(printed.out)
    opening, _, rest = printed.err.partition("\n\n")
    lines = rest.splitlines()
    assert max(map(len, lines)) <= 80
    assert " ".join(opening.split()) == (
        "The target is 60 to 300 m away in an unknown direction and flies (flee) at up to 5 m/s. Six trackers fly at "
        "up to 10 m/s and listen on their way: 20 samples a second, a decision every 0.5 s."
    )
    told = [line for line in lines if " m away" in line]
    assert [line.split(" s  ")[0].strip() for line in told] == ["0.5", "1.5", "2.5"]
    assert ["m/s" in line for line in told] == [False, True, True]
    for shown in ("Least distance", "Way of the centre", "2.5 s", "target not reached", "6 of 6"):
        assert shown in printed.err
    assert (document["format"], document["capture_s"]) == (2, 2.5)
    assert sorted(path.name for path in (folder / "chase-output").iterdir()) == ["chase.json", "chase.png"]
    with Image.open(folder / "films" / "chase.gif") as film:
        assert film.n_frames == 6  # type: ignore[attr-defined]  # the beginning, the first decision, four movements
        for frame in ImageSequence.Iterator(film):
            low, high = frame.convert("L").getextrema()
            assert (low, high) == (0, 255)


def test_evaluate_prints_the_promised_keys_and_the_chases_of_its_seed(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = "evaluate --controller oracle --sampling-hz 50 --spatial-correlation .5 --episodes 12 --seed 4 --json"
    main(words.split())
    output = capsys.readouterr()
    document = json.loads(output.out)
    assert output.out.count("\n") == 1
    scenario = paper_scenario(sampling_hz=50, spatial_correlation=0.5)
    assert document == evaluate(scenario, "oracle", episodes=12, seed=4).summary()
    promised = "controller sampling_hz spatial_correlation episodes seed success_rate movements_mean movements_p50"
    assert document.keys() >= {*promised.split(), "movements_p90", "movements_p90_ci95", "movements_max"}
    assert document["tracking_time_mean_s"].keys() == {"2", "5"}
    assert "12 of 12" in output.err
    main(words.replace("--seed 4", "--seed 5").split())
    assert json.loads(capsys.readouterr().out)["movements_mean"] != document["movements_mean"]


def test_evaluate_reads_a_scenario_file_writes_a_table_and_takes_weights(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    save_weights(folder / "fresh.safetensors", SwarmNetworks(torch.Generator().manual_seed(1)), {})
    (folder / "near.toml").write_text("start_distance_m = 8\nmax_movements = 4\nsampling_hz = 20\n")
    words = "evaluate --controller fresh.safetensors --scenario near.toml --sampling-hz 100 --episodes 9 --json"
    main([*words.split(), "--table", "tables/chases.parquet"])
    document = json.loads(capsys.readouterr().out)
    assert (document["sampling_hz"], document["controller"]) == (100.0, "fresh.safetensors")  # the option wins
    scenario = paper_scenario(start_distance_m=8, max_movements=4, sampling_hz=100)
    expected = evaluate(scenario, "fresh.safetensors", episodes=9, seed=0)
    table = pq.read_table(folder / "tables" / "chases.parquet")
    assert table["movements"].to_pylist() == [chase.movements for chase in expected.chases]
    assert document == expected.summary()


def test_evaluate_shows_people_a_table(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    main(["evaluate", "--controller", "oracle", "--episodes", "3"])
    output = capsys.readouterr()
    assert output.out == ""
    for shown in ("oracle", "10 Hz", "100.00 %", "mean tracking time at 5 m/s", "confidence interval"):
        assert shown in output.err
    assert max(map(len, output.err.splitlines())) <= 80
    assert list(folder.iterdir()) == []


# --- bad input -------------------------------------------------------------------------------------------------------

EVALUATE = "evaluate --controller random --episodes 2"
FLIGHT = "--scenario flight --behaviour"


@pytest.mark.parametrize(
    ("words", "line"),
    [
        ("evaluate --controller nobody", "no controller 'nobody'; there are particle, particle-unknown-power"),
        ("chase --controller nobody", "no controller 'nobody'"),
        ("train a3c --folder run --preset quick", "no preset 'quick'; there are paper"),
        ("train a3c --folder run --agents 0", "num_agents = 0 is refused: allowed is a whole number at least 1"),
        (f"{EVALUATE} --spatial-correlation 1.5", "spatial_correlation = 1.5 is refused: allowed is between 0 and 1"),
        (f"{EVALUATE} --spatial-correlation -0.1", "spatial_correlation = -0.1 is refused"),
        (f"{EVALUATE} --spatial-correlation nan", "spatial_correlation = nan is refused"),
        (f"{EVALUATE} --sampling-hz 0", "sampling_hz = 0.0 is refused: allowed is greater than 0"),
        ("chase --controller random --sampling-hz -10", "sampling_hz = -10.0 is refused"),
        ("evaluate --controller random --episodes 0", "episodes = 0 is refused: allowed is at least 1"),
        (f"{EVALUATE} --batch-size 0", "batch_size = 0 is refused"),
        (f"{EVALUATE} --processes 0", "processes = 0 is refused"),
        (f"{EVALUATE} --seed -1", "seed = -1 is refused: allowed is at least 0"),
        ("chase --controller random --seed -1", "seed = -1, chase = 0 is refused"),
        ("chase --controller random --chase -1", "seed = 0, chase = -1 is refused"),
        ("chase --controller nobody --animation film.webm", "animation film.webm is refused: allowed is a file that"),
        (
            "chase --controller random --animation film",
            "animation film is refused: allowed is a file that ends in .gif",
        ),
        ("chase --controller random --animation folder.gif", "cannot write folder.gif: it exists and is no regular"),
        ("chase --controller random --animation file.txt/film.gif", "cannot write file.txt/film.gif: Not a directory"),
        ("chase --controller random --folder file.txt/below", "cannot write file.txt/below/chase.json"),
        ("chase --controller random --folder /proc/nowhere", "cannot write /proc/nowhere/chase.json"),
        (f"{EVALUATE} --table file.txt/below/table.parquet", "cannot write file.txt/below/table.parquet"),
        (f"{EVALUATE} --table folder", "cannot write folder: it exists and is no regular file"),
        (f"{EVALUATE} --table /dev/full", "cannot write /dev/full: it exists and is no regular file"),
        ("train a3c --folder file.txt/below", "cannot write to folder file.txt/below"),
        ("evaluate --controller gone.safetensors", "cannot read weights file gone.safetensors"),
        ("evaluate --controller cut.safetensors", "weights file cut.safetensors is damaged"),
        ("evaluate --controller folder", "no controller 'folder'"),
        ("evaluate --controller folder.safetensors", "cannot read weights file folder.safetensors"),
        ("evaluate --controller file.txt", "weights file file.txt is damaged"),
        (f"{EVALUATE} --scenario gone.toml", "cannot read scenario gone.toml"),
        (f"{EVALUATE} --scenario file.txt", "cannot read scenario file.txt"),
        (f"{EVALUATE} --scenario folder", "cannot read scenario folder"),
        (f"{EVALUATE} --scenario other.toml", "scenario has no field 'speed'"),
        # Worlds in which no chase can be flown.
        (f"{EVALUATE} --scenario fligth", "no scenario 'fligth'; shipped are paper, flight, field, rough"),
        (f"{EVALUATE} {FLIGHT} fle", "no behaviour 'fle' (did you mean flee?); there are hover, straight"),
        (f"chase {FLIGHT} nobody", "no behaviour 'nobody'; there are hover"),
        (f"compare --controllers oracle {FLIGHT} nobody", "no behaviour 'nobody'"),
        (f"train batched --preset a2c --folder run {FLIGHT} nobody", "no behaviour 'nobody'"),
        (f"train a3c --folder run {FLIGHT} nobody", "no behaviour 'nobody'"),
        (f"chase {FLIGHT} flee --target-speed-mps 200", "target_speed_mps = 200.0 is refused: allowed is between 0"),
        (f"chase {FLIGHT} flee --target-speed-mps 0", "behaviour = 'flee' needs a target_speed_mps that is greater"),
        (f"chase {FLIGHT} flee --decision-s 0.04", "decision_s = 0.04 is refused: allowed is at least 1 / sampling_hz"),
        (f"chase {FLIGHT} back.csv", "track back.csv goes back in time: row 2 is of 0.5 s, after 1 s"),
        (f"chase {FLIGHT} gone.csv", "cannot read track gone.csv: No such file or directory"),
        (
            f"chase {FLIGHT} flee --tracker-acceleration-mps2 0",
            "tracker_acceleration_mps2 = 0.0 is refused: allowed is",
        ),
        (f"chase {FLIGHT} flee --target-acceleration-mps2 0", "target_acceleration_mps2 = 0.0 is refused: allowed is"),
        (f"chase {FLIGHT} flee --follow-s -1", "follow_s = -1.0 is refused: allowed is between 0 and 3600"),
        (f"chase {FLIGHT} hover --lowest-altitude-m 120", "lowest_altitude_m = 120 is refused: allowed is less than"),
        # tyro's own
        ("evaluate --episode 5 --colour", "Unrecognized options"),
        ("evaluate --episodes many", "Error parsing --episodes: invalid literal for int() with base 10: 'many'"),
        ("evaluate --sampling-hz fast", "Error parsing --sampling-hz"),
        ("evaluate --action-choice lazy", "invalid choice 'lazy' for argument '--action-choice'"),
        ("evaluate --seed", "Missing value for argument '--seed'"),
        ("train a3c", "Missing from swarmchase train a3c: --folder PATH"),
    ],
)
def test_bad_input_is_one_line_and_leaves_nothing(
    words: str, line: str, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (folder / "file.txt").write_text("neither weights nor a scenario\n")
    (folder / "folder").mkdir()
    (folder / "folder.safetensors").mkdir()
    (folder / "folder.gif").mkdir()
    (folder / "other.toml").write_text("speed = 3\n")
    (folder / "back.csv").write_text("time_s,x_m,y_m,z_m\n1,0,0,0\n0.5,1,0,0\n")
    save_weights(folder / "whole.safetensors", SwarmNetworks(torch.Generator().manual_seed(1)), {})
    (folder / "cut.safetensors").write_bytes((folder / "whole.safetensors").read_bytes()[:100_000])
    before = sorted(folder.rglob("*"))
    assert refused(words.split(), capsys).startswith(line)
    assert sorted(folder.rglob("*")) == before


@pytest.mark.parametrize(
    ("words", "help_words"),
    [("", "--help"), ("fly", "--help"), ("chase --fly", "chase --help"), ("train a3c --agents x", "train a3c --help")],
)
def test_a_command_line_that_cannot_be_read_says_which_help_to_read(
    words: str, help_words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert refused(words.split(), capsys).endswith(f"; see: swarmchase {help_words}")


@pytest.mark.parametrize("encoding", ["utf-8", "latin-1"])
def test_refusals_are_one_line_for_a_script_too(tmp_path: Path, encoding: str) -> None:
    """A narrow terminal with colours or few characters changes nothing, and a real process ends with 2."""
    environment = {**os.environ, "COLUMNS": "30", "FORCE_COLOR": "1", "PYTHONIOENCODING": encoding}
    ran = run("evaluate", "--sampling-hz", "fast", folder=tmp_path, env=environment)
    assert (ran.returncode, ran.stdout) == (2, "")
    assert ran.stderr.count("\n") == 1
    assert "--sampling-hz: no type matching" in ran.stderr
    assert "│" not in ran.stderr


@pytest.mark.parametrize("full", ["table", "standard output"])
def test_a_full_disk_is_one_line_and_costs_nothing_else(full: str, tmp_path: Path) -> None:
    """What was found out is in the other place."""
    words = ["evaluate", "--controller", "random", "--episodes", "1", "--scenario", "short.toml", "--json"]
    words += ["--table", "table.parquet"]
    (tmp_path / "short.toml").write_text("max_movements = 1\n")
    program = (
        "import errno, os, sys\n"
        "def full(_descriptor):\n"
        "    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))\n"
        "if sys.argv[1] == 'table':\n"
        "    os.fsync = full\n"
        "from swarmchase.cli import main\n"
        "main(sys.argv[2:])\n"
    )
    with open("/dev/full", "w") as dev_full:
        ran = subprocess.run(
            [sys.executable, "-c", program, full, *words],
            stdout=subprocess.PIPE if full == "table" else dev_full,
            stderr=subprocess.PIPE,
            text=True,
            cwd=tmp_path,
            check=False,
        )
    assert ran.returncode == 2
    where = "table.parquet" if full == "table" else "to standard output"
    assert ran.stderr.splitlines()[-1] == f"swarmchase: cannot write {where}: No space left on device"
    assert "Traceback" not in ran.stderr
    assert "Exception ignored" not in ran.stderr
    if full == "table":
        assert json.loads(ran.stdout)["episodes"] == 1
        assert [path.name for path in tmp_path.iterdir()] == ["short.toml"]
    else:
        assert len(read_rows(tmp_path / "table.parquet", "table")) == 1


def test_a_terminal_that_has_gone_costs_nobody_the_result(tmp_path: Path) -> None:
    """Its window was closed, and SIGHUP is ignored; standard output is a file."""
    (tmp_path / "short.toml").write_text("max_movements = 1\n")
    reader, writer = os.pipe()
    os.close(reader)
    words = ["evaluate", "--controller", "random", "--episodes", "3", "--scenario", "short.toml", "--json"]
    try:
        ran = run(*words, folder=tmp_path, capture_output=False, stdout=subprocess.PIPE, stderr=writer)
    finally:
        os.close(writer)
    assert (ran.returncode, json.loads(ran.stdout)["episodes"]) == (0, 3)


# --- signals ---------------------------------------------------------------------------------------------------------


def children(pid: int) -> list[int]:
    with contextlib.suppress(OSError):
        return [int(child) for child in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]
    return []


@contextlib.contextmanager
def evaluation_in_the_background(folder: Path) -> Iterator["subprocess.Popen[str]"]:
    """An endless evaluation on two processes, in a process group of its own as a terminal would give it."""
    # Whoever runs the tests may have Ctrl-C ignored, which a process inherits.
    program = (
        "import signal, sys; signal.signal(signal.SIGINT, signal.default_int_handler); "
        "from swarmchase.cli import main; main(sys.argv[1:])"
    )
    words = f"{EVALUATE}000000 --processes 2 --table table.parquet --json".split()
    with subprocess.Popen(
        [sys.executable, "-c", program, *words],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        cwd=folder,
        start_new_session=True,
    ) as process:
        try:
            yield process
        finally:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)


@pytest.mark.skipif(not Path("/proc/self/task").exists(), reason="looks for processes in /proc")
@pytest.mark.parametrize(
    ("sent_to", "numbers"),
    [
        ("the group, as a terminal does", [signal.SIGINT]),
        ("the group, as timeout does", [signal.SIGTERM, signal.SIGTERM]),
        ("a worker alone", [signal.SIGHUP]),
    ],
)
def test_a_signal_ends_an_evaluation_with_one_line_and_no_orphans(
    sent_to: str, numbers: list[signal.Signals], tmp_path: Path
) -> None:
    with evaluation_in_the_background(tmp_path) as process:
        deadline = time.monotonic() + 60
        while len(children(process.pid)) < 3 and process.poll() is None and time.monotonic() < deadline:
            time.sleep(0.05)  # until both processes are there, beside Python's own resource tracker
        workers = children(process.pid)
        assert len(workers) >= 3
        time.sleep(0.5)  # in the midst of importing or of chasing
        for number in numbers:
            if sent_to.startswith("the group"):
                os.killpg(process.pid, number)
            else:
                os.kill(workers[-1], number)
        output, errors = process.communicate(timeout=60)
        assert (process.returncode, output) == (128 + numbers[0], "")
        (line,) = [line for line in errors.splitlines() if line.strip() and "/2000000" not in line]
        assert re.fullmatch(r"swarmchase: interrupted( after \d+ of 2000000 chases: nothing is kept, since .*)?", line)
        for _ in itertools.takewhile(lambda _: any(map(alive, workers)), range(1200)):
            time.sleep(0.05)
        assert not any(map(alive, workers))
    assert list(tmp_path.iterdir()) == []


def alive(pid: int) -> bool:
    with contextlib.suppress(OSError):
        return ") Z " not in Path(f"/proc/{pid}/stat").read_text()
    return False
