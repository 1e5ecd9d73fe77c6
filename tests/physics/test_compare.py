"""`gibson-sim compare --fit` on two simulated robots: one stands in for a real robot, and all its differences are found."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
import yaml

from gibson_sim.cli.main import main
from gibson_sim.robots.load import load_robot
from gibson_sim.robots.path_tracking import parse_script
from support.drives import Recorder, record_drive
from support.robots import GIBSON_BOT, write_gibson_bot

STEPS = [f"{v} 0 1.2" for v in (0.3, 0, -0.45, 0)] + [f"0 {w} 1.2" for w in (1.0, 0, -1.7, 0)]
RAMP = [f"{0.05 * sign * k:.2f} 0 0.2" for sign in (1, -1) for k in range(1, 9)]
SCRIPT = "\n".join(["0 0 5", *STEPS, *RAMP, "0 0 1", "0.3 0.8 3", "0.2 -0.9 3", "-0.3 0.6 3", "-0.25 -0.7 3", "0 0 5"])
OTHER_SCRIPT = "\n".join(
    [
        "0 0 4.98",
        *(f"{v} 0 0.97" for v in (0.35, 0, -0.4, 0)),
        *(f"0 {w} 1.13" for w in (1.2, 0, -1.5, 0)),
        "0.3 0.7 2",
        "-0.3 -0.5 2",
        "0 0 4",
    ]
)
REAL: dict[str, dict[str, Any]] = {
    "drive": {
        "command_delay": 0.12, "slip": 0.05, "turn_slip": 0.08, "max_linear_acceleration": 0.6, "max_angular_acceleration": 2.5,
    },
    "wheel_odometry": {
        "encoder_ticks": 2048, "left_radius_factor": 1.02, "right_radius_factor": 1.02, "separation_factor": 1.03,
    },
    "imu": {"gyro_noise": 4e-4, "accel_noise": 4e-3, "gyro_bias": 3e-3, "accel_bias": 0.05},
    "lidar": {"range_noise": 0.02, "dropout": 0.03, "resolution": 0.001},
}  # fmt: skip
SIM: dict[str, dict[str, Any]] = {
    "drive": {"command_delay": 0.02}, "wheel_odometry": {"encoder_ticks": 0},
    "imu": {"gyro_noise": 1e-4, "accel_noise": 2e-3}, "lidar": {"range_noise": 0.01, "dropout": 0.01},
}  # fmt: skip
FITTED = [(section, key) for section, values in REAL.items() for key in values if not key.endswith("bias")]


@dataclass(frozen=True)
class Outcome:
    folder: Path
    fitted: dict[str, Any]
    biases: list[float]
    """Biases of the real robot's three gyroscopes and three accelerometers."""
    twin: dict[str, Any]
    """Result of comparing the simulated robot with itself, in another drive with other noise."""


@pytest.fixture(scope="module")
def outcome(tmp_path_factory: pytest.TempPathFactory) -> Outcome:
    folder = tmp_path_factory.mktemp("compare")
    real = _record(folder / "real", REAL, seed=5)
    _record(folder / "sim", SIM, seed=0)
    _record(folder / "twin", SIM, seed=3, script=OTHER_SCRIPT, command_hz=30)
    files = ["--html", str(folder / "report.html"), "--json", str(folder / "figures.json")]
    fit = ["--robot", str(folder / "sim/robot"), "--fit", "--output", str(folder / "fitted.yaml")]
    with pytest.raises(SystemExit) as ended:
        main(["compare", str(folder / "real/bag"), str(folder / "sim/bag"), *files, *fit])
    assert ended.value.code == 0
    with pytest.raises(SystemExit) as ended:
        main(["compare", str(folder / "twin/bag"), str(folder / "sim/bag"), "--json", str(folder / "twin.json"), *fit[:2]])
    assert ended.value.code == 0
    fitted = yaml.safe_load((folder / "fitted.yaml").read_text())
    return Outcome(folder, fitted, real["biases"][0], json.loads((folder / "twin.json").read_text()))


def _record(
    folder: Path, changes: dict[str, dict[str, Any]], seed: int, script: str = SCRIPT, command_hz: int = 20
) -> dict[str, Any]:
    """Writes the robot with these changes, and the bag of its drive."""
    drive = yaml.safe_load(GIBSON_BOT.read_text(encoding="utf-8"))["drive"]
    robot = write_gibson_bot(
        folder / "robot", drive={**drive, **changes["drive"]}, wheel_odometry=changes["wheel_odometry"], cameras=None, bumper=None,
        battery=None, imu={"link": "base_link", "rate_hz": 100.0, **changes["imu"]},
        lidar={"link": "base_scan", "beams": 72, "range_min": 0.12, "range_max": 12.0, "rate_hz": 10.0, **changes["lidar"]},
    )  # fmt: skip
    how = Recorder(seed=seed, command_hz=command_hz)
    return record_drive(folder / "bag", load_robot(robot), parse_script(script), how)


def test_comparison_of_a_robot_with_itself_suggests_no_change(outcome: Outcome) -> None:
    fitted = outcome.twin["parameters"]
    assert [(one["name"], one["old"], one["new"]) for one in fitted if one["changes"]] == []
    assert {"drive.max_linear_acceleration", "drive.max_angular_acceleration", "drive.slip"} <= {one["name"] for one in fitted}


@pytest.mark.parametrize(("section", "key"), FITTED)
def test_differences_of_the_real_robot_are_recovered_within_ten_percent(outcome: Outcome, section: str, key: str) -> None:
    assert outcome.fitted[section][key] == pytest.approx(REAL[section][key], rel=0.1)


def test_fitted_imu_biases_have_the_magnitude_of_the_drawn_biases(outcome: Outcome) -> None:
    imu, biases = outcome.fitted["imu"], outcome.biases
    gyro, accel = (math.sqrt(sum(b * b for b in part) / 3) for part in (biases[:3], biases[3:]))
    assert (imu["gyro_bias"], imu["accel_bias"]) == pytest.approx((gyro, accel), rel=0.1)


def test_fitted_file_is_a_robot_that_keeps_what_was_not_fitted(outcome: Outcome) -> None:
    robot = load_robot(outcome.folder / "fitted.yaml")
    assert robot.drive is not None
    assert robot.drive.command_delay == outcome.fitted["drive"]["command_delay"]
    assert (robot.drive.max_linear, robot.sensors.lidars[0].beams) == (0.5, 72)


def test_figures_name_what_differs_and_what_to_change(outcome: Outcome) -> None:
    found = json.loads((outcome.folder / "figures.json").read_text())
    delay = next(row for row in found["figures"] if (row["group"], row["name"]) == ("velocity, forward", "delay"))
    assert delay["difference"] == pytest.approx(100.0, abs=25.0)
    assert delay["change"].startswith("drive.command_delay: 0.02 → ")
    assert any("no image" in note for note in found["notes"])


def test_page_is_one_file_with_plots(outcome: Outcome) -> None:
    page = (outcome.folder / "report.html").read_text(encoding="utf-8")
    assert page.count("<svg") >= 5
    assert "drive.command_delay" in page
    for loads in ("<script", 'src="http', "<link", "@import"):
        assert loads not in page
