"""The rendered lidar on drawn scenes: against formulas, and against the rays of the physics engine."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from gibson_sim.description.shapes import Shape, VisualSpec
from gibson_sim.geometry.transforms import matrix_from_quat, quat_from_rpy
from gibson_sim.physics.world import PhysicsWorld
from gibson_sim.render.renderer import Renderer, RenderOptions
from gibson_sim.robots.load import load_robot
from gibson_sim.scenes.load import load_scene, with_robots
from gibson_sim.scenes.spec import drawn_scene
from gibson_sim.sensors.lidar import world_rays
from gibson_sim.sensors.rendered_lidar import LidarPattern, RenderedLidar, RenderedScan, even_elevations
from gibson_sim.types import Pose, SceneState
from render.drawing import BLUE, RED, box, scene, state

pytestmark = pytest.mark.egl
LINK = "robot/lidar"
SIXTEEN = LidarPattern(even_elevations(16, math.radians(-15), math.radians(15)), 720, 0.1, 30.0)
SEVEN_SIDES = [
    box((5.5, 0.0, 0.0), size=(1.0, 30.0, 10.0)),  # its face stands at x = 5
    box((-4.0, 0.0, 0.0), size=(2.0, 30.0, 10.0)),  # at x = -3
    box((0.0, 4.5, 0.0), size=(30.0, 1.0, 10.0)),  # at y = 4
    box((0.0, -2.5, 0.0), size=(30.0, 1.0, 10.0)),  # at y = -2
    box((0.0, 0.0, -1.5), size=(30.0, 30.0, 1.0)),  # at z = -1
]


def measure(
    pattern: LidarPattern, *visuals: VisualSpec, rpy: tuple[float, float, float] = (0.0, 0.0, 0.0), **options: bool
) -> RenderedScan:
    with Renderer(scene(*visuals, links=(LINK,))) as renderer:
        now = state((LINK,), [(0.0, 0.0, 0.0)], [quat_from_rpy(*rpy)], stamp_ns=7)
        return RenderedLidar(LINK, pattern, **options).measure(now, renderer)


def directions(pattern: LidarPattern) -> NDArray[np.float64]:
    return RenderedLidar(LINK, pattern).directions.reshape(len(pattern.elevations), pattern.azimuth_steps, 3)


def room_ranges(d: NDArray[np.float64]) -> NDArray[np.float64]:
    """Returns the distances of the sides above along unit vectors (..., 3)."""
    with np.errstate(divide="ignore"):
        sides = [5.0 / d[..., 0], -3.0 / d[..., 0], 4.0 / d[..., 1], -2.0 / d[..., 1], -1.0 / d[..., 2]]
    return np.minimum.reduce([np.where(s > 0.0, s, np.inf) for s in sides])


@pytest.mark.parametrize("rpy", [(0.0, 0.0, 0.0), (0.1, -0.2, 2.0)], ids=["level", "tilted"])
def test_sides_of_a_room_are_exact_to_two_millimetres_but_beside_its_edges(rpy: tuple[float, float, float]) -> None:
    scan = measure(SIXTEEN, *SEVEN_SIDES, rpy=rpy)
    expected = room_ranges(directions(SIXTEEN) @ matrix_from_quat(quat_from_rpy(*rpy)).T)
    error = np.abs(scan.ranges - expected)
    assert np.mean(error < 0.002) > 0.98
    assert error.max() < 0.06
    assert (scan.stamp_ns, scan.link) == (7, LINK)


def test_flat_wall_at_five_metres_is_exact_to_two_millimetres_all_over() -> None:
    ranges = measure(SIXTEEN, SEVEN_SIDES[0]).ranges
    expected = 5.0 / directions(SIXTEEN)[..., 0]
    seen = np.isfinite(ranges) & (expected > 0.0) & (expected < 20.0)
    assert seen.sum() > 16 * 240
    assert np.abs(ranges[seen] - expected[seen]).max() < 0.002


def test_points_lie_on_the_wall_and_know_their_ray() -> None:
    scan = measure(SIXTEEN, SEVEN_SIDES[0])
    np.testing.assert_allclose(scan.points[:, 0], 5.0, atol=0.003)
    np.testing.assert_allclose(np.linalg.norm(scan.points, axis=1), scan.ranges[scan.ring, scan.column], rtol=1e-6)
    heights = np.arctan2(scan.points[:, 2], np.hypot(scan.points[:, 0], scan.points[:, 1]))
    np.testing.assert_allclose(heights, np.array(SIXTEEN.elevations)[scan.ring], atol=1e-5)


def test_points_on_a_ball_are_a_radius_from_its_middle() -> None:
    ball = VisualSpec("ball", "", Shape("sphere", (1.0, 0.0, 0.0)), Pose((4.0, 0.0, 0.0)), RED)
    scan = measure(SIXTEEN, ball)
    away = np.linalg.norm(scan.points - (4.0, 0.0, 0.0), axis=1)
    assert len(away) > 500
    # It is drawn as facets, whose centres are up to a centimetre deeper; a facet is extrapolated beyond its edge by part of a pixel.
    assert away.max() < 1.003
    assert np.mean(away > 0.99) > 0.97


def test_labels_are_those_of_what_each_ray_meets() -> None:
    left = replace(box((0.0, 4.5, 0.0), RED, (30.0, 1.0, 10.0)), name="left", semantic_class="wall")
    post = replace(box((3.0, 0.0, 0.0), BLUE), name="post", semantic_class="pillar")
    scan = measure(SIXTEEN, left, post, labels=True)
    assert scan.semantic is not None and scan.instance is not None
    # Classes in alphabetical order after "unlabelled": pillar 1, wall 2; instances in the order of the scene.
    nearer = scan.points[:, 0] ** 2 + scan.points[:, 1] ** 2 < 3.0**2
    np.testing.assert_array_equal(scan.semantic, np.where(nearer, 1, 2))
    np.testing.assert_array_equal(scan.instance, np.where(nearer, 2, 1))


def test_intensity_falls_with_the_cosine_at_which_a_wall_is_met() -> None:
    scan = measure(
        replace(SIXTEEN, elevations=(0.0,)), box((5.5, 0.0, 0.0), (1.0, 1.0, 1.0, 1.0), (1.0, 30.0, 10.0)), intensity=True
    )
    assert scan.intensity is not None
    ahead = scan.intensity[scan.column == 0][0]
    # Column 120 of 720 is 60 degrees to the left: half of the light.
    assert scan.intensity[scan.column == 120][0] == pytest.approx(0.5 * ahead, rel=0.02)
    assert 0.2 < ahead <= 1.0


def test_own_body_is_invisible_unless_requested() -> None:
    shell = box((0.0, 0.0, 0.0), RED, (0.8, 0.8, 0.8), link=LINK)
    wall = box((5.5, 0.0, 0.0), size=(1.0, 30.0, 10.0))
    assert measure(SIXTEEN, shell, wall).ranges[7, 0] == pytest.approx(5.0, abs=0.03)
    assert measure(SIXTEEN, shell, wall, see_own_body=True).ranges[7, 0] == pytest.approx(0.4, abs=0.01)


# A visual without a collision shape: rays of the physics engine pass through.
NO_COLLISION = ("ceiling", "floor", "painting", "rug", "skirting")


@pytest.mark.parametrize("start", [0, 3])
def test_flat_is_the_same_as_for_the_rays_of_the_physics_engine(root: Path, start: int) -> None:
    flat = load_scene(root / "scenes/flat")
    robot = replace(load_robot(root / "config/robots/gibson_bot"), start=flat.starts[start].pose)
    whole = with_robots(flat, [robot])
    lidar = RenderedLidar(f"{robot.name}/base_scan", SIXTEEN, labels=True)
    with PhysicsWorld(whole) as world:
        now = world.state()
        cast = world.cast_rays(*world_rays(_pose(now, lidar.link), lidar.directions), SIXTEEN.range_max, robot.name)
    drawn = drawn_scene(whole, now.links)
    with Renderer(drawn, options=RenderOptions(detail_px=0.0)) as renderer:
        scan = lidar.measure(now, renderer)
    classes = [drawn.semantic_classes.index(name) for name in NO_COLLISION]
    assert scan.semantic is not None
    solid = ~np.isin(scan.semantic, classes)
    distances = cast.reshape(scan.ranges.shape)[scan.ring, scan.column]
    off = np.abs(scan.ranges[scan.ring, scan.column] - distances)[solid]
    assert len(off) > 6000
    # The others are rays that pass an edge within half a pixel.
    assert np.mean(off < 0.01) > 0.985
    assert np.mean(off < 0.001) > 0.97


def _pose(now: SceneState, link: str) -> NDArray[np.float64]:
    row = now.links.index(link)
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = matrix_from_quat(now.quats_xyzw[row]), now.positions[row]
    return T
