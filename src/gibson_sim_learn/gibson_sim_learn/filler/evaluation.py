"""Evaluates fillers in scenes that they were not trained in: scores of single views, flicker on drives, and a contact sheet of examples.

Learned fillers run as in the simulator, through ``gibson_sim.filling``.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from gibson_sim.filling.fillers import open_filler
from gibson_sim.filling.holes import is_hole
from gibson_sim.filling.inputs import filled_colour
from gibson_sim.geometry.transforms import pose_from_xyz_rpy
from gibson_sim.maps.paths import PathPlanner
from gibson_sim.types import Frame
from gibson_sim_learn.filler.pairs import Pairs, ScannedScene, camera_at, depth_of, drawn_pairs, normals_of
from gibson_sim_learn.filler.scoring import Score, Scoring, warped
from gibson_sim_learn.path_following.data import ROBOT_RADIUS, DataSettings, draw_path, shard_rng

F32 = NDArray[np.float32]
U8 = NDArray[np.uint8]
FillMethod = Callable[[U8, F32, F32, U8], U8]
"""Function that takes colours (H, W, 3), depth (H, W), normals (H, W, 3) and hole (H, W) of a ``Frame`` and returns the filled colours."""

CLASSICAL = ("telea", "navier_stokes", "push_pull")
"""Methods without training."""
_INPAINT_PX = 3.0
"""Radius of OpenCV's two inpainting methods, pixels."""
_HEIGHT, _FOV = 0.46, 1.2
"""Height above the floor, metres, and field of view, radians, of the camera of a drive."""
_ROWS = 10
"""Rows of a contact sheet."""


@dataclass(frozen=True, slots=True)
class Flicker:
    """Mean absolute difference between successive images after motion compensation, levels of 255."""

    all: float
    holes: float
    """The same in holes of the later image only."""


def fill_methods(model: Path, name: str) -> dict[str, FillMethod]:
    """Returns the compared methods by name: ``nothing`` returns the unchanged image; the last one is a network.

    Args:
        model: file of the network.
        name: name of the network.

    Raises:
        ConfigError: the file is not a filler network.
    """

    def inpainted(method: int) -> FillMethod:
        def filled(colour: U8, depth: F32, normals: F32, hole: U8) -> U8:
            return np.asarray(cv2.inpaint(colour, is_hole(hole).astype(np.uint8), _INPAINT_PX, method), dtype=np.uint8)

        return filled

    filler = open_filler(str(model))
    return {
        "nothing": lambda colour, depth, normals, hole: colour,
        "telea": inpainted(cv2.INPAINT_TELEA),
        "navier_stokes": inpainted(cv2.INPAINT_NS),
        "push_pull": lambda colour, depth, normals, hole: filled_colour(colour, hole),
        name: lambda colour, depth, normals, hole: filler.fill(colour, depth, normals, hole, with_depth=False).colour,
    }


def scores_of(
    pairs: Sequence[Pairs], methods: Mapping[str, FillMethod], every: int = 1, progress: Callable[[str], None] = lambda text: None
) -> dict[str, Score]:
    """Returns the score of each method on every ``every``-th view of some shards."""
    gathered = {name: Scoring() for name in methods}
    for number, part in enumerate(pairs):
        for k in range(0, len(part.hole), every):
            colour, depth, normals, hole = view_arrays(part, k)
            for name, method in methods.items():
                gathered[name].add(method(colour, depth, normals, hole), part.truth[k], is_hole(hole))
            progress(f"scores: view {k + 1} of {len(part.hole)}, shard {number + 1} of {len(pairs)}")
    return {name: scoring.score() for name, scoring in gathered.items()}


def flicker_of(scanned: ScannedScene, methods: Mapping[str, FillMethod], seed: int, frames: int) -> dict[str, Flicker]:
    """Returns the flicker of each method, and of the true images, ``truth``, on a drive with 5 cm between images.

    The previous image is warped by the true depth; only pixels at which both images show the same surface count.
    """
    rng = shard_rng(f"drive {seed} {scanned.scene.name}")
    path = draw_path(scanned.floor, PathPlanner(scanned.floor, ROBOT_RADIUS + 0.08), rng, DataSettings())[:frames]
    cameras = [
        camera_at(pose_from_xyz_rpy((x, y, scanned.scene.floor_z), (0.0, 0.0, yaw)), _HEIGHT, 0.0, _FOV)
        for x, y, yaw in path.tolist()
    ]
    names = (*methods, "truth")
    sums = {name: np.zeros(2) for name in names}
    counts = np.zeros(2)
    before: tuple[Frame, dict[str, U8]] | None = None
    for scan, clean in drawn_pairs(scanned, cameras):
        assert scan.rgb is not None and scan.depth is not None and scan.normal is not None and scan.hole is not None
        assert clean.rgb is not None and clean.depth is not None
        images = {name: method(scan.rgb, scan.depth, scan.normal, scan.hole) for name, method in methods.items()} | {
            "truth": clean.rgb
        }
        if before is not None:
            last, others = before
            assert last.depth is not None
            for name in names:
                moved, known = warped(
                    others[name], clean.T_world_camera, clean.camera.intrinsics(), clean.depth, last.T_world_camera, last.depth
                )
                change = np.abs(moved.astype(np.float64) - images[name]).mean(axis=2)
                regions = (known, known & is_hole(scan.hole))
                sums[name] += [change[region].sum() for region in regions]
            counts += [region.sum() for region in regions]
        before = clean, images
    return {name: Flicker(*(sums[name] / np.maximum(counts, 1)).tolist()) for name in names}


def sheet(pairs: Sequence[Pairs], methods: Mapping[str, FillMethod], network: str, seed: int) -> U8:
    """Returns a contact sheet, RGB: in each row a view of the scan, filled by push-pull and by the network, and the ground truth.

    The seed selects the views.
    """
    rng = np.random.default_rng(seed)
    views = [(part, k) for part in pairs for k in range(len(part.hole))]
    rows = []
    for number in rng.permutation(len(views))[:_ROWS].tolist():
        part, k = views[number]
        given = view_arrays(part, k)
        chosen = [methods[name](*given) for name in ("nothing", "push_pull", network)]
        rows.append(np.concatenate([*chosen, part.truth[k]], axis=1))
    return np.concatenate(rows)


def view_arrays(part: Pairs, k: int) -> tuple[U8, F32, F32, U8]:
    """Returns colours, depth, normals and hole of a view, in the format of ``Frame``."""
    return np.array(part.drawn[k]), depth_of(part.depth_mm[k]), normals_of(part.normals[k]), np.array(part.hole[k])


def table(scores: Mapping[str, Score], flicker: Mapping[str, Flicker] | None = None) -> list[str]:
    """Returns the lines of a Markdown table."""
    flicker = {} if flicker is None else flicker
    lines = [
        "| | holes: PSNR, SSIM | seen: PSNR, SSIM | GMSD | flicker, of 255: all, holes |",
        "|---|---|---|---|---|",
    ]
    for name in dict.fromkeys((*scores, *flicker)):
        s, f = scores.get(name), flicker.get(name)
        cells = (
            ("-", "-", "-")
            if s is None
            else (f"{s.hole_psnr:.2f} dB, {s.hole_ssim:.3f}", f"{s.seen_psnr:.2f} dB, {s.seen_ssim:.3f}", f"{s.gmsd:.3f}")
        )
        lines.append(f"| `{name}` | {' | '.join(cells)} | {'-' if f is None else f'{f.all:.2f}, {f.holes:.2f}'} |")
    return lines


def mean_flicker(found: Sequence[Mapping[str, Flicker]]) -> dict[str, Flicker]:
    """Returns the mean over scenes of each method's flicker."""
    return {
        name: Flicker(*(float(np.mean([getattr(one[name], part) for one in found])) for part in ("all", "holes")))
        for name in found[0]
    }


def beats_baselines(scores: Mapping[str, Score], network: str) -> bool:
    """Returns whether a network has a higher PSNR than every classical method in holes, and than the unfilled image outside holes."""
    learned = scores[network]
    return (
        learned.hole_psnr > max(scores[name].hole_psnr for name in CLASSICAL) and learned.seen_psnr > scores["nothing"].seen_psnr
    )


def as_json(values: Mapping[str, Score] | Mapping[str, Flicker]) -> dict[str, Any]:
    """Returns scores or flicker as plain values, for JSON."""
    return {name: {key: round(number, 4) for key, number in asdict(value).items()} for name, value in values.items()}
