"""Path following with a differential drive, and scripted drives. Pure: computes a speed and a yaw rate from a pose."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gibson_sim.errors import CommandError, ConfigError
from gibson_sim.geometry.transforms import wrap_angle
from gibson_sim.quoting import quoted

F64 = NDArray[np.float64]

GOAL_TOLERANCE = 0.05
"""Distance at which a corner or the end of the path counts as reached, metres."""
CUSP = math.radians(50.0)
"""Minimum direction change of a path at which the robot stops and turns in place, radians."""
TURN_FROM = math.radians(50.0)
"""Heading error above which the robot starts to turn in place, radians."""
TURN_UNTIL = math.radians(6.0)
"""Heading error below which it stops turning in place, radians."""
SLOWDOWN = 0.5
"""Deceleration planned towards corners and the end, m/s^2."""
MIN_LINEAR = 0.06
"""Minimum speed along the path, m/s, so that a corner is reached in finite time."""
TURN_GAIN = 2.5
"""Yaw rate per heading error when turning in place, 1/s."""
SQUARE_SIDE = 1.0
"""Side of the square drive, metres."""


class PathFollower:
    """Regulated pure pursuit: drives towards a lookahead point on the path, slows down in bends, turns in place at corners.

    Args:
        path: (N, 2), metres, N >= 2, in the frame of the poses.
        max_linear: maximum speed, m/s.
        max_angular: maximum yaw rate, rad/s.
        lookahead: distance along the path to the lookahead point, metres.

    Raises:
        ConfigError: the path has fewer than two distinct points, or a limit is not above 0.
    """

    def __init__(self, path: ArrayLike, max_linear: float = 0.4, max_angular: float = 1.2, lookahead: float = 0.25) -> None:
        for name, value in (("max_linear", max_linear), ("max_angular", max_angular), ("lookahead", lookahead)):
            if not (math.isfinite(value) and value > 0):
                raise ConfigError(f"path follower: {name} is {quoted(value)}, must be a finite number above 0")
        self._max_linear, self._max_angular, self._lookahead = max_linear, max_angular, lookahead
        self._points = _distinct(path)
        steps = np.linalg.norm(np.diff(self._points, axis=0), axis=1)
        self._arc = np.concatenate([[0.0], np.cumsum(steps)])
        self._ends = _cusps(self._points)
        self._leg = 0
        self._at = 0.0
        self._turning = True
        self._done = False

    @property
    def done(self) -> bool:
        """Whether the end is reached."""
        return self._done

    @property
    def length(self) -> float:
        """Length of the path, metres."""
        return float(self._arc[-1])

    @property
    def progress(self) -> float:
        """Fraction of the path that is completed, 0 to 1."""
        return 1.0 if self._done else self._at / self.length

    def command(self, x: float, y: float, yaw: float) -> tuple[float, float]:
        """Returns forward speed (m/s) and yaw rate (rad/s) for a pose in the frame of the path (metres, radians)."""
        if not all(map(math.isfinite, (x, y, yaw))):
            raise CommandError(f"path follower: pose ({x}, {y}, {yaw}) holds a NaN or an infinity")
        position = np.array([x, y])
        if not self._done:
            self._advance(position)
        if self._done:
            return 0.0, 0.0
        end = float(self._arc[self._ends[self._leg]])
        target = self._point_at(min(self._at + self._lookahead, end))
        if float(np.linalg.norm(target - position)) < GOAL_TOLERANCE:
            target = self._point_at(end)
        dx, dy = (float(c) for c in target - position)
        error = wrap_angle(math.atan2(dy, dx) - yaw)
        if abs(error) > TURN_FROM:
            self._turning = True
        elif abs(error) < TURN_UNTIL:
            self._turning = False
        if self._turning:
            return 0.0, self._clip_turn(TURN_GAIN * error)
        return self._pursue(error, math.hypot(dx, dy), float(np.linalg.norm(self._point_at(end) - position)))

    def _pursue(self, error: float, distance: float, to_corner: float) -> tuple[float, float]:
        """Returns the command that drives an arc through the lookahead point."""
        curvature = 2.0 * math.sin(error) / max(distance, GOAL_TOLERANCE)
        linear = min(self._max_linear, math.sqrt(2 * SLOWDOWN * max(to_corner - GOAL_TOLERANCE / 2, 0.0)))
        if abs(curvature) > 1e-9:
            # Keep half of the yaw rate in reserve for corrections.
            linear = min(linear, max(0.5 * self._max_angular / abs(curvature), MIN_LINEAR))
        linear = min(max(linear, MIN_LINEAR), self._max_linear)
        return linear, self._clip_turn(linear * curvature)

    def _clip_turn(self, angular: float) -> float:
        return min(max(angular, -self._max_angular), self._max_angular)

    def _advance(self, position: F64) -> None:
        """Advances ``_at`` to the nearest point of the path ahead, but not beyond a corner that is not reached."""
        end_index = self._ends[self._leg]
        end = float(self._arc[end_index])
        self._at = self._nearest(position, self._at, min(self._at + 2 * self._lookahead + 0.5, end))
        if float(np.linalg.norm(self._points[end_index] - position)) > GOAL_TOLERANCE and not self._passed(position, end_index):
            return
        self._at, self._turning = end, True
        self._leg += 1
        if self._leg == len(self._ends):
            self._done = True

    def _passed(self, position: F64, index: int) -> bool:
        """Returns whether the robot has passed a nearby corner; else it would circle about a point beside its path."""
        along = self._points[index] - self._points[index - 1]
        offset = position - self._points[index]
        return bool(offset @ along >= 0 and np.linalg.norm(offset) < 3 * GOAL_TOLERANCE)

    def _nearest(self, position: F64, first: float, last: float) -> float:
        """Returns the arc length of the nearest point between two arc lengths."""
        i = min(max(int(np.searchsorted(self._arc, first, side="right")) - 1, 0), len(self._points) - 2)
        j = max(int(np.searchsorted(self._arc, last, side="left")), i + 1)
        a, b = self._points[i:j], self._points[i + 1 : j + 1]
        along = b - a
        t = np.clip(np.sum((position - a) * along, axis=1) / np.sum(along * along, axis=1), 0.0, 1.0)
        nearest = int(np.argmin(np.sum((a + t[:, None] * along - position) ** 2, axis=1)))
        arc = self._arc[i + nearest] + t[nearest] * (self._arc[i + nearest + 1] - self._arc[i + nearest])
        return float(min(max(arc, first), last))

    def _point_at(self, arc: float) -> F64:
        return np.array([np.interp(arc, self._arc, self._points[:, k]) for k in range(2)])


def _distinct(path: ArrayLike) -> F64:
    """Returns the path (N, 2) without consecutive duplicates."""
    points = np.asarray(path, dtype=np.float64)
    if points.ndim != 2 or points.shape[1] != 2 or not np.isfinite(points).all():
        raise ConfigError(f"path follower: the path has shape {points.shape}; it must be (N, 2) finite numbers")
    keep = np.ones(len(points), dtype=bool)
    keep[1:] = np.linalg.norm(np.diff(points, axis=0), axis=1) > 1e-6
    if int(keep.sum()) < 2:
        raise ConfigError("path follower: the path needs at least two different points")
    return points[keep]


def _cusps(points: F64) -> list[int]:
    """Returns the indices of the corners at which the robot must turn in place, and of the end."""
    headings = np.arctan2(*np.diff(points, axis=0).T[::-1])
    turns = np.abs((np.diff(headings) + math.pi) % (2 * math.pi) - math.pi)
    return [*(int(i) + 1 for i in np.flatnonzero(turns > CUSP)), len(points) - 1]


@dataclass(frozen=True, slots=True)
class ScriptedDrive:
    """A sequence of velocities over time."""

    steps: tuple[tuple[float, float, float], ...]
    """Steps (forward speed m/s, yaw rate rad/s, duration s)."""

    def __post_init__(self) -> None:
        if not self.steps:
            raise ConfigError("scripted drive: there are no steps; give at least one `linear angular seconds`")
        for step in self.steps:
            if len(step) != 3 or not all(map(math.isfinite, step)) or step[2] <= 0:
                raise ConfigError(f"scripted drive: step {step} must be finite m/s, rad/s and seconds above 0")

    @property
    def duration(self) -> float:
        """Total duration, seconds."""
        return sum(seconds for _, _, seconds in self.steps)

    def command(self, seconds: float) -> tuple[float, float]:
        """Returns forward speed (m/s) and yaw rate (rad/s) at a time since the start; zero before it and after the end."""
        if seconds < 0:
            return 0.0, 0.0
        for linear, angular, lasting in self.steps:
            if seconds < lasting:
                return linear, angular
            seconds -= lasting
        return 0.0, 0.0


def scripted_drive(name: str, *, linear: float = 0.4, angular: float = 1.2, length: float = 2.0) -> ScriptedDrive:
    """Returns a drive by name, or read from a file.

    Args:
        name: ``forward`` (straight for ``length``), ``square`` (sides of 1 m, counter-clockwise, ending at the start pose), ``spin``
            (one revolution counter-clockwise), or a text file for ``parse_script``.
        linear: speed of the named drives, m/s.
        angular: yaw rate of the named drives, rad/s.
        length: length of ``forward``, metres.

    Raises:
        ConfigError: the name is neither known nor a readable file, or the file is not a script.
    """
    if name == "forward":
        return ScriptedDrive(((linear, 0.0, length / linear),))
    if name == "spin":
        return ScriptedDrive(((0.0, angular, 2 * math.pi / angular),))
    if name == "square":
        return ScriptedDrive(((linear, 0.0, SQUARE_SIDE / linear), (0.0, angular, math.pi / 2 / angular)) * 4)
    try:
        text = Path(name).read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as e:
        why = e.strerror if isinstance(e, OSError) else "it is not text"
        raise ConfigError(
            f"drive {quoted(name)} is neither forward, square nor spin, nor a text file that can be read ({why})"
        ) from e
    return parse_script(text, name)


def parse_script(text: str, source: str = "script") -> ScriptedDrive:
    """Returns the drive in a text with lines ``linear angular seconds`` (m/s, rad/s, s); ``#`` starts a comment."""
    steps: list[tuple[float, float, float]] = []
    for number, line in enumerate(text.splitlines(), start=1):
        words = line.split("#", 1)[0].replace(",", " ").split()
        if not words:
            continue
        try:
            linear, angular, seconds = (float(word) for word in words)
        except ValueError as e:
            raise ConfigError(
                f"{source}, line {number}: {quoted(line.strip())} must be three numbers, `linear angular seconds` (m/s, rad/s, s)"
            ) from e
        steps.append((linear, angular, seconds))
    return ScriptedDrive(tuple(steps))
