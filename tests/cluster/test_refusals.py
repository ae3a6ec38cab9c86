"""A cluster that cannot be used is refused in one clear line, exit code 2, and soon."""

import contextlib
import socket
import sys
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from ray_nodes import Nodes
from swarmchase.cli import main
from swarmchase.cluster import training as cluster_training
from swarmchase.cluster.connection import connected
from swarmchase.cluster.software import installed, require_same_software
from swarmchase.cluster.training import train_on_cluster
from swarmchase.errors import InputError, WorkerDiedError
from swarmchase.scenario import paper_scenario
from swarmchase.training.settings import TrainingSettings

HERE = {"Python": "3.11.7", "swarmchase": "0.3.0", "torch": "2.13.0", "numpy": "2.4.6", "code of swarmchase": "a1b2"}


@contextlib.contextmanager
def server(answer: bytes | None) -> Iterator[str]:
    """Takes connections and says this once, or nothing."""
    with socket.create_server(("127.0.0.1", 0)) as listening:
        taken = []

        def take() -> None:
            with contextlib.suppress(OSError):
                connection = listening.accept()[0]
                taken.append(connection)
                if answer is not None:
                    connection.sendall(answer)

        thread = threading.Thread(target=take, daemon=True)
        thread.start()
        yield f"127.0.0.1:{listening.getsockname()[1]}"
        thread.join()
        for connection in taken:
            connection.close()


def refusal(words: list[str], capsys: pytest.CaptureFixture[str]) -> str:
    """What the command says before it exits with code 2."""
    with pytest.raises(SystemExit) as exit_:
        main(words)
    output = capsys.readouterr()
    assert (exit_.value.code, output.out) == (2, "")
    lines = [line for line in output.err.splitlines() if line.startswith("swarmchase: ")]
    assert len(lines) == 1, output.err
    return lines[0]


@pytest.mark.parametrize(
    ("address", "message"),
    [
        ("rack", "cluster address 'rack' is refused: allowed is HOST:PORT of its head, or local"),
        ("rack:", "cluster address 'rack:' is refused"),
        (":6379", "cluster address ':6379' is refused"),
        ("rack:66000", "cluster address 'rack:66000' is refused"),
        ("127.0.0.1:1", "nobody answers at the cluster address 127.0.0.1:1 (Connection refused)"),
    ],
)
@pytest.mark.parametrize("command", [["evaluate"], ["train", "a3c"]])
def test_an_address_where_no_cluster_can_be(
    command: list[str], address: str, message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    said = refusal([*command, "--cluster", address, "--folder", str(tmp_path / "out")], capsys)
    assert message in said
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("answer", "message"),
    [
        (b"HTTP/1.1 400 Bad Request\r\n\r\n", "is not the head of a Ray cluster"),
        (None, r"nobody answers at the cluster address .* \(timed out\)"),
    ],
)
def test_a_server_that_is_no_cluster(answer: bytes | None, message: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("swarmchase.cluster.connection.REACH_LIMIT_S", 0.5)
    with server(answer) as address, pytest.raises(InputError, match=message), connected(address, 1):
        pass


def test_without_ray(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    monkeypatch.setitem(sys.modules, "ray", None)
    for command in (["train", "a3c"], ["evaluate"], ["compare"], ["reproduce"]):
        said = refusal([*command, "--folder", str(tmp_path / "out"), "--cluster", "local"], capsys)
        assert "a cluster needs Ray, which is not installed: pip install 'swarmchase[cluster]'" in said
    assert not (tmp_path / "out").exists()


def test_a_schedule_that_no_cluster_has(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    words = ["train", "a3c", "--folder", str(tmp_path), "--cluster", "local", "--schedule", "deterministic"]
    assert "schedule = 'deterministic' is refused: agents on a cluster are asynchronous" in refusal(words, capsys)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"swarmchase": None}, r"^node b has no swarmchase: pip install 'swarmchase\[cluster\]==0.3.0' there$"),
        ({"torch": "2.12.0"}, "^node b has torch 2.12.0, and this machine 2.13.0: install the same on all nodes$"),
        ({"numpy": None}, "^node b has numpy None, and this machine 2.4.6"),
        ({"Python": "3.12.1"}, "^node b has Python 3.12.1"),
        ({"code of swarmchase": "c3d4"}, "^node b has code of swarmchase c3d4, and this machine a1b2"),
    ],
)
def test_other_software_on_a_node(changes: dict[str, str | None], message: str) -> None:
    require_same_software("b", dict(HERE), dict(HERE))
    with pytest.raises(InputError, match=message):
        require_same_software("b", HERE | changes, dict(HERE))


def test_what_is_installed_here_is_found() -> None:
    found = installed()
    assert found.keys() == HERE.keys()
    assert all(found.values())


def test_a_cluster_without_cpus(head: Nodes) -> None:
    head.settle()
    with pytest.raises(InputError, match="has no CPUs: start its nodes with"), connected(head.address, 1):
        pass


def test_a_node_without_the_package_and_one_with_another_version(head: Nodes, tmp_path: Path) -> None:
    """Real nodes, whose Python finds another swarmchase first: a broken one, and another torch."""
    (tmp_path / "torch-1.0.0.dist-info").mkdir()
    (tmp_path / "torch-1.0.0.dist-info" / "METADATA").write_text("Metadata-Version: 2.1\nName: torch\nVersion: 1.0.0\n")
    node = head.add(1, PYTHONPATH=str(tmp_path))
    with pytest.raises(InputError, match=r"node .* has torch 1\.0\.0, and this machine"), connected(head.address, 1):
        pass
    head.remove(node)
    (tmp_path / "without").mkdir()
    (tmp_path / "without" / "sitecustomize.py").write_text("import sys\nsys.modules['swarmchase'] = None\n")
    node = head.add(1, PYTHONPATH=str(tmp_path / "without"))
    with pytest.raises(InputError, match=r"node .* has no swarmchase: pip install"), connected(head.address, 1):
        pass
    head.remove(node)


def test_agents_that_find_no_cpu_do_not_wait_for_ever(
    head: Nodes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The only node with a CPU goes before they start."""
    monkeypatch.setattr(cluster_training, "START_LIMIT_S", 6.0)
    node = head.add(1)
    gone = []

    def remove(_: object) -> None:
        if not gone:
            gone.append(head.remove(node))

    settings = TrainingSettings(num_agents=2, max_updates=5)
    with pytest.raises(WorkerDiedError, match=r"no local agent has reported for 6 s: 2 of 2 wait for a CPU; the clus"):
        train_on_cluster(paper_scenario(), settings, tmp_path / "run", head.address, progress=remove)
