"""Where several images stand in one target, so that they are drawn and read back together. Pure."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass


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
