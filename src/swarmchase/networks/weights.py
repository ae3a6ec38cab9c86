"""Weights files: the networks as safetensors with the configuration that made them."""

from pathlib import Path
from typing import Any

import torch

from ..batch.tensor_files import load_tensors, save_tensors
from ..errors import InputError
from .actor_critic import SwarmNetworks
from .fading import FadingNetwork
from .gated import GatedNetwork

FiledNetworks = SwarmNetworks | GatedNetwork | FadingNetwork
"""What a weights file may hold."""

FORMAT = "swarmchase-networks-1"
"""Of the paper's four networks."""
_FORMS: dict[str, type[FiledNetworks]] = {
    FORMAT: SwarmNetworks,
    "swarmchase-gated-1": GatedNetwork,
    "swarmchase-fading-1": FadingNetwork,
}


def save_weights(
    path: Path,
    networks: FiledNetworks,
    configuration: dict[str, Any],
    dtype: torch.dtype = torch.float32,
) -> None:
    """Write the parameters in ``dtype`` with their configuration (scenario and training), whole or not at all."""
    tensors = {name: tensor.detach().to(dtype).clone() for name, tensor in networks.state_dict().items()}
    [form] = [name for name, network_form in _FORMS.items() if isinstance(networks, network_form)]
    save_tensors(path, tensors, {"format": form, **configuration})


def load_weights(path: Path) -> tuple[FiledNetworks, dict[str, Any]]:
    """The networks in float32 and the configuration that made them.

    Raises:
        InputError: no such file, damaged, or with parameters that are not those of the networks it names.
    """
    tensors, configuration = load_tensors(path, "weights file")
    form = configuration.get("format", "no known format")
    if form not in _FORMS:
        raise InputError(f"weights file {path} holds {form!r}, not {' or '.join(map(repr, _FORMS))}")
    networks = _FORMS[form]()
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
