"""The map of a scene with the paths of all runs, as one SVG element with colours from the page's style sheet."""

from __future__ import annotations

import base64
import html
import logging
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from gibson_sim.errors import GibsonSimError
from gibson_sim.maps.floor_map import floor_name, scene_floor_map
from gibson_sim.scenes.load import load_scene
from gibson_sim.trials.records import RunResult
from gibson_sim.trials.report.paths import Points, bounds
from gibson_sim.trials.report.words import xy_text

_HEIGHT = 0.5
"""Height above the floor up to which objects count as obstacles on the map, metres."""
_OCCUPIED, _UNKNOWN = (148, 134, 122, 235), (160, 150, 140, 46)
"""Colours of cells as blue, green, red, alpha: grey on a light and on a dark page. Free cells are transparent."""
_MARGIN = 0.3
"""Margin around the map and the paths, metres."""
_log = logging.getLogger(__name__)

Box = tuple[float, float, float, float]
"""Left, right, bottom and top, metres."""


@dataclass(frozen=True, slots=True, eq=False)
class SceneMap:
    """A picture of the floor of a scene."""

    pixels: NDArray[np.uint8]
    """(H, W, 4), uint8: blue, green, red, alpha; row 0 has the greatest y."""
    box: Box
    """World coordinates of its edges."""
    floor: str = ""
    """Name of the floor where the scene has several."""


def scene_map(scene: str) -> SceneMap | None:
    """Returns the map of a scene, cropped to the known cells; None, with a warning, if it cannot be created.

    Args:
        scene: name or file.
    """
    try:
        loaded = load_scene(scene)
        floor = scene_floor_map(loaded, robot_height=_HEIGHT)
    except GibsonSimError as error:
        _log.warning("the page shows scene %s without its map: %s", scene, error)
        return None
    known = np.argwhere(floor.occupied | floor.floor)
    (row0, column0), (row1, column1) = known.min(axis=0), known.max(axis=0) + 1
    occupied, ground = floor.occupied[row0:row1, column0:column1], floor.floor[row0:row1, column0:column1]
    pixels = np.zeros((*occupied.shape, 4), dtype=np.uint8)
    pixels[~ground] = _UNKNOWN
    pixels[occupied] = _OCCUPIED
    x, y, cell = *floor.origin, floor.resolution
    box = (x + column0 * cell, x + column1 * cell, y + row0 * cell, y + row1 * cell)
    return SceneMap(pixels[::-1], (float(box[0]), float(box[1]), float(box[2]), float(box[3])), floor_name(loaded))


def map_svg(floor: SceneMap | None, runs: Sequence[tuple[RunResult, Points]]) -> str:
    """Returns the ``<svg>`` element: the map, and the path of each run with its start and end; empty if there is nothing to draw.

    Args:
        floor: the map; None = no map.
        runs: results of one scene with their true paths.
    """
    extents = [bounds([path for _, path in runs]), floor.box if floor is not None else None]
    boxes = [box for box in extents if box is not None]
    if not boxes:
        return ""
    left, right = min(box[0] for box in boxes) - _MARGIN, max(box[1] for box in boxes) + _MARGIN
    bottom, top = min(box[2] for box in boxes) - _MARGIN, max(box[3] for box in boxes) + _MARGIN
    unit = max(right - left, top - bottom) / 100.0
    labels = _Labels(unit)
    parts = [_image(floor)] if floor is not None else []
    ordered = sorted(runs, key=lambda item: not item[0].passed)  # failed runs are drawn over the others
    parts += [_path(result, path, unit, labels) for result, path in ordered]
    return (
        f'<svg class="map" role="img" aria-label="Map with the paths of {len(runs)} runs" style="--unit:{unit:.4f}" '
        f'viewBox="{left:.3f} {-top:.3f} {right - left:.3f} {top - bottom:.3f}">{"".join(parts)}{labels.svg()}</svg>'
    )


def _image(floor: SceneMap) -> str:
    _, data = cv2.imencode(".png", floor.pixels, [cv2.IMWRITE_PNG_COMPRESSION, 9])
    left, right, bottom, top = floor.box
    return (
        f'<image x="{left:.3f}" y="{-top:.3f}" width="{right - left:.3f}" height="{top - bottom:.3f}" preserveAspectRatio="none" '
        f'href="data:image/png;base64,{base64.b64encode(data.tobytes()).decode()}"/>'
    )


def _path(result: RunResult, path: Points, unit: float, labels: _Labels) -> str:
    """Returns the path of a run with its marks; the path of a failed run links to its description."""
    run = result.run
    points = path or ((run.start[0], run.start[1]),)
    line = " ".join(f"{x:.3f},{-y:.3f}" for x, y in points)
    kind = "passed" if result.passed else "failed"
    (x0, y0), (x1, y1) = points[0], points[-1]
    title = f"run {run.number}, {kind}: {xy_text(run.start)} to {xy_text(run.goal)}"
    marks = f'<circle class="start" cx="{x0:.3f}" cy="{-y0:.3f}" r="{0.55 * unit:.3f}"/>'
    if result.passed:
        marks += f'<circle class="end" cx="{x1:.3f}" cy="{-y1:.3f}" r="{0.55 * unit:.3f}"/>'
    else:
        r, goal_x, goal_y = unit, run.goal[0], -run.goal[1]
        marks += (
            f'<path class="goal" d="M{goal_x:.3f} {goal_y - r:.3f}l{r:.3f} {r:.3f}l{-r:.3f} {r:.3f}l{-r:.3f} {-r:.3f}z"/>'
            f'<path class="end" d="M{x1 - r:.3f} {-y1 - r:.3f}l{2 * r:.3f} {2 * r:.3f}m0 {-2 * r:.3f}l{-2 * r:.3f} {2 * r:.3f}"/>'
        )
        half = 0.7 * unit
        marks += "".join(
            f'<rect class="thing" x="{x - half:.3f}" y="{-y - half:.3f}" width="{2 * half:.3f}" height="{2 * half:.3f}"/>'
            for x, y, _ in (placed.pose for placed in run.things)
        )
        labels.add(str(run.number), x1, -y1)
    drawing = f'<g class="{kind}"><title>{html.escape(title)}</title><polyline points="{line}"/>{marks}</g>'
    return drawing if result.passed else f'<a href="#run-{run.number}">{drawing}</a>'


class _Labels:
    """Non-overlapping number labels beside marks; a label without room is omitted."""

    _SIDES = ((1.6, -1.0), (1.6, 2.6), (-1.6, -1.0), (-1.6, 2.6), (0.0, -2.2), (0.0, 4.0), (4.4, 0.8), (-4.4, 0.8))
    """Offsets of the text's baseline from a mark, in units: of its start, or of its end if to the left."""
    _HEIGHT, _WIDTH = 2.8, 1.7
    """Size of a character, units."""

    def __init__(self, unit: float) -> None:
        self._unit = unit
        self._boxes: list[Box] = []
        self._texts: list[str] = []

    def add(self, text: str, x: float, y: float) -> None:
        """Adds a text beside a point in SVG coordinates."""
        width = self._WIDTH * len(text) * self._unit
        for dx, dy in self._SIDES:
            anchor = "start" if dx > 0 else "end" if dx < 0 else "middle"
            at_x, at_y = x + dx * self._unit, y + dy * self._unit
            left = at_x - {"start": 0.0, "end": width, "middle": width / 2}[anchor]
            box = (left, left + width, at_y - self._HEIGHT * self._unit, at_y)
            if all(box[1] < b[0] or b[1] < box[0] or box[3] < b[2] or b[3] < box[2] for b in self._boxes):
                self._boxes.append(box)
                self._texts.append(
                    f'<a href="#run-{text}"><text x="{at_x:.3f}" y="{at_y:.3f}" text-anchor="{anchor}">{html.escape(text)}</text></a>'
                )
                return

    def svg(self) -> str:
        """Returns the SVG elements of all texts."""
        return "".join(self._texts)
