"""Weights files: the networks as safetensors with the configuration that made them."""

import functools
import hashlib
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

MOST_SHARED = 16
"""Files of which ``shared_weights`` keeps the networks."""
_shared: dict[str | None, tuple[FiledNetworks, dict[str, Any]]] = {}
"""By the SHA-256 of their file."""


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
        InputError: as ``checked_weights``.
    """
    form, tensors, configuration = checked_weights(path)
    networks = form()
    networks.load_state_dict(tensors)
    return networks.eval(), configuration


def shared_weights(path: Path) -> tuple[FiledNetworks, dict[str, Any]]:
    """What ``load_weights`` gives, made once in a process of files with the same content. It is not to be changed.

    Raises:
        InputError: as ``checked_weights``.
    """
    sha256 = _content_sha256(path)
    if sha256 in _shared:
        return _shared[sha256]
    loaded = load_weights(path)
    if sha256 is not None and sha256 == _content_sha256(path):  # else the file was replaced while it was read
        if len(_shared) >= MOST_SHARED:
            del _shared[next(iter(_shared))]
        _shared[sha256] = loaded
    return loaded


def checked_weights(path: Path) -> tuple[type[FiledNetworks], dict[str, torch.Tensor], dict[str, Any]]:
    """The form of the networks in a file, their parameters in the file's own type, and the configuration that made
    them. No networks are built.

    Raises:
        InputError: no such file, damaged, or with parameters that are not those of the networks it names.
    """
    tensors, configuration = load_tensors(path, "weights file")
    form = configuration.get("format", "no known format")
    if form not in _FORMS:
        raise InputError(f"weights file {path} holds {form!r}, not {' or '.join(map(repr, _FORMS))}")
    expected = _parameter_shapes(form)
    found = {name: tuple(tensor.shape) for name, tensor in tensors.items()}
    if found != expected:
        name = sorted(set(expected.items()) ^ set(found.items()))[0][0]
        raise InputError(
            f"weights file {path} does not match the networks: {name} is {found.get(name, 'missing')}, "
            f"needed is {expected.get(name, 'no such parameter')}"
        )
    if not all(tensor.isfinite().all() for tensor in tensors.values()):
        raise InputError(f"weights file {path} holds numbers that are not finite")
    return _FORMS[form], tensors, configuration


@functools.cache
def _parameter_shapes(form: str) -> dict[str, tuple[int, ...]]:
    with torch.device("meta"):  # no memory, and no random numbers drawn
        return {name: tuple(tensor.shape) for name, tensor in _FORMS[form]().state_dict().items()}


def _content_sha256(path: Path) -> str | None:
    """None for what cannot be read; ``load_weights`` says why."""
    try:
        return hashlib.sha256(path.read_bytes()).hexdigest()
    except OSError:
        return None
