"""Random places on a floor where nothing is near."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from gibson_sim.errors import SceneError
from gibson_sim.geometry.transforms import pose_from_xyz_rpy
from gibson_sim.scenes.floor_map import FloorMap
from gibson_sim.types import Pose


def random_free_poses(
    floor: FloorMap,
    count: int,
    rng: np.random.Generator,
    *,
    clearance: float = 0.3,
    spacing: float = 0.0,
    region: NDArray[np.bool_] | None = None,
) -> tuple[Pose, ...]:
    """Returns ``count`` poses (T_world_base) on the floor, evenly spread over it, of any heading; equal generators give equal poses.

    Args:
        floor: the map.
        count: how many.
        rng: where chance comes from.
        clearance: metres to the nearest obstacle, at least.
        spacing: metres between any two of them, at least.
        region: (H, W), cells that they may lie in; None = ``floor.largest_free_region(clearance)``.

    Raises:
        SceneError: there is not so much room.
    """
    places = floor.inflate(clearance) & (floor.largest_free_region(clearance) if region is None else region)
    cells = np.argwhere(places)
    # Any point of such a cell keeps the clearance, and there are enough of them even where places are few.
    drawn = rng.permutation(np.tile(np.arange(len(cells)), max(1, math.ceil(4 * count / max(len(cells), 1)))))
    points = floor.centers(cells[drawn]) + rng.uniform(-0.5, 0.5, (len(drawn), 2)) * floor.resolution
    left = np.ones(len(points), dtype=bool)
    chosen: list[NDArray[np.float64]] = []
    while len(chosen) < count:
        if not left.any():
            raise SceneError(
                f"floor at z = {floor.floor_z:g} m: only {len(chosen)} of {count} poses fit with {clearance:g} m to obstacles and "
                f"{spacing:g} m to each other; ask for fewer, or less distance"
            )
        point = points[int(left.argmax())]
        left[int(left.argmax())] = False
        chosen.append(point)
        if spacing > 0:
            left &= np.linalg.norm(points - point, axis=1) >= spacing
    yaws = rng.uniform(-math.pi, math.pi, count)
    return tuple(
        pose_from_xyz_rpy((float(x), float(y), floor.floor_z), (0.0, 0.0, float(yaw)))
        for (x, y), yaw in zip(chosen, yaws, strict=True)
    )
