"""Compares two recordings: one row for each metric, and the fitted parameters. Pure."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from gibson_sim.bags.comparison.drift import Drift
from gibson_sim.bags.comparison.imu_noise import NoiseModel
from gibson_sim.bags.comparison.lidar import Residuals, residuals_at_matches, scan_poses
from gibson_sim.bags.comparison.measure import Assumptions, Measurements, measure
from gibson_sim.bags.comparison.parameters import Parameter, fitted_parameters
from gibson_sim.bags.comparison.pictures import STATISTICS, exposure_stops, histogram_distance
from gibson_sim.bags.comparison.recorded_drive import F64, PlanarTrack, RecordedDrive
from gibson_sim.bags.comparison.response import AxisResponse
from gibson_sim.robots.spec import RobotSpec

MAX_MATCH_DISTANCE, MAX_MATCH_ANGLE = 0.15, np.radians(6.0)
"""Maximum distance between matching poses, m and rad."""
SCAN_MATCH = 0.05, math.radians(3.0)
"""Maximum distance between poses whose scans are compared, m and rad."""
TIMED_ROLES = ("odom", "truth", "imu", "scan", "image")
"""Roles whose topics' timing is compared."""


@dataclass(frozen=True, slots=True, eq=False)
class Comparison:
    """Result of ``compare``."""

    real: Measurements
    sim: Measurements
    rows: tuple[Row, ...]
    parameters: tuple[Parameter, ...]
    pictures: MatchedPictures | None
    scan_residuals: Residuals | None
    """Real minus simulated ranges at matched poses."""
    alignment: str
    """Alignment of the poses of both recordings, as text."""
    notes: tuple[str, ...]

    @property
    def differing(self) -> tuple[Row, ...]:
        """Rows with a notable difference, the largest first."""
        return tuple(sorted((row for row in self.rows if row.weight >= 1.0), key=lambda row: -row.weight))


@dataclass(frozen=True, slots=True)
class Row:
    """One metric of both recordings."""

    group: str
    name: str
    unit: str
    real: float
    """Metric of the real recording; NaN = the recording does not determine it."""
    sim: float
    notable: float
    """Minimum notable difference."""
    change: str = ""
    """Value to change in the ``robot.yaml``."""

    @property
    def difference(self) -> float:
        """Real minus simulated."""
        return self.real - self.sim

    @property
    def weight(self) -> float:
        """Absolute difference in units of ``notable``; 0 if a value is missing."""
        weight = abs(self.difference) / self.notable if self.notable > 0 else 0.0
        return weight if math.isfinite(weight) else 0.0


@dataclass(frozen=True, slots=True, eq=False)
class MatchedPictures:
    """Images of both recordings at nearly the same poses."""

    pairs: NDArray[np.intp]
    """Rows of the real and the simulated images, (K, 2)."""
    real: F64
    """Mean of ``STATISTICS`` of the real images, (8,)."""
    sim: F64
    histogram_distance: float
    """Mean distance of the histograms over the pairs."""


def compare(
    real: RecordedDrive, sim: RecordedDrive, robot: RobotSpec, assumptions: Assumptions | None = None, align: str = "auto"
) -> Comparison:
    """Compares two recordings.

    Args:
        real: Recording of the real robot.
        sim: Recording of ``robot``, simulated.
        robot: The simulated robot.
        assumptions: Values that no bag contains.
        align: ``map``: both have poses in one map; ``start``: poses are relative to the start of each; ``auto``: the map if both have
            poses in one.
    """
    assumptions = assumptions or Assumptions()
    a, b = measure(real, robot.drive, assumptions), measure(sim, robot.drive, assumptions)
    parameters = fitted_parameters(a, b, robot)
    how, poses = _aligned(real, sim, align)
    pictures = None if poses is None else _pictures(real, sim, *poses)
    residuals = None if poses is None else _scans(real, sim, *poses)
    rows = [*_velocity(a, b), *_drift(a, b), *_imu(a, b), *_lidar(a, b, residuals), *_pictures_rows(pictures), *_timing(a, b)]
    hints = {parameter.name: parameter for parameter in parameters if parameter.changes}
    notes = [
        f"{side}: {note}"
        for side, measured in (("real", a), ("sim", b))
        for note in (*measured.recording.notes, *_stuck(measured))
    ]
    return Comparison(a, b, tuple(_with_hint(row, hints) for row in rows), parameters, pictures, residuals, how, tuple(notes))


def _stuck(measured: Measurements) -> Iterator[str]:
    """Yields a note if wheel odometry and ground truth disagree for some time."""
    if measured.drift is not None and measured.drift.stuck_s > 0.0:
        yield (
            f"for {measured.drift.stuck_s:.0f} s wheels and truth disagree by far: the robot was stuck or pushed there; "
            "scales, slip and factors leave it out, errors over distances and at the end do not"
        )


def _with_hint(row: Row, hints: dict[str, Parameter]) -> Row:
    """Returns the row with the names of parameters in ``change`` replaced by their old and new values; other text stays."""
    names = row.change.split()
    if not names or not all("." in name and name.replace(".", "").replace("_", "").isalnum() for name in names):
        return row
    changes = [f"{name}: {hints[name].old:.4g} → {hints[name].new:.4g}" for name in names if name in hints]
    return Row(row.group, row.name, row.unit, row.real, row.sim, row.notable, ", ".join(changes))


def _velocity(a: Measurements, b: Measurements) -> Iterator[Row]:
    if a.fit is not None and b.fit is not None:
        delays = 1e3 * a.fit.delay.value, 1e3 * b.fit.delay.value
        yield Row("velocity", "delay over the whole drive", "ms", *delays, 10.0, "drive.command_delay")
    for name, unit, key, of_a, of_b in (
        ("forward", "m/s²", "linear", a.linear, b.linear),
        ("turning", "rad/s²", "angular", a.angular, b.angular),
    ):
        if of_a is None or of_b is None:
            continue
        group = f"velocity, {name}"
        yield Row(group, "delay", "ms", 1e3 * of_a.delay, 1e3 * of_b.delay, 25.0, "drive.command_delay")
        limit = f"drive.max_{key}_acceleration"
        rises = 1e3 * of_a.median("rise_time"), 1e3 * of_b.median("rise_time")
        yield Row(group, "rise time, 10 to 90 %", "ms", *rises, 0.1 * _larger(*rises), limit)
        slopes = _limit(a, key, of_a), _limit(b, key, of_b)
        yield Row(group, "acceleration limit", unit, *slopes, 0.05 * _larger(*slopes), limit)
        overshoots = 100 * of_a.median("overshoot"), 100 * of_b.median("overshoot")
        yield Row(group, "overshoot", "%", *overshoots, 3.0, "a controller's overshoot is not simulated")
        gains = "wheel_odometry.left_radius_factor wheel_odometry.right_radius_factor"
        hint = gains if key == "linear" else "wheel_odometry.separation_factor"
        yield Row(group, "settled velocity over command", "", of_a.gain, of_b.gain, 0.01, hint)


def _limit(measured: Measurements, key: str, response: AxisResponse) -> float:
    """Returns the acceleration limit by the fit, else by the slope of the steps."""
    fitted = None if measured.fit is None else getattr(measured.fit, f"{key}_acceleration")
    return response.median("acceleration") if fitted is None else float(fitted.value)


def _drift(a: Measurements, b: Measurements) -> Iterator[Row]:
    if a.drift is None or b.drift is None:
        return
    group, real, sim = "odometry", a.drift, b.drift
    yield Row(group, "forward distance over the true one", "", real.scales.forward, sim.scales.forward, 0.01, "drive.slip")
    yield Row(group, "turn over the true one", "", real.scales.turn, sim.scales.turn, 0.01, "drive.turn_slip")
    veer = "wheel_odometry.left_radius_factor wheel_odometry.right_radius_factor"
    yield Row(group, "veer", "°/m", math.degrees(real.scales.veer), math.degrees(sim.scales.veer), 0.5, veer)
    for length in sorted(set(real.error_per_m) & set(sim.error_per_m)):
        pair = 100 * real.error_per_m[length], 100 * sim.error_per_m[length]
        yield Row(group, f"error of position after {length:g} m", "%", *pair, 1.0, "drive.slip")
    per_metre = math.degrees(real.turn_per_m), math.degrees(sim.turn_per_m)
    yield Row(group, "error of heading a metre", "°/m", *per_metre, 0.5, "drive.turn_slip")
    per_turn = 100 * real.turn_per_rad, 100 * sim.turn_per_rad
    yield Row(group, "error of heading, of what it turned", "%", *per_turn, 1.0, "drive.turn_slip")
    yield Row(group, "final position error, % of path length", "%", _end_error(real), _end_error(sim), 1.0)


def _end_error(drift: Drift) -> float:
    """Returns the final position error, % of the path length; NaN for paths below 0.5 m."""
    return 100 * drift.end_error_m / drift.path_m if drift.path_m > 0.5 else math.nan


def _larger(*values: float) -> float:
    return max((abs(value) for value in values if math.isfinite(value)), default=0.0)


def _imu(a: Measurements, b: Measurements) -> Iterator[Row]:
    if a.imu is None or b.imu is None:
        return
    for name, unit, key, real, sim, least in (
        ("gyroscope", "rad/s", "gyro", a.imu.gyro, b.imu.gyro, 1e-5),
        ("accelerometer", "m/s²", "accel", a.imu.accel, b.imu.accel, 1e-4),
    ):
        for what, per, x, y, hint in (
            ("noise density", "/√Hz", real.density, sim.density, f"imu.{key}_noise"),
            ("bias instability", "", *_instabilities(real, sim), f"imu.{key}_bias_walk"),
            ("random walk of the bias", "/√s", real.walk, sim.walk, f"imu.{key}_bias_walk"),
        ):
            yield Row(f"IMU, {name}", what, unit + per, x, y, max(0.15 * _larger(x, y), least), hint)
    gyro, accel = (a.imu.gyro_bias_rms, b.imu.gyro_bias_rms), (a.imu.accel_bias_rms, b.imu.accel_bias_rms)
    yield Row("IMU, gyroscope", "bias, three axes", "rad/s", *gyro, max(0.2 * _larger(*gyro), 1e-4), "imu.gyro_bias")
    yield Row("IMU, accelerometer", "bias, three axes", "m/s²", *accel, max(0.2 * _larger(*accel), 5e-3), "imu.accel_bias")


def _instabilities(real: NoiseModel, sim: NoiseModel) -> tuple[float, float]:
    """Returns both bias instabilities; NaN if the recording ends before the curve rises, so that only an upper limit is known."""
    first, second = (model.instability if model.reaches else math.nan for model in (real, sim))
    return first, second


def _lidar(a: Measurements, b: Measurements, matched: Residuals | None) -> Iterator[Row]:
    real, sim = a.lidar, b.lidar
    if real is not None and sim is not None:
        noise = 1e3 * real.range_noise, 1e3 * sim.range_noise
        yield Row("lidar", "range noise", "mm", *noise, max(0.1 * _larger(*noise), 0.5), "lidar.range_noise")
        steps = 1e3 * real.resolution, 1e3 * sim.resolution
        yield Row("lidar", "steps of range", "mm", *steps, 0.5, "lidar.resolution")
        drops = 100 * real.dropout, 100 * sim.dropout
        yield Row("lidar", "beams that do not return", "%", *drops, max(0.1 * _larger(*drops), 0.2), "lidar.dropout")
        yield Row("lidar", "beams a turn", "", real.beams, sim.beams, 1.0, "lidar.beams")
    x, y = a.map_residuals, b.map_residuals
    if x is not None and y is not None:
        group, unmapped = "lidar against the map", "obstacles that are not on the map"
        yield Row(group, "bias", "mm", 1e3 * x.bias, 1e3 * y.bias, 10.0, "calibrate the real lidar, or its mount")
        yield Row(group, "spread", "mm", 1e3 * x.spread, 1e3 * y.spread, 10.0, "lidar.range_noise")
        yield Row(group, "beams off by 0.3 m", "%", 100 * x.outliers, 100 * y.outliers, 5.0, unmapped)
    if matched is not None:
        group = "lidar at the same poses"
        yield Row(
            group, "bias, real minus simulated", "mm", 1e3 * matched.bias, 0.0, 10.0, "calibrate the real lidar, or its mount"
        )
        yield Row(group, "beams off by 0.3 m", "%", 100 * matched.outliers, 0.0, 5.0, "the scene differs from the real room")


def _pictures_rows(matched: MatchedPictures | None) -> Iterator[Row]:
    if matched is None:
        return
    brightness = STATISTICS.index("brightness")
    stops = exposure_stops(float(matched.real[brightness]), float(matched.sim[brightness]))
    hints = {
        "brightness": f"effects.exposure_ev {stops:+.2f} of the camera, or the lamps of the scene",
        "contrast": "lights and materials of the scene",
        "sharpness": "textures of the scene, samples of the camera",
        "noise": "effects.shot_noise and effects.read_noise of the camera",
        "red": "effects.white_balance_k of the camera",
        "blue": "effects.white_balance_k of the camera",
    }
    for i, name in enumerate(STATISTICS):
        real, sim = float(matched.real[i]), float(matched.sim[i])
        notable = {"sharpness": 0.25 * _larger(real, sim), "noise": max(0.25 * _larger(real, sim), 0.002)}.get(name, 0.05)
        yield Row("images at the same poses", name, "", real, sim, notable, hints.get(name, ""))
    yield Row("images at the same poses", "distance of histograms", "", matched.histogram_distance, 0.0, 0.05)


def _timing(a: Measurements, b: Measurements) -> Iterator[Row]:
    for role in TIMED_ROLES:
        real, sim = ((measured.timing or {}).get(measured.recording.topics.get(role, "")) for measured in (a, b))
        if real is None or sim is None or not (real.rate_hz and sim.rate_hz):
            continue
        group = f"topic {a.recording.topics[role]}"
        hint = {"imu": "imu.rate_hz", "scan": "lidar.rate_hz", "odom": "--publish-hz of the run"}.get(role, "")
        yield Row(group, "rate", "Hz", real.rate_hz, sim.rate_hz, 0.05 * real.rate_hz, hint)
        yield Row(group, "jitter", "ms", real.jitter_ms, sim.jitter_ms, max(50.0 / real.rate_hz, 1.0))
        clock_hint = "log time minus stamp: only meaningful if both use one clock"
        yield Row(group, "latency", "ms", real.latency_ms, sim.latency_ms, 20.0, clock_hint)
        yield Row(group, "missing messages", "%", 100.0 * real.missing_part, 100.0 * sim.missing_part, 1.0)


def _aligned(real: RecordedDrive, sim: RecordedDrive, align: str) -> tuple[str, tuple[PlanarTrack, PlanarTrack] | None]:
    """Returns a description of the alignment, and both tracks in one frame; None = a recording has no poses."""
    both_mapped = real.truth is not None and sim.truth is not None
    on_map = align == "map" or (align == "auto" and both_mapped)
    tracks = [
        recording.truth if on_map and recording.truth is not None else recording.odometry or recording.truth
        for recording in (real, sim)
    ]
    if tracks[0] is None or tracks[1] is None:
        return "no poses: nothing is compared at the same ones", None
    if on_map:
        return "poses in the map", (tracks[0], tracks[1])
    return "poses seen from the start of each", (_from_start(tracks[0]), _from_start(tracks[1]))


def _from_start(track: PlanarTrack) -> PlanarTrack:
    poses = np.stack([track.x, track.y, track.yaw], axis=1)
    x, y, yaw = from_start(poses, poses[0]).T
    return PlanarTrack(track.t, x, y, yaw, track.linear, track.angular, track.source)


def _pictures(real: RecordedDrive, sim: RecordedDrive, a: PlanarTrack, b: PlanarTrack) -> MatchedPictures | None:
    if real.pictures is None or sim.pictures is None:
        return None
    pairs = matches(np.stack(a.at(real.pictures.t), axis=1), np.stack(b.at(sim.pictures.t), axis=1))
    if not len(pairs):
        return None
    means = [recording.statistics[pairs[:, i]].mean(axis=0) for i, recording in enumerate((real.pictures, sim.pictures))]
    distances = [histogram_distance(real.pictures.histograms[i], sim.pictures.histograms[j]) for i, j in pairs]
    return MatchedPictures(pairs, means[0], means[1], float(np.mean(distances)))


def _scans(real: RecordedDrive, sim: RecordedDrive, a: PlanarTrack, b: PlanarTrack) -> Residuals | None:
    if real.scans is None or sim.scans is None:
        return None
    poses = scan_poses(real.scans, a), scan_poses(sim.scans, b)
    return residuals_at_matches(real.scans, poses[0], sim.scans, poses[1], matches(*poses, *SCAN_MATCH))


def from_start(poses: F64, start: F64) -> F64:
    """Returns poses (N, 3), x, y, yaw, relative to the pose ``start``, (3,)."""
    dx, dy = poses[:, 0] - start[0], poses[:, 1] - start[1]
    cos, sin = np.cos(start[2]), np.sin(start[2])
    return np.stack([dx * cos + dy * sin, dy * cos - dx * sin, poses[:, 2] - start[2]], axis=1)


def matches(a: F64, b: F64, max_distance: float = MAX_MATCH_DISTANCE, max_angle: float = MAX_MATCH_ANGLE) -> NDArray[np.intp]:
    """Returns (K, 2): rows of ``a`` with the nearest row of ``b``, no row of ``b`` twice, in the order of ``a``.

    Args:
        a: (N, 3), x, y (m), yaw (rad); rows with NaN match nothing.
        b: (M, 3), in the same frame.
        max_distance: Maximum distance, metres.
        max_angle: Maximum heading difference, radians.
    """
    rows_a, rows_b = (np.flatnonzero(np.isfinite(poses).all(axis=1)) for poses in (a, b))
    if not len(rows_a) or not len(rows_b):
        return np.zeros((0, 2), dtype=np.intp)
    # A rotation by max_angle weighs as much as a translation by max_distance.
    lever = max_distance / (2 * np.sin(max_angle / 2))
    points = [
        np.stack([p[:, 0], p[:, 1], lever * np.cos(p[:, 2]), lever * np.sin(p[:, 2])], axis=1) for p in (a[rows_a], b[rows_b])
    ]
    distance, nearest = cKDTree(points[1]).query(points[0], distance_upper_bound=1.5 * max_distance)
    pairs, used = [], set()
    for i in np.argsort(distance, kind="stable"):
        if np.isfinite(distance[i]) and nearest[i] not in used:
            used.add(nearest[i])
            pairs.append((rows_a[i], rows_b[nearest[i]]))
    return np.array(sorted(pairs), dtype=np.intp).reshape(-1, 2)
