"""Capsules, ellipsoids and cones: their triangles, their extents and what they rest on."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from gibson_sim.description.body import BodySpec
from gibson_sim.description.extents import radius_and_top, shape_points
from gibson_sim.description.shapes import Shape
from gibson_sim.description.urdf import Inertial, UrdfCollision, UrdfLink, UrdfModel
from gibson_sim.formats.load_mesh import primitive_mesh
from gibson_sim.geometry.transforms import matrix_from_pose, pose_from_xyz_rpy
from gibson_sim.physics.world import PhysicsWorld
from gibson_sim.scenes.spec import CollisionSpec, SceneSpec
from gibson_sim.types import Pose

CAPSULE, ELLIPSOID, CONE = Shape("capsule", (0.1, 0.3, 0.0)), Shape("ellipsoid", (0.1, 0.2, 0.3)), Shape("cone", (0.2, 0.4, 0.0))
SHAPES = [CAPSULE, ELLIPSOID, CONE]
HALF = {"capsule": (0.1, 0.1, 0.25), "ellipsoid": (0.1, 0.2, 0.3), "cone": (0.2, 0.2, 0.2)}
"""Half of the edges of each shape's bounding box, metres."""
VOLUME = {
    "capsule": math.pi * 0.1**2 * 0.3 + 4 / 3 * math.pi * 0.1**3,
    "ellipsoid": 4 / 3 * math.pi * 0.1 * 0.2 * 0.3,
    "cone": math.pi * 0.2**2 * 0.4 / 3,
}
"""Volumes, m^3."""


def _names(shape: Shape) -> str:
    return shape.kind


@pytest.mark.parametrize("shape", SHAPES, ids=_names)
def test_triangles_enclose_the_volume_of_the_shape(shape: Shape) -> None:
    (part,) = primitive_mesh(shape).parts
    a, b, c = (part.vertices[part.triangles[:, k]].astype(float) for k in range(3))
    volume = np.einsum("ij,ij->", np.cross(a, b), c) / 6
    assert VOLUME[shape.kind] * 0.98 < volume < VOLUME[shape.kind]  # 48 corners on a circle
    np.testing.assert_allclose(part.vertices.max(axis=0), HALF[shape.kind], rtol=1e-6)
    np.testing.assert_allclose(part.vertices.min(axis=0), -np.array(HALF[shape.kind]), rtol=1e-6)


@pytest.mark.parametrize("shape", SHAPES, ids=_names)
def test_normals_point_outwards_along_those_of_the_triangles(shape: Shape) -> None:
    (part,) = primitive_mesh(shape).parts
    corners = part.vertices[part.triangles].astype(float)
    flat = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    flat /= np.linalg.norm(flat, axis=1, keepdims=True)
    np.testing.assert_allclose(np.linalg.norm(part.normals, axis=1), 1.0, atol=1e-6)
    assert np.einsum("ij,ikj->ik", flat, part.normals[part.triangles].astype(float)).min() > 0.9


@pytest.mark.parametrize("shape", SHAPES, ids=_names)
def test_extents_are_those_of_the_shape(shape: Shape) -> None:
    points = shape_points(shape)
    assert points is not None
    np.testing.assert_allclose(points.max(axis=0), HALF[shape.kind], atol=1e-12)
    np.testing.assert_allclose(points.min(axis=0), -np.array(HALF[shape.kind]), atol=1e-12)


def test_radius_and_top_of_a_tilted_capsule_are_those_of_its_farther_sphere() -> None:
    T = matrix_from_pose(pose_from_xyz_rpy((1.0, 0.0, 0.5), (0.0, math.pi / 6, 0.0)))
    x, z = 1.0 + 0.15 * math.sin(math.pi / 6), 0.5 + 0.15 * math.cos(math.pi / 6)
    assert radius_and_top(CAPSULE, T) == pytest.approx((x + 0.1, z + 0.1), abs=1e-12)


def _body(shape: Shape, z: float = 1.0, *, static: bool = False) -> BodySpec:
    link = UrdfLink("body", (), (UrdfCollision(shape, Pose()),), Inertial(1.0, Pose(), (0.01, 0.0, 0.0, 0.01, 0.0, 0.01)))
    model = UrdfModel("m", Path("/nowhere/x.urdf"), (link,), ())
    return BodySpec("m", model, pose_from_xyz_rpy((0.0, 0.0, z)), static)


@pytest.mark.parametrize("shape", SHAPES, ids=_names)
def test_a_body_rests_on_its_lowest_point(shape: Shape) -> None:
    with PhysicsWorld(SceneSpec("flat", Path("/nowhere"), "0", (), (), ground_z=0.0)) as world:
        world.add(_body(shape, HALF[shape.kind][2] + 0.01))
        world.step(20)  # before it topples
        assert world.body_pose("m").position[2] == pytest.approx(HALF[shape.kind][2], abs=2e-3)


@pytest.mark.parametrize("fixed", ["scene", "body"])
@pytest.mark.parametrize("shape", SHAPES, ids=_names)
def test_a_box_rests_on_top_of_a_fixed_one(shape: Shape, fixed: str) -> None:
    collisions = (CollisionSpec("c", shape, pose_from_xyz_rpy((0.0, 0.0, 1.0))),) if fixed == "scene" else ()
    with PhysicsWorld(SceneSpec("one", Path("/nowhere"), "0", (), collisions, ground_z=0.0)) as world:
        if fixed == "body":
            world.add(_body(shape, static=True))
        box = _body(Shape("box", (0.2, 0.2, 0.2)))
        world.add(BodySpec("box", box.model, pose_from_xyz_rpy((0.0, 0.0, 1.11 + HALF[shape.kind][2]))))
        world.step(20)  # before it falls off
        assert world.body_pose("box").position[2] == pytest.approx(1.1 + HALF[shape.kind][2], abs=2e-3)


@pytest.mark.parametrize("shape", ["ground", "box"])
@pytest.mark.parametrize(("friction", "slides"), [(1.0, False), (0.1, True)])
def test_friction_of_the_world_decides_whether_a_box_slides(shape: str, friction: float, slides: bool) -> None:
    # Gravity is 17 degrees off the vertical: a box with a coefficient of 0.5 stays on ground with 1, and slides on one with 0.1.
    slab = CollisionSpec("slab", Shape("box", (40.0, 40.0, 0.1)), pose_from_xyz_rpy((0.0, 0.0, -0.05)), friction)
    collisions = (slab,) if shape == "box" else ()
    ground_z = 0.0 if shape == "ground" else None
    scene = SceneSpec("ice", Path("/nowhere"), "0", (), collisions, ground_z, gravity=(3.0, 0.0, -9.81), ground_friction=friction)
    with PhysicsWorld(scene) as world:
        world.add(_body(Shape("box", (0.2, 0.2, 0.1)), 0.05))
        world.step(240)
        assert (world.body_pose("m").position[0] > 0.5) == slides
