"""What all tests share."""

import os
import signal
from collections.abc import Generator
from pathlib import Path
from typing import Any

import pytest
import torch

from type_checks import check_types, check_types_anew

check_types()

# One thread: tests compare small batches, where more threads only wait for one another.
torch.set_num_threads(1)

# Ray's processes run at niceness 15: beside three other workers they get hardly any of two cores.
os.environ.setdefault("RAY_worker_niceness", "0")

# A job in the background of a script has Ctrl-C ignored, one under nohup the end of its terminal, and so would all that
# the tests start.
for number, handler in ((signal.SIGINT, signal.default_int_handler), (signal.SIGHUP, signal.SIG_DFL)):
    if signal.getsignal(number) is signal.SIG_IGN:
        signal.signal(number, handler)

AGAIN_S = 60.0
"""The time limit of a test strikes again after so long."""
HERE = Path(__file__).parent
GROUPS = {
    "ray": {
        "cluster/test_training.py",
        "cluster/test_evaluation.py",
        "cluster/test_refusals.py",
        "benchmarks/test_cluster.py",
    },
    "live": {
        "benchmarks/test_kills.py",
        "commands/test_live_commands.py",
        "live/log/test_log.py",
        "live/page/test_in_browser.py",
        "live/page/test_page.py",
        "simulation/test_live_chase.py",
        "test_packaging.py",
        "test_pictures.py",
    },
}
"""Ray clusters; live processes and a browser, with limits of wall time: never two of a group side by side. They wait a
lot, so there are two workers more than there are cores."""
LONG = {"batch", "channel", "controllers", "networks", "simulation", "test_docs.py", "training"}
"""Files and folders that take long: they begin early, so that no worker has one left when the other is done."""


def pytest_runtest_setup() -> None:
    """The first calls in each test are checked."""
    check_types_anew()


@pytest.hookimpl(wrapper=True, optionalhook=True)
def pytest_timeout_set_timer() -> Generator[None, Any, Any]:
    """Let the time limit of a test strike again: the first is a failing example to hypothesis, which runs it anew."""
    result = yield
    limit_s, _ = signal.getitimer(signal.ITIMER_REAL)
    if limit_s > 0:
        signal.setitimer(signal.ITIMER_REAL, limit_s, AGAIN_S)
    return result


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> Any:
    """``pytest -n 4 --dist loadfile``: a file stays with one worker, and so does a group.

    Not by ``pytest.mark.xdist_group``, which pytest-xdist 3.8 under pytest 9.2 passes over without a word.
    """
    if config.getoption("dist") != "loadfile":
        return None
    from xdist.scheduler import LoadFileScheduling

    class Scheduling(LoadFileScheduling):
        def _split_scope(self, nodeid: str) -> str:
            return _group(nodeid)

    return Scheduling(config, log)


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Workers begin the groups in this order, if they are not told to reorder them by the number of tests."""
    if hasattr(config, "workerinput"):
        items.sort(key=_turn)


def _group(nodeid: str) -> str:
    file = nodeid.split("::", 1)[0].removeprefix("tests/")
    return next((name for name, files in GROUPS.items() if file in files), file)


def _turn(item: pytest.Item) -> int:
    group = _group(item.nodeid)
    return 0 if group in GROUPS else 1 if group.split("/")[0] in LONG else 2
