"""The model of a cluster's cost: against a simulation, against what is known, and fitted to what it made itself."""

import dataclasses
import heapq
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from swarmchase.benchmarks import cluster as benchmark
from swarmchase.benchmarks.cluster_model import (
    UpdateCost,
    fitted_line,
    on_few_cores,
    predicted,
    saturating_agents,
    throughput,
)
from swarmchase.cli import main
from swarmchase.reports import cluster as cluster_figures

COST = UpdateCost(
    agent_fixed_s=0.02,
    agent_step_s=0.008,
    global_agent_s=0.005,
    raylet_s=0.011,
    delay_s=0.01,
    message_bytes=5_882_368,
)
GIGABIT = 1e9


def simulated(customers: int, think_s: float, demands_s: list[float], rounds: int, seed: int) -> float:
    """Rounds a second of customers that think, then queue at one server after another; all times exponential."""
    draw = np.random.default_rng(seed).exponential
    free_at = [0.0] * len(demands_s)
    events = [(draw(think_s), customer, 0) for customer in range(customers)]
    heapq.heapify(events)
    ended, now = 0, 0.0
    while ended < rounds:
        now, customer, station = heapq.heappop(events)
        if station == len(demands_s):
            ended += 1
            heapq.heappush(events, (now + draw(think_s), customer, 0))
            continue
        free_at[station] = max(now, free_at[station]) + draw(demands_s[station])
        heapq.heappush(events, (free_at[station], customer, station + 1))
    return ended / now


@pytest.mark.parametrize("customers", [1, 3, 8, 40])
def test_the_throughput_is_that_of_a_simulated_network(customers: int) -> None:
    demands_s = {"one": 0.01, "two": 0.02, "three": 0.004}
    rate = throughput(customers, 0.1, demands_s)
    assert simulated(customers, 0.1, list(demands_s.values()), 40_000, seed=1) == pytest.approx(rate, rel=0.03)


def test_one_agent_waits_for_nobody_and_many_for_the_slowest() -> None:
    alone = predicted(COST, 1, 8, 5, 10 * GIGABIT)
    network_s = 8 * COST.message_bytes / (10 * GIGABIT)
    assert 1 / alone.updates_per_s == pytest.approx(0.02 + 0.008 * 40 + 0.01 + 0.005 + 0.011 + 2 * network_s)
    assert alone.steps_per_s == pytest.approx(40 * alone.updates_per_s)
    many = predicted(COST, 1000, 8, 5, 10 * GIGABIT)
    assert many.updates_per_s == pytest.approx(1 / 0.011, rel=1e-3)
    assert (many.busiest, many.updates_behind) == ("raylet", 999)
    assert many.busy_share == pytest.approx(1, rel=1e-3)
    slow_network = predicted(COST, 1000, 8, 5, GIGABIT)
    assert slow_network.busiest == "network in"
    # Both directions are as busy: the last agent of a thousand still waits a little.
    assert slow_network.updates_per_s == pytest.approx(GIGABIT / (8 * COST.message_bytes), rel=2e-3)


def test_more_chases_move_the_saturation_to_more_agents() -> None:
    few, many = (saturating_agents(COST, chases, 5, 10 * GIGABIT) for chases in (1, 8))
    assert many - few == pytest.approx(0.008 * 35 / 0.011)
    for agents, chases in ((few, 1), (many, 8)):
        before, behind = (predicted(COST, round(share * agents), chases, 5, 10 * GIGABIT) for share in (0.5, 3))
        assert before.updates_per_s > 0.8 * before.agents / (agents * 0.011)
        assert behind.updates_per_s > 0.95 / 0.011


def test_cores_that_all_share_are_the_limit_where_they_are_few() -> None:
    work_s = COST.agent_s(1, 5) + COST.global_agent_s + 2 * COST.raylet_s
    assert on_few_cores(COST, 4, 1, 5, cores=2) == pytest.approx(2 / work_s)
    assert on_few_cores(COST, 1, 1, 5, cores=2) == pytest.approx(
        1 / (COST.agent_s(1, 5) + COST.delay_s + COST.global_agent_s + COST.raylet_s)
    )


def test_the_line_is_found_again_and_never_begins_below_zero() -> None:
    x = [5, 40, 160]
    assert fitted_line(x, [0.02 + 0.008 * one for one in x]) == pytest.approx((0.02, 0.008))
    intercept, slope = fitted_line(x, [0.008 * one - 0.01 for one in x])
    assert intercept == 0
    assert slope == pytest.approx(0.0073, abs=0.0006)


def made_up_rows() -> list[dict[str, Any]]:
    """What would be measured of ``COST`` if the shared processes also did a hundredth of a second's work in each."""
    rows = []
    for agents in (1, 2, 4):
        for chases in (1, 8, 32):
            rate = on_few_cores(COST, agents, chases, 5, cores=64)
            rows.append(
                {
                    "agents": agents,
                    "chases_per_agent": chases,
                    "update_interval": 5,
                    "updates_per_s": rate,
                    "steps_per_s": 5 * chases * rate,
                    "agent_cpu_s": COST.agent_s(chases, 5),
                    "exchange_s": COST.delay_s + COST.global_agent_s + COST.raylet_s,
                    "global_agent_cpu_s": COST.global_agent_s + 0.01 / rate,
                    "raylet_cpu_s": COST.raylet_s + 0.01 / rate,
                    "updates_behind": agents - 1.0,
                    "message_bytes": COST.message_bytes,
                }
            )
    return rows


def test_the_fit_finds_the_cost_that_made_the_rows() -> None:
    found = benchmark.fitted_cost(made_up_rows())
    assert dataclasses.asdict(found) == pytest.approx(dataclasses.asdict(COST), rel=1e-6)


def test_it_measures_a_real_cluster_and_draws_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(benchmark, "WARM_UP_S", 0.2)
    result = benchmark.measure(seconds=0.5, agents=(2,), chases_per_agent=(1,))
    assert json.loads(json.dumps(result)) == result
    assert [(row["agents"], row["chases_per_agent"]) for row in result["measured"]] == [(2, 1)]
    for row in result["measured"]:
        assert row["steps_per_s"] == pytest.approx(5 * row["chases_per_agent"] * row["updates_per_s"], rel=0.01)
        assert row["updates_behind"] <= 1.5
        assert 0 < row["exchange_s"] < 10
        assert row["agent_cpu_s"] > row["global_agent_cpu_s"] > 0
        assert row["message_bytes"] >= 4 * 1_470_488
    assert len(result["planned"]) == len(benchmark.PLANNED_AGENTS) * len(benchmark.PLANNED_SETTINGS)
    cluster_figures.draw_scaling(result, tmp_path / "scaling.png")
    assert (tmp_path / "scaling.png").stat().st_size > 10_000
    assert benchmark.table(result).row_count == 1 + 3 * len(benchmark.PLANNED_SETTINGS)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--seconds", "0"], "seconds = 0.0 is refused: allowed is greater than 0"),
        (["--figure", "scaling.svg"], "figure scaling.svg is refused: allowed is .png or .pdf"),
        (["--figure", "/dev/null.png"], "cannot write /dev/null.png"),
    ],
)
def test_bad_options_are_refused_before_anything_is_measured(
    words: list[str], message: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(benchmark, "measure", lambda **_: pytest.fail("measured"))
    if words[-1].startswith("/dev"):
        monkeypatch.setattr("swarmchase.files.tempfile.TemporaryFile", _full)
    with pytest.raises(SystemExit) as exit_:
        main(["benchmark", "cluster", *words])
    assert exit_.value.code == 2
    assert message in capsys.readouterr().err


def test_the_page_holds_the_figures_of_the_file() -> None:
    root = Path(__file__).parents[2]
    result = json.loads((root / "benchmarks" / "cluster.json").read_text(encoding="utf-8"))
    page = (root / "docs" / "cluster.md").read_text(encoding="utf-8")
    for table in benchmark.markdown(result).split("\n\n"):
        assert table in page


def _full(**_: Any) -> Any:
    raise OSError(28, "No space left on device")


def test_the_staleness_is_drawn_as_it_was_logged(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    drawn: list[Any] = []
    monkeypatch.setattr(cluster_figures, "save_figure", lambda figure, *_: drawn.append(figure))
    behind = [0, 1, 1, 3] * 50
    gradients = [{"update": k + 1, "agent": k % 3, "updates_behind": one} for k, one in enumerate(behind)]
    cluster_figures.draw_staleness(gradients, tmp_path / "staleness.png")
    curve, count = drawn[0].axes
    np.testing.assert_array_equal(curve.lines[0].get_ydata(), behind)
    np.testing.assert_allclose(curve.lines[1].get_ydata(), 1.25)
    np.testing.assert_array_equal(curve.lines[1].get_xdata(), range(100, 201))
    assert [(bar.get_x() + bar.get_width() / 2, bar.get_height()) for bar in count.patches] == [
        (0, 50),
        (1, 100),
        (3, 50),
    ]
