"""Data of a recorded run that is plotted: arrays. Times are seconds: of simulation, or since the start of a bag of wall time."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gibson_sim.bags.plots.touches import Touch

F64 = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Track:
    """Planar poses in one frame."""

    t: F64
    """Times, (N,), increasing, s."""
    x: F64
    y: F64
    """Position, (N,), metres."""
    yaw: F64
    """Heading, (N,), radians, unwrapped."""
    source: str
    """Topic or transforms that they come from."""

    def at(self, t: float) -> tuple[float, float, float]:
        """Returns x, y (m) and yaw (rad) at a time, interpolated; the first or the last pose outside the track."""
        x, y, yaw = (float(np.interp(t, self.t, values)) for values in (self.x, self.y, self.yaw))
        return x, y, yaw

    def laid_onto(self, other: Track) -> Track:
        """Returns the track transformed so that it has the pose of the other one at the first common time."""
        t = max(float(self.t[0]), float(other.t[0]))
        (x0, y0, yaw0), (x1, y1, yaw1) = self.at(t), other.at(t)
        turn = yaw1 - yaw0
        dx, dy, c, s = self.x - x0, self.y - y0, np.cos(turn), np.sin(turn)
        return Track(self.t, x1 + c * dx - s * dy, y1 + s * dx + c * dy, self.yaw + turn, self.source)


@dataclass(frozen=True, slots=True, eq=False)
class Velocities:
    """Planar velocities in the base frame."""

    t: F64
    """Times, (N,), s."""
    forward: F64
    sideways: F64
    """Lateral velocity, (N,), m/s."""
    turning: F64
    """Yaw rate, (N,), rad/s."""
    source: str
    """Topic that they come from."""


@dataclass(frozen=True, slots=True, eq=False)
class RobotRun:
    """Motion, commands and contacts of one robot; None = the bag does not have them."""

    name: str
    """Namespace of its topics; empty for a single robot."""
    truth: Track | None
    odometry: Track | None
    """Laid onto the truth, or the estimate, at its start."""
    estimate: Track | None
    """Estimate of a localiser: a pose topic, or the transform map -> odom."""
    commands: Velocities | None
    by_wheels: Velocities | None
    in_truth: Velocities | None
    touches: tuple[Touch, ...]

    @property
    def reference(self) -> Track | None:
        """The best available track."""
        return self.truth or self.estimate or self.odometry


@dataclass(frozen=True, slots=True, eq=False)
class Floor:
    """The map below the paths."""

    cells: NDArray[np.int8]
    """Cells, (rows, columns), as in nav_msgs/OccupancyGrid: 0 free to 100 occupied, -1 unknown; row 0 has the lowest y."""
    resolution: float
    """Edge of a cell, metres."""
    origin: tuple[float, float]
    """World x, y of the corner of cell (0, 0), metres."""
    source: str
    """Topic, or scene, that it comes from."""

    @property
    def extent(self) -> tuple[float, float, float, float]:
        """Left, right, bottom and top in the world, metres."""
        rows, columns = self.cells.shape
        x, y = self.origin
        return x, x + columns * self.resolution, y, y + rows * self.resolution


@dataclass(frozen=True, slots=True, eq=False)
class Arrivals:
    """The messages of one topic."""

    topic: str
    t: F64
    """Log times, (N,), s, increasing."""


@dataclass(frozen=True, slots=True, eq=False)
class RecordedRun:
    """All plotted data of a bag."""

    folder: Path
    begin: float
    end: float
    """Times of the first and the last message, s."""
    time_label: str
    """Label of time axes."""
    robots: tuple[RobotRun, ...]
    floor: Floor | None
    has_contact_topics: bool
    """Whether the bag has topics that report contacts."""
    arrivals: tuple[Arrivals, ...]
    """Arrivals of topics that are not latched, sorted by name."""
    notes: tuple[str, ...] = ()
    """Omitted data with reasons, one sentence each."""
