"""Tensors with a JSON document in one safetensors file. Nothing is unpickled."""

import json
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError
from safetensors.torch import load, save_file

from ..errors import InputError
from ..files import atomic_path
from ..ranges import shown
from ..reading import Bounds, DocumentError, parsed_json, read_bytes

_DOCUMENT_KEY = "swarmchase"
_DTYPES = frozenset({torch.float16, torch.bfloat16, torch.float32, torch.float64, torch.int64, torch.bool})
HEADER_BOUNDS = Bounds(most_bytes=100_000_000, most_values=2**23, is_finite=False)
"""The bytes are safetensors' own limit. A resume file of 400 agents with 64 chases each has a million values: where
each of their random streams stands."""


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


def load_tensors(path: Path, kind: str, most_bytes: int) -> tuple[dict[str, torch.Tensor], dict[str, Any]]:
    """Read what ``save_tensors`` wrote; ``kind`` names the file in refusals.

    Raises:
        InputError: no such file, too long, damaged, or of another making.
    """
    return parsed_tensors(read_bytes(path, kind, most_bytes), path, kind)


def parsed_tensors(content: bytes, path: Path, kind: str) -> tuple[dict[str, torch.Tensor], dict[str, Any]]:
    """The tensors and the document in the content of a file.

    Raises:
        InputError: damaged, of another making, or with tensors of types that ``save_tensors`` never writes.
    """
    try:
        document = _document(content)
        tensors = load(content)
    except (SafetensorError, DocumentError, KeyError, TypeError, ValueError, RuntimeError, AssertionError) as error:
        raise InputError(
            f"{kind} {path} is damaged or was not written by swarmchase ({type(error).__name__})"
        ) from error
    strange = [name for name, tensor in tensors.items() if tensor.dtype not in _DTYPES]
    if strange:
        dtype = tensors[strange[0]].dtype
        raise InputError(f"{kind} {path} holds {shown(strange[0])} as {dtype}, in which swarmchase writes nothing")
    return tensors, document


def _document(content: bytes) -> dict[str, Any]:
    """What lies beside the tensors: text in the metadata of the header, which safetensors reads from named files alone.

    The header is 8 bytes that say how long it is, and so much JSON (https://huggingface.co/docs/safetensors, Format).

    Raises:
        DocumentError, KeyError, TypeError: there is no such document.
    """
    header = parsed_json(content[8 : 8 + int.from_bytes(content[:8], "little")], HEADER_BOUNDS)
    document = parsed_json(header["__metadata__"][_DOCUMENT_KEY], HEADER_BOUNDS)
    if not isinstance(document, dict):
        raise KeyError(_DOCUMENT_KEY)
    return document
