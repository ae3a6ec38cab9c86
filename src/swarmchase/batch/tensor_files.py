"""Tensors with a JSON document in one safetensors file. Nothing is unpickled."""

import json
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file

from ..errors import InputError
from ..files import atomic_path

_DOCUMENT_KEY = "swarmchase"


def save_tensors(path: Path, tensors: dict[str, torch.Tensor], document: dict[str, Any]) -> None:
    """Write tensors with a JSON document beside them, whole or not at all.

    Raises:
        InputError: it cannot be written there, or the disk is full.
    """
    contiguous = {name: tensor.contiguous() for name, tensor in tensors.items()}
    with atomic_path(path) as temporary:
        try:
            save_file(contiguous, temporary, {_DOCUMENT_KEY: json.dumps(document)})
        except SafetensorError as error:
            raise InputError(f"cannot write {path}: {error}") from error


def load_tensors(path: Path, kind: str) -> tuple[dict[str, torch.Tensor], dict[str, Any]]:
    """Read what ``save_tensors`` wrote; ``kind`` names the file in refusals.

    Raises:
        InputError: no such file, damaged, or of another making.
    """
    try:
        with safe_open(path, framework="pt") as file:
            document = json.loads((file.metadata() or {})[_DOCUMENT_KEY])
            if not isinstance(document, dict):
                raise KeyError(_DOCUMENT_KEY)
            return {name: file.get_tensor(name) for name in file.keys()}, document  # noqa: SIM118 (safe_open is no mapping)
    except OSError as error:
        raise InputError(f"cannot read {kind} {path}: {error.strerror or error}") from error
    except (SafetensorError, KeyError, json.JSONDecodeError, UnicodeDecodeError) as error:
        raise InputError(
            f"{kind} {path} is damaged or was not written by swarmchase ({type(error).__name__})"
        ) from error
