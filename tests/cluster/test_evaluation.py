"""An evaluation on a real Ray cluster of two nodes is the table of this machine, whatever happens to the nodes."""

import json
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from ray_nodes import Nodes, processes_at
from swarmchase.cli import main
from swarmchase.cluster import connection
from swarmchase.cluster import evaluation as cluster_evaluation
from swarmchase.cluster.connection import Cluster, connected
from swarmchase.cluster.evaluation import on_cluster
from swarmchase.controllers import weights_path
from swarmchase.errors import InputError
from swarmchase.evaluation import blocks, comparison
from swarmchase.evaluation.blocks import Job, evaluate_jobs
from swarmchase.evaluation.comparison import TABLE_FILE
from swarmchase.evaluation.table import Evaluation
from swarmchase.scenario import paper_scenario

pytestmark = pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="reads /proc to know a node's processes")

NEAR = paper_scenario(start_distance_m=20.0, max_movements=40)


@pytest.fixture(autouse=True)
def small_blocks(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(blocks, "BLOCK_CHASES", 8)
    monkeypatch.setattr(cluster_evaluation, "PART_CHASES", 3)
    # Both here, wherever the chases are.
    monkeypatch.setattr(comparison, "TIMED_DECISIONS", 10)
    monkeypatch.setattr("swarmchase.reports.comparison.draw_comparison", lambda *_: [])


def jobs() -> list[Job]:
    return [Job(name, name, NEAR, NEAR, 20) for name in ("random", "particle")]


def run_on(joined: Cluster, folder: Path, finished: Any = None) -> list[Evaluation]:
    return evaluate_jobs(folder, jobs(), 3, 1, finished, on_cluster(joined))


@pytest.fixture(scope="module")
def here(tmp_path_factory: pytest.TempPathFactory) -> list[Evaluation]:
    return evaluate_jobs(tmp_path_factory.mktemp("here"), jobs(), 3, 1)


def test_the_only_node_with_a_cpu_goes_and_another_comes_and_the_table_is_the_same(
    head: Nodes,
    here: list[Evaluation],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """It goes while it has a part at work, and the others wait for it. First, while no other node is there.

    Ray tells of it where people read, and not where a script reads the result.
    """
    monkeypatch.setattr(cluster_evaluation, "PART_CHASES", 1)
    lost = head.add(num_cpus=1)
    new: list[Any] = []

    def exchange_nodes(chases: int, found: int, job: str) -> None:
        if not new and processes_at(lost, "_chases"):
            head.remove(lost)
            new.append(head.add(num_cpus=1))

    try:
        with connected(head.address, 1) as joined:
            there = run_on(joined, tmp_path, exchange_nodes)
    finally:
        for node in new or [lost]:
            head.remove(node)
    assert [one.chases for one in there] == [one.chases for one in here]
    assert len(new) == 1
    output = capsys.readouterr()
    assert "(raylet)" in output.err
    assert output.out == ""


@pytest.fixture(scope="module")
def cluster(head: Nodes) -> Iterator[Nodes]:
    """All that is computed goes from the head to the other node and back."""
    with head.with_node(num_cpus=2):
        yield head


def words(place: Path, **options: Any) -> list[str]:
    NEAR.save_toml(place / "near.toml")
    given = {"scenario": place / "near.toml", "episodes": 20, "seed": 3, **options}
    return [word for name, value in given.items() for word in (f"--{name}", str(value))]


def test_the_commands_give_the_table_of_this_machine_bit_for_bit(
    cluster: Nodes, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """With a weights file that only this machine has, which acts as it is told, and with those that come with it."""
    own = tmp_path / "own.safetensors"
    shutil.copy(weights_path("paper", NEAR) or "", own)
    options = {"controller": own, "action-choice": "sampled"}
    main(["evaluate", *words(tmp_path, **options, table=tmp_path / "here.parquet"), "--json"])
    here = json.loads(capsys.readouterr().out)
    there = {"table": tmp_path / "there.parquet", "cluster": cluster.address, "folder": tmp_path / "kept"}
    main(["evaluate", *words(tmp_path, **options, **there), "--json"])
    output = capsys.readouterr()
    assert json.loads(output.out) == here
    told = f"The cluster at {cluster.address} has no token: whoever reaches its ports can run"
    assert (told in output.err) is not connection._has_token()
    assert (tmp_path / "there.parquet").read_bytes() == (tmp_path / "here.parquet").read_bytes()
    for folder, where in (("here", {}), ("there", {"cluster": cluster.address})):
        options = words(tmp_path, folder=tmp_path / folder, **where)
        main(["compare", "--controllers", "particle", "random", *options, "--json"])
    assert (tmp_path / "there" / TABLE_FILE).read_bytes() == (tmp_path / "here" / TABLE_FILE).read_bytes()


@pytest.fixture(scope="module")
def joined(cluster: Nodes) -> Iterator[Cluster]:
    """For the tests that follow: to join takes some seconds. The commands above do so themselves."""
    with connected(cluster.address, 1) as one:
        yield one


def test_interrupted_it_goes_on_behind_the_last_part(joined: Cluster, here: list[Evaluation], tmp_path: Path) -> None:
    """Complete blocks are kept as a whole, as without a cluster, and parts of others as they are."""

    def stop_at_13(chases: int, found: int, job: str) -> None:
        if chases >= 13:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_on(joined, tmp_path, stop_at_13)
    kept = sum(int(path.stem.split("-")[-1]) for path in (tmp_path / "blocks").iterdir())
    assert 13 <= kept < 40
    reported: list[tuple[int, int]] = []
    there = run_on(joined, tmp_path, lambda chases, found, _: reported.append((chases, found)))
    assert [one.chases for one in there] == [one.chases for one in here]
    assert max(found for _, found in reported) == kept
    assert reported[-1][0] == 40
    assert [chases for chases, _ in reported] == sorted(chases for chases, _ in reported)
    assert sorted(int(path.stem.split("-")[-1]) for path in (tmp_path / "blocks").iterdir()) == [4, 4, 8, 8, 8, 8]
    # All of it is found again without a cluster.
    monkey = evaluate_jobs(tmp_path, jobs(), 3, 1, lambda chases, found, _: reported.append((chases, found)))
    assert [one.chases for one in monkey] == [one.chases for one in here]
    assert reported[-1] == (40, 40)


def test_a_part_that_is_refused_there_ends_it_in_one_line(joined: Cluster, tmp_path: Path) -> None:
    """A weights file that was damaged after it had been looked at."""
    damaged = tmp_path / "damaged.safetensors"
    damaged.write_bytes(b"no weights at all")
    block = blocks.Block(tmp_path, Job("damaged", str(damaged), NEAR, NEAR, 3), 0, 0, 3)
    with pytest.raises(InputError, match=r"^(?!.*\n).*weights file .*\.safetensors"):
        list(on_cluster(joined)([block], lambda *_: None))
    assert not (tmp_path / "blocks").exists()
