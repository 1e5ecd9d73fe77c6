"""Random numbers that depend on a seed, a name and a stamp alone, whatever else runs and in which order. Pure."""

from __future__ import annotations

from typing import Any

import numpy as np


class NoiseSource:
    """Draws of one sensor: equal seeds, name, stamp and purpose give equal bits."""

    def __init__(self, name: str, *seeds: int) -> None:
        """Makes the key.

        Args:
            name: Of the sensor, with that of its body, so that two of a kind differ.
            seeds: 0 to 2^63 - 1 each.
        """
        entropy = [*seeds, len(seeds), *name.encode()]
        self._key = np.random.SeedSequence(entropy).generate_state(2, np.uint64)
        self._bits = np.random.Philox(key=self._key)
        self._generator = np.random.Generator(self._bits)
        self._unused = np.zeros(4, dtype=np.uint64)

    def at(self, stamp_ns: int, purpose: int = 0) -> np.random.Generator:
        """Returns the numbers of one stamp and purpose, from their beginning; they end at the next call.

        Args:
            stamp_ns: 0 or more.
            purpose: Keeps draws apart, so that one setting does not change what another one does.
        """
        # Philox counts in 256 bits: the upper half says which numbers, the lower half runs through them.
        state: Any = {
            "bit_generator": "Philox",
            "state": {"counter": np.array([0, 0, purpose, stamp_ns], dtype=np.uint64), "key": self._key},
            "buffer": self._unused,
            "buffer_pos": 4,
            "has_uint32": 0,
            "uinteger": 0,
        }
        self._bits.state = state
        return self._generator
