"""Counter-based random numbers that depend only on seeds, a name and a stamp, not on the order of calls. Pure."""

from __future__ import annotations

from typing import Any

import numpy as np


class NoiseSource:
    """Random numbers of one sensor: equal seeds, name, stamp and purpose give equal bits."""

    def __init__(self, name: str, *seeds: int) -> None:
        """Computes the key.

        Args:
            name: Name of the sensor, with that of its body, so that equal sensors differ.
            seeds: Seeds, each 0 to 2^63 - 1.
        """
        entropy = [*seeds, len(seeds), *name.encode()]
        self._key = np.random.SeedSequence(entropy).generate_state(2, np.uint64)
        self._bits = np.random.Philox(key=self._key)
        self._generator = np.random.Generator(self._bits)
        self._unused = np.zeros(4, dtype=np.uint64)

    def at(self, stamp_ns: int, purpose: int = 0) -> np.random.Generator:
        """Returns a generator at the start of the sequence of a stamp and purpose; valid until the next call.

        Args:
            stamp_ns: Stamp, ns, 0 or more.
            purpose: Number of an independent sequence, so that one setting does not change the noise of another.
        """
        # Philox has a 256-bit counter: the upper half selects the sequence, the lower half counts within it.
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
