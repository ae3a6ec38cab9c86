"""Networks as ONNX files, for a computer that has onnxruntime and no torch (extra: onnx).

A file takes levels in dBm and places in metres, NaN where a sample is missing: the scaling of its input and what its
networks do about gaps are inside. What networks remember comes in and goes out as one vector, ``memory``; the first is
in the file's metadata.
"""

import json
import math
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from torch import nn

from ..batch.array_types import Float, Tensor
from ..errors import InputError
from ..files import atomic_path
from ..scenario import NUM_TRACKERS, Scenario
from .actor_critic import WindowNetworks, filled_window_dbm
from .protocol import DecidingNetworks, ExpectingNetwork, HearingNetworks
from .pursuit import PursuitNetwork
from .windows import WindowsNetwork

OPSET = 17
METADATA_KEY = "swarmchase"
_FLOAT, _DOUBLE = 1, 11
"""Of ``onnx.TensorProto``."""


@dataclass(frozen=True)
class _Graph:
    """What becomes a file: a module, and the axis of each of its inputs and outputs that may have any length."""

    module: nn.Module
    inputs: Mapping[str, Tensor]
    """Examples."""
    outputs: tuple[str, ...]
    axis: str


class _FromOneWindow(nn.Module):
    def __init__(self, networks: WindowNetworks) -> None:
        super().__init__()
        self.networks = networks

    def forward(self, rssi_dbm: Float[Tensor, "chase sample 6"]) -> Float[Tensor, "chase 4 5"]:
        return self.networks.policy_logits(filled_window_dbm(rssi_dbm))


class _FromMemory(nn.Module):
    """Of a window without any sample nothing is remembered, as by ``controllers.learned``."""

    def __init__(self, networks: DecidingNetworks) -> None:
        super().__init__()
        self.networks = networks

    def forward(
        self,
        rssi_dbm: Float[Tensor, "chase sample 6"],
        tracker_position_m: Float[Tensor, "chase 6 3"],
        memory: Float[Tensor, "chase memory"],
    ) -> tuple[Float[Tensor, "chase 4 5"], Float[Tensor, "chase memory"]]:
        logits, following = self.networks.decide(rssi_dbm, tracker_position_m, memory)
        heard = rssi_dbm.isfinite().flatten(1).any(dim=1, keepdim=True)
        return logits, torch.where(heard, following, memory)


class _OfAllWindows(nn.Module):
    def __init__(self, networks: WindowsNetwork) -> None:
        super().__init__()
        self.networks = networks

    def forward(self, rssi_dbm: Float[Tensor, "window sample 6"]) -> tuple[Tensor, Tensor, Tensor]:
        heard = self.networks.heard(rssi_dbm)
        counts = rssi_dbm.isfinite().flatten(1).any(dim=1)
        chase = type(heard)(heard.own[None], heard.together[None])
        law = self.networks.law(chase, counts[None])
        return law.mean_db[0], law.apart_db[0], law.together_db[0]


class _OfPursuit(nn.Module):
    def __init__(self, network: PursuitNetwork) -> None:
        super().__init__()
        self.network = network

    def forward(
        self,
        rssi_dbm: Float[Tensor, "chase sample 6"],
        tracker_position_m: Float[Tensor, "chase 6 3"],
        center_m: Float[Tensor, "chase 3"],
        memory: Float[Tensor, "chase memory"],
    ) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor]:
        reading, following = self.network(rssi_dbm, tracker_position_m, center_m, memory)
        return reading.command, reading.way_m, reading.velocity_mps, reading.spread_m, following


def save_onnx(path: Path, networks: HearingNetworks, scenario: Scenario, document: dict[str, Any]) -> dict[str, Any]:
    """Write networks as they decide in this scenario, whole or not at all; gives what the file says of itself.

    Args:
        document: goes into the file's metadata as JSON, under ``swarmchase``, with the names of the inputs and outputs
            and the memory before the first window.

    Raises:
        InputError: onnx is not installed, or the file cannot be written.
    """
    try:
        import onnx
    except ImportError as error:
        raise InputError("the export needs onnx, which is not installed: pip install onnx") from error
    graph = _graph(networks.eval(), scenario)
    told = {
        **document,
        "inputs": list(graph.inputs),
        "outputs": list(graph.outputs),
        "initial_memory": networks.begin(scenario, 1)[0].tolist(),
    }
    with atomic_path(path) as temporary:
        _export(graph, temporary)
        model = onnx.load_model(temporary)
        model.metadata_props.add(key=METADATA_KEY, value=json.dumps(told))
        onnx.checker.check_model(model)
        onnx.save_model(model, temporary)
    return told


def _graph(networks: HearingNetworks, scenario: Scenario) -> _Graph:
    # With a gap: what is done about gaps is what the tracer sees. One of them: LSTM in ONNX wants no other example.
    rssi_dbm = torch.full((1, scenario.samples_a_decision, NUM_TRACKERS), -60.0)
    rssi_dbm[0, 0, 0] = math.nan
    memory = networks.begin(scenario, 1)
    if isinstance(networks, WindowNetworks):
        return _Graph(_FromOneWindow(networks), {"rssi_dbm": rssi_dbm}, ("logits",), "chase")
    if isinstance(networks, ExpectingNetwork):
        return _Graph(networks, {"rssi_dbm": rssi_dbm, "memory": memory}, ("expected_db",), "chase")
    if isinstance(networks, WindowsNetwork):
        law = ("mean_db", "apart_db", "together_db")
        return _Graph(_OfAllWindows(networks), {"rssi_dbm": rssi_dbm}, law, "window")
    place_m = torch.zeros(1, NUM_TRACKERS, 3)
    if isinstance(networks, PursuitNetwork):
        inputs = {
            "rssi_dbm": rssi_dbm,
            "tracker_position_m": place_m,
            "center_m": torch.zeros(1, 3),
            "memory": memory,
        }
        outputs = ("command", "way_m", "velocity_mps", "spread_m", "next_memory")
        return _Graph(_OfPursuit(networks), inputs, outputs, "chase")
    assert isinstance(networks, DecidingNetworks)
    inputs = {"rssi_dbm": rssi_dbm, "tracker_position_m": place_m, "memory": memory}
    return _Graph(_FromMemory(networks), inputs, ("logits", "next_memory"), "chase")


def _export(graph: _Graph, path: Path) -> None:
    for name, symbolic in _operators(graph.inputs["rssi_dbm"].shape[1]).items():
        torch.onnx.register_custom_op_symbolic(f"aten::{name}", symbolic, OPSET)  # type: ignore[attr-defined]
    with warnings.catch_warnings(), torch.inference_mode(False), torch.no_grad():
        # That the example decides whether there is a gap is meant; an LSTM's first state is as long as the batch; and
        # torch's other exporter, for which this one is deprecated, unrolls an LSTM.
        warnings.simplefilter("ignore", torch.jit.TracerWarning)  # type: ignore[attr-defined]
        warnings.filterwarnings("ignore", "Exporting a model to ONNX with a batch_size other than 1", UserWarning)
        warnings.simplefilter("ignore", DeprecationWarning)
        torch.onnx.export(
            graph.module,
            tuple(graph.inputs.values()),
            str(path),
            input_names=list(graph.inputs),
            output_names=list(graph.outputs),
            dynamic_axes={name: {0: graph.axis} for name in (*graph.inputs, *graph.outputs)},
            opset_version=OPSET,
            dynamo=False,
        )


def _nanmean(g: Any, values: Any, axes: Any, keepdim: Any, _dtype: Any) -> Any:
    valid = g.op("Not", g.op("IsNaN", values))
    wide = g.op("Cast", values, to_i=_DOUBLE)
    total = g.op("Where", valid, wide, g.op("Constant", value_t=torch.tensor(0.0, dtype=torch.float64)))
    number = g.op("Cast", valid, to_i=_DOUBLE)
    keeps = int(keepdim.node().t("value"))
    mean = g.op("Div", *(g.op("ReduceSum", part, axes, keepdims_i=keeps) for part in (total, number)))
    return g.op("Cast", mean, to_i=_FLOAT)


def _running(reduction: str, is_seen: Tensor, never: int) -> Callable[..., Any]:
    """The largest or smallest whole number so far along the last axis: ONNX has only sums of that kind."""

    def symbolic(g: Any, values: Any, _dim: Any) -> Any:
        others = g.op("Unsqueeze", values, g.op("Constant", value_t=torch.tensor([-2])))
        nothing = g.op("Constant", value_t=torch.tensor(never))
        extreme = g.op(
            reduction, g.op("Where", g.op("Constant", value_t=is_seen), others, nothing), axes_i=[-1], keepdims_i=0
        )
        return extreme, extreme  # nobody asks where it was

    return symbolic


def _operators(num_samples: int) -> dict[str, Callable[..., Any]]:
    """Of torch, which its exporter does not know, for windows of so many samples."""
    is_before = torch.ones(num_samples, num_samples, dtype=torch.bool).tril()
    return {
        "nanmean": _nanmean,
        "cummax": _running("ReduceMax", is_before, -1),
        "cummin": _running("ReduceMin", is_before, num_samples),
    }
