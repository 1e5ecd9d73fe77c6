"""Images that wait while one is processed, and their counts. Independent of ROS."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import Generic, TypeVar

_Image = TypeVar("_Image")


@dataclass(frozen=True, slots=True)
class ImageCounts:
    """Numbers of images that a node received, adapted, skipped and could not use."""

    received: int = 0
    adapted: int = 0
    skipped: int = 0
    """Images that newer ones replaced, since the queue was full."""
    unusable: int = 0

    def since(self, before: ImageCounts) -> ImageCounts:
        """Returns the counts of the images after those of ``before``."""
        return ImageCounts(
            self.received - before.received,
            self.adapted - before.adapted,
            self.skipped - before.skipped,
            self.unusable - before.unusable,
        )

    def __str__(self) -> str:
        return f"{self.received} received, {self.adapted} adapted, {self.skipped} skipped, {self.unusable} unusable"


class ImageQueue(Generic[_Image]):
    """Images that wait to be adapted, oldest first. If it is full, the oldest one is skipped.

    Args:
        size: maximum number of images that wait; 1 = only the newest.
    """

    def __init__(self, size: int) -> None:
        self.size = size
        """Maximum number of images that wait."""
        self._waiting: deque[_Image] = deque(maxlen=size)
        self._received = self._adapted = self._skipped = self._unusable = 0

    @property
    def counts(self) -> ImageCounts:
        """Counts of all images; those that wait are only received."""
        return ImageCounts(self._received, self._adapted, self._skipped, self._unusable)

    @property
    def waiting(self) -> int:
        """Number of images that wait."""
        return len(self._waiting)

    def add(self, image: _Image) -> None:
        """Adds an image that was received."""
        self._received += 1
        self._skipped += len(self._waiting) == self.size
        self._waiting.append(image)

    def pop(self) -> _Image | None:
        """Returns the oldest image that waits; None = there is none."""
        return self._waiting.popleft() if self._waiting else None

    def note_result(self, *, usable: bool) -> None:
        """Counts an image that was popped as adapted, or as unusable."""
        self._adapted += usable
        self._unusable += not usable

    def close(self) -> None:
        """Counts all images that have no result as skipped; a second call does nothing."""
        self._waiting.clear()
        self._skipped = self._received - self._adapted - self._unusable
