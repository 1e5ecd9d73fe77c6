"""Criteria for a successful run. Independent of ROS."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from gibson_examples.geometry import F64, Pose2D
from gibson_examples.grid import Grid, distance_to

REACHED_WITHIN = 0.25
"""Largest distance of the true position from a reached goal, metres."""
BODY_RADIUS = 0.175
"""Radius of gibson_bot, metres: with less clearance it may have touched an obstacle of the map."""
DOORWAYS = 2
"""Fewest doorways of a run that counts."""


@dataclass(frozen=True, slots=True)
class Run:
    """Result of one run. Metres, seconds of simulation time, degrees."""

    goal: str
    status: str
    """Last status of the navigation node."""
    error: float
    """Distance of the true position from the goal."""
    heading_error_deg: float
    clearance: float
    """Smallest true distance of the robot's centre from an obstacle of the map."""
    closest: tuple[float, float]
    """Position of the smallest distance, map frame."""
    length: float
    """Distance driven."""
    duration: float
    doorways: tuple[str, ...]
    """Doorways that the robot passed."""
    recoveries: int
    localisation_error: float
    """Mean distance of the estimated position from the true one."""
    localisation_error_max: float

    @property
    def passed(self) -> bool:
        """Whether the run was successful."""
        near = self.status.startswith("reached") and self.error <= REACHED_WITHIN
        return near and self.clearance >= BODY_RADIUS and len(self.doorways) >= DOORWAYS


@dataclass(frozen=True, slots=True)
class Trial:
    """All runs of one simulation, and the cost of the navigation node."""

    scene: str
    robot: str
    rate: float
    seed: int
    runs: tuple[Run, ...]
    real_time_factor: float
    """Simulated seconds per second, as measured; ``rate`` was requested."""
    cpu_per_simulated_second: float
    """Seconds of processor time that the node used: at real time, its fraction of a core."""

    @property
    def passed(self) -> int:
        """Number of successful runs."""
        return sum(run.passed for run in self.runs)


def describe(run: Run) -> str:
    """Returns one line about a run."""
    return (
        f"{'ok  ' if run.passed else 'FAIL'} {run.goal:>16}  {run.error:.3f} m  {run.heading_error_deg:4.1f} deg  "
        f"{run.length:5.1f} m in {run.duration:5.1f} s  "
        f"clearance {run.clearance:.2f} m at {run.closest[0]:.2f},{run.closest[1]:.2f}  {run.recoveries} recoveries  "
        f"localised to {run.localisation_error:.3f} m (max {run.localisation_error_max:.3f})  "
        f"{', '.join(run.doorways)}  [{run.status}]"
    )


def initial_error(seed: int, run: int) -> Pose2D:
    """Returns the error of a run's initial pose, in the robot's frame: sigma 0.1 m and 5 degrees, at most two sigma."""
    x, y, yaw = np.clip(np.random.default_rng((seed, run)).standard_normal(3), -2.0, 2.0)
    return Pose2D(0.1 * float(x), 0.1 * float(y), math.radians(5.0) * float(yaw))


def track_clearance(grid: Grid, track: F64) -> tuple[float, tuple[float, float]]:
    """Returns the smallest distance of a track's points (N, 2), metres, from an obstacle of the map, and the point."""
    distances = grid.values(distance_to(grid.occupied, grid.resolution), track, np.inf)
    nearest = int(distances.argmin())
    return float(distances[nearest]), (float(track[nearest, 0]), float(track[nearest, 1]))
