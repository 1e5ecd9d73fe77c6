"""Robots that differ from run to run: the files of a run describe a robot that can be loaded from anywhere, with the drawn values."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import pytest

from gibson_sim.description.urdf import UrdfModel, read_urdf
from gibson_sim.errors import ConfigError
from gibson_sim.resources import list_robots
from gibson_sim.robots.drive_spec import AckermannSpec, DifferentialSpec
from gibson_sim.robots.load import load_robot
from gibson_sim.robots.spec import RobotSpec
from gibson_sim.trials.planning.plan import plan_runs
from gibson_sim.trials.planning.robots import VariedRobot, check_variants
from gibson_sim.trials.scenario.load import ScenarioError
from gibson_sim.trials.scenario.spec import Randomisation, Scenario, StackSpec


def varied(folder: Path, name: str, drawn: Mapping[str, float]) -> RobotSpec:
    """Returns a variant of a robot, loaded from files in a folder."""
    robot = VariedRobot(name)
    for path, text in robot.files(drawn).items():
        (folder / path).parent.mkdir(exist_ok=True)
        (folder / path).write_text(text, encoding="utf-8")
    return load_robot(folder / robot.file)


def model(robot: RobotSpec) -> UrdfModel:
    return read_urdf(robot.urdf)


def mass(robot: RobotSpec) -> float:
    return sum(link.inertial.mass for link in model(robot).links if link.inertial is not None)


@pytest.mark.parametrize("name", [name for name in list_robots() if name != "gibson_bot_360"])
def test_a_robot_without_changes_is_the_same_robot(name: str, tmp_path: Path) -> None:
    before, after = load_robot(name), varied(tmp_path, name, {})
    same = replace(after, urdf=before.urdf, visuals=before.visuals)
    assert same == before
    assert [link.collisions for link in model(after).links] == [link.collisions for link in model(before).links]
    assert [v.shape.kind for v in after.visuals] == [v.shape.kind for v in before.visuals]


def test_slip_and_latency_are_those_of_the_drive(tmp_path: Path) -> None:
    drive = varied(tmp_path, "gibson_bot", {"slip": 0.05, "latency": 0.12}).drive
    assert isinstance(drive, DifferentialSpec)
    assert (drive.slip, drive.turn_slip, drive.command_delay) == (0.05, 0.05, 0.12)


def test_a_car_slips_forward_alone(tmp_path: Path) -> None:
    drive = varied(tmp_path, "ackermann_bot", {"slip": 0.05}).drive
    assert isinstance(drive, AckermannSpec)
    assert drive.slip == 0.05


def test_noise_is_multiplied_and_variances_by_the_square(tmp_path: Path) -> None:
    before, after = load_robot("gibson_bot_real"), varied(tmp_path, "gibson_bot_real", {"noise": 3.0})
    (lidar,), (was,) = after.sensors.lidars, before.sensors.lidars
    assert (lidar.range_noise, lidar.range_noise_ratio, lidar.dropout) == pytest.approx((0.009, 0.03, 0.03))
    assert (lidar.resolution, lidar.range_max) == (was.resolution, was.range_max)
    assert after.sensors.imus[0].gyro_noise == pytest.approx(3 * 1.75e-4)
    wheels = after.sensors.wheel_odometry
    assert (wheels.alpha1, wheels.alpha2) == pytest.approx((36e-4, 9e-4))
    assert (wheels.separation_factor, wheels.right_radius_factor) == pytest.approx((1.03, 0.9985))
    assert wheels.encoder_ticks == 4096
    (camera,) = after.cameras
    assert camera.effects is not None
    assert camera.depth_noise is not None
    assert camera.effects.shot_noise == pytest.approx(0.06)
    assert camera.depth_noise.quadratic == pytest.approx(0.0075)
    assert camera.depth_noise.hole_angle_deg == 82.0


def test_noise_stays_within_what_a_sensor_can_have(tmp_path: Path) -> None:
    lidar = varied(tmp_path, "gibson_bot_real", {"noise": 100.0}).sensors.lidars[0]
    assert (lidar.range_noise_ratio, lidar.range_scale, lidar.dropout) == (0.2, 0.2, 1.0)


def test_a_payload_adds_its_mass_above_the_base_and_no_shape(tmp_path: Path) -> None:
    before, after = load_robot("gibson_bot"), varied(tmp_path, "gibson_bot", {"payload": 2.5})
    assert mass(after) == pytest.approx(mass(before) + 2.5)
    joint = model(after).joint("payload_joint")
    assert joint.parent == "base_link"
    # The disc of the base reaches 0.064 m above the axle, where base_link is; the centre of mass is 0.03 m behind it.
    assert joint.pose.position == pytest.approx((-0.03, 0.0, 0.064 + 0.05), abs=1e-6)
    inertial = model(after).link("payload").inertial
    assert inertial is not None
    assert inertial.inertia == pytest.approx((2.5 * 0.01 / 6, 0, 0, 2.5 * 0.01 / 6, 0, 2.5 * 0.01 / 6))
    assert (after.radius, after.height) == (before.radius, before.height)


def test_a_negligible_payload_adds_no_link(tmp_path: Path) -> None:
    assert "payload" not in varied(tmp_path, "gibson_bot", {"payload": 0.0}).links


def test_friction_is_multiplied_also_where_the_default_counts(tmp_path: Path) -> None:
    robot = model(varied(tmp_path, "gibson_bot", {"friction": 0.4}))
    assert robot.link("wheel_left_link").friction == pytest.approx(0.4)
    assert robot.link("base_link").friction == pytest.approx(0.2)  # 0.5 if the file gives none


def test_wheels_that_slide_by_design_lose_traction(tmp_path: Path) -> None:
    drive = varied(tmp_path, "skid_bot", {"friction": 0.5}).drive
    assert isinstance(drive, DifferentialSpec)
    assert drive.traction == pytest.approx(0.4)


def test_a_urdf_alone_can_be_varied(tmp_path: Path) -> None:
    urdf = Path(load_robot("gibson_bot").urdf)
    (tmp_path / "mine.urdf").write_bytes(urdf.read_bytes())
    robot = VariedRobot(str(tmp_path / "mine.urdf"))
    assert robot.file == "robot/mine.yaml"
    drive = varied(tmp_path, str(tmp_path / "mine.urdf"), {"latency": 0.2}).drive
    assert drive is not None
    assert drive.command_delay == 0.2


def test_meshes_that_lie_beside_the_robot_are_found_from_a_run(tmp_path: Path) -> None:
    meshes = [
        visual.shape.mesh for visual in varied(tmp_path, "arm_bot", {"payload": 1.0}).visuals if visual.shape.kind == "mesh"
    ]
    assert meshes
    assert all(Path(mesh).is_file() for mesh in meshes)


def test_meshes_in_installed_packages_keep_names_that_other_machines_know() -> None:
    text = VariedRobot("husky").files({"slip": 0.1})["robot/husky.urdf"]
    assert 'filename="package://pybullet_data/husky/meshes/base_link.stl"' in text
    assert "file://" not in text


def test_a_factor_of_no_noise_is_refused() -> None:
    with pytest.raises(ConfigError, match=r"^randomise\.noise is a factor, and the robot has no noise"):
        check_variants(VariedRobot("gibson_bot"), {"noise": (1.0, 2.0)})


def test_values_that_make_no_robot_are_refused_before_anything_starts() -> None:
    rules = Randomisation(noise=(0.5, 2.0))
    scenario = Scenario("trial", Path("/nowhere/trial.yaml"), ("arena",), StackSpec(("true",)), ("skid_bot",), randomise=rules)
    with pytest.raises(ScenarioError, match=r"^/nowhere/trial\.yaml: randomise\.noise is a factor, .* \(robots is 'skid_bot'\)$"):
        plan_runs(scenario)


def test_each_run_has_its_own_robot_within_the_ranges() -> None:
    rules = Randomisation(slip=(0.0, 0.1), latency=(0.05, 0.05))
    scenario = Scenario(
        "trial",
        Path("/nowhere/trial.yaml"),
        ("arena",),
        StackSpec(("true",)),
        starts=("first",),
        goals=("second",),
        runs=5,
        randomise=rules,
    )
    runs = plan_runs(scenario)
    slips = [run.drawn["slip"] for run in runs]
    assert len(set(slips)) == 5
    assert all(0.0 <= slip <= 0.1 for slip in slips)
    assert {run.drawn["latency"] for run in runs} == {0.05}
    assert {run.robot for run in runs} == {"robot/gibson_bot.yaml"}
    assert all(set(run.files) == {"robot/gibson_bot.yaml", "robot/gibson_bot.urdf"} for run in runs)
    assert f"slip: {slips[0]}" in runs[0].files["robot/gibson_bot.yaml"]
