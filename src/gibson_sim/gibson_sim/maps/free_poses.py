"""Free poses, at which a robot is not in collision: sampled on a map, or read from a scene's ``free_poses.csv``."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gibson_sim.errors import SceneError
from gibson_sim.geometry.transforms import pose_from_xyz_rpy
from gibson_sim.maps.floor_map import FloorMap
from gibson_sim.reading import is_file, read_file
from gibson_sim.scenes.spec import SceneSpec
from gibson_sim.types import Pose
from gibson_sim.writing import write_file

FREE_POSES = "free_poses.csv"
"""Name of the file in a scene's folder."""
COLUMNS = ("floor", "x", "y", "z", "yaw", "room")
_MAX_BYTES = 16_000_000
"""Maximum size of a file that is read, bytes."""


@dataclass(frozen=True, slots=True)
class FreePose:
    """A collision-free pose of a robot on a floor, in the world frame."""

    floor: int
    """Index of its floor, 0 = the lowest."""
    x: float
    """Position, world metres."""
    y: float
    """Position, world metres."""
    z: float
    """Height of the surface below the robot, metres."""
    yaw: float
    """Heading, radians."""
    room: str = ""
    """Name of its room; empty = no room there."""

    @property
    def pose(self) -> Pose:
        """T_world_base, with the base on the floor."""
        return pose_from_xyz_rpy((self.x, self.y, self.z), (0.0, 0.0, self.yaw))


def random_free_poses(
    floor: FloorMap,
    count: int,
    rng: np.random.Generator,
    *,
    clearance: float = 0.3,
    spacing: float = 0.0,
    region: NDArray[np.bool_] | None = None,
) -> tuple[Pose, ...]:
    """Samples random poses (T_world_base) on the floor, uniformly distributed in position and heading.

    Args:
        floor: the map.
        count: number of poses.
        rng: random generator; equal generators give equal poses.
        clearance: minimum distance to obstacles, metres.
        spacing: minimum distance between two poses, metres.
        region: (H, W), mask of the allowed cells; None = ``floor.largest_free_region(clearance)``.

    Raises:
        SceneError: the floor is too small for that number of poses.
    """
    places = floor.inflate(clearance) & (floor.largest_free_region(clearance) if region is None else region)
    cells = np.argwhere(places)
    # Every point of such a cell has the clearance, so that cells can be used several times if there are few.
    drawn = rng.permutation(np.tile(np.arange(len(cells)), max(1, math.ceil(4 * count / max(len(cells), 1)))))
    points = floor.centers(cells[drawn]) + rng.uniform(-0.5, 0.5, (len(drawn), 2)) * floor.resolution
    left = np.ones(len(points), dtype=bool)
    chosen: list[NDArray[np.float64]] = []
    while len(chosen) < count:
        if not left.any():
            raise SceneError(
                f"floor at z = {floor.floor_z:g} m: only {len(chosen)} of {count} poses fit with {clearance:g} m to obstacles and "
                f"{spacing:g} m to each other; request fewer poses, or smaller distances"
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


def scene_free_poses(scene: SceneSpec) -> tuple[FreePose, ...]:
    """Returns the free poses in a scene's folder; empty if it has no ``free_poses.csv``.

    Raises:
        SceneError: the file is invalid.
    """
    path = scene.root / FREE_POSES
    return read_free_poses(path) if is_file(path) else ()


def read_free_poses(path: Path) -> tuple[FreePose, ...]:
    """Returns the poses in a file, in its order.

    Raises:
        SceneError: the file cannot be read, or a line is invalid.
    """
    try:
        rows = list(csv.reader(read_file(path, _MAX_BYTES).decode("utf-8").splitlines()))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise SceneError(f"{path}: cannot be read: {error}; write it anew with gibson-sim scene map SCENE --write") from error
    if not rows or tuple(rows[0]) != COLUMNS:
        first = repr(",".join(rows[0])) if rows else "nothing"
        raise SceneError(f"{path}: begins with {first}, must begin with {','.join(COLUMNS)}")
    return tuple(_row(row, f"{path}: line {number}") for number, row in enumerate(rows[1:], 2))


def write_free_poses(path: Path, poses: Iterable[FreePose]) -> None:
    """Writes a file of free poses, rounded: x and y to a millimetre, z to 0.1 mm, yaw to 0.0001 rad.

    Raises:
        WriteError: the file cannot be written.
    """
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(COLUMNS)
    for p in poses:
        writer.writerow((p.floor, f"{p.x:.3f}", f"{p.y:.3f}", f"{p.z:.4f}", f"{p.yaw:.4f}", p.room))
    write_file(path, text.getvalue())


def _row(row: Sequence[str], where: str) -> FreePose:
    if len(row) != len(COLUMNS):
        raise SceneError(f"{where}: has {len(row)} values, must have {len(COLUMNS)}: {','.join(COLUMNS)}")
    try:
        floor, (x, y, z, yaw) = int(row[0]), (float(text) for text in row[1:5])
    except ValueError as error:
        raise SceneError(f"{where}: {error}; floor must be a whole number, x, y, z in metres and yaw in radians") from error
    if floor < 0 or not all(map(math.isfinite, (x, y, z, yaw))):
        raise SceneError(f"{where}: is {','.join(row)}; floor must be 0 or more, the others finite numbers")
    return FreePose(floor, x, y, z, yaw, row[5])
