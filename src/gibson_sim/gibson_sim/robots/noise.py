"""Random numbers that depend only on seeds, a name and a stamp, whatever else runs and in which order. Pure."""

from __future__ import annotations

from typing import Any

import numpy as np


class NoiseSource:
    """Random numbers of one sensor: equal seeds, name, stamp and purpose give equal bits."""

    def __init__(self, name: str, *seeds: int) -> None:
        """Makes the key.

        Args:
            name: Name of the sensor, with that of its body, so that two of a kind differ.
            seeds: 0 to 2^63 - 1 each.
        """
        entropy = [*seeds, len(seeds), *name.encode()]
        self._key = np.random.SeedSequence(entropy).generate_state(2, np.uint64)
        self._bits = np.random.Philox(key=self._key)
        self._generator = np.random.Generator(self._bits)
        self._unused = np.zeros(4, dtype=np.uint64)

    def at(self, stamp_ns: int, purpose: int = 0) -> np.random.Generator:
        """Returns the numbers of one stamp and purpose, from their beginning; the generator is valid until the next call.

        Args:
            stamp_ns: 0 or more.
            purpose: Separates independent sequences, so that one setting does not change the noise of another.
        """
        # Philox has a counter of 256 bits: the upper half selects the sequence, the lower half runs through it.
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
