"""Randomness, one stream a chase.

A chase is named by its key: the seed of the run and its number in the run. All of its random numbers come from
streams derived from that key and a purpose, so that a chase is the same alone, in any batch and in any process, and a
controller's draws never disturb the world's. Nothing here reads or sets a global generator.
"""

import math
from collections.abc import Sequence
from typing import Any, Literal

import numpy as np
import torch

from ..ranges import AT_LEAST_ZERO, checked_number
from .array_types import Float, Tensor
from .seed_words import SeedWords, seed_words

ChaseKey = tuple[int, int]
"""(seed of the run, number of the chase in the run)."""

Purpose = Literal[
    "target", "fading", "policy", "receivers", "world", "transit", "behaviour", "shadowing", "transmissions"
]
_PURPOSES: tuple[Purpose, ...] = (
    "target",
    "fading",
    "policy",
    "receivers",
    "world",
    "transit",
    "behaviour",
    "shadowing",
    "transmissions",
)

_SFC64_WORDS = 3
"""That the bit generator asks of its seed sequence."""
_MANY_CHASES = 32
"""Of fewer, numpy's seed sequences are as soon made one by one."""
_CHASES_AT_ONCE = 128
"""Chases whose normals are made together: few enough for the arrays in between to stay in the L2 cache."""


def chase_keys(seed: int, num_chases: int, first_chase: int = 0) -> list[ChaseKey]:
    """The keys of ``num_chases`` chases of the run ``seed``, counted from ``first_chase``."""
    checked_number("seed", seed, AT_LEAST_ZERO)
    return [(seed, chase) for chase in range(first_chase, first_chase + num_chases)]


class ChaseStreams:
    """One random stream for each chase of a batch. Drawing advances the streams in place."""

    def __init__(self, generators: Sequence[np.random.Generator]) -> None:
        self._generators = list(generators)

    @classmethod
    def of(cls, keys: Sequence[ChaseKey], purpose: Purpose) -> "ChaseStreams":
        """The streams of these chases for one purpose, at their beginning."""
        beginnings = _beginnings(keys, _PURPOSES.index(purpose))
        return cls([np.random.Generator(np.random.SFC64(beginning)) for beginning in beginnings])

    def __len__(self) -> int:
        return len(self._generators)

    def standard_normal(self, *shape: int) -> Float[Tensor, "chase ..."]:
        """Float32 normals of shape [chase, *shape].

        Every chase gives raw bits, and one Box-Muller transform makes normals of them for many chases at once: half the
        time of asking each generator for its normals, which is most of what a fading window costs.
        """
        num_chases, num_normals = len(self._generators), math.prod(shape)
        num_pairs = (num_normals + 1) // 2
        normals = np.empty((num_chases, 2, num_pairs), dtype=np.float32)
        for first in range(0, num_chases, _CHASES_AT_ONCE):
            rows = slice(first, first + _CHASES_AT_ONCE)
            words = np.concatenate([one.bit_generator.random_raw(num_pairs) for one in self._generators[rows]])
            _box_muller(words.view(np.uint32).reshape(-1, 2, num_pairs), out=normals[rows])
        flat = normals.reshape(num_chases, 2 * num_pairs)[:, :num_normals]
        return torch.from_numpy(flat.reshape(num_chases, *shape))

    def uniform(self, *shape: int) -> Float[Tensor, "chase ..."]:
        """Float64 numbers in [0, 1) of shape [chase, *shape]."""
        values = np.empty((len(self._generators), *shape))
        for row, generator in zip(values, self._generators, strict=True):
            generator.random(out=row)
        return torch.from_numpy(values)

    def select(self, rows: Sequence[int]) -> "ChaseStreams":
        """The streams of some chases of the batch; they go on where they are."""
        return ChaseStreams([self._generators[row] for row in rows])

    def followed_by(self, others: "ChaseStreams") -> "ChaseStreams":
        """This batch's streams and then the others'."""
        return ChaseStreams([*self._generators, *others._generators])

    def positions(self) -> list[dict[str, Any]]:
        """Where each stream stands, as JSON can hold it."""
        return [_jsonable(generator.bit_generator.state) for generator in self._generators]

    @classmethod
    def at(cls, positions: Sequence[dict[str, Any]], num_chases: int) -> "ChaseStreams":
        """Streams that go on where ``positions`` said.

        Raises:
            LookupError, TypeError, ValueError, OverflowError: these are no positions of so many streams.
        """
        if len(positions) != num_chases:
            raise ValueError(f"{len(positions)} streams, needed {num_chases}")
        generators = []
        for position in positions:
            bit_generator = np.random.SFC64(0)
            state: Any = {**position, "state": {"state": np.array(position["state"]["state"], dtype=np.uint64)}}
            bit_generator.state = state
            generators.append(np.random.Generator(bit_generator))
        return cls(generators)


def _beginnings(keys: Sequence[ChaseKey], purpose: int) -> list[Any]:
    """numpy's seed sequence of each key; many of one run are made together, in a fifth of the time."""
    seed, chases = keys[0][0] if keys else 0, [chase for _, chase in keys]
    if len(keys) < _MANY_CHASES or seed >> 128 or max(chases) >> 32 or any(own != seed for own, _ in keys):
        return [np.random.SeedSequence(own, spawn_key=(purpose, chase)) for own, chase in keys]
    return [SeedWords(words) for words in seed_words(seed, purpose, chases, _SFC64_WORDS)]


def _jsonable(state: Any) -> dict[str, Any]:
    return {**state, "state": {"state": [int(word) for word in state["state"]["state"]]}}


def _box_muller(
    bits: "np.ndarray[tuple[int, int, int], np.dtype[np.uint32]]",
    out: "np.ndarray[tuple[int, int, int], np.dtype[np.float32]]",
) -> None:
    """Normals [row, 2, pair] from random bits [row, 2, pair]: radius sqrt(-2 ln u), u in (0, 1], and angle 2 pi v.

    The arrays in between are contiguous, so that numpy computes every element in the same way whatever the batch.
    """
    radius = bits[:, 0].astype(np.float32)
    radius += np.float32(0.5)
    radius *= np.float32(2**-32)
    np.log(radius, out=radius)
    radius *= np.float32(-2)
    np.sqrt(radius, out=radius)
    angle_rad = bits[:, 1].astype(np.float32)
    angle_rad *= np.float32(2 * np.pi * 2**-32)
    np.multiply(radius, np.cos(angle_rad), out=out[:, 0])
    np.multiply(radius, np.sin(angle_rad), out=out[:, 1])
