"""Weights files: the networks as safetensors with the configuration that made them."""

import functools
import hashlib
from pathlib import Path
from typing import Any

import torch

from ..batch.tensor_files import parsed_tensors, save_tensors
from ..errors import InputError
from ..ranges import MOST_SHOWN_CHARACTERS, shown
from ..reading import read_bytes, read_unpacked
from .forms import FORMS
from .protocol import Form, HearingNetworks

MOST_SHARED = 16
"""Files of which ``shared_weights`` keeps the networks."""
MOST_FILE_BYTES = 64 * 2**20
"""Twenty times the largest that comes with the package."""
_shared: dict[str, tuple[HearingNetworks, dict[str, Any]]] = {}
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


def read_weights(path: Path) -> bytes:
    """The content of a weights file, whatever it is; a wheel holds its own packed (``.xz``).

    Raises:
        InputError: no such file, or longer than one can be.
    """
    read = read_unpacked if path.suffix == ".xz" else read_bytes
    return read(path, "weights file", MOST_FILE_BYTES)


def load_weights(path: Path) -> tuple[HearingNetworks, dict[str, Any]]:
    """The networks in float32 and the configuration that made them.

    Raises:
        InputError: as ``checked_weights``.
    """
    return _networks(path, read_weights(path))


def shared_weights(path: Path) -> tuple[HearingNetworks, dict[str, Any]]:
    """What ``load_weights`` gives, made once in a process of files with the same content. It is not to be changed.

    Raises:
        InputError: as ``checked_weights``.
    """
    content = read_weights(path)
    sha256 = hashlib.sha256(content).hexdigest()
    if sha256 not in _shared:
        loaded = _networks(path, content)
        if len(_shared) >= MOST_SHARED:
            del _shared[next(iter(_shared))]
        _shared[sha256] = loaded
    return _shared[sha256]


def checked_weights(path: Path) -> tuple[Form[Any, Any], dict[str, torch.Tensor], dict[str, Any]]:
    """The form of the networks in a file, their parameters in the file's own type, and the configuration that made
    them. No networks are built.

    Raises:
        InputError: no such file, damaged, or with parameters that are not those of the networks it names.
    """
    return _checked(path, read_weights(path))


def _networks(path: Path, content: bytes) -> tuple[HearingNetworks, dict[str, Any]]:
    form, tensors, configuration = _checked(path, content)
    networks: HearingNetworks = form.filed()
    networks.load_state_dict(tensors)
    return networks.eval(), configuration


def _checked(path: Path, content: bytes) -> tuple[Form[Any, Any], dict[str, torch.Tensor], dict[str, Any]]:
    tensors, configuration = parsed_tensors(content, path, "weights file")
    file_format = configuration.get("format", "no known format")
    by_format = {form.file_format: form for form in FORMS.values()}
    if not isinstance(file_format, str) or file_format not in by_format:
        raise InputError(f"weights file {path} holds {shown(file_format)}, not {' or '.join(map(repr, by_format))}")
    form = by_format[file_format]
    expected = _parameter_shapes(form)
    found = {name: tuple(tensor.shape) for name, tensor in tensors.items()}
    if found != expected:
        name = sorted(set(expected.items()) ^ set(found.items()))[0][0]
        raise InputError(
            f"weights file {path} does not match the networks: {name[:MOST_SHOWN_CHARACTERS]} is "
            f"{found.get(name, 'missing')}, needed is {expected.get(name, 'no such parameter')}"
        )
    if not all(tensor.is_floating_point() for tensor in tensors.values()):
        raise InputError(f"weights file {path} holds parameters that are no floating-point numbers")
    if not all(tensor.float().isfinite().all() for tensor in tensors.values()):
        raise InputError(f"weights file {path} holds numbers that are not finite")
    return form, tensors, configuration


@functools.cache
def _parameter_shapes(form: Form[Any, Any]) -> dict[str, tuple[int, ...]]:
    with torch.device("meta"):  # no memory, and no random numbers drawn
        return {name: tuple(tensor.shape) for name, tensor in form.filed().state_dict().items()}
