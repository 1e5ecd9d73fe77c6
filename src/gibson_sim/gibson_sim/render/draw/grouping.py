"""Which cameras are drawn together into one target, and what else of cameras is worked out once: they are the same objects picture after picture."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Generic, TypeVar

from gibson_sim.render.draw.target import Feature, features_of
from gibson_sim.types import CameraSpec


@dataclass(frozen=True, slots=True)
class Tiles:
    """Images in a target."""

    width: int
    """Of the target, pixels."""
    height: int
    places: tuple[tuple[int, int], ...]
    """(left column, top row) of each image."""


def arrange(sizes: Sequence[tuple[int, int]], limit: int) -> list[tuple[list[int], Tiles]]:
    """Places images (width, height) in rows, the tallest first.

    Args:
        sizes: of the images, pixels.
        limit: longest side of a target.

    Returns:
        For each target the numbers of the images in it, and where they stand. An image above the limit gets a target of its own.
    """
    area = sum(w * h for w, h in sizes)
    widest = max((w for w, _ in sizes), default=1)
    # About square, in whole columns of the widest image.
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


_MOST = 256
"""So many answers are kept."""
Thing = TypeVar("Thing")
Answer = TypeVar("Answer")


class Remembered(Generic[Thing, Answer]):
    """What a function says of things that never change, by their identity: quicker than to compare or to hash them.

    Args:
        function: of one thing; its answers are shared and not to be written to.
    """

    def __init__(self, function: Callable[[Thing], Answer]) -> None:
        self._function = function
        self._known: dict[int, tuple[Thing, Answer]] = {}  # with the thing, so that no other gets its identity

    def __call__(self, thing: Thing) -> Answer:
        """Returns what the function says of a thing."""
        found = self._known.get(id(thing))
        if found is None:
            if len(self._known) >= _MOST:
                self._known.clear()
            found = self._known[id(thing)] = thing, self._function(thing)
        return found[1]


@dataclass(frozen=True, slots=True, eq=False)
class Group:
    """Cameras whose images are drawn into one target."""

    features: tuple[Feature, ...]
    """Of the target."""
    width: int
    """Of the target, pixels."""
    height: int
    numbers: tuple[int, ...]
    """Of the cameras."""
    places: tuple[tuple[int, int], ...]
    """(left column, top row) of the image of each."""


class Grouping:
    """Groups of cameras.

    Args:
        largest: longest side of a target, pixels.
    """

    def __init__(self, largest: int) -> None:
        self._largest = largest
        self._known: dict[tuple[int, ...], tuple[tuple[CameraSpec, ...], tuple[Group, ...]]] = {}

    def of(self, cameras: Sequence[CameraSpec]) -> tuple[Group, ...]:
        """Returns the groups of cameras; each is in one of them."""
        key = tuple(map(id, cameras))
        found = self._known.get(key)
        if found is None:
            if len(self._known) >= _MOST:
                self._known.clear()
            found = self._known[key] = tuple(cameras), tuple(self._groups(cameras))
        return found[1]

    def _groups(self, cameras: Sequence[CameraSpec]) -> list[Group]:
        groups = []
        for features, numbers in _alike(cameras):
            for inside, tiles in arrange([(cameras[k].width, cameras[k].height) for k in numbers], self._largest):
                groups.append(Group(features, tiles.width, tiles.height, tuple(numbers[i] for i in inside), tiles.places))
        return groups


def _alike(cameras: Sequence[CameraSpec]) -> list[tuple[tuple[Feature, ...], list[int]]]:
    """Returns the numbers of the cameras by what is drawn for them: features, colours or none, samples.

    Those on bodies and those on none (views) stand apart: what a robot sees is the same, to the bit, with and without views beside it.
    """
    groups: dict[tuple[tuple[Feature, ...], bool, int, bool], list[int]] = {}
    for k, camera in enumerate(cameras):
        color = "rgb" in camera.outputs
        key = features_of(camera.outputs), color, camera.samples if color else 1, "/" in camera.link
        groups.setdefault(key, []).append(k)
    return [(features, numbers) for (features, *_), numbers in groups.items()]
