"""The digest of a run: one hash of all messages that physics published, tick by tick. Equal digests mean equal runs."""

from __future__ import annotations

import hashlib
import struct
from typing import Any

from gibson_sim.bags.digest_comparison import Tick, TickDigests
from gibson_sim.bags.stamps import header_stamp_ns

_SIZE = 16
"""Size of a run's digest, bytes."""


class RunDigest:
    """Collects ``tick_digest`` messages in any order.

    Digests of render nodes are ignored: the set of rendered images depends on subscribers and machine speed, and their pixels depend on the
    graphics driver.
    """

    def __init__(self) -> None:
        self._ticks: dict[Tick, tuple[int, tuple[tuple[str, int], ...]]] = {}
        """Physics tick -> stamp, and the digest of each topic."""

    def add(self, msg: Any) -> None:
        """Adds a gibson_msgs/TickDigest."""
        digests = TickDigests(header_stamp_ns(msg.header.stamp), tuple(msg.topics), msg.digests)
        if digests.is_physics:
            values = tuple(sorted((topic, int(digest)) for topic, digest in digests.values().items()))
            self._ticks[int(msg.epoch), int(msg.step)] = digests.stamp_ns, values

    @property
    def stamps_ns(self) -> list[int]:
        """Stamps of all ticks, ns, in no particular order."""
        return [stamp_ns for stamp_ns, _ in self._ticks.values()]

    def hexdigest(self, end_ns: int) -> str:
        """Returns the BLAKE2b hash of all ticks up to a stamp, ns, in order; empty = no ticks.

        Epochs are counted from the first one, so that a run after a reset equals one in a fresh simulation.
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
