"""A3C under its deterministic schedule: resuming is exact, bad folders are refused, the best is kept, and it learns."""

import dataclasses
import json
import resource
import shutil
import signal

import numpy as np
import pytest
import torch
from safetensors import safe_open
from safetensors.torch import load_file, save_file

from swarmchase.cli import main
from swarmchase.controllers import load_controller
from swarmchase.errors import InputError
from swarmchase.networks.actor_critic import SwarmNetworks
from swarmchase.networks.weights import load_weights
from swarmchase.scenario import paper_scenario
from swarmchase.training import run_folder
from swarmchase.training.a3c import train_a3c
from swarmchase.training.agent import FinishedChase
from swarmchase.training.losses import LossSettings
from swarmchase.training.parameters import FlatNetworks
from swarmchase.training.run_folder import TrainingLog, read_log
from swarmchase.training.settings import TrainingSettings

WORLD = paper_scenario(window_samples=3, start_distance_m=8.0, max_movements=8, continuity="continuous")
SETTINGS = TrainingSettings(
    num_agents=3,
    learning_rate=1e-3,
    max_updates=12,
    seed=5,
    evaluation_interval=4,
    evaluation_chases=3,
    checkpoint_interval=5,
)


def train(folder, settings=SETTINGS, resume=False, interrupt_at=None, scenario=WORLD):
    """Run to the end, or until Ctrl-C after so many updates."""

    interrupted = []

    def progress(status):
        if status.updates == interrupt_at and not interrupted:  # a second one would end it at once
            interrupted.append(status)
            signal.raise_signal(signal.SIGINT)

    return train_a3c(scenario, settings, folder, "deterministic", resume, progress)


def left_behind(folder):
    """All that a run leaves, but for the wall-clock seconds."""
    with safe_open(folder / "resume.safetensors", framework="pt") as file:
        document = json.loads(file.metadata()["swarmchase"])
        tensors = {name: file.get_tensor(name).numpy().tobytes() for name in file.keys()}  # noqa: SIM118
    log = [json.loads(line) for line in (folder / "training.jsonl").read_text().splitlines()]
    best = folder / "best.safetensors"
    return (
        tensors,
        {name: value for name, value in document.items() if name != "seconds"},
        [{name: value for name, value in line.items() if name != "seconds"} for line in log],
        best.read_bytes() if best.exists() else None,
    )


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory):
    folder = tmp_path_factory.mktemp("undisturbed")
    return train(folder), folder


def test_a_run_leaves_what_it_promises(undisturbed):
    result, folder = undisturbed
    assert (result.updates, result.stopped, result.weights) == (12, "finished", folder / "best.safetensors")
    evaluations, chases = read_log(folder, "evaluation"), read_log(folder, "chase")
    assert [line["update"] for line in evaluations] == [4, 8, 12]
    # Agent i takes the chases i, i + 3, i + 6, ...
    assert len(chases) >= 5
    for agent in range(3):
        own = [line["chase"] for line in chases if line["agent"] == agent]
        assert own == [agent + 3 * k for k in range(len(own))]
    assert all(1 <= line["movements"] <= 8 for line in chases)
    # Every movement made is in a finished chase or in one of the three that are under way.
    booked = sum(line["movements"] for line in chases)
    assert booked <= result.environment_steps <= booked + 3 * 8
    assert result.environment_steps == evaluations[-1]["environment_steps"]
    names = {path.name for path in folder.iterdir()}
    assert names == {"best.safetensors", "resume.safetensors", "training.jsonl", "training.lock", "tensorboard"}


def test_another_seed_is_another_run(tmp_path):
    """The same seed is the same run, bit for bit: so says the command's test."""
    for seed in (5, 6):
        train(tmp_path / str(seed), dataclasses.replace(SETTINGS, seed=seed), interrupt_at=2)
    ours, others = (load_file(tmp_path / seed / "resume.safetensors") for seed in ("5", "6"))
    assert not [name for name in ("global.vector", "agent0.state.center_m") if torch.equal(ours[name], others[name])]


@pytest.mark.parametrize("interrupt_at", [1, 8, 10])
def test_a_run_interrupted_and_resumed_is_the_undisturbed_one_bit_for_bit(undisturbed, tmp_path, interrupt_at):
    result = train(tmp_path, interrupt_at=interrupt_at)
    assert (result.updates, result.stopped) == (interrupt_at, "interrupted")
    assert left_behind(tmp_path)[0] != left_behind(undisturbed[1])[0]
    result = train(tmp_path, resume=True)
    assert (result.updates, result.stopped) == (12, "finished")
    assert left_behind(tmp_path) == left_behind(undisturbed[1])


def test_resuming_is_exact_with_several_chases_an_agent_and_a_falling_learning_rate(tmp_path):
    settings = dataclasses.replace(SETTINGS, num_agents=2, chases_per_agent=3, final_learning_rate=1e-4, max_updates=8)
    train(tmp_path / "whole", settings)
    train(tmp_path / "parts", settings, interrupt_at=4)
    train(tmp_path / "parts", settings, resume=True)
    assert left_behind(tmp_path / "parts") == left_behind(tmp_path / "whole")
    assert len(read_log(tmp_path / "whole", "chase")) >= 6


def test_what_was_logged_after_the_last_checkpoint_is_made_again_and_not_twice(undisturbed, tmp_path):
    """A killed run: its log goes further than its checkpoint, and its last line is half written."""
    train(tmp_path, interrupt_at=5)
    resume_file = (tmp_path / "resume.safetensors").read_bytes()
    train(tmp_path, resume=True, interrupt_at=9)
    (tmp_path / "resume.safetensors").write_bytes(resume_file)
    chases = read_log(tmp_path, "chase")
    with open(tmp_path / "training.jsonl", "a") as log:
        log.write('{"kind": "chase", "upd')
    assert read_log(tmp_path, "chase") == chases != []
    train(tmp_path, resume=True)
    assert left_behind(tmp_path) == left_behind(undisturbed[1])


def test_a_finished_run_resumed_does_nothing(undisturbed, tmp_path):
    folder = shutil.copytree(undisturbed[1], tmp_path / "run")
    result = train(folder, resume=True)
    assert (result.updates, result.stopped) == (12, "finished")
    assert left_behind(folder) == left_behind(undisturbed[1])


def test_ctrl_c_is_again_what_it_was(undisturbed):
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_a_folder_with_a_run_is_refused_and_left_as_it_is(undisturbed):
    _, folder = undisturbed
    before = left_behind(folder)
    with pytest.raises(InputError, match="holds a run already: resume it, or choose another folder"):
        train(folder)
    assert left_behind(folder) == before


def test_a_folder_without_a_run_is_not_resumed(tmp_path):
    with pytest.raises(InputError, match="holds no run to resume"):
        train(tmp_path, resume=True)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("settings", "scenario", "says"),
    [
        (dataclasses.replace(SETTINGS, learning_rate=2e-3), WORLD, "learning_rate = 0.001 there and 0.002 here"),
        (
            dataclasses.replace(SETTINGS, losses=LossSettings(discount=0.5), num_agents=2),
            WORLD,
            "agents = 3 there and 2 here, discount = 0.99 there and 0.5 here",
        ),
        (SETTINGS, dataclasses.replace(WORLD, rician_k=4.0), "rician_k = 3.0 there and 4.0 here"),
        # What is as in the paper is in no file.
        (SETTINGS, dataclasses.replace(WORLD, shadowing_db=2.0), "shadowing_db = 0.0 there and 2.0 here"),
        (dataclasses.replace(SETTINGS, max_updates=11), WORLD, "updates = 12 there and 11 here"),
        # Its learning rates would have been others.
        (
            dataclasses.replace(SETTINGS, max_updates=13, final_learning_rate=1e-5),
            WORLD,
            "final_learning_rate = None there and 1e-05 here, updates = 12 there and 13 here",
        ),
    ],
)
def test_a_run_is_not_resumed_with_other_options_and_says_which(undisturbed, settings, scenario, says):
    with pytest.raises(InputError) as refusal:
        train(undisturbed[1], settings, resume=True, scenario=scenario)
    folder = undisturbed[1]
    assert f"{folder / 'resume.safetensors'} is of a run with other options: " in str(refusal.value)
    assert f"{says}; give the same, or choose another folder" in str(refusal.value)


def test_a_finished_run_is_made_longer_as_if_it_had_been_so_from_the_first(undisturbed, tmp_path):
    """Its last evaluation was at a time for one. The best weights, from before, still say how long it was to be."""
    shorter = dataclasses.replace(SETTINGS, max_updates=8)
    assert train(tmp_path, shorter).stopped == "finished"
    again = train(tmp_path, shorter, resume=True)
    assert (again.updates, again.stopped) == (8, "finished")
    longer = train(tmp_path, SETTINGS, resume=True)
    assert (longer.updates, longer.stopped) == (12, "finished")
    assert left_behind(tmp_path)[:-1] == left_behind(undisturbed[1])[:-1]


def without(name):
    def spoil(path):
        with safe_open(path, framework="pt") as file:
            metadata = file.metadata()
        tensors = load_file(path)
        del tensors[name]
        save_file(tensors, path, metadata)

    return spoil


def changed(name, change):
    def spoil(path):
        with safe_open(path, framework="pt") as file:
            metadata = file.metadata()
        tensors = load_file(path)
        tensors[name] = change(tensors[name])
        save_file(tensors, path, metadata)

    return spoil


def saying(**fields):
    def spoil(path):
        with safe_open(path, framework="pt") as file:
            document = json.loads(file.metadata()["swarmchase"])
        save_file(load_file(path), path, {"swarmchase": json.dumps(document | fields)})

    return spoil


@pytest.mark.parametrize(
    "spoil",
    [
        lambda path: path.write_bytes(path.read_bytes()[:-1]),
        lambda path: path.write_bytes(path.read_bytes()[:50]),
        lambda path: path.write_bytes(b""),
        lambda path: path.write_text("not a resume file at all"),
        lambda path: save_file({"a": torch.zeros(1)}, path),
        lambda path: save_file({}, path, {"swarmchase": "{}"}),
        without("global.first_moment"),
        without("agent1.state.center_m"),
    ],
)
def test_a_damaged_resume_file_ends_in_one_line_and_exit_code_2(tmp_path, capsys, spoil):
    folder, words = tmp_path / "run", command(tmp_path)
    train(folder, interrupt_at=2)
    spoil(folder / "resume.safetensors")
    with pytest.raises(SystemExit) as ending:
        main([*words, "--folder", str(folder), "--resume"])
    assert ending.value.code == 2
    standard_error = capsys.readouterr().err
    assert len([line for line in standard_error.splitlines() if "swarmchase:" in line]) == 1
    assert "resume" in standard_error
    assert "Traceback" not in standard_error


@pytest.mark.parametrize(
    "spoil",
    [
        changed("global.vector", lambda vector: vector[:-1].clone()),
        changed("global.vector", lambda vector: vector * float("nan")),
        changed("global.second_moment", lambda moment: moment.half()),
        changed("global.updates", lambda updates: updates - 100),
        changed("global.updates", lambda updates: updates + 0.5),
        changed("agent1.state.center_m", lambda center_m: center_m[:, :2].clone()),
        changed("agent1.state.center_m", lambda center_m: center_m.float()),
        changed("agent1.state.center_m", lambda center_m: center_m * float("nan")),
        changed("agent1.number", lambda number: number + 1),
        changed("agent1.number", lambda number: number - 3 * 1000),
        changed("agent1.movements", lambda movements: movements - 1000),
        saying(agents=[]),
        saying(agents={}),
        saying(agents=[1, 2, 3]),
        saying(best={"update": 1}),
        saying(best=[1]),
        saying(environment_steps="many"),
        saying(environment_steps=-1),
        saying(seconds=float("nan")),
    ],
)
def test_a_resume_file_that_is_not_of_the_run_is_refused(undisturbed, tmp_path, spoil):
    folder = shutil.copytree(undisturbed[1], tmp_path / "run")
    spoil(folder / "resume.safetensors")
    with pytest.raises(InputError, match="resume ") as refusal:
        train(folder, resume=True)
    assert "\n" not in str(refusal.value)


def command(tmp_path):
    """The command line that says WORLD and SETTINGS."""
    WORLD.save_toml(tmp_path / "world.toml")
    options = {
        "scenario": tmp_path / "world.toml",
        "schedule": "deterministic",
        "learning-rate": SETTINGS.learning_rate,
        "agents": SETTINGS.num_agents,
        "updates": SETTINGS.max_updates,
        "seed": SETTINGS.seed,
        "evaluation-interval": SETTINGS.evaluation_interval,
        "evaluation-chases": SETTINGS.evaluation_chases,
        "checkpoint-interval": SETTINGS.checkpoint_interval,
    }
    return ["train", "a3c", *(word for name, value in options.items() for word in (f"--{name}", str(value)))]


def test_the_command_makes_the_same_run(undisturbed, tmp_path, capsys):
    main([*command(tmp_path), "--folder", str(tmp_path / "run"), "--json"])
    assert left_behind(tmp_path / "run") == left_behind(undisturbed[1])
    printed = json.loads(capsys.readouterr().out)
    assert (printed["updates"], printed["stopped"]) == (12, "finished")
    assert printed["weights"] == str(tmp_path / "run" / "best.safetensors")
    assert printed["best"] == dataclasses.asdict(undisturbed[0].best)


def test_a_damaged_log_is_refused(tmp_path):
    train(tmp_path, interrupt_at=2)
    (tmp_path / "training.jsonl").write_text("not JSON, and whole lines of it\n")
    with pytest.raises(InputError, match=r"training log .* is damaged"):
        train(tmp_path, resume=True)


def test_a_full_disk_is_said_in_one_line(tmp_path, monkeypatch):
    monkeypatch.setattr(run_folder, "_tensorboard", lambda folder, resume_update: None)
    log = TrainingLog(tmp_path, 0)
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (4096, hard))
    try:
        with pytest.raises(InputError, match=r"cannot write .*training\.jsonl: File too large"):  # noqa: PT012
            for chase in range(1000):
                log.chase(FinishedChase(0, chase, 0, 1, True, (0.0, 0.0, 0.0, 0.0)))
        with pytest.raises(InputError, match="cannot write"):
            log.close()
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


@pytest.mark.parametrize(
    "changes",
    [
        {"num_agents": 0},
        {"chases_per_agent": 0},
        {"update_interval": 0},
        {"max_updates": 0},
        {"max_updates": 2**24 + 1},
        {"evaluation_interval": 0},
        {"evaluation_chases": -1},
        {"checkpoint_interval": 0},
        {"learning_rate": 0.0},
        {"learning_rate": float("nan")},
        {"learning_rate": float("inf")},
        {"final_learning_rate": -1e-9},
        {"final_learning_rate": float("nan")},
        {"seed": -1},
    ],
)
def test_settings_outside_their_range_are_refused_by_name(changes):
    [(name, value)] = changes.items()
    with pytest.raises(
        InputError, match=f"{name} = {value} is refused: allowed is (a whole number )?(at least|between|greater than) "
    ):
        TrainingSettings(**changes)


def test_the_defaults_are_table_one():
    settings = TrainingSettings()
    assert (settings.num_agents, settings.update_interval, settings.learning_rate) == (8, 5, 1e-5)
    assert settings.final_learning_rate is None


@pytest.mark.parametrize(("stop_at_p90", "updates"), [(9.0, 4), (0.0, 12)])
def test_the_stop_criterion_stops_it_at_the_first_evaluation_that_meets_it(tmp_path, stop_at_p90, updates):
    """9 movements is a failed chase: any policy meets that, and none meets 0."""
    result = train(tmp_path, dataclasses.replace(SETTINGS, stop_at_p90=stop_at_p90))
    assert (result.updates, result.stopped) == (updates, "criterion met" if updates == 4 else "finished")
    assert load_file(tmp_path / "resume.safetensors")["global.updates"].item() == updates


def order(line):
    """Smaller is better."""
    return 1 - line["success_rate"], line["movements_p90"], line["movements_mean"]


def test_the_best_weights_are_those_of_the_best_evaluation(tmp_path):
    """A learning rate that destroys: an early evaluation is the best, and its weights stay."""
    settings = dataclasses.replace(SETTINGS, learning_rate=0.3, evaluation_interval=2, evaluation_chases=8)
    folder = tmp_path / "run"
    result = train(folder, settings)
    evaluations = read_log(folder, "evaluation")
    best = min(evaluations, key=order)
    assert best["update"] < 12
    assert dataclasses.asdict(result.best) == {name: best[name] for name in dataclasses.asdict(result.best)}
    networks, configuration = load_weights(folder / "best.safetensors")
    assert configuration["update"] == best["update"]
    assert configuration["scenarios"] == [WORLD.to_dict()]
    assert configuration["settings"] == settings.to_dict()
    # They are the global parameters of that moment, in float16, and a controller.
    train(tmp_path / "until", settings, interrupt_at=best["update"])
    then = load_file(tmp_path / "until" / "resume.safetensors")["global.vector"]
    torch.testing.assert_close(FlatNetworks(networks).vector, then, rtol=1e-3, atol=1e-6)
    assert load_controller(folder / "best.safetensors", WORLD).name == str(folder / "best.safetensors")


def test_a_resumed_run_keeps_the_best_of_before(tmp_path):
    settings = dataclasses.replace(SETTINGS, learning_rate=0.3, evaluation_interval=2, evaluation_chases=8)
    train(tmp_path, settings, interrupt_at=8)
    weights = (tmp_path / "best.safetensors").read_bytes()
    best = min(
        (1 - line["success_rate"], line["movements_p90"], line["movements_mean"])
        for line in read_log(tmp_path, "evaluation")
    )
    result = train(tmp_path, settings, resume=True)
    later = [
        (1 - line["success_rate"], line["movements_p90"], line["movements_mean"])
        for line in read_log(tmp_path, "evaluation")[4:]
    ]
    assert len(later) == 2
    assert min(later) >= best
    assert result.best.order == best
    assert (tmp_path / "best.safetensors").read_bytes() == weights


def test_a_run_stopped_before_its_first_evaluation_leaves_its_last_weights(tmp_path):
    result = train(tmp_path, interrupt_at=2)
    assert result.best is None
    assert result.weights == tmp_path / "last.safetensors"
    networks, configuration = load_weights(result.weights)
    assert configuration["update"] == 2
    vector = load_file(tmp_path / "resume.safetensors")["global.vector"]
    torch.testing.assert_close(FlatNetworks(networks).vector, vector, rtol=1e-3, atol=1e-6)


def test_the_learning_rate_falls_over_the_run(tmp_path):
    """A rate that falls to 0 after one update: nothing moves any more."""
    settings = dataclasses.replace(SETTINGS, final_learning_rate=0.0, max_updates=2)
    train(tmp_path / "both", settings)
    # Rates 1e-3 and 5e-4: Adam's first step is the rate itself for every parameter with a gradient.
    start = FlatNetworks(new_networks(settings)).vector
    train(tmp_path / "one", settings, interrupt_at=1)
    first, both = (load_file(tmp_path / name / "resume.safetensors")["global.vector"] for name in ("one", "both"))
    assert (first - start).abs().max().item() == pytest.approx(1e-3, rel=1e-3)
    # The second is at most about its own rate: |m / (1 - .9^2)| / sqrt(v / (1 - .999^2)) <= 1.0 for two gradients.
    assert 1e-4 < (both - first).abs().max().item() < 5.1e-4


def new_networks(settings):
    from swarmchase.training.settings import training_seed

    return SwarmNetworks(torch.Generator().manual_seed(training_seed(settings.seed)))


def test_it_learns(tmp_path):
    """The target 8 m away and no fading: within 50 updates the networks win distance on every axis.

    The reward of a movement, chase by chase, rises from the first fifth of the chases to the last for each of x, y and
    z, by an effect of more than 0.8 standard deviations, which is called large; 1.0 to 2.3 was seen with five seeds.
    """
    scenario = paper_scenario(start_distance_m=8.0, max_movements=20, rician_k=1e6, window_samples=4)
    settings = TrainingSettings(
        num_agents=2,
        chases_per_agent=8,
        learning_rate=3e-3,
        losses=LossSettings(discount=0.5),
        max_updates=50,
        evaluation_interval=50,
        evaluation_chases=2,
    )
    train(tmp_path, settings, scenario=scenario)
    chases = read_log(tmp_path, "chase")
    rate_m = np.array([line["reward_m"] for line in chases]) / [[line["movements"]] for line in chases]
    fifth = len(chases) // 5
    first, last = rate_m[:fifth], rate_m[-fifth:]
    effect = (last.mean(axis=0) - first.mean(axis=0)) / np.sqrt((first.var(axis=0) + last.var(axis=0)) / 2)
    assert fifth >= 20
    assert (effect[1:] > 0.8).all(), effect
    movements = np.array([line["movements"] for line in chases])
    assert movements[-fifth:].mean() < 0.7 * movements[:fifth].mean()
