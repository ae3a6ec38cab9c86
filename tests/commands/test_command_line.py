"""The command line before a command runs: what there is, what was meant, options from a file, and completion."""

import json
import os
import shutil
import signal
import subprocess
from importlib.metadata import version
from pathlib import Path

import pytest
import tyro

from swarmchase.cli import main
from swarmchase.commands.catalogue import COMMANDS, SECTIONS, kind
from swarmchase.commands.completion import completion_script
from swarmchase.processes.stop_request import STOP_SIGNALS

BENCHMARKS = Path(__file__).parents[2] / "benchmarks"
TRACKER = 'number = 2\nsource = "udp:5000"\nvehicle = "simulated"\n'


def answered(words: str, capsys: pytest.CaptureFixture[str]) -> str:
    with pytest.raises(SystemExit) as end:
        main(words.split())
    output = capsys.readouterr()
    assert (end.value.code, output.err) == (0, "")
    return output.out


def refused(words: str, capsys: pytest.CaptureFixture[str]) -> str:
    with pytest.raises(SystemExit) as end:
        main(words.split())
    output = capsys.readouterr()
    assert (end.value.code, output.out, output.err.count("\n")) == (2, "", 1)
    return output.err.removeprefix("swarmchase: ").rstrip("\n")


# --- what there is ---------------------------------------------------------------------------------------------------


def test_the_version_is_the_package_s(capsys: pytest.CaptureFixture[str]) -> None:
    assert answered("--version", capsys) == f"swarmchase {version('swarmchase')}\n"


def test_help_groups_the_commands_by_what_they_are_for(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "60")
    lines = answered("--help", capsys).splitlines()
    titles = [lines.index(title) for title in SECTIONS]
    assert titles == sorted(titles)
    assert max(map(len, lines[: lines.index("Begin with")])) <= 60
    assert answered("-h", capsys).splitlines() == lines


@pytest.mark.parametrize("words", ["train", "train --help", "train -h"])
def test_the_first_of_two_words_says_which_commands_there_are(words: str, capsys: pytest.CaptureFixture[str]) -> None:
    told = answered(words, capsys)
    assert told.startswith("usage: swarmchase train COMMAND [OPTIONS]\n")
    assert all(f"  {name}  " in told for name in COMMANDS if name.startswith("train "))
    assert "evaluate" not in told


@pytest.mark.parametrize(
    ("words", "line"),
    [
        ("", "give a command; see: swarmchase --help"),
        ("evalute", "no command 'evalute' (did you mean evaluate?); see: swarmchase --help"),
        ("benchmrk live", "no command 'benchmrk' (did you mean benchmark?); see: swarmchase --help"),
        ("fly", "no command 'fly'; see: swarmchase --help"),
        ("train a3 --folder x", "no command 'train a3' (did you mean a3c?); see: swarmchase train --help"),
        ("train --folder x", "no command 'train --folder'; see: swarmchase train --help"),
        ("--json", "no option '--json' before a command; see: swarmchase --help"),
        (
            "evaluate --episods 3",
            "Unrecognized options: --episods, 3 (did you mean --episodes?); see: swarmchase evaluate --help",
        ),
    ],
)
def test_who_mistypes_is_told_what_was_meant(words: str, line: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert refused(words, capsys) == line


# --- completion ------------------------------------------------------------------------------------------------------

ASK_BASH = """
source /dev/stdin
COMP_WORDS=("$@") COMP_CWORD=$(($# - 1))
"$(complete -p swarmchase | sed 's/.*-F //; s/ .*//')"
echo "${COMPREPLY[@]}"
"""


@pytest.mark.skipif(shutil.which("bash") is None, reason="there is no bash")
@pytest.mark.parametrize(
    ("words", "completions"),
    [
        (["swarmchase", "re"], "replay reproduce"),
        (["swarmchase", "train", "b"], "batched"),
        (["swarmchase", "train", "a3c", "--chases"], "--chases-per-agent"),
        (["swarmchase", "evaluate", "--epi"], "--episodes"),
    ],
)
def test_bash_completes_commands_of_one_and_of_two_words(words: list[str], completions: str) -> None:
    asked = subprocess.run(
        ["bash", "-c", ASK_BASH, "bash", *words],
        input=completion_script("bash"),
        capture_output=True,
        text=True,
        check=True,
    )
    assert asked.stdout.split() == completions.split()


# --- options from a file ---------------------------------------------------------------------------------------------


def test_a_configuration_gives_options_and_the_command_line_others(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "tracker.toml"
    path.write_text(TRACKER + "position_m = [1, 2.5, 3]\nsame_clock = true\nsampling_hz = 20\n")
    main(["tracker", "--config", str(path), "--number", "4", "--no-same-clock", "--print-config"])
    told = capsys.readouterr().out.splitlines()
    expected = [
        "number = 4",
        'source = "udp:5000"',
        "position_m = [1.0, 2.5, 3.0]",
        "same_clock = false",
        "sampling_hz = 20.0",
        "# keys =",
    ]
    assert set(expected) < set(told)


@pytest.mark.parametrize("words", ["serve", "tracker --number 1 --source udp:7 --vehicle mavlink:8"])
def test_what_is_printed_is_a_configuration_that_says_the_same(
    words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    main([*words.split(), "--print-config"])
    printed = capsys.readouterr().out
    path = tmp_path / "all.toml"
    path.write_text(printed)
    main([words.split(maxsplit=1)[0], f"--config={path}", "--print-config"])
    assert capsys.readouterr().out == printed


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ("numbr = 2", "cannot use configuration FILE: no option 'numbr' (did you mean number?)"),
        ("config = 'other.toml'", "cannot use configuration FILE: no option 'config'"),
        ("number = {x = 1}", "cannot use configuration FILE: number = {'x': 1} is no text, number or list of them"),
        ("number = ", "cannot read configuration FILE: it is no TOML: "),
        (
            TRACKER.replace("2", "'two'"),
            "Error parsing --number: invalid literal for int() with base 10: 'two'; the configuration is FILE; "
            "see: swarmchase tracker --help",
        ),
        (
            "number = 2",
            "Missing from swarmchase tracker: --source STR, --vehicle STR; the configuration is FILE; see: ",
        ),
    ],
)
def test_a_configuration_is_checked_whole_before_anything_starts(
    text: str, line: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "tracker.toml"
    path.write_text(text)
    assert refused(f"tracker --config {path}", capsys).startswith(line.replace("FILE", str(path)))


def test_a_file_that_is_not_there_is_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    missing = tmp_path / "serve.toml"
    assert refused(f"serve --config {missing}", capsys) == (
        f"cannot read configuration {missing}: No such file or directory"
    )


# --- one rule for signals, and one for files that are there ----------------------------------------------------------


# --- the controller of live chases that are measured -----------------------------------------------------------------


@pytest.mark.parametrize(
    ("words", "controller"),
    [
        ("", "recurrent"),
        ("--sampling-hz 100 --spatial-correlation 0.5", "recurrent"),
        ("--scenario flight", "adaptive"),
        ("--scenario rough --behaviour wander", "adaptive"),
        ("--scenario flight --controller particle", "particle"),
        ("--controller gradient", "gradient"),
    ],
)
@pytest.mark.parametrize("name", ["live", "liars", "soak"])
def test_measured_live_chases_have_the_controller_of_their_pace(name: str, words: str, controller: str) -> None:
    command = tyro.cli(kind(f"benchmark {name}"), args=words.split())
    assert command.controller_in(command.world()) == controller


@pytest.mark.parametrize("name", ["live", "liars", "soak"])
def test_what_is_published_of_stopping_trackers_is_measured_again_without_naming_a_controller(name: str) -> None:
    published = json.loads((BENCHMARKS / f"{name}.json").read_text())
    command = tyro.cli(kind(f"benchmark {name}"), args=[])
    assert command.controller_in(command.world()) == published["controller"]


@pytest.mark.parametrize("name", ["live", "liars", "soak"])
def test_help_says_which_controller_that_is(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    told = " ".join(answered(f"benchmark {name} --help", capsys).split())
    assert "default is adaptive where trackers listen in flight, recurrent where they stop to listen." in told


@pytest.mark.parametrize(
    ("words", "line"),
    [
        ("1 --scenario flight", "seconds = 1 is refused: the first 60 are only to warm up"),
        ("nan --scenario flight", "seconds = nan is refused: it must be a finite number"),
        ("inf", "seconds = inf is refused: it must be a finite number"),
        (
            "1 --scenario flight --controller gradient",
            "gradient is refused where a target is followed: it has no belief to follow",
        ),
    ],
)
def test_an_hour_in_flight_is_refused_for_what_somebody_typed_alone(
    words: str, line: str, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("pymavlink", reason="the live system needs: pip install 'swarmchase[live]'")
    assert refused(f"benchmark soak --seconds {words}", capsys) == line


@pytest.mark.parametrize("number", STOP_SIGNALS)
@pytest.mark.parametrize("name", COMMANDS)
def test_what_asks_a_command_to_stop_is_heard_alike_by_all(
    name: str, number: signal.Signals, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """While one works that does not look for it itself; those that do have tests of their own."""

    class Working:
        def run(self) -> None:
            os.kill(os.getpid(), number)
            raise AssertionError("it was not heard")

    monkeypatch.setattr("swarmchase.cli._parsed", lambda words: (name, Working()))
    with pytest.raises(SystemExit) as end:
        main([name])
    assert (end.value.code, capsys.readouterr().err) == (128 + number, "swarmchase: interrupted\n")


@pytest.mark.parametrize(
    ("words", "file"),
    [
        ("chase --controller gradient --animation film.gif", "film.gif"),
        ("evaluate --controller gradient --episodes 2 --processes 1 --table table.parquet", "table.parquet"),
        ("benchmark cluster --figure scaling.png", "scaling.png"),
        ("live --headless --log chase.mcap --output jsonl:estimate.jsonl", "chase.mcap"),
        ("live --headless --log new.mcap --output jsonl:estimate.jsonl", "estimate.jsonl"),
        ("keys swarm.keys", "swarm.keys"),
    ],
)
def test_no_file_that_somebody_names_is_replaced_unasked(
    words: str, file: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Each is refused before any work."""
    monkeypatch.chdir(tmp_path)
    Path(file).write_text("precious")
    assert f"{file}" in (told := refused(words, capsys))
    assert "exists already" in told
    assert {path.name: path.stat().st_size for path in tmp_path.iterdir()} == {file: len("precious")}


def test_overwrite_replaces_it_and_results_in_a_folder_are_told_of(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    evaluate, chase = "evaluate --controller gradient --episodes 2", "chase --controller gradient --max-movements 2"
    Path("table.parquet").write_text("precious")
    main([*evaluate.split(), "--processes", "1", "--table", "table.parquet", "--overwrite"])
    assert Path("table.parquet").read_bytes()[:4] == b"PAR1"
    main(chase.split())
    assert "Replaced" not in capsys.readouterr().err
    main(chase.split())
    assert "Replaced: chase-output/chase.json, chase-output/chase.png\n" in capsys.readouterr().err
