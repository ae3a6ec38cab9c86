"""``numpy.random.SeedSequence`` for many streams at once: what it makes of (seed, spawn key), word by word the same.

It takes most of the time of beginning a stream, and a law of fading begins twenty thousand. The algorithm is O'Neill's
(https://www.pcg-random.org/posts/developing-a-seed_seq-alternative.html), which numpy promises not to change.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

POOL_WORDS = 4
_INIT_A, _MULT_A = 0x43B0D7E5, 0x931E8875
_INIT_B, _MULT_B = 0x8B51F9DD, 0x58F38DED
_MIX_LEFT, _MIX_RIGHT = np.uint32(0xCA01F9DD), np.uint32(0x4973F715)
_HALF_WORD = np.uint32(16)

Words = NDArray[np.uint32]


class SeedWords(np.random.bit_generator.ISeedSequence):
    """The words that a bit generator asks for when it begins."""

    def __init__(self, words: "NDArray[np.uint64]") -> None:
        self._words = words

    def generate_state(self, n_words: int, dtype: object = np.uint64) -> "NDArray[np.uint64]":
        """All of them; a generator that wants others is not what they were made for."""
        if n_words != len(self._words) or dtype != np.uint64:
            raise ValueError(f"{len(self._words)} words of 64 bits were made, {n_words} of {dtype} are wanted")
        return self._words


def seed_words(seed: int, purpose: int, numbers: Sequence[int], count: int) -> "NDArray[np.uint64]":
    """``SeedSequence(seed, spawn_key=(purpose, number)).generate_state(count, np.uint64)`` of each number.

    Args:
        seed: below 2^128.
        purpose, numbers: below 2^32.

    Returns:
        [number, count].
    """
    seeds = [seed >> 32 * place & 0xFFFFFFFF for place in range(POOL_WORDS)]
    entropy: list[Words] = [np.full(len(numbers), word, np.uint32) for word in (*seeds, purpose)]
    pool = _mixed([*entropy, np.array(numbers, dtype=np.uint32)])
    drawn = np.empty((len(numbers), 2 * count), dtype=np.uint32)
    hashing = _Hash(_INIT_B, _MULT_B)
    for place in range(2 * count):
        drawn[:, place] = hashing(pool[place % POOL_WORDS])
    return drawn.astype("<u4").view("<u8").astype(np.uint64)


class _Hash:
    """Its constant goes on with every word."""

    def __init__(self, first: int, factor: int) -> None:
        self._constant, self._factor = first, factor

    def __call__(self, word: Words) -> Words:
        mixed = word ^ np.uint32(self._constant)
        self._constant = self._constant * self._factor & 0xFFFFFFFF
        mixed *= np.uint32(self._constant)
        return mixed ^ (mixed >> _HALF_WORD)


def _mixed(entropy: Sequence[Words]) -> list[Words]:
    """The pool after all entropy has gone in."""
    hashing = _Hash(_INIT_A, _MULT_A)
    pool = [hashing(word) for word in entropy[:POOL_WORDS]]
    for source in range(POOL_WORDS):
        for place in range(POOL_WORDS):
            if source != place:
                pool[place] = _mix(pool[place], hashing(pool[source]))
    for word in entropy[POOL_WORDS:]:
        pool = [_mix(mine, hashing(word)) for mine in pool]
    return pool


def _mix(one: Words, other: Words) -> Words:
    mixed: Words = _MIX_LEFT * one - _MIX_RIGHT * other
    return mixed ^ (mixed >> _HALF_WORD)
