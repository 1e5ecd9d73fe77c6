"""Groups cameras by target and arranges their images in it.

Callers pass the same camera objects for every frame, so groups and other results for cameras are cached by identity.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Generic, TypeVar

from gibson_sim.render.draw.target import Feature, draws_colors, features_of
from gibson_sim.types import CameraSpec

_MAX_ENTRIES = 256
"""Maximum number of results in a cache; a full cache is cleared."""
Argument = TypeVar("Argument")
Result = TypeVar("Result")


@dataclass(frozen=True, slots=True, eq=False)
class CameraGroup:
    """Cameras whose images are drawn into one target."""

    features: tuple[Feature, ...]
    """Features of the target."""
    width: int
    """Width of the target, pixels."""
    height: int
    numbers: tuple[int, ...]
    """Indices of the cameras."""
    places: tuple[tuple[int, int], ...]
    """(left column, top row) of the image of each camera."""


class CameraGrouping:
    """Groups cameras by target.

    Args:
        largest: longest side of a target, pixels.
        share: whether cameras share targets; see ``Renderer``.
    """

    def __init__(self, largest: int, *, share: bool = True) -> None:
        self._largest, self._share = largest, share
        self._known: dict[tuple[int, ...], tuple[tuple[CameraSpec, ...], tuple[CameraGroup, ...]]] = {}

    def of(self, cameras: Sequence[CameraSpec]) -> tuple[CameraGroup, ...]:
        """Returns the groups of cameras; each camera is in exactly one group."""
        key = tuple(map(id, cameras))
        entry = self._known.get(key)
        if entry is None:
            if len(self._known) >= _MAX_ENTRIES:
                self._known.clear()
            entry = self._known[key] = tuple(cameras), tuple(self._groups(cameras))
        return entry[1]

    def _groups(self, cameras: Sequence[CameraSpec]) -> list[CameraGroup]:
        groups = []
        for features, numbers in _by_features(cameras, share=self._share):
            for inside, tiles in arrange([(cameras[k].width, cameras[k].height) for k in numbers], self._largest):
                groups.append(CameraGroup(features, tiles.width, tiles.height, tuple(numbers[i] for i in inside), tiles.places))
        return groups


def _by_features(cameras: Sequence[CameraSpec], *, share: bool) -> list[tuple[tuple[Feature, ...], list[int]]]:
    """Returns the indices of the cameras grouped by features, colour output and number of samples; one per group if they do not share."""
    groups: dict[tuple[tuple[Feature, ...], bool, int, int], list[int]] = {}
    for k, camera in enumerate(cameras):
        color = draws_colors(camera)
        key = features_of(camera.outputs, filled=bool(camera.fill)), color, camera.samples if color else 1, 0 if share else k
        groups.setdefault(key, []).append(k)
    return [(features, numbers) for (features, *_), numbers in groups.items()]


@dataclass(frozen=True, slots=True)
class Tiles:
    """Arrangement of images in a target."""

    width: int
    """Width of the target, pixels."""
    height: int
    places: tuple[tuple[int, int], ...]
    """(left column, top row) of each image."""


def arrange(sizes: Sequence[tuple[int, int]], limit: int) -> list[tuple[list[int], Tiles]]:
    """Arranges images (width, height) in rows, tallest first.

    Args:
        sizes: sizes of the images, pixels.
        limit: longest side of a target, pixels.

    Returns:
        For each target the indices of its images, and their positions. An image larger than the limit gets a separate target.
    """
    area = sum(w * h for w, h in sizes)
    widest = max((w for w, _ in sizes), default=1)
    # About square, a whole multiple of the width of the widest image.
    width = min(widest * max(1, math.ceil(math.sqrt(area) / widest)), max(limit, widest))
    targets: list[tuple[list[int], Tiles]] = []
    numbers: list[int] = []
    places: list[tuple[int, int]] = []
    x = y = row = right = 0
    for number in sorted(range(len(sizes)), key=lambda k: -sizes[k][1]):
        w, h = sizes[number]
        if x + w > width:
            x, y, row = 0, y + row, 0
        if numbers and y + h > limit:
            targets.append((numbers, Tiles(right, y + row, tuple(places))))
            numbers, places, x, y, row, right = [], [], 0, 0, 0, 0
        numbers.append(number)
        places.append((x, y))
        x, row = x + w, max(row, h)
        right = max(right, x)
    if numbers:
        targets.append((numbers, Tiles(right, y + row, tuple(places))))
    return targets


class IdentityCache(Generic[Argument, Result]):
    """Caches a function of immutable objects by their identity, which is faster than comparing or hashing them.

    Args:
        function: function of one object; its results are shared and must not be modified.
    """

    def __init__(self, function: Callable[[Argument], Result]) -> None:
        self._function = function
        self._known: dict[int, tuple[Argument, Result]] = {}  # keeps the object, so that its id is not reused

    def __call__(self, argument: Argument) -> Result:
        """Returns the function's result for an object."""
        entry = self._known.get(id(argument))
        if entry is None:
            if len(self._known) >= _MAX_ENTRIES:
                self._known.clear()
            entry = self._known[id(argument)] = argument, self._function(argument)
        return entry[1]
