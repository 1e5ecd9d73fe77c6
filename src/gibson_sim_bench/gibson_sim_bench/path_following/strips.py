"""Film strips of runs: images of the camera, recorded images of the same places, and a map. Runs are repeated from their seeds."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from gibson_sim.errors import GibsonSimError
from gibson_sim.picture_files import write_picture
from gibson_sim_bench.path_following.plan import parts_of
from gibson_sim_bench.path_following.runs import SUCCESS, Runner, RunResult
from gibson_sim_bench.path_following.store import Store
from gibson_sim_learn.path_following.cameras import Rig
from gibson_sim_learn.path_following.drives import Recording, Trace
from gibson_sim_learn.path_following.layout import Layout

Picture = NDArray[np.uint8]
FOLDER = "strips"
_VIEWS = 8
"""Images of a strip."""
_GAP = 4
"""Pixels between images."""
_MAP_M = 0.025
"""Resolution of the map, metres per pixel."""
_ORDER = ("learned", "teach_repeat", "blind", "random", "oracle")
"""Methods in the order in which examples are selected."""


def write_strips(store: Store, results: Iterable[RunResult], tell: Callable[[str], None] = lambda line: None) -> dict[str, Path]:
    """Writes a strip of one success of each method that uses images, and of one failure of each kind; returns the files by captions.

    Args:
        store: the folder of the runs.
        results: the runs to choose from.
        tell: called with one line of progress.

    Raises:
        GibsonSimError: a file cannot be written.
    """
    out: dict[str, Path] = {}
    runner = Runner(store.plan.seed, Rig(store.plan.camera), store.plan.model, store.plan.goggles)
    try:
        for caption, result in sorted(examples(results).items(), key=lambda item: item[1].key.scene):
            file = store.folder / FOLDER / f"{result.key.name}.png"
            out[caption] = file
            if not file.is_file():
                tell(f"film strip: {caption}")
                case = store.case(result.key)
                try:
                    trace = runner.trace(case, result.key, keep_views=True)
                except GibsonSimError as error:
                    tell(f"left out: {error}")
                    del out[caption]
                    continue
                write_picture(file, strip(runner.recording(case), trace)[..., ::-1])
    finally:
        runner.close()
    return dict(sorted(out.items()))


def examples(results: Iterable[RunResult]) -> dict[str, RunResult]:
    """Returns the runs to draw strips of, by caption: the first success of each method with images, the first failure of each kind.

    Methods with images come first, and the domain ``reality`` before the others.
    """
    found: dict[str, RunResult] = {}

    def order(result: RunResult) -> tuple[object, ...]:
        key = result.key
        return (
            _ORDER.index(parts_of(key.method)[0]),
            key.method,
            key.domain != "reality",
            key.length,
            key.scene,
            key.path,
            key.repeat,
        )

    for result in sorted((r for r in results if not r.kind.startswith("not run")), key=order):
        kind = f"{result.key.method}: {SUCCESS}" if result.success else result.kind
        if not (result.success and result.key.method in ("oracle", "blind", "random")):
            found.setdefault(kind, result)
    return {f"{kind} ({r.key.method}, {r.key.domain}, {r.key.length:g} m)": r for kind, r in found.items()}


def strip(recording: Recording, trace: Trace) -> Picture:
    """Returns (H, W, 3), uint8, RGB: images of the camera above, those of the nearest nodes below, and the map to the right."""
    chosen = np.unique(np.linspace(0, len(trace.views) - 1, _VIEWS).astype(int)).tolist()
    nodes = np.array([pose[:2] for pose in recording.poses])
    upper = [_large(trace.views[k][0]) for k in chosen]
    lower = []
    for k in chosen:
        nearest = int(np.hypot(*(nodes - trace.ticks[k].pose[:2]).T).argmin())
        lower.append(_large(recording.path.nodes[nearest].view[0]))
    films = np.concatenate([_row(upper), np.full((_GAP, _row(upper).shape[1], 3), 255, np.uint8), _row(lower)])
    drawn = _map(recording, trace, [trace.ticks[k].pose for k in chosen])
    height = max(films.shape[0], drawn.shape[0])
    gap = np.full((height, _GAP, 3), 255, np.uint8)
    return np.concatenate([_padded(films, height), gap, _padded(drawn, height)], axis=1)


def _large(image: Picture) -> Picture:
    return np.asarray(image.repeat(2, axis=0).repeat(2, axis=1))


def _row(images: list[Picture]) -> Picture:
    gap = np.full((images[0].shape[0], _GAP, 3), 255, np.uint8)
    return np.concatenate([part for image in images for part in (image, gap)][:-1], axis=1)


def _padded(image: Picture, height: int) -> Picture:
    return np.pad(image, ((0, height - image.shape[0]), (0, 0), (0, 0)), constant_values=255)


def _map(recording: Recording, trace: Trace, marked: list[tuple[float, float, float]]) -> Picture:
    """Returns the map around the path: recorded line blue, driven line red, dots where the images were taken, a black ring at a collision."""
    layout = trace.layout
    assert isinstance(layout, Layout)
    floor = layout.floor
    ways = [np.array(recording.line), np.array([tick.pose[:2] for tick in trace.ticks])]
    low = np.concatenate(ways).min(axis=0) - 1.0
    high = np.concatenate(ways).max(axis=0) + 1.0
    columns, rows = (math.ceil(length / _MAP_M) for length in high - low)
    xs, ys = low[0] + (np.arange(columns) + 0.5) * _MAP_M, high[1] - (np.arange(rows) + 0.5) * _MAP_M
    grid = np.stack(np.meshgrid(xs, ys), axis=-1)
    free = floor.look_up(floor.free, grid, outside=False)
    picture = np.where(free[..., None], np.uint8(255), np.uint8(170)).repeat(3, axis=2)

    def pixels(points: NDArray[np.float64]) -> NDArray[np.int32]:
        return np.stack([(points[:, 0] - low[0]) / _MAP_M, (high[1] - points[:, 1]) / _MAP_M], axis=1).astype(np.int32)

    bodies = {body.name: body for body in layout.bodies}
    for names, colour in ((layout.moved, (255, 180, 60)), (layout.obstacles, (220, 60, 200))):
        for name in names:
            place = np.array([bodies[name].start.position[:2]])
            cv2.circle(picture, tuple(pixels(place)[0].tolist()), round(0.15 / _MAP_M), colour, -1)
    for way, colour in zip(ways, ((40, 90, 220), (210, 40, 40)), strict=True):
        cv2.polylines(picture, [pixels(way)], False, colour, 2)
    for pose in marked:
        cv2.circle(picture, tuple(pixels(np.array([pose[:2]]))[0].tolist()), 4, (210, 40, 40), -1)
    for tick in trace.ticks:
        if tick.in_collision:
            cv2.circle(picture, tuple(pixels(np.array([tick.pose[:2]]))[0].tolist()), 7, (0, 0, 0), 2)
            break
    return np.asarray(picture)
