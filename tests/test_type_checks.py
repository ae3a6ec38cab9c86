"""The test run checks types at every call, and the axes of tensors where there are any."""

import re
from pathlib import Path

import jaxtyping
import pytest
import torch
from beartype.roar import BeartypeCallHintParamViolation

import swarmchase
from live_bench import FLYING
from swarmchase.evaluation.statistics import nearest_rank_percentile
from swarmchase.live.link.messages import Heartbeat, TrackerMode
from swarmchase.observation import mean_power_dbm
from type_checks import AXES


def test_types_are_checked() -> None:
    with pytest.raises(jaxtyping.TypeCheckError):
        nearest_rank_percentile([1, 2], "90")
    with pytest.raises(BeartypeCallHintParamViolation):
        Heartbeat(tracker="0", time_ns=0, mode=TrackerMode.FOLLOWING, vehicle=FLYING)


def test_axes_are_checked() -> None:
    assert mean_power_dbm(torch.zeros(2, 50, 6)).shape == (2, 6)
    with pytest.raises(jaxtyping.TypeCheckError):
        mean_power_dbm(torch.zeros(50, 6))


def test_all_that_has_axes_is_where_they_are_checked() -> None:
    package = Path(swarmchase.__file__).parent
    modules = [
        "swarmchase." + ".".join(path.relative_to(package).with_suffix("").parts)
        for path in package.rglob("*.py")
        if re.search(r"\b(Float|Int|Bool)\[Tensor", path.read_text(encoding="utf-8"))
    ]
    assert len(modules) > 20
    assert [one for one in modules if not any(one == room or one.startswith(f"{room}.") for room in AXES)] == []
