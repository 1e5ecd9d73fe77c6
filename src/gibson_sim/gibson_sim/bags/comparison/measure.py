"""Measures all metrics of one recording. Pure."""

from __future__ import annotations

from dataclasses import dataclass

from gibson_sim.bags.comparison.drift import Alphas, Drift, drift, fit_alphas
from gibson_sim.bags.comparison.encoder import fit_ticks
from gibson_sim.bags.comparison.identify import LEAST_ANGULAR, LEAST_LINEAR, DriveFit, Estimate, fit_drive
from gibson_sim.bags.comparison.imu_noise import ImuNoise, imu_noise
from gibson_sim.bags.comparison.lidar import LidarNoise, Residuals, lidar_noise, residuals_against_map
from gibson_sim.bags.comparison.recorded_drive import RecordedDrive
from gibson_sim.bags.comparison.response import AxisResponse, axis_response
from gibson_sim.bags.comparison.signals import rests, speeds
from gibson_sim.bags.comparison.timing import TopicTiming, topic_timing
from gibson_sim.robots.drive_spec import DriveSpec


@dataclass(frozen=True, slots=True)
class Assumptions:
    """Values that no bag contains."""

    gravity: float = 9.81
    """Gravity, m/s^2."""
    command_timeout: float = 0.5
    """Command timeout of the real robot, seconds."""
    step_hz: int = 240
    """Physics steps per second of the simulation."""


@dataclass(frozen=True, slots=True, eq=False)
class Measurements:
    """Metrics of one recording; None = not determined."""

    recording: RecordedDrive
    rests: tuple[tuple[float, float], ...]
    """Intervals (begin, end) in which the robot stands still, seconds."""
    linear: AxisResponse | None = None
    angular: AxisResponse | None = None
    fit: DriveFit | None = None
    ticks: Estimate | None = None
    drift: Drift | None = None
    alphas: Alphas | None = None
    imu: ImuNoise | None = None
    lidar: LidarNoise | None = None
    map_residuals: Residuals | None = None
    timing: dict[str, TopicTiming] | None = None
    """Topic -> timing."""


def measure(recording: RecordedDrive, drive: DriveSpec | None, assumptions: Assumptions) -> Measurements:
    """Returns the metrics of a recording.

    Args:
        recording: Content of the bag.
        drive: Drive of the robot; None = no drive is fitted.
        assumptions: Values that no bag contains.
    """
    commands, odometry, truth = recording.commands, recording.odometry, recording.truth
    still = rests(recording.imu, odometry, commands)
    drifted = drift(odometry, truth) if odometry is not None and truth is not None else None
    stuck = () if drifted is None else drifted.stuck
    linear = angular = fit = ticks = None
    if commands is not None and odometry is not None:
        forward, turning = speeds(odometry)
        timeout = assumptions.command_timeout
        linear = axis_response(commands.t, commands.linear, odometry.t, forward, least=LEAST_LINEAR, timeout=timeout)
        angular = axis_response(commands.t, commands.angular, odometry.t, turning, least=LEAST_ANGULAR, timeout=timeout)
        if drive is not None:
            fit = fit_drive(drive, commands, odometry, timeout=timeout, without=stuck)
            ticks = None if fit is None else fit_ticks(drive, fit, odometry, step_hz=assumptions.step_hz, without=stuck)
    on_map = truth if truth is not None else odometry
    scans, grid = recording.scans, recording.map
    return Measurements(
        recording=recording,
        rests=tuple(still),
        linear=linear,
        angular=angular,
        fit=fit,
        ticks=ticks,
        drift=drifted,
        alphas=fit_alphas(odometry, truth) if odometry is not None and truth is not None else None,
        imu=None if recording.imu is None else imu_noise(recording.imu, still, assumptions.gravity),
        lidar=None if scans is None else lidar_noise(scans, still),
        map_residuals=None if scans is None or grid is None or on_map is None else residuals_against_map(scans, on_map, grid),
        timing={topic: topic_timing(arrivals) for topic, arrivals in recording.arrivals.items()},
    )
