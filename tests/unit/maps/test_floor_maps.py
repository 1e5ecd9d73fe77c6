"""Traversability for robots of several sizes: steps, slopes, platforms, storeys, bodies, and the region indoors."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from gibson_sim.description.body import BodySpec
from gibson_sim.description.shapes import Shape
from gibson_sim.description.urdf import UrdfCollision, UrdfJoint, UrdfLink, UrdfModel
from gibson_sim.errors import SceneError
from gibson_sim.maps.bodies import body_triangles, link_transforms
from gibson_sim.maps.floor_map import FloorMap, make_floor_map
from gibson_sim.maps.traversability import RobotSize, find_floors, floor_maps, scene_floors, traversable_map
from gibson_sim.scenes.spec import CollisionSpec, SceneSpec
from gibson_sim.types import Pose

Corners = list[list[float]]


def _quad(a: list[float], b: list[float], c: list[float], d: list[float]) -> Corners:
    return [a, b, c, a, c, d]


def _level(x0: float, y0: float, x1: float, y1: float, z: float) -> Corners:
    return _quad([x0, y0, z], [x1, y0, z], [x1, y1, z], [x0, y1, z])


def _box(x0: float, y0: float, x1: float, y1: float, top: float, bottom: float = 0.0) -> Corners:
    sides = [((x0, y0), (x1, y0)), ((x1, y0), (x1, y1)), ((x1, y1), (x0, y1)), ((x0, y1), (x0, y0))]
    out = _level(x0, y0, x1, y1, top)
    for (a, b), (c, d) in sides:
        out += _quad([a, b, bottom], [c, d, bottom], [c, d, top], [a, b, top])
    return out


def _walls(x0: float, y0: float, x1: float, y1: float, z: float = 0.0, height: float = 2.4) -> Corners:
    ends = [(x0, y0), (x1, y0), (x1, y1), (x0, y1), (x0, y0)]
    out: Corners = []
    for (a, b), (c, d) in pairwise(ends):
        out += _quad([a, b, z], [c, d, z], [c, d, z + height], [a, b, z + height])
    return out


def _triangles(corners: Corners) -> NDArray[np.float64]:
    return np.array(corners, dtype=float).reshape(-1, 3, 3)


def _map(corners: Corners, robot: RobotSize | None = None, **more: float) -> FloorMap:
    return traversable_map(_triangles(corners), floor_z=0.0, robot=robot or RobotSize(), resolution=0.1, **more)  # type: ignore[arg-type]


def _free_at(floor: FloorMap, x: float, y: float) -> bool:
    return bool(floor.free[tuple(floor.cells((x, y)))])


ROOM = _level(0, 0, 4, 3, 0) + _walls(0, 0, 4, 3)


@pytest.mark.parametrize(("step", "climbs"), [(0.07, False), (0.08, True)])
def test_platform_is_free_for_a_robot_that_climbs_its_step(step: float, climbs: bool) -> None:
    floor = _map(ROOM + _box(2.0, 1.0, 3.0, 2.0, 0.08), RobotSize(step=step))
    assert _free_at(floor, 2.55, 1.55) is climbs
    assert _free_at(floor, 1.0, 1.5)


def test_seat_of_a_chair_is_not_free_although_it_is_level() -> None:
    assert not _free_at(_map(ROOM + _box(2.0, 1.0, 2.5, 1.5, 0.25), RobotSize(step=0.1)), 2.25, 1.25)


@pytest.mark.parametrize(("rise", "climbs"), [(0.25, True), (0.29, False)])
def test_ramp_is_free_up_to_the_slope_limit(rise: float, climbs: bool) -> None:
    # Over 1 m, up to a platform: 14 and 16 degrees, and the limit is 15.
    ramp = _quad([1.0, 1.0, 0.0], [2.0, 1.0, rise], [2.0, 2.0, rise], [1.0, 2.0, 0.0])
    floor = _map(ROOM + ramp + _box(2.0, 1.0, 3.0, 2.0, rise), RobotSize(slope=np.radians(15.0)))
    assert _free_at(floor, 2.55, 1.55) is climbs


@pytest.mark.parametrize(("height", "passes"), [(0.6, True), (0.8, False)])
def test_low_passage_is_free_for_a_robot_that_fits_below(height: float, passes: bool) -> None:
    floor = _map(ROOM + _box(1.0, 0.0, 2.0, 3.0, 1.2, bottom=0.7) + _level(1, 0, 2, 3, 0.7), RobotSize(height=height))
    assert _free_at(floor, 1.55, 1.55) is passes


def test_hole_in_the_floor_is_not_free() -> None:
    pit = _level(0, 0, 2, 3, 0) + _level(3, 0, 4, 3, 0) + _level(2, 0, 3, 3, -1.0) + _walls(0, 0, 4, 3)
    floor = _map(pit)
    assert not _free_at(floor, 2.55, 1.55)
    assert _free_at(floor, 1.0, 1.5)


def test_ground_plane_is_floor_where_the_mesh_has_none() -> None:
    floor = _map(_walls(0, 0, 4, 3), ground_plane=True)
    assert _free_at(floor, 2.0, 1.5)
    assert floor.largest_free_region()[tuple(floor.cells((2.0, 1.5)))]


def test_size_that_no_robot_has_is_refused() -> None:
    with pytest.raises(SceneError, match=r"step is 0\.5 m, must be from 0 to 0\.3 m"):
        RobotSize(step=0.5)
    with pytest.raises(SceneError, match=r"height is 0\.1 m, must be more than step"):
        RobotSize(height=0.1, step=0.2)


TWO_STOREYS = ROOM + _level(0, 0, 4, 3, 2.8) + _walls(0, 0, 4, 3, z=2.8) + _level(0, 0, 4, 3, 5.3)


def test_floors_of_all_storeys_are_found_and_the_roof_is_none() -> None:
    corners = _triangles(TWO_STOREYS + _box(1.0, 1.0, 3.0, 2.0, 0.75))
    assert find_floors(corners.reshape(-1, 3), np.arange(3 * len(corners)).reshape(-1, 3)) == pytest.approx((0.0, 2.8))


def _scene(folder: Path, corners: Corners, **more: object) -> SceneSpec:
    text = [f"v {x:.4f} {y:.4f} {z:.4f}" for x, y, z in corners]
    text += [f"f {i + 1} {i + 2} {i + 3}" for i in range(0, len(corners), 3)]
    (folder / "mesh.obj").write_text("\n".join(text) + "\n")
    mesh = CollisionSpec("mesh", Shape("mesh", (1.0, 1.0, 1.0), str(folder / "mesh.obj")))
    return SceneSpec("test", folder, "", (), (mesh,), **more)  # type: ignore[arg-type]


def test_every_storey_gets_a_map(tmp_path: Path) -> None:
    scene = _scene(tmp_path, TWO_STOREYS + _box(1.0, 1.0, 2.0, 2.0, 3.3, bottom=2.8))
    assert scene_floors(scene) == pytest.approx((0.0, 2.8))
    lower, upper = floor_maps(scene, resolution=0.1)
    assert _free_at(lower, 1.5, 1.5)
    assert not _free_at(upper, 1.5, 1.5)
    assert upper.floor_z == pytest.approx(2.8)


def _door(angle: float) -> BodySpec:
    """A leaf from the hinge at (2, 1) along y, 0.8 m wide, rotated about the hinge."""
    leaf = UrdfLink("leaf", collisions=(UrdfCollision(Shape("box", (0.04, 0.8, 2.0)), Pose((0.0, 0.4, 1.0))),))
    hinge = UrdfJoint("hinge", "revolute", "frame", "leaf", Pose(), (0.0, 0.0, 1.0), -1.6, 1.6)
    model = UrdfModel("door", Path("door.urdf"), (UrdfLink("frame"), leaf), (hinge,))
    return BodySpec("door", model, Pose((2.0, 1.0, 0.0)), joints=(("hinge", angle),))


def test_movable_parts_are_mapped_at_their_joint_positions(tmp_path: Path) -> None:
    shut, ajar = ((_scene(tmp_path, ROOM, bodies=(_door(angle),))) for angle in (0.0, -np.pi / 2))
    # Rotated by -90 degrees, a leaf along +y points along +x.
    assert link_transforms(ajar.bodies[0])["leaf"][:3, :3] @ (0, 1, 0) == pytest.approx((1, 0, 0))
    for scene, places in ((shut, (False, True)), (ajar, (True, False))):
        floor = floor_maps(scene, resolution=0.1)[0]
        assert (_free_at(floor, 2.01, 1.55), _free_at(floor, 2.55, 1.01)) == places
    assert _free_at(floor_maps(shut, resolution=0.1, bodies=False)[0], 2.01, 1.55)


def _house(lawn: Corners, ceiling: bool, gap: bool) -> FloorMap:
    """A house of 4 x 3 m, of which one wall may have a gap of 1 m, on a lawn."""
    walls = _quad([0, 0, 0], [0, 3, 0], [0, 3, 2], [0, 0, 2]) + _quad([4, 0, 0], [4, 3, 0], [4, 3, 2], [4, 0, 2])
    walls += _quad([0, 3, 0], [4, 3, 0], [4, 3, 2], [0, 3, 2])
    walls += _quad([0, 0, 0], [1.5 if gap else 4, 0, 0], [1.5 if gap else 4, 0, 2], [0, 0, 2])
    walls += _quad([2.5, 0, 0], [4, 0, 0], [4, 0, 2], [2.5, 0, 2])
    points = _triangles(lawn + walls + (_level(0, 0, 4, 3, 2.4) if ceiling else [])).reshape(-1, 3)
    return make_floor_map(points, np.arange(len(points)).reshape(-1, 3), floor_z=0.0, robot_height=0.5, resolution=0.1)


LAWN = _level(-6, -6, 10, 9, 0)
FENCE = _walls(-5, -5, 9, 8, height=1.0)


@pytest.mark.parametrize(
    ("lawn", "ceiling", "gap"),
    [(LAWN, False, False), (LAWN, True, False), (LAWN, True, True), (LAWN + FENCE, True, False)],
    ids=["lawn", "lawn and ceiling", "open door", "fence"],
)
def test_lawn_around_a_house_is_not_taken_for_indoors(lawn: Corners, ceiling: bool, gap: bool) -> None:
    floor = _house(lawn, ceiling, gap)
    region = floor.largest_free_region(0.2)
    inside = region[tuple(floor.cells((2.0, 1.5)))]
    assert inside
    assert not region[tuple(floor.cells((-3.0, 1.5)))]


def test_open_floor_without_any_wall_is_a_region() -> None:
    floor = _map(_level(0, 0, 4, 3, 0))
    assert floor.largest_free_region(0.2).any()


def _turned(corners: Corners) -> Corners:
    """Returns the triangles with flipped faces."""
    return [corner for k in range(0, len(corners), 3) for corner in (corners[k], corners[k + 2], corners[k + 1])]


def _standing(bottom: float) -> Corners:
    """A wardrobe higher than the robot, whose underside is ``bottom`` above the floor and faces down."""
    return _box(1.0, 1.0, 3.0, 2.0, 2.0, bottom=bottom) + _turned(_level(1, 1, 3, 2, bottom))


@pytest.mark.parametrize("ground_plane", [False, True], ids=["floor", "ground plane"])
@pytest.mark.parametrize("bottom", [0.0, 0.02])
def test_inside_of_a_wardrobe_on_the_floor_nothing_is_free(bottom: float, ground_plane: bool) -> None:
    corners = _triangles((_walls(0, 0, 4, 3) if ground_plane else ROOM) + _standing(bottom))
    simple = make_floor_map(
        corners.reshape(-1, 3), np.arange(3 * len(corners)).reshape(-1, 3), floor_z=0.0, robot_height=0.5, resolution=0.1,
        ground_plane=ground_plane,
    )  # fmt: skip
    for floor in (simple, traversable_map(corners, floor_z=0.0, robot=RobotSize(), resolution=0.1, ground_plane=ground_plane)):
        assert not _free_at(floor, 2.05, 1.55)
        assert floor.occupied[tuple(floor.cells((2.05, 1.55)))]
        assert _free_at(floor, 0.5, 1.5)


def test_below_a_table_and_below_a_roof_seen_from_above_alone_the_floor_is_free() -> None:
    # The top of the table faces up, and so do the roof and an upper floor without a ceiling.
    floor = _map(ROOM + _level(1, 1, 3, 2, 0.75) + _level(0, 0, 4, 3, 2.5))
    assert _free_at(floor, 2.05, 1.55) and _free_at(floor, 0.5, 0.5)


def test_a_rug_lies_on_the_floor_and_is_free() -> None:
    floor = _map(ROOM + _box(1, 1, 3, 2, 0.015) + _turned(_level(1, 1, 3, 2, 0.0)))
    assert _free_at(floor, 2.05, 1.55)


@pytest.mark.parametrize("doubled", [True, False], ids=["doubled", "turned"])
def test_a_room_whose_faces_are_turned_or_doubled_keeps_its_floor(doubled: bool) -> None:
    inside_out = _turned(ROOM) + _level(0, 0, 4, 3, 2.5)
    floor = _map(inside_out + (ROOM if doubled else []))
    assert _free_at(floor, 2.05, 1.55)


def test_hulls_of_bodies_face_outwards(tmp_path: Path) -> None:
    path = tmp_path / "wedge.obj"
    path.write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nv 1 1 1\nf 1 2 3\nf 1 2 4\nf 2 3 5\nf 3 4 5\n")
    link = UrdfLink("wedge", collisions=(UrdfCollision(Shape("mesh", (1.0, 1.0, 1.0), str(path)), Pose()),))
    body = BodySpec("wedge", UrdfModel("wedge", Path("wedge.urdf"), (link,), ()), Pose((2.0, 1.0, 0.0)))
    vertices, triangles = body_triangles(_scene(tmp_path, ROOM, bodies=(body,)))
    corners = vertices[triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert (np.einsum("ij,ij->i", normals, corners.mean(axis=1) - vertices.mean(axis=0)) > 0).all()
