"""Faults of a camera, on purpose: covered for a time, images missing or late. To see what a follower does then, before it happens to it."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import Generic, TypeVar

from gibson_path_following.errors import check_ranges
from gibson_path_following.motions import NS_PER_S

_Image = TypeVar("_Image")


@dataclass(frozen=True, slots=True)
class FaultSettings:
    """What is wrong with a camera."""

    cover_after: float = 0.0
    """Seconds from the first motion to when the lens is covered."""
    cover: float = 0.0
    """How long it is covered, seconds; 0 = never."""
    drop: float = 0.0
    """Part of the images that is missing, evenly spread: 0.5 is every other one."""
    delay: float = 0.0
    """How late images come, seconds, by their stamps."""

    def __post_init__(self) -> None:
        check_ranges(
            self, ("cover_after", 0.0, 3600.0), ("cover", 0.0, 3600.0), ("drop", 0.0, 1.0), ("delay", 0.0, 60.0)
        )  # fmt: skip


class CameraFaults(Generic[_Image]):
    """Passes on the images of one camera with its faults. It knows no clock: an image that is late goes out with a later one."""

    def __init__(self, settings: FaultSettings) -> None:
        self._settings = settings
        self._held: deque[tuple[int, _Image]] = deque()
        """Images that are not late enough yet, by stamp, ns."""
        self._missing = 0.0
        """Images that should be missing by now and are not."""
        self._moved_ns: int | None = None

    def move(self, now_ns: int) -> None:
        """The robot is told to move; only the first time counts."""
        self._moved_ns = now_ns if self._moved_ns is None else self._moved_ns

    def add(self, stamp_ns: int, image: _Image) -> list[tuple[_Image, bool]]:
        """Takes the newest image; returns those that go out now, and of each whether the lens was covered."""
        if self._held and stamp_ns < self._held[-1][0]:  # time has gone back: a reset
            self._held.clear()
            self._moved_ns = None
        self._missing += self._settings.drop
        if self._missing >= 1.0 - 1e-9:
            self._missing -= 1.0
        else:
            self._held.append((stamp_ns, image))
        passed = []
        while self._held and stamp_ns - self._held[0][0] >= self._settings.delay * NS_PER_S:
            taken_ns, late = self._held.popleft()
            passed.append((late, self._is_covered(taken_ns)))
        return passed

    def _is_covered(self, stamp_ns: int) -> bool:
        if self._moved_ns is None:
            return False
        since = (stamp_ns - self._moved_ns) / NS_PER_S - self._settings.cover_after
        return 0.0 <= since < self._settings.cover
