"""Data of one bag to be compared: arrays, one object for each role. Times are seconds since the recording began."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

F64 = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Commands:
    """Velocity commands, in the order of their arrival."""

    t: F64
    """Times of arrival at the recorder, on the clock of the stamps, (N,), seconds."""
    linear: F64
    """Linear velocity, (N,), m/s."""
    angular: F64
    """Angular velocity, (N,), rad/s."""


@dataclass(frozen=True, slots=True, eq=False)
class PlanarTrack:
    """Planar poses in one frame, and velocities in the base frame."""

    t: F64
    """Times, (N,), seconds, increasing."""
    x: F64
    y: F64
    """Position, (N,), metres."""
    yaw: F64
    """Heading, (N,), radians, unwrapped."""
    linear: F64
    """Forward velocity, (N,), m/s; NaN if the source has no velocities."""
    angular: F64
    """Yaw rate, (N,), rad/s; NaN if the source has no velocities."""
    source: str = ""
    """Name of the source, for display."""

    def at(self, t: F64) -> tuple[F64, F64, F64]:
        """Returns x, y, yaw, each (M,), interpolated; NaN outside the track."""
        x, y, yaw = (np.interp(t, self.t, values, left=np.nan, right=np.nan) for values in (self.x, self.y, self.yaw))
        return x, y, yaw


@dataclass(frozen=True, slots=True, eq=False)
class ImuSamples:
    """Samples of an IMU in its own frame."""

    t: F64
    """Times, (N,), seconds, increasing."""
    gyro: F64
    """Angular velocity, (N, 3), rad/s."""
    accel: F64
    """Linear acceleration, (N, 3), m/s^2."""


@dataclass(frozen=True, slots=True, eq=False)
class Scans:
    """Scans of a planar lidar."""

    t: F64
    """Times, (N,), seconds, increasing."""
    ranges: F64
    """Ranges, (N, B), metres; not finite = no return."""
    angle_min: float
    """Angle of the first beam about the lidar's z axis, radians."""
    angle_increment: float
    """Angle between beams, radians."""
    range_min: float
    range_max: float
    """Maximum range, metres."""
    mount: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Pose x, y (m) and yaw (rad) of the lidar in the base frame."""
    upside_down: bool = False

    @property
    def angles(self) -> F64:
        """(B,), radians from the base's x axis, counter-clockwise from above."""
        angles = self.angle_min + self.angle_increment * np.arange(self.ranges.shape[1])
        return np.asarray(self.mount[2] + (-angles if self.upside_down else angles), dtype=np.float64)


@dataclass(frozen=True, slots=True, eq=False)
class OccupancyMap:
    """A map of walls."""

    occupied: NDArray[np.bool_]
    """Mask of the occupied cells, (rows, columns); row 0 is the lowest y."""
    resolution: float
    """Edge of a cell, metres."""
    origin: tuple[float, float]
    """Corner of cell (0, 0) in the map frame, metres."""


@dataclass(frozen=True, slots=True, eq=False)
class Pictures:
    """Statistics of images, one row each; of the pixels, only thumbnails are kept."""

    t: F64
    """Times, (N,), seconds."""
    statistics: F64
    """Statistics, (N, len(pictures.STATISTICS))."""
    histograms: F64
    """Luma histograms, (N, 64), fraction of the pixels."""
    thumbnails: tuple[NDArray[np.uint8], ...] = ()
    """Thumbnails, each (h, w, 3) RGB."""


@dataclass(frozen=True, slots=True, eq=False)
class Arrivals:
    """Log times and stamps of the messages of one topic."""

    log_ns: NDArray[np.int64]
    """Log times, (N,), nanoseconds."""
    stamp_ns: NDArray[np.int64] | None
    """Stamps, (N,), nanoseconds; None = the type has no stamp."""


@dataclass(frozen=True, slots=True, eq=False)
class RecordedDrive:
    """All compared data of one bag; None = the bag does not have it."""

    path: Path
    duration: float
    """Duration, seconds."""
    topics: dict[str, str]
    """Role -> topic."""
    commands: Commands | None = None
    odometry: PlanarTrack | None = None
    truth: PlanarTrack | None = None
    imu: ImuSamples | None = None
    scans: Scans | None = None
    map: OccupancyMap | None = None
    pictures: Pictures | None = None
    arrivals: dict[str, Arrivals] = field(default_factory=dict)
    """Topic -> arrivals."""
    notes: tuple[str, ...] = ()
    """Missing data and assumptions, one sentence each."""
