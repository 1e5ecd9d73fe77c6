"""The digest of a run: one value of all that physics published, tick by tick, so that equal digests are equal runs."""

from __future__ import annotations

import hashlib
import struct
from typing import Any

from gibson_sim.bags.digest_comparison import Tick, TickDigests
from gibson_sim.bags.stamps import header_stamp_ns

_SIZE = 16
"""Bytes of a run's digest."""


class RunDigest:
    """Collects messages of ``tick_digest`` in any order.

    Those of render nodes are left out: which images are drawn depends on subscribers and on the speed of the machine, and their pixels on
    the graphics driver.
    """

    def __init__(self) -> None:
        self._ticks: dict[Tick, tuple[int, tuple[tuple[str, int], ...]]] = {}
        """Stamp, and the digest of each topic, by tick of physics."""

    def add(self, msg: Any) -> None:
        """Adds a gibson_msgs/TickDigest."""
        found = TickDigests(header_stamp_ns(msg.header.stamp), tuple(msg.topics), msg.digests)
        if found.is_physics:
            values = tuple(sorted((topic, int(digest)) for topic, digest in found.values().items()))
            self._ticks[int(msg.epoch), int(msg.step)] = found.stamp_ns, values

    def hexdigest(self, end_ns: int) -> str:
        """Returns BLAKE2b of all ticks up to a stamp, ns, in their order; empty = there are none.

        Epochs count from the first one, so that a run after a reset equals one in a fresh simulation.
        """
        ticks = sorted(tick for tick, (stamp_ns, _) in self._ticks.items() if stamp_ns <= end_ns)
        if not ticks:
            return ""
        digest, first = hashlib.blake2b(digest_size=_SIZE), ticks[0][0]
        for epoch, step in ticks:
            values = self._ticks[epoch, step][1]
            digest.update(struct.pack("<IQI", epoch - first, step, len(values)))
            for topic, value in values:
                name = topic.encode()
                digest.update(struct.pack("<I", len(name)) + name + struct.pack("<Q", value))
        return digest.hexdigest()
