"""The simulation in one process, without images: equal to the bit to its parts assembled by hand."""

from __future__ import annotations

import pickle
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import gibson_sim as gs
from gibson_sim.maps.placement import populate
from gibson_sim.sensors.suite import SensorSuite


def _equal(one: gs.SceneState, other: gs.SceneState) -> bool:
    arrays = ("positions", "quats_xyzw", "twists")
    return one.stamp_ns == other.stamp_ns and all(np.array_equal(getattr(one, a), getattr(other, a)) for a in arrays)


def _drive(sim: gs.Simulation) -> gs.SceneState:
    sim.command(linear=0.3, angular=0.4)
    sim.step(seconds=0.5)
    sim.spawn("ball", "ball", (1.9, 4.9, 0.3))
    sim.step(seconds=0.5)
    sim.command(linear=0.4)
    sim.move("ball", (2.2, 5.0, 0.2), yaw=1.0)
    return sim.step(seconds=1.0)


def test_simulation_equals_its_parts_assembled_by_hand() -> None:
    scene = populate("flat", "gibson_bot_real")
    with gs.Simulation("flat", "gibson_bot_real", seed=3) as sim, gs.PhysicsWorld(scene, seed=3, cmd_vel_timeout=60.0) as world:
        suite = SensorSuite(scene.robots[0], 240, 60, scene.gravity, 3)
        sim.command(linear=0.3, angular=0.2)
        world.command("robot", gs.VelocityCommand((0.3, 0.0, 0.0), (0.0, 0.0, 0.2), 0))
        state = sim.step(seconds=1.0)
        measured = []
        for _ in range(240):
            world.step(1)
            measured.append(suite.measure(world, world.step_count, world.stamp_ns))
        assert (state.step, sim.time) == (240, 1.0)
        assert _equal(state, world.state())
        assert sim.robot.pose == world.base_pose("robot")
        assert sim.robot.odometry == world.odometry("robot")
        # The lidar is due at 1 s, so a scan on request then equals the published one.
        (scan,) = measured[-1].scans
        assert sim.scan().stamp_ns == scan.stamp_ns == 1_000_000_000
        assert np.array_equal(sim.scan().ranges, scan.ranges)
        imu, wanted = sim.reading("imu"), measured[-1].imus[-1]
        assert all(np.array_equal(getattr(imu, f.name), getattr(wanted, f.name)) for f in fields(wanted))


def test_a_reset_simulation_equals_a_new_one_and_a_restored_one_goes_on_as_it_did() -> None:
    with gs.Simulation("flat") as sim, gs.Simulation("flat") as other:
        first = _drive(sim)
        saved = sim.save()
        later = sim.step(seconds=0.5)
        sim.remove("ball")
        sim.reset()
        assert (sim.time, sim.world.names) == (0.0, ("robot",))
        assert _equal(_drive(sim), first)
        assert _equal(sim.restore(saved), first)
        assert _equal(sim.step(seconds=0.5), later)
        assert _equal(other.restore(pickle.loads(pickle.dumps(saved))), first)
        assert _equal(other.step(seconds=0.5), later)


def test_a_command_holds_until_the_next_one_unless_it_times_out() -> None:
    with gs.Simulation("arena") as sim, gs.Simulation("arena", cmd_vel_timeout=0.5) as other:
        for each in (sim, other):
            each.command(linear=0.3)
            each.step(seconds=3.0)
        assert sim.robot.twist[0][0] == pytest.approx(0.3, abs=0.01)
        assert other.robot.twist[0][0] == pytest.approx(0.0, abs=0.01)


def test_an_omnidirectional_robot_moves_sideways_and_the_world_ignores_it_for_others() -> None:
    with gs.Simulation("arena", "omni_bot") as sim, gs.Simulation("arena") as other:
        sim.command(lateral=0.2)
        other.world.command("robot", gs.VelocityCommand((0.0, 0.2, 0.0), (0.0, 0.0, 0.0), 0))  # as a Twist over ROS
        for each in (sim, other):
            each.step(seconds=1.0)
        assert sim.robot.twist[0][1] == pytest.approx(0.2, abs=0.01)
        assert other.robot.twist[0][1] == pytest.approx(0.0, abs=1e-3)


def test_several_robots_are_commanded_by_name() -> None:
    with gs.Simulation("flat", "left=gibson_bot,right=gibson_bot", start="1.0,4.7,0;6.4,3.3,90") as sim:
        sim.command(linear=0.3, robot="right")
        sim.step(seconds=1.0)
        assert list(sim.robots) == ["left", "right"]
        assert sim.robot.pose.position[0] == pytest.approx(1.0, abs=1e-3)
        assert sim.robots["right"].pose.position[1] > 3.4
        assert sim.robots["right"].yaw == pytest.approx(np.pi / 2, abs=0.01)
        assert sim.scan(robot="right").link == "right/base_scan"


def test_a_scene_that_was_loaded_and_a_robot_that_was_loaded_can_be_given() -> None:
    with gs.Simulation(gs.load_scene("flat"), gs.load_robot("omni_bot"), start="living") as sim:
        assert sim.robot.spec.name == "robot"
        assert sim.scene.starts[1].name == "living"
        assert sim.robot.pose.position[:2] == pytest.approx(sim.scene.starts[1].pose.position[:2], abs=1e-6)
    with gs.Simulation("flat", None) as empty:
        assert list(empty.robots) == []
        with pytest.raises(gs.CommandError, match="no robot in this simulation; there are: none"):
            empty.command(linear=0.1)


@pytest.mark.parametrize(
    ("call", "error"),
    [
        (lambda sim: sim.step(seconds=0.001), r"step by 0.001 s, 0.24 steps of 1/240 s: must be a finite whole number"),
        (lambda sim: sim.step(seconds=0.101), r"0 or more; nearest: steps=24 \(0.1 s\) or steps=25 \(0.104167 s\)$"),
        (lambda sim: sim.step(steps=-2), r"step by -2 steps: .*, 0 or more; nearest: steps=0 \(0 s\)$"),
        (lambda sim: sim.step(seconds=-1.0), "must be a finite whole number of steps, 0 or more"),
        (lambda sim: sim.step(seconds=float("nan")), "must be a finite whole number of steps, 0 or more$"),
        (lambda sim: sim.step(seconds=1.0, steps=2), "step takes seconds .* or steps .*, not both"),
        (lambda sim: sim.command(linear=float("inf")), "holds a NaN or an infinity"),
        (lambda sim: sim.command(lateral=float("nan")), "holds a NaN or an infinity"),
        (
            lambda sim: sim.command(lateral=0.2),
            "drive of type differential, which cannot move sideways: lateral is 0.2 m/s, must be 0",
        ),
        (lambda sim: sim.command(linear=0.1, robot="bob"), "no robot 'bob' in this simulation; there are: robot"),
        (lambda sim: sim.robots["bob"], "no robot 'bob' in this simulation; there are: robot"),
        (lambda sim: sim.bodies["chair_99"], "no body 'chair_99' in this simulation; there are: "),
        (lambda sim: sim.command_joints({"elbow": 1.0}), "'elbow'"),
        (lambda sim: sim.command_joints([1.0]), "positions is .*, must map names of joints to radians or metres"),
        (lambda sim: sim.command("0.3"), "linear is '0.3', must be a number"),
        (lambda sim: sim.step(seconds="1"), "seconds is '1', must be a number"),
        (lambda sim: sim.move("robot", (1.0, 2.0)), "position is .*, must be three numbers: x, y and z in metres"),
        (lambda sim: sim.spawn("ball", "a b/c"), "name is 'a b/c', must be letters, digits and _"),
        (lambda sim: sim.spawn("ball", None), "name is None, must be letters"),
        (lambda sim: sim.spawn("ball", "map"), "and not 'map'"),
        (lambda sim: sim.restore(None), "restore takes the result of save, not None"),
        (lambda sim: setattr(sim, "light", {"sun": 1}), "light is .*, must be a LightSpec"),
        (lambda sim: sim.scan("radar"), "there is no lidar 'radar'; there are: scan"),
        (lambda sim: sim.reading("imux"), "has no sensor 'imux'; it has: scan, bumper, imu, battery_state"),
        (lambda sim: sim.reading("imu"), "sensor 'imu' of robot 'robot' has not measured yet: step first"),
        (lambda sim: sim.spawn("botle", "b"), "neither a file nor a built-in model"),
        (lambda sim: sim.spawn("ball", "robot"), "the name 'robot' is taken"),
        (lambda sim: sim.move("ghost", (0.0, 0.0, 0.0)), "no robot or body 'ghost' in this world"),
        (lambda sim: sim.remove("ghost"), "no robot or body 'ghost' in this world"),
    ],
)
def test_an_impossible_request_fails_in_one_line_and_changes_nothing(call: object, error: str) -> None:
    with gs.Simulation("flat") as sim:
        before = sim.save()
        with pytest.raises(gs.GibsonSimError, match=error) as found:
            call(sim)  # type: ignore[operator]
        assert "\n" not in str(found.value)
        assert sim.save() == before


@pytest.mark.parametrize(
    ("arguments", "error"),
    [
        ({"seed": -1}, "seed is -1, must be 0 to"),
        ({"seed": 1.5}, "seed is 1.5, must be a whole number, 0 or more"),
        ({"step_hz": "240"}, "step_hz is '240', must be a number"),
        ({"step_hz": float("nan")}, "step_hz is nan, must be a whole number from 1 to 100000"),
        ({"view_size": 5}, "view_size is 5, must be width and height in pixels, two whole numbers above 0"),
        ({"view_size": (0, 480)}, r"view_size is \(0, 480\), must be width and height"),
        ({"publish_hz": 0}, "publish_hz is 0, must be 1 Hz or more"),
        ({"views": ["follow"]}, "views is .*, must be text such as 'follow,top'"),
        ({"start": (1.0, 2.0)}, "start is .*, must be three numbers: x, y in metres and yaw in degrees"),
        ({"cmd_vel_timeout": "1"}, "cmd_vel_timeout is '1', must be a number"),
    ],
)
def test_impossible_arguments_are_refused_in_one_line(arguments: dict[str, Any], error: str) -> None:
    with pytest.raises(gs.GibsonSimError, match=error):
        gs.Simulation("flat", **arguments)


def test_a_start_may_be_numbers_and_a_saved_run_fits_equal_arguments_alone() -> None:
    with gs.Simulation("flat", start=(3.95, 1.75, 150.0)) as sim, gs.Simulation("flat", step_hz=480) as other:
        assert sim.robot.pose.position[:2] == pytest.approx((3.95, 1.75), abs=1e-6)
        assert sim.robot.yaw == pytest.approx(np.radians(150.0), abs=1e-6)
        other.step(seconds=0.5)
        with pytest.raises(
            gs.ConfigError, match="belongs to another simulation: scene, robots, step_hz, cmd_vel_timeout and seed must be equal"
        ):
            other.restore(sim.save())
        assert other.time == 0.5, "nothing has changed"


def test_doors_are_found_and_opened_and_a_restored_run_has_its_light() -> None:
    with gs.Simulation("linden_flat") as sim:
        doors = {name: body.joints.names for name, body in sim.bodies.items() if name.endswith("_door")}
        assert len(doors) >= 3
        name, (hinge, *_) = next((name, joints) for name, joints in doors.items() if joints)
        before = sim.bodies[name].joints.positions[0]
        light = sim.light
        sim.light = replace(light, sun=0.1)
        saved = sim.save()
        sim.command_joints({hinge: 0.3}, name)
        sim.step(seconds=2.0)
        assert sim.bodies[name].joints.positions[0] == pytest.approx(0.3, abs=0.05) != pytest.approx(before, abs=0.01)
        sim.light = light
        sim.restore(saved)
        assert sim.light.sun == 0.1
        assert sim.bodies[name].joints.positions[0] == pytest.approx(before, abs=1e-3)
        sim.reset()
        assert sim.light == light


def test_a_robot_that_is_spawned_has_cameras_of_its_own_name() -> None:
    with gs.Simulation("flat") as sim:
        sim.spawn("gibson_bot", "second", (6.4, 3.3, 0.0), yaw=1.0)
        assert [camera.name for camera in sim.cameras] == ["camera", "second/camera"]
        assert repr(sim) == "<Simulation flat: 0.000 s, robots robot, second, 0 bodies>"
        gone = sim.robots["second"]
        sim.remove("second")
        assert repr(gone) == "<Robot second: removed>"


def test_use_after_close_is_refused(tmp_path: Path) -> None:
    sim = gs.Simulation("flat")
    sim.close()
    sim.close()
    for use in (sim.step, sim.command, sim.save, sim.reset, lambda: sim.renderer, lambda: sim.render(), sim.__enter__):
        with pytest.raises(gs.PhysicsError, match="closed"):
            use()
    assert repr(sim) == "<Simulation: closed>"
    with pytest.raises(gs.SceneNotFoundError, match="did you mean 'linden_flat'"):
        gs.Simulation("lindenflat")


def test_saved_state_does_not_alias_given_arrays() -> None:
    place = np.array([1.9, 4.9, 0.3])
    with gs.Simulation("flat") as sim:
        sim.spawn("ball", "ball", place)  # type: ignore[arg-type]
        saved, pose = sim.save(), sim.bodies["ball"].pose
        place += 1.0
        sim.restore(saved)
        assert sim.bodies["ball"].pose == pose


def test_a_robot_that_is_spawned_has_no_readings_of_one_that_was_removed() -> None:
    with gs.Simulation("flat", "gibson_bot_real") as sim:
        sim.spawn("gibson_bot_real", "other", (1.9, 4.9, 0.0))
        sim.step(seconds=0.1)
        sensor = sim.robots["other"].spec.sensors.imus[0].name
        assert sim.reading(sensor, "other")
        sim.remove("other")
        sim.spawn("gibson_bot_real", "other", (1.9, 4.9, 0.0))
        with pytest.raises(gs.GibsonSimError, match="has not measured yet"):
            sim.reading(sensor, "other")


def test_a_start_outside_the_building_is_a_warning(caplog: pytest.LogCaptureFixture) -> None:
    with gs.Simulation("flat", start="100,200,0"):
        assert "robot starts at 100.00,200.00, " in caplog.text and "scene inspect" in caplog.text
    caplog.clear()
    with gs.Simulation("flat"):
        assert not caplog.text
