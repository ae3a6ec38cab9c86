"""Weights files: the networks as safetensors with the configuration that made them."""

import functools
import hashlib
from pathlib import Path
from typing import Any

import torch

from ..batch.tensor_files import load_tensors, save_tensors
from ..errors import InputError
from .forms import FORMS
from .protocol import Form, HearingNetworks

MOST_SHARED = 16
"""Files of which ``shared_weights`` keeps the networks."""
_shared: dict[str | None, tuple[HearingNetworks, dict[str, Any]]] = {}
"""By the SHA-256 of their file."""


def save_weights(
    path: Path,
    networks: HearingNetworks,
    configuration: dict[str, Any],
    dtype: torch.dtype = torch.float32,
) -> None:
    """Write the parameters in ``dtype`` with their configuration (scenario and training), whole or not at all."""
    tensors = {name: tensor.detach().to(dtype).clone() for name, tensor in networks.state_dict().items()}
    form = FORMS[networks.form]
    assert isinstance(networks, form.filed)
    save_tensors(path, tensors, {"format": form.file_format, **configuration})


def load_weights(path: Path) -> tuple[HearingNetworks, dict[str, Any]]:
    """The networks in float32 and the configuration that made them.

    Raises:
        InputError: as ``checked_weights``.
    """
    form, tensors, configuration = checked_weights(path)
    networks: HearingNetworks = form.filed()
    networks.load_state_dict(tensors)
    return networks.eval(), configuration


def shared_weights(path: Path) -> tuple[HearingNetworks, dict[str, Any]]:
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


def checked_weights(path: Path) -> tuple[Form[Any, Any], dict[str, torch.Tensor], dict[str, Any]]:
    """The form of the networks in a file, their parameters in the file's own type, and the configuration that made
    them. No networks are built.

    Raises:
        InputError: no such file, damaged, or with parameters that are not those of the networks it names.
    """
    tensors, configuration = load_tensors(path, "weights file")
    file_format = configuration.get("format", "no known format")
    by_format = {form.file_format: form for form in FORMS.values()}
    if file_format not in by_format:
        raise InputError(f"weights file {path} holds {file_format!r}, not {' or '.join(map(repr, by_format))}")
    form = by_format[file_format]
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
    return form, tensors, configuration


@functools.cache
def _parameter_shapes(form: Form[Any, Any]) -> dict[str, tuple[int, ...]]:
    with torch.device("meta"):  # no memory, and no random numbers drawn
        return {name: tuple(tensor.shape) for name, tensor in form.filed().state_dict().items()}


def _content_sha256(path: Path) -> str | None:
    """None for what cannot be read; ``load_weights`` says why."""
    try:
        return hashlib.sha256(path.read_bytes()).hexdigest()
    except OSError:
        return None
