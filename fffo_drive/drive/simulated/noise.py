"""Random numbers of the plant: xoshiro128++ (Blackman and Vigna, 2019) in int64 words.

All arithmetic stays below 2**63 with 32-bit words, so compiled and interpreted code give the same bits. The
state is part of the plant's state: the same seed gives the same run, and a copied state continues identically.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ...jit import njit

Words = np.ndarray[Any, np.dtype[np.int64]]

RANDOM_WORDS = 4  # words of generator state, at the start of the plant's `words`
_MASK = 0xFFFFFFFF
_HALF = 0xFFFF
# four uniform 16-bit numbers: mean 4 * 65535 / 2, variance 4 * (65536**2 - 1) / 12
_MEAN = 2.0 * 65535.0
_PER_DEVIATION = 1.0 / (((65536.0 * 65536.0 - 1.0) / 3.0) ** 0.5)


def seed_words(seed: int) -> tuple[int, int, int, int]:
    """Generator state of a seed (any int), by splitmix64. Never all zero."""
    state = seed & 0xFFFFFFFFFFFFFFFF
    words: list[int] = []
    for _ in range(2):
        state = (state + 0x9E3779B97F4A7C15) & 0xFFFFFFFFFFFFFFFF
        z = state
        z = ((z ^ (z >> 30)) * 0xBF58476D1CE4E5B9) & 0xFFFFFFFFFFFFFFFF
        z = ((z ^ (z >> 27)) * 0x94D049BB133111EB) & 0xFFFFFFFFFFFFFFFF
        z ^= z >> 31
        words += [z & _MASK, z >> 32]
    return words[0], words[1], words[2], words[3] | 1


@njit
def random_word(words: Words) -> int:
    """The next 32 random bits; moves words[0:4] on."""
    s0, s1, s2, s3 = int(words[0]), int(words[1]), int(words[2]), int(words[3])
    total = (s0 + s3) & _MASK
    result = ((((total << 7) & _MASK) | (total >> 25)) + s0) & _MASK
    shifted = (s1 << 9) & _MASK
    s2 ^= s0
    s3 ^= s1
    s1 ^= s2
    s0 ^= s3
    s2 ^= shifted
    s3 = ((s3 << 11) & _MASK) | (s3 >> 21)
    words[0], words[1], words[2], words[3] = s0, s1, s2, s3
    return result


@njit
def random_normal(words: Words) -> float:
    """Mean 0, variance 1, nearly normal: the sum of four uniform numbers, so never beyond 3.47."""
    a = random_word(words)
    b = random_word(words)
    total = (a & _HALF) + (a >> 16) + (b & _HALF) + (b >> 16)
    return (total - _MEAN) * _PER_DEVIATION
