"""Support polygon, stability margin and footprint of bodies whose values are known by hand."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from gibson_sim.description.shapes import Shape
from gibson_sim.description.urdf import parse_urdf
from gibson_sim.description.urdf_model import UrdfModel
from gibson_sim.geometry.transforms import matrix_from_pose, pose_from_xyz_rpy
from gibson_sim_tools.robots.stability import base_links, convex_polygon, footprint, lowest_points, stability

FEET = ((0.3, 0.2), (0.3, -0.2), (-0.1, 0.2), (-0.1, -0.2))


def table(feet: tuple[tuple[float, float], ...] = FEET, *, mass_at: str = "0 0.05 0.4") -> UrdfModel:
    """10 kg in one point above feet of 10 mm radius; the box on top is wider than they are."""
    balls = "".join(
        f'<collision><origin xyz="{x} {y} 0.01"/><geometry><sphere radius="0.01"/></geometry></collision>' for x, y in feet
    )
    top = '<collision><origin xyz="0.1 0 0.5"/><geometry><box size="0.6 0.5 0.02"/></geometry></collision>'
    inertia = '<inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/>'
    inertial = f'<inertial><origin xyz="{mass_at}"/><mass value="10"/>{inertia}</inertial>'
    return parse_urdf(f'<robot name="t"><link name="base">{inertial}{balls}{top}</link></robot>', Path("t.urdf"))


def test_margin_and_tipping_accelerations_are_those_of_statics() -> None:
    stable = stability(table(), {"base": np.eye(4)})
    assert sorted(map(tuple, stable.support.tolist())) == sorted(FEET)
    assert (stable.mass, stable.center_of_mass.tolist()) == (10.0, pytest.approx([0.0, 0.05, 0.4]))
    assert stable.margin == pytest.approx(0.1)
    assert stable.tilt_margin == pytest.approx(math.atan(0.1 / 0.4))
    # a / g = distance to the edge that the inertial force points to, over the height: behind 0.1, in front 0.3, right 0.25, left 0.15.
    expected = {(1.0, 0.0): 0.1, (-1.0, 0.0): 0.3, (0.0, 1.0): 0.25, (0.0, -1.0): 0.15}
    for direction, distance in expected.items():
        assert stable.tipping_acceleration(direction) == pytest.approx(9.81 * distance / 0.4)


def test_a_robot_supported_on_a_line_or_outside_its_feet_tips_over() -> None:
    on_a_line = stability(table(FEET[:2]), {"base": np.eye(4)})
    assert (len(on_a_line.support), on_a_line.margin, on_a_line.tipping_acceleration((1.0, 0.0))) == (2, 0.0, 0.0)
    beside = stability(table(mass_at="0.5 0 0.4"), {"base": np.eye(4)})
    assert beside.margin == pytest.approx(-0.2)
    assert beside.tipping_acceleration((1.0, 0.0)) == 0.0


def test_feet_above_the_floor_bear_nothing() -> None:
    lifted = np.eye(4)
    lifted[2, 3] = 0.003
    assert len(stability(table(), {"base": lifted}).support) == 0


def test_a_footprint_holds_all_shapes_and_turns_with_the_base() -> None:
    assert sorted(np.round(footprint(table(), {"base": np.eye(4)}), 6).tolist()) == [
        [-0.2, -0.25],
        [-0.2, 0.25],
        [0.4, -0.25],
        [0.4, 0.25],
    ]
    T_world_base = matrix_from_pose(pose_from_xyz_rpy((3.0, 1.0, 0.0), (0.0, 0.0, 1.2)))
    links = base_links(T_world_base, {"base": T_world_base})
    assert np.allclose(links["base"], np.eye(4))
    assert np.allclose(footprint(table(), links), footprint(table(), {"base": np.eye(4)}))


def test_a_round_robot_has_a_polygon_around_it() -> None:
    shape = '<collision><geometry><cylinder radius="0.2" length="0.1"/></geometry></collision>'
    corners = footprint(
        parse_urdf(f'<robot name="r"><link name="base">{shape}</link></robot>', Path("r.urdf")), {"base": np.eye(4)}
    )
    assert len(corners) == 16
    assert np.hypot(*corners.T) == pytest.approx(0.2 / math.cos(math.pi / 16), rel=2e-3)


def test_a_wheel_stands_on_a_line_and_a_disc_on_its_rim() -> None:
    wheel = matrix_from_pose(pose_from_xyz_rpy((1.0, 0.0, 0.1), (math.pi / 2, 0.0, 0.0)))
    assert sorted(lowest_points(Shape("cylinder", (0.1, 0.04, 0.0)), wheel).round(9).tolist()) == [
        [1.0, -0.02, 0.0],
        [1.0, 0.02, 0.0],
    ]
    cambered = wheel @ matrix_from_pose(pose_from_xyz_rpy(rpy=(0.1, 0.0, 0.0)))
    assert len(lowest_points(Shape("cylinder", (0.1, 0.04, 0.0)), cambered)) == 1
    disc = lowest_points(Shape("cylinder", (0.1, 0.04, 0.0)), np.eye(4))
    assert len(disc) == 72 and disc[:, 2] == pytest.approx(-0.02)


def test_polygons_lose_corners_on_their_edges() -> None:
    square = np.array([[0.0, 0.0], [0.5, -0.0004], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0], [0.5, 0.5]])
    assert len(convex_polygon(square)) == 4
    assert convex_polygon(np.array([[0.0, 0.0], [1.0, 1.0], [0.5, 0.5]])).tolist() == [[0.0, 0.0], [1.0, 1.0]]
    assert len(convex_polygon(np.zeros((0, 2)))) == 0
