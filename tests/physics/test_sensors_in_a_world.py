"""Our robot's sensors in the physics engine: at rest, on a circle, against a wall."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace

import numpy as np
import pytest

from gibson_sim.description.shapes import Shape
from gibson_sim.geometry.transforms import yaw_from_quat
from gibson_sim.physics.world import PhysicsWorld
from gibson_sim.robots.sensor_specs import Lidar3DSpec, SensorSpecs
from gibson_sim.robots.spec import RobotSpec
from gibson_sim.scenes.spec import CollisionSpec, SceneSpec
from gibson_sim.sensors.suite import Measurements, SensorSuite
from gibson_sim.types import Pose, VelocityCommand

STEP_HZ = 240
WALL = CollisionSpec("wall", Shape("box", (0.2, 4.0, 1.0)), Pose((0.6, 0.0, 0.5)))  # its face is at x = 0.5
Step = Callable[[float, float, float], list[Measurements]]


@contextmanager
def driving(scene: SceneSpec) -> Iterator[Step]:
    """Returns a function that drives (m/s, rad/s, seconds) and returns the measurements of every step."""
    robot = scene.robots[0]
    suite = SensorSuite(robot, STEP_HZ, 60, scene.gravity)
    with PhysicsWorld(scene, step_hz=STEP_HZ) as world:

        def step(linear: float, angular: float, seconds: float) -> list[Measurements]:
            out = []
            for _ in range(round(seconds * STEP_HZ)):
                world.command(robot.name, VelocityCommand((linear, 0.0, 0.0), (0.0, 0.0, angular), world.stamp_ns))
                world.step()
                out.append(suite.measure(world, world.step_count, world.stamp_ns))
            return out

        yield step


def forces(found: list[Measurements]) -> np.ndarray:
    return np.array([imu.linear_acceleration for got in found for imu in got.imus])


def test_imu_of_a_standing_robot_feels_gravity_and_no_turning(flat: SceneSpec) -> None:
    with driving(flat) as drive:
        drive(0.0, 0.0, 1.0)
        found = drive(0.0, 0.0, 1.0)
    assert len(forces(found)) == 100
    assert forces(found).mean(axis=0).tolist() == pytest.approx([0.0, 0.0, 9.81], abs=0.02)
    assert abs(np.array([imu.angular_velocity for got in found for imu in got.imus])).max() < 0.01


def test_imu_on_a_circle_feels_the_centripetal_force(flat: SceneSpec) -> None:
    # 0.4 m/s at 1.5 rad/s: v w = 0.6 m/s^2 to the left.
    with driving(flat) as drive:
        drive(0.4, 1.5, 2.0)
        found = drive(0.4, 1.5, 2.0)
    assert forces(found).mean(axis=0).tolist() == pytest.approx([0.0, 0.6, 9.81], abs=0.05)
    assert np.mean([imu.angular_velocity[2] for got in found for imu in got.imus]) == pytest.approx(1.5, rel=0.02)


def test_wheels_on_the_floor_do_not_press_the_bumper(flat: SceneSpec) -> None:
    with driving(flat) as drive:
        found = drive(0.5, 1.0, 3.0)
    readings = [bumper for got in found for bumper in got.bumpers]
    assert len(readings) == 90
    assert not any(reading.pressed or reading.total for reading in readings)


def test_wall_presses_the_bumper_from_the_front(make_scene: Callable[..., SceneSpec], robot: RobotSpec) -> None:
    with driving(make_scene(robot, collisions=(WALL,))) as drive:
        assert not any(bumper.pressed for got in drive(0.0, 0.0, 0.5) for bumper in got.bumpers)
        drive(0.3, 0.0, 2.0)
        pushing = [bumper for got in drive(0.3, 0.0, 0.5) for bumper in got.bumpers]
    assert all(bumper.pressed for bumper in pushing)
    assert np.mean([bumper.force[0] for bumper in pushing]) < -1.0


def test_points_of_a_lidar_with_many_channels_lie_on_floor_and_wall(
    make_scene: Callable[..., SceneSpec], robot: RobotSpec
) -> None:
    lidar = Lidar3DSpec(f"{robot.name}/base_scan", channels=8, samples=90, rate_hz=60.0, range_max=10.0)
    scene = make_scene(replace(robot, sensors=SensorSpecs(lidars_3d=(lidar,))), collisions=(WALL,))
    with driving(scene) as drive:
        cloud = drive(0.0, 0.0, 0.5)[-1].clouds[0]
    # The lidar is 0.16 m above the floor; the wall's face stands at x = 0.5 of the world.
    with PhysicsWorld(scene) as world:
        T_base_lidar = world.state().positions[world.links.index(lidar.link)]
    height, ahead = T_base_lidar[2], 0.5 - T_base_lidar[0]
    on_floor = abs(cloud.points[:, 2] + height) < 5e-3
    on_wall = abs(cloud.points[:, 0] - ahead) < 5e-3
    assert (on_floor | on_wall).all()
    # 15 degrees down reaches the floor, straight ahead the wall.
    assert on_floor[cloud.ring == 0].any()
    assert on_wall[cloud.ring == 4].any()


def test_driving_takes_more_out_of_the_battery_than_standing(make_scene: Callable[..., SceneSpec], robot: RobotSpec) -> None:
    def left(linear: float) -> float:
        with driving(make_scene(robot)) as drive:
            return [battery for got in drive(linear, 0.0, 3.0) for battery in got.batteries][-1].percentage

    assert left(0.5) < left(0.0) < 1.0
    # 10 W for 3 s from a little under 5.2 A h * 11.25 V.
    assert 1.0 - left(0.0) == pytest.approx(30.0 / (5.2 * 3600 * 12.6), rel=0.02)
    assert math.isfinite(left(0.5))


def test_odometry_of_an_exact_robot_is_as_good_as_its_covariance_says(flat: SceneSpec) -> None:
    """The engine's contacts yield a little, more on a floor of triangles; there are no other errors."""
    worst = 0.0
    with PhysicsWorld(flat, step_hz=STEP_HZ) as world:
        for linear, angular, seconds in ((0.4, 0.0, 3.0), (0.0, 1.5, 4.0), (0.3, -0.8, 4.0), (0.0, 0.0, 1.0)):
            for _ in range(round(seconds * STEP_HZ)):
                world.command("robot", VelocityCommand((linear, 0.0, 0.0), (0.0, 0.0, angular), world.stamp_ns))
                world.step()
            odometry, truth = world.odometry("robot"), world.base_pose("robot")
            turned = math.remainder(odometry.yaw - yaw_from_quat(truth.quat_xyzw), 2 * math.pi)
            error = np.array([odometry.x - truth.position[0], odometry.y - truth.position[1], turned])
            pose = np.array(world.odometry_covariance("robot").pose).reshape(3, 3)
            worst = max(worst, float(error @ np.linalg.solve(pose, error)))
            assert (pose.diagonal() < 0.02**2).all()
    assert worst < 16.3, "99.9 % of a chi-square distribution of three dimensions"


def test_covariance_of_odometry_restarts_with_odometry(flat: SceneSpec) -> None:
    with PhysicsWorld(flat, step_hz=STEP_HZ) as world:
        world.step()
        fresh = world.odometry_covariance("robot")
        world.command("robot", VelocityCommand((0.4, 0.0, 0.0), (0.0, 0.0, 1.0), world.stamp_ns))
        world.step(100)
        assert world.odometry_covariance("robot").pose[8] > fresh.pose[8]
        world.reset()
        world.step()
        assert world.odometry_covariance("robot").pose == pytest.approx(fresh.pose, rel=0.01)
