"""A small tf buffer: the tree of frames, and transforms interpolated in time. Independent of ROS."""

from __future__ import annotations

from bisect import bisect_left
from collections import deque
from typing import NamedTuple

import numpy as np

from gibson_examples.errors import TransformError, TransformNotYetError
from gibson_examples.geometry import F64, invert, matrix_from

NS_PER_S = 1_000_000_000
_MAX_CHAIN = 64


class _Sample(NamedTuple):
    stamp_ns: int
    translation: tuple[float, float, float]
    quat_xyzw: tuple[float, float, float, float]


class TransformBuffer:
    """Keeps transforms of the last ``seconds``; a stamp that jumps back (the simulation was reset) discards all later ones."""

    def __init__(self, seconds: float = 10.0) -> None:
        self._keep_ns = int(seconds * NS_PER_S)
        self._parents: dict[str, str] = {}
        self._static: dict[str, F64] = {}
        self._moving: dict[str, deque[_Sample]] = {}

    def set_static(
        self, parent: str, child: str, translation: tuple[float, float, float], quat_xyzw: tuple[float, float, float, float]
    ) -> None:
        """Sets a constant transform T_parent_child (metres, unit quaternion)."""
        self._parents[child] = parent
        self._static[child] = matrix_from(translation, quat_xyzw)

    def add(
        self,
        stamp_ns: int,
        parent: str,
        child: str,
        translation: tuple[float, float, float],
        quat_xyzw: tuple[float, float, float, float],
    ) -> None:
        """Adds T_parent_child at a time."""
        self._parents[child] = parent
        samples = self._moving.setdefault(child, deque())
        while samples and samples[-1].stamp_ns >= stamp_ns:
            samples.pop()
        samples.append(_Sample(stamp_ns, translation, quat_xyzw))
        while samples[0].stamp_ns < stamp_ns - self._keep_ns:
            samples.popleft()

    def forget_moving(self) -> None:
        """Discards all transforms but constant ones."""
        for child in self._moving:
            del self._parents[child]
        self._moving.clear()

    def newest_ns(self, child: str) -> int | None:
        """Returns the stamp of the newest transform of ``child``; None if it has none, or a constant one."""
        samples = self._moving.get(child)
        return samples[-1].stamp_ns if samples else None

    def lookup(self, target: str, source: str, stamp_ns: int | None = None) -> F64:
        """Returns T_target_source, (4, 4), at a time; None = the newest transform of each link of the chain.

        Raises:
            TransformNotYetError: a link of the chain is unknown, or has not reached this time.
            TransformError: this time is no longer in the buffer.
        """
        up_source, up_target = self._chain(source), self._chain(target)
        common = next((frame for frame in up_source if frame in up_target), None)
        if common is None:
            raise TransformNotYetError(
                f"tf: {source!r} and {target!r} are not connected; the frames above {source!r}: {' <- '.join(reversed(up_source))}"
            )
        return invert(self._product(up_target, common, stamp_ns)) @ self._product(up_source, common, stamp_ns)

    def _chain(self, frame: str) -> list[str]:
        """Returns the frame, its parent, and so on up to the root."""
        chain = [frame]
        while (parent := self._parents.get(chain[-1])) is not None:
            chain.append(parent)
            if len(chain) > _MAX_CHAIN:
                raise TransformError(f"tf: the frames above {frame!r} form a loop: {' <- '.join(chain[:6])} ...")
        return chain

    def _product(self, chain: list[str], ancestor: str, stamp_ns: int | None) -> F64:
        """Returns T_ancestor_frame, (4, 4), for the first frame of the chain."""
        matrix = np.eye(4)
        for frame in chain[: chain.index(ancestor)]:
            matrix = self._link(frame, stamp_ns) @ matrix
        return matrix

    def _link(self, child: str, stamp_ns: int | None) -> F64:
        """Returns T_parent_child, (4, 4)."""
        if child in self._static:
            return self._static[child]
        samples = self._moving[child]
        if stamp_ns is None:
            stamp_ns = samples[-1].stamp_ns
        after = bisect_left(samples, stamp_ns, key=lambda sample: sample.stamp_ns)
        if after == len(samples):
            raise TransformNotYetError(
                f"tf: {child!r} is known up to {samples[-1].stamp_ns / NS_PER_S:.3f} s, requested at {stamp_ns / NS_PER_S:.3f} s"
            )
        b = samples[after]
        if b.stamp_ns == stamp_ns:
            return matrix_from(b.translation, b.quat_xyzw)
        if after == 0:
            raise TransformError(
                f"tf: {child!r} is known from {b.stamp_ns / NS_PER_S:.3f} s on, requested at {stamp_ns / NS_PER_S:.3f} s"
            )
        return _between(samples[after - 1], b, stamp_ns)


def _between(a: _Sample, b: _Sample, stamp_ns: int) -> F64:
    """Interpolates between two samples: linearly, with normalised quaternions."""
    fraction = (stamp_ns - a.stamp_ns) / (b.stamp_ns - a.stamp_ns)
    first, last = np.array(a.quat_xyzw), np.array(b.quat_xyzw)
    if first @ last < 0:
        last = -last
    quat = (1 - fraction) * first + fraction * last
    translation = (1 - fraction) * np.array(a.translation) + fraction * np.array(b.translation)
    return matrix_from(translation, quat / np.linalg.norm(quat))
