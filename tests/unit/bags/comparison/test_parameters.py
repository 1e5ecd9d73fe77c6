"""Values of the robot.yaml from the measurements of two recordings, and a copy with them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml

from gibson_sim.bags.comparison.drift import Drift, Scales
from gibson_sim.bags.comparison.identify import DriveFit, Estimate
from gibson_sim.bags.comparison.measure import Measurements
from gibson_sim.bags.comparison.parameters import Parameter, fitted_parameters
from gibson_sim.bags.comparison.recorded_drive import RecordedDrive
from gibson_sim.bags.comparison.robot_file import robot_file, write_fitted
from gibson_sim.errors import RobotError
from gibson_sim.robots.load import load_robot
from gibson_sim.robots.spec import RobotSpec
from support.robots import write_gibson_bot

NOTHING = np.zeros(0)


def measured(delay: float, acceleration: float, gains: tuple[float, float], scales: Scales | None) -> Measurements:
    """Returns a recording with exactly these measurements of the drive."""
    estimates = [Estimate(value, 0.0) for value in (delay, acceleration, 3 * acceleration, *gains)]
    fit = DriveFit(*estimates, 0.0, 0.0, NOTHING, NOTHING, NOTHING)
    drift = None if scales is None else Drift(10.0, 10.0, scales, 0.0, 0.0, {}, 0.0, 0.0)
    return Measurements(RecordedDrive(Path("bag"), 10.0, {}), (), fit=fit, drift=drift)


@pytest.fixture
def robot(tmp_path: Path) -> RobotSpec:
    return load_robot(write_gibson_bot(tmp_path / "robot"))


EXACT = Scales(1.0, 1.0, 0.0)


def values(real: Measurements, sim: Measurements, robot: RobotSpec) -> dict[str, float]:
    return {one.name: one.new for one in fitted_parameters(real, sim, robot)}


def test_delay_of_the_transport_is_not_given_to_the_robot(robot: RobotSpec) -> None:
    found = values(measured(0.15, 1.0, (1.0, 1.0), EXACT), measured(0.03, 1.0, (1.0, 1.0), EXACT), robot)
    assert found["drive.command_delay"] == pytest.approx(0.12)


def test_a_faster_real_robot_has_no_negative_delay(robot: RobotSpec) -> None:
    found = values(measured(0.01, 1.0, (1.0, 1.0), EXACT), measured(0.03, 1.0, (1.0, 1.0), EXACT), robot)
    assert found["drive.command_delay"] == 0.0


def test_limits_change_by_the_difference_of_the_recordings(robot: RobotSpec) -> None:
    found = values(measured(0.0, 0.6, (1.0, 1.0), EXACT), measured(0.0, 1.2, (1.0, 1.0), EXACT), robot)
    # The file says 1 and 4.
    assert (found["drive.max_linear_acceleration"], found["drive.max_angular_acceleration"]) == pytest.approx((0.5, 2.0))


def test_slip_is_the_difference_of_truth_and_command(robot: RobotSpec) -> None:
    # Scale of the odometry: 1.02 against the command, 1.02 / 0.95 against the truth.
    real = measured(0.0, 1.0, (1.02, 0.99), Scales(1.02 / 0.95, 0.99 / 0.92, 0.0))
    found = values(real, measured(0.0, 1.0, (1.0, 1.0), EXACT), robot)
    assert (found["drive.slip"], found["drive.turn_slip"]) == pytest.approx((0.05, 0.08))
    assert found["wheel_odometry.left_radius_factor"] == pytest.approx(1.02)
    assert found["wheel_odometry.separation_factor"] == pytest.approx(1.02 / 0.99)


def test_a_veer_makes_the_wheels_differ(robot: RobotSpec) -> None:
    real = measured(0.0, 1.0, (1.0, 1.0), Scales(1.0, 1.0, 0.05))
    found = values(real, measured(0.0, 1.0, (1.0, 1.0), EXACT), robot)
    difference = found["wheel_odometry.right_radius_factor"] - found["wheel_odometry.left_radius_factor"]
    assert robot.drive is not None
    assert difference == pytest.approx(0.05 * robot.drive.wheel_separation)  # type: ignore[union-attr]


def test_wheels_change_together(robot: RobotSpec) -> None:
    real = measured(0.0, 1.0, (1.0, 1.0), Scales(1.0, 1.0, 0.05))
    real = replace(real, fit=replace(real.fit, linear_gain=Estimate(1.006, 0.004)))  # type: ignore[type-var]
    found = {one.key: one for one in fitted_parameters(real, measured(0.0, 1.0, (1.0, 1.0), EXACT), robot)}
    assert abs(found["left_radius_factor"].new - 1.0) < 0.008
    assert found["left_radius_factor"].changes
    assert found["right_radius_factor"].changes


def test_without_a_truth_there_is_no_slip(robot: RobotSpec) -> None:
    found = values(measured(0.1, 1.0, (0.9, 0.9), None), measured(0.0, 1.0, (1.0, 1.0), None), robot)
    assert "drive.slip" not in found
    assert "drive.command_delay" in found


PARAMETER = Parameter("drive", "max_linear_acceleration", 0, 1.0, 0.61234, "m/s²", 0.01, "")


@pytest.mark.parametrize(
    ("new", "deviation", "changes"), [(0.6, 0.01, True), (0.9995, 0.0, False), (0.9, 0.1, False), (0.9, float("inf"), False)]
)
def test_only_clear_differences_change(new: float, deviation: float, changes: bool) -> None:
    assert replace(PARAMETER, new=new, deviation=deviation).changes is changes


@pytest.mark.parametrize(
    ("section", "key", "new", "changes"),
    [
        ("imu", "gyro_bias", 3.3e-6, False),
        ("imu", "accel_bias", 5.5e-7, False),
        ("lidar", "range_noise", 5.5e-6, False),
        ("imu", "gyro_bias", 1e-4, True),
        ("lidar", "range_noise", 1e-3, True),
    ],
)
def test_values_of_an_exact_robot_at_rest_are_no_errors(section: str, key: str, new: float, changes: bool) -> None:
    """The small values are those of an exact robot, each with an uncertainty of a thousandth."""
    assert Parameter(section, key, 0, 0.0, new, "", 1e-3 * new, "").changes == changes


def test_copy_keeps_comments_and_marks_its_changes(tmp_path: Path) -> None:
    delay = replace(PARAMETER, key="command_delay", old=0.0, new=0.1)
    path = write_fitted(robot_file("gibson_bot"), [PARAMETER, delay], tmp_path / "out" / "fitted.yaml")
    text = path.read_text(encoding="utf-8")
    assert "# wheel_radius and wheel_separation are read from the URDF." in text
    assert "max_linear_acceleration: 0.6123  # fitted; was 1" in text
    drive = load_robot(path).drive
    assert drive is not None
    assert (drive.max_linear_acceleration, drive.command_delay, drive.max_linear) == (0.6123, 0.1, 0.5)


def test_missing_section_is_created(tmp_path: Path) -> None:
    ticks = replace(PARAMETER, section="wheel_odometry", key="encoder_ticks", old=0.0, new=2048.3)
    path = write_fitted(robot_file("gibson_bot"), [ticks], tmp_path / "fitted.yaml")
    assert load_robot(path).sensors.wheel_odometry.encoder_ticks == 2048


def test_the_right_one_of_several_sensors_is_changed(tmp_path: Path) -> None:
    imus = [{"name": "imu", "link": "base_link"}, {"name": "imu2", "link": "base_link"}]
    source = write_gibson_bot(tmp_path / "robot", imu=imus)
    path = write_fitted(
        robot_file(str(source)), [replace(PARAMETER, section="imu", key="gyro_noise", index=1)], tmp_path / "fitted.yaml"
    )
    assert [imu.get("gyro_noise") for imu in yaml.safe_load(path.read_text())["imu"]] == [None, 0.6123]


def test_robot_that_does_not_exist_is_an_error() -> None:
    with pytest.raises(RobotError):
        robot_file("no_such_robot/robot.yaml")
