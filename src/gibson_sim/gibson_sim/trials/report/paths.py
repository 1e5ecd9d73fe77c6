"""The true path of a run, extracted from its bag before the bag is removed: ``path.json`` in the folder of the run."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gibson_sim.bags.comparison.topics import ODOMETRY
from gibson_sim.bags.reader import BagReader
from gibson_sim.reading import read_file
from gibson_sim.writing import write_file

FILE = "path.json"
_TOLERANCE = 0.02
"""Largest distance between the true path and the simplified path, metres."""
_LARGEST = 1e6
"""Largest plausible coordinate, metres."""

Points = tuple[tuple[float, float], ...]
"""x, y: map frame, metres."""


def write_path(bag: Path, folder: Path) -> None:
    """Writes the true path of the bag's robot into the folder of the run; does nothing if the bag has none.

    Raises:
        RecordError: the bag cannot be read.
        WriteError: the file cannot be written.
    """
    points = true_path(bag)
    if points:
        write_file(folder / FILE, json.dumps([[round(x, 3), round(y, 3)] for x, y in points]) + "\n")


def read_path(folder: Path) -> Points:
    """Returns the path in the folder of a run; empty if it is missing or unreadable."""
    try:
        values = json.loads(read_file(folder / FILE))
        points = tuple((float(x), float(y)) for x, y in values)
    except (OSError, ValueError, TypeError):
        return ()
    return points if all(math.isfinite(x) and math.isfinite(y) for x, y in points) else ()


def true_path(bag: Path) -> Points:
    """Returns the simplified true path of the bag's robot; empty if the bag has none.

    Raises:
        RecordError: the bag cannot be read.
    """
    with BagReader(bag) as reader:
        infos = reader.topics()
        topics = [name for name, info in infos.items() if name.endswith("/ground_truth/odom") and info.type_name == ODOMETRY]
        if not topics:
            return ()
        positions = [message.pose.pose.position for _, _, message in reader.messages(topics[:1])]
    xy = np.array([(p.x, p.y) for p in positions], dtype=np.float64).reshape(-1, 2)
    xy = xy[(np.abs(xy) < _LARGEST).all(axis=1)]
    return tuple((float(x), float(y)) for x, y in simplify(xy, _TOLERANCE))


def simplify(xy: NDArray[np.float64], tolerance: float) -> NDArray[np.float64]:
    """Returns the vertices (M, 2) of a polyline (N, 2) that remain after simplification within a tolerance (Ramer-Douglas-Peucker)."""
    if len(xy) < 3:
        return xy
    kept = np.zeros(len(xy), dtype=bool)
    kept[[0, -1]] = True
    spans = [(0, len(xy) - 1)]
    while spans:
        first, last = spans.pop()
        if last - first < 2:
            continue
        distances = _distances(xy[first + 1 : last], xy[first], xy[last])
        farthest = int(np.argmax(distances))
        if distances[farthest] > tolerance:
            middle = first + 1 + farthest
            kept[middle] = True
            spans += [(first, middle), (middle, last)]
    return xy[kept]


def _distances(xy: NDArray[np.float64], a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    """Returns the distances (N,) of points (N, 2) to the segment from a to b."""
    along = b - a
    square = float(along @ along)
    t = np.clip((xy - a) @ along / square, 0.0, 1.0) if square > 0.0 else np.zeros(len(xy))
    return np.asarray(np.linalg.norm(xy - (a + t[:, None] * along), axis=1))


def bounds(paths: Sequence[Points]) -> tuple[float, float, float, float] | None:
    """Returns left, right, bottom and top of all paths, metres; None without points."""
    points = [point for path in paths for point in path]
    if not points:
        return None
    xs, ys = [x for x, _ in points], [y for _, y in points]
    return min(xs), max(xs), min(ys), max(ys)
