"""Random streams of a trial. Each depends only on the seed and its names, so that adding a scene or a rule changes no other run."""

from __future__ import annotations

import hashlib

import numpy as np

_SEED_BYTES = 6
"""Size of the seed of a run, bytes: 2^48 is exact as a JSON number."""


def seed_of(seed: int, *names: str | int) -> int:
    """Returns a seed, 0 to 2^48 - 1, that depends only on the arguments."""
    return int.from_bytes(_digest(seed, *names)[:_SEED_BYTES], "little")


def stream(seed: int, *names: str | int) -> np.random.Generator:
    """Returns a random stream that depends only on the arguments."""
    return np.random.Generator(np.random.PCG64(int.from_bytes(_digest(seed, *names)[:16], "little")))


def _digest(seed: int, *names: str | int) -> bytes:
    return hashlib.sha256("\0".join(map(str, (seed, *names))).encode("utf-8", errors="surrogateescape")).digest()
