"""Batches of chases: pick some, put two batches together, take one apart for a file.

Works on any dataclass whose fields are tensors with the chase axis first, ``ChaseStreams``, such dataclasses again, or
None.
"""

import dataclasses
from collections.abc import Sequence
from typing import Any, TypeVar

import torch

from ..errors import InputError
from .streams import ChaseStreams

Batch = TypeVar("Batch")


def select_chases(batch: Batch, rows: Sequence[int]) -> Batch:
    """The chases in these rows, in this order."""
    value: Any = batch
    if value is None:
        return batch
    if isinstance(value, torch.Tensor):
        return value[torch.as_tensor(rows, dtype=torch.long, device=value.device)]  # type: ignore[return-value]
    if isinstance(value, ChaseStreams):
        return value.select(rows)  # type: ignore[return-value]
    return _rebuilt(value, {name: select_chases(part, rows) for name, part in _parts(value)})  # type: ignore[no-any-return]


def join_chases(first: Batch, second: Batch) -> Batch:
    """The chases of the first batch, then those of the second."""
    one: Any = first
    other: Any = second
    if one is None:
        return first
    if isinstance(one, torch.Tensor):
        return torch.cat([one, other])  # type: ignore[return-value]
    if isinstance(one, ChaseStreams):
        return one.followed_by(other)  # type: ignore[return-value]
    return _rebuilt(one, {name: join_chases(part, getattr(other, name)) for name, part in _parts(one)})  # type: ignore[no-any-return]


def pack(batch: Any, prefix: str) -> tuple[dict[str, torch.Tensor], dict[str, Any]]:
    """The tensors and the stream positions of a batch, by dotted name."""
    tensors: dict[str, torch.Tensor] = {}
    positions: dict[str, Any] = {}
    if isinstance(batch, torch.Tensor):
        tensors[prefix] = batch
    elif isinstance(batch, ChaseStreams):
        positions[prefix] = batch.positions()
    elif batch is not None:
        for part in dataclasses.fields(batch):
            part_tensors, part_positions = pack(getattr(batch, part.name), f"{prefix}.{part.name}")
            tensors |= part_tensors
            positions |= part_positions
    return tensors, positions


def unpack(like: Batch, prefix: str, tensors: dict[str, torch.Tensor], positions: dict[str, Any]) -> Batch:
    """The batch that ``pack`` took apart; ``like`` is any batch of the same form and length.

    Raises:
        InputError: a part is missing, or is not of the form of ``like``.
    """
    value: Any = like
    if value is None:
        return like
    try:
        if isinstance(value, torch.Tensor):
            return _like(value, tensors[prefix])  # type: ignore[return-value]
        if isinstance(value, ChaseStreams):
            return ChaseStreams.at(positions[prefix], len(value))  # type: ignore[return-value]
    except (LookupError, TypeError, ValueError, OverflowError) as error:
        raise InputError(
            f"resume state lacks {prefix}: it was written for another scenario or by another version"
        ) from error
    parts = {
        part.name: unpack(getattr(value, part.name), f"{prefix}.{part.name}", tensors, positions)
        for part in dataclasses.fields(value)
    }
    return dataclasses.replace(value, **parts)  # type: ignore[no-any-return]


def _like(value: torch.Tensor, tensor: torch.Tensor) -> torch.Tensor:
    if tensor.shape != value.shape or tensor.dtype != value.dtype:
        raise ValueError(f"{tuple(tensor.shape)} of {tensor.dtype}, needed {tuple(value.shape)} of {value.dtype}")
    return tensor.to(value.device)


def _parts(value: Any) -> list[tuple[str, Any]]:
    if not dataclasses.is_dataclass(value):
        raise TypeError(f"cannot batch a {type(value).__name__}: it is no tensor, no streams and no dataclass of them")
    return [(part.name, getattr(value, part.name)) for part in dataclasses.fields(value)]


def _rebuilt(value: Any, parts: dict[str, Any]) -> Any:
    return dataclasses.replace(value, **parts)
