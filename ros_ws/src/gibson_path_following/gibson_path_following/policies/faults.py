"""Fault injection for a camera: a covered lens, dropped and delayed images, to test how a follower reacts."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import Generic, TypeVar

from gibson_path_following.errors import check_ranges
from gibson_path_following.localisation.motions import NS_PER_S

_Image = TypeVar("_Image")


@dataclass(frozen=True, slots=True)
class FaultSettings:
    """Faults to inject."""

    cover_after: float = 0.0
    """Time from the first motion until the lens is covered, seconds."""
    cover: float = 0.0
    """Duration of the cover, seconds; 0 = never."""
    drop: float = 0.0
    """Share of the images that are dropped, evenly spread: 0.5 = every other one."""
    delay: float = 0.0
    """Delay of the images, seconds, by their stamps."""

    def __post_init__(self) -> None:
        check_ranges(
            self, ("cover_after", 0.0, 3600.0), ("cover", 0.0, 3600.0), ("drop", 0.0, 1.0), ("delay", 0.0, 60.0)
        )  # fmt: skip


class CameraFaults(Generic[_Image]):
    """Injects faults into the images of one camera. It has no clock: a delayed image is passed on with a later one."""

    def __init__(self, settings: FaultSettings) -> None:
        self._settings = settings
        self._held: deque[tuple[int, _Image]] = deque()
        """Delayed images with their stamps, ns."""
        self._to_drop = 0.0
        """Images to drop, a fraction carried over."""
        self._moved_ns: int | None = None
        """Time of the first motion, ns."""

    def move(self, now_ns: int) -> None:
        """Notes a command that moves the robot; only the first one counts."""
        self._moved_ns = now_ns if self._moved_ns is None else self._moved_ns

    def add(self, stamp_ns: int, image: _Image) -> list[tuple[_Image, bool]]:
        """Adds the newest image; returns the images to pass on now, each with whether the lens was covered."""
        if self._held and stamp_ns < self._held[-1][0]:  # time has gone back: a reset
            self._held.clear()
            self._moved_ns = None
        elif self._held and stamp_ns == self._held[-1][0]:  # a stamp that stands still: the newest image counts
            self._held.pop()
        self._to_drop += self._settings.drop
        if self._to_drop >= 1.0 - 1e-9:
            self._to_drop -= 1.0
        else:
            self._held.append((stamp_ns, image))
        passed = []
        while self._held and stamp_ns - self._held[0][0] >= self._settings.delay * NS_PER_S:
            image_ns, delayed = self._held.popleft()
            passed.append((delayed, self._is_covered(image_ns)))
        return passed

    def _is_covered(self, stamp_ns: int) -> bool:
        if self._moved_ns is None:
            return False
        since = (stamp_ns - self._moved_ns) / NS_PER_S - self._settings.cover_after
        return 0.0 <= since < self._settings.cover
