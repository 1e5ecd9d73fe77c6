"""Bumper readings from contacts."""

from __future__ import annotations

import math

import numpy as np
import pytest

from gibson_sim.errors import ConfigError
from gibson_sim.robots.sensor_specs import BumperSpec
from gibson_sim.sensors.bumper import BumperReading, measure_bumper
from gibson_sim.types import Contact, SceneState, Vec3

SPEC = BumperSpec("r/base", threshold=1.0)


def touch(normal: Vec3, force: float, link: str = "base", position: Vec3 = (0.0, 0.0, 0.0)) -> Contact:
    """The robot is a, so the normal points to it."""
    return Contact("r", link, "wall", "", position, normal, force)


def read(*contacts: Contact, spec: BumperSpec = SPEC, yaw: float = 0.0, at: Vec3 = (0.0, 0.0, 0.0)) -> BumperReading:
    quat = np.array([[0.0, 0.0, math.sin(yaw / 2), math.cos(yaw / 2)]])
    return measure_bumper(spec, SceneState(9, 1, 1, ("r/base",), np.array([at]), quat, np.zeros((1, 6))), contacts)


def test_bumper_without_contact_is_not_pressed() -> None:
    reading = read()
    assert (reading.pressed, reading.links, reading.total) == (False, (), 0.0)
    assert reading.force.tolist() == [0.0, 0.0, 0.0]


def test_wall_presses_back() -> None:
    reading = read(touch((-1.0, 0.0, 0.0), 5.0))
    assert (reading.pressed, reading.links, reading.total, reading.stamp_ns) == (True, ("base",), 5.0, 9)
    assert reading.force.tolist() == [-5.0, 0.0, 0.0]


def test_floor_under_the_wheels_is_no_bump() -> None:
    reading = read(touch((0.0, 0.0, 1.0), 20.0, "wheel"), touch((0.1, 0.0, math.sqrt(0.99)), 20.0, "wheel"))
    assert (reading.pressed, reading.links) == (False, ())


def test_load_on_top_is_no_bump() -> None:
    assert not read(touch((0.0, 0.0, -1.0), 20.0)).pressed


@pytest.mark.parametrize(("angle_deg", "pressed"), [(44.0, False), (46.0, True)])
def test_slope_decides_what_is_a_floor(angle_deg: float, pressed: bool) -> None:
    normal = (math.sin(math.radians(angle_deg)), 0.0, math.cos(math.radians(angle_deg)))
    assert read(touch(normal, 5.0)).pressed == pressed


def test_forces_below_the_threshold_are_not_felt_until_they_add_up() -> None:
    light = touch((-1.0, 0.0, 0.0), 0.6)
    assert not read(light).pressed
    assert read(light).links == ("base",)
    assert read(light, light).pressed


def test_opposite_forces_cancel_in_the_vector_but_not_in_what_is_felt() -> None:
    reading = read(touch((-1.0, 0.0, 0.0), 5.0), touch((1.0, 0.0, 0.0), 5.0))
    assert (reading.pressed, reading.total) == (True, 10.0)
    assert reading.force.tolist() == [0.0, 0.0, 0.0]


def test_contact_that_names_the_robot_second_pushes_the_other_way() -> None:
    # The normal points from b to a, so away from the robot.
    reading = read(Contact("ball", "", "r", "base", (0.0, 0.0, 0.0), (1.0, 0.0, 0.0), 3.0))
    assert reading.links == ("base",)
    assert reading.force.tolist() == [-3.0, 0.0, 0.0]


def test_only_the_chosen_links_feel() -> None:
    spec = BumperSpec("r/base", links=("base",))
    reading = read(touch((-1.0, 0.0, 0.0), 5.0, "arm"), touch((0.0, 1.0, 0.0), 2.0, "base"), spec=spec)
    assert (reading.links, reading.total) == (("base",), 2.0)


def test_force_and_torque_are_in_the_frame_of_the_link() -> None:
    # The robot at (1, 2) faces left. A wall ahead (world +y) presses it at 0.2 m ahead and 0.1 m to its right, with 4 N along -y.
    reading = read(touch((0.0, -1.0, 0.0), 4.0, position=(1.1, 2.2, 0.3)), yaw=math.pi / 2, at=(1.0, 2.0, 0.0))
    assert reading.force.tolist() == pytest.approx([-4.0, 0.0, 0.0])
    # r = (0.2, -0.1, 0.3), f = (-4, 0, 0): r x f = (0, -1.2, -0.4).
    assert reading.torque.tolist() == pytest.approx([0.0, -1.2, -0.4])


def test_unknown_link_is_refused() -> None:
    with pytest.raises(ConfigError, match="bumper on 'r/gone'"):
        read(spec=BumperSpec("r/gone"))
