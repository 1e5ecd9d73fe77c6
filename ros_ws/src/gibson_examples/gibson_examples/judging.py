"""What counts as a run that went well. Knows no ROS."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from gibson_examples.geometry import F64, Pose2D
from gibson_examples.grid import Grid, distance_to

REACHED_WITHIN = 0.25
"""Metres, true position to goal."""
BODY_RADIUS = 0.175
"""Of gibson_bot, metres: with less than this to an obstacle of the map it may have touched something."""
DOORWAYS = 2


@dataclass(frozen=True, slots=True)
class Run:
    """How one run went. Metres, seconds of simulation time, degrees."""

    goal: str
    status: str
    """What the navigation said last."""
    error: float
    """True position to goal."""
    heading_error_deg: float
    clearance: float
    """Smallest true distance of the robot's centre to anything on the map."""
    closest: tuple[float, float]
    """Where that was, map frame."""
    length: float
    """Driven."""
    duration: float
    doorways: tuple[str, ...]
    """Those it drove through."""
    recoveries: int
    """How often it had to get itself free."""
    localisation_error: float
    """Mean distance of the estimated position from the true one."""
    localisation_error_max: float

    @property
    def passed(self) -> bool:
        """Whether it counts."""
        near = self.status.startswith("reached") and self.error <= REACHED_WITHIN
        return near and self.clearance >= BODY_RADIUS and len(self.doorways) >= DOORWAYS


@dataclass(frozen=True, slots=True)
class Trial:
    """All runs of one simulation, and what the navigation node cost."""

    scene: str
    robot: str
    rate: float
    seed: int
    runs: tuple[Run, ...]
    real_time_factor: float
    """Simulated seconds a second: what came of ``rate``."""
    cpu_per_simulated_second: float
    """Seconds of one core that the node used: at real time, its share of a core."""

    @property
    def passed(self) -> int:
        """How many runs count."""
        return sum(run.passed for run in self.runs)


def describe(run: Run) -> str:
    """Returns a run in one line."""
    return (
        f"{'ok  ' if run.passed else 'FAIL'} {run.goal:>16}  {run.error:.3f} m  {run.heading_error_deg:4.1f} deg  "
        f"{run.length:5.1f} m in {run.duration:5.1f} s  "
        f"clearance {run.clearance:.2f} m at {run.closest[0]:.2f},{run.closest[1]:.2f}  {run.recoveries} recoveries  "
        f"localised to {run.localisation_error:.3f} m (max {run.localisation_error_max:.3f})  "
        f"{', '.join(run.doorways)}  [{run.status}]"
    )


def initial_error(seed: int, run: int) -> Pose2D:
    """Returns how wrong the initial pose of a run is, in the robot's frame: 0.1 m and 5 degrees, one sigma, at most two."""
    x, y, yaw = np.clip(np.random.default_rng((seed, run)).standard_normal(3), -2.0, 2.0)
    return Pose2D(0.1 * float(x), 0.1 * float(y), math.radians(5.0) * float(yaw))


def track_clearance(grid: Grid, track: F64) -> tuple[float, tuple[float, float]]:
    """Returns the smallest distance of a track's points (N, 2), metres, from anything on the map, and where that is."""
    distances = grid.values(distance_to(grid.occupied, grid.resolution), track, np.inf)
    nearest = int(distances.argmin())
    return float(distances[nearest]), (float(track[nearest, 0]), float(track[nearest, 1]))
