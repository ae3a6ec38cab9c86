"""Weights files: the four networks as safetensors with the configuration that made them."""

from pathlib import Path
from typing import Any

import torch

from ..errors import InputError
from ..networks import SwarmNetworks
from ..tensor_files import load_tensors, save_tensors

FORMAT = "swarmchase-networks-1"


def save_weights(
    path: Path, networks: SwarmNetworks, configuration: dict[str, Any], dtype: torch.dtype = torch.float32
) -> None:
    """Write the parameters in ``dtype`` with their configuration (scenario and training), whole or not at all."""
    tensors = {name: tensor.detach().to(dtype).clone() for name, tensor in networks.state_dict().items()}
    save_tensors(path, tensors, {"format": FORMAT, **configuration})


def load_weights(path: Path) -> tuple[SwarmNetworks, dict[str, Any]]:
    """The networks in float32 and the configuration that made them.

    Raises:
        InputError: no such file, damaged, or with parameters that are not those of the four networks.
    """
    tensors, configuration = load_tensors(path, "weights file")
    if configuration.get("format") != FORMAT:
        raise InputError(
            f"weights file {path} holds {configuration.get('format', 'no known format')!r}, not {FORMAT!r}"
        )
    networks = SwarmNetworks()
    expected = {name: tuple(tensor.shape) for name, tensor in networks.state_dict().items()}
    found = {name: tuple(tensor.shape) for name, tensor in tensors.items()}
    if found != expected:
        name = sorted(set(expected.items()) ^ set(found.items()))[0][0]
        raise InputError(
            f"weights file {path} does not match the networks: {name} is {found.get(name, 'missing')}, "
            f"needed is {expected.get(name, 'no such parameter')}"
        )
    if not all(tensor.isfinite().all() for tensor in tensors.values()):
        raise InputError(f"weights file {path} holds numbers that are not finite")
    networks.load_state_dict(tensors)
    return networks.eval(), configuration
