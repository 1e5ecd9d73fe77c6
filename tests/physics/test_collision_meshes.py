"""The simplified collision shapes of a scan give the contacts of the scan, and a level floor."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from gibson_sim.description.shapes import Shape
from gibson_sim.geometry.transforms import pose_from_xyz_rpy
from gibson_sim.physics.convex_parts import convex_parts
from gibson_sim.physics.world import PhysicsWorld
from gibson_sim.robots.spec import RobotSpec
from gibson_sim.scenes.collision import scan as scan_module
from gibson_sim.scenes.collision.scan import scan_shapes
from gibson_sim.scenes.spec import CollisionSpec, SceneSpec
from gibson_sim.types import Pose, VelocityCommand
from support.probes import BOX, SPHERE, random_places, verdicts, write_mesh
from support.scans import STEP, noisy_room

Shapes = tuple[tuple[Shape, Pose], ...]


@pytest.fixture(scope="module")
def scan(tmp_path_factory: pytest.TempPathFactory) -> tuple[Shapes, Shapes, NDArray[np.float64]]:
    """The scan, its simplified collision shapes, and its vertices."""
    folder = tmp_path_factory.mktemp("scan")
    vertices, triangles = noisy_room(edge=0.1)
    full = ((write_mesh(folder / "full.obj", vertices, triangles), Pose()),)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(scan_module, "_SAMPLES", 8_000)
        return full, scan_shapes(vertices, triangles, "room", folder=folder / "cache"), vertices


@pytest.mark.parametrize(("kind", "sizes"), [(SPHERE, (0.1, 0.2, 0.3)), (BOX, (0.2, 0.35, 0.5))], ids=["spheres", "boxes"])
def test_98_percent_of_probes_touch_both_or_neither(
    scan: tuple[Shapes, Shapes, NDArray[np.float64]], kind: str, sizes: tuple[float, ...]
) -> None:
    full, simple, vertices = scan
    places = random_places(vertices, 700, np.random.default_rng(0))
    one, other = (verdicts(shapes, places, sizes, kind) for shapes in (full, simple))
    assert 0.2 < one.mean() < 0.5
    assert (one == other).mean() > 0.98


def _world(shapes: Shapes, robot: RobotSpec, z: float) -> PhysicsWorld:
    collisions = tuple(CollisionSpec("scan", shape, pose) for shape, pose in shapes)
    start = pose_from_xyz_rpy((2.0, 2.5, z + 0.02))
    return PhysicsWorld(SceneSpec("scan", Path(), "", (), collisions, robots=(replace(robot, start=start),)))


def _heights(world: PhysicsWorld) -> NDArray[np.float64]:
    """Returns the height of a robot that drives an arc for a second, metres."""
    heights = []
    world.step(60)
    for _ in range(20):
        world.command("robot", VelocityCommand((0.3, 0.0, 0.0), (0.0, 0.0, 0.8), world.stamp_ns))
        world.step(12)
        heights.append(world.base_pose("robot").position[2])
    return np.array(heights)


def test_robot_drives_level_where_the_scan_shakes_it(scan: tuple[Shapes, Shapes, NDArray[np.float64]], robot: RobotSpec) -> None:
    full, simple, _ = scan
    with _world(full, robot, 0.0) as bumpy, _world(simple, robot, 0.0) as level:
        shaken, calm = _heights(bumpy), _heights(level)
    assert np.ptp(shaken) > 0.003
    assert np.ptp(calm) < 0.0005
    assert calm == pytest.approx(0.0, abs=0.003)


def test_step_still_stops_the_robot(scan: tuple[Shapes, Shapes, NDArray[np.float64]], robot: RobotSpec) -> None:
    start = pose_from_xyz_rpy((2.3, 0.6, 0.02), (0.0, 0.0, np.pi))
    collisions = tuple(CollisionSpec("scan", shape, pose) for shape, pose in scan[1])
    with PhysicsWorld(SceneSpec("scan", Path(), "", (), collisions, robots=(replace(robot, start=start),))) as world:
        for _ in range(50):
            world.command("robot", VelocityCommand((0.5, 0.0, 0.0), (0.0, 0.0, 0.0), world.stamp_ns))
            world.step(12)
        x, _, z = world.base_pose("robot").position
    assert x > 1.5
    assert z < STEP / 2


def test_v_hacd_fills_a_concave_object_with_convex_parts() -> None:
    corners = ((0, 0), (2, 0), (2, 1), (1, 1), (1, 2), (0, 2))
    points = np.array([(x, y, z) for z in (0, 1) for x, y in corners], dtype=np.float64)
    sides = [t for a in range(6) for b in [(a + 1) % 6] for t in ((a, b, b + 6), (a, b + 6, a + 6))]
    lids = [(0, 2, 1), (0, 3, 2), (0, 4, 3), (0, 5, 4), (6, 7, 8), (6, 8, 9), (6, 9, 10), (6, 10, 11)]
    parts = convex_parts(points, np.array(sides + lids))
    assert len(parts) >= 2
    assert sum(ConvexHull(vertices).volume for vertices, _ in parts) == pytest.approx(3.0, rel=0.1)
