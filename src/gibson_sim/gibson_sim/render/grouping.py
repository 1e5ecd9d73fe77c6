"""Which cameras are drawn together into one target, and what else of cameras is worked out once: they are the same objects picture after picture."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Generic, TypeVar

from gibson_sim.render.target import Feature, features_of
from gibson_sim.render.tiles import arrange
from gibson_sim.types import CameraSpec

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
