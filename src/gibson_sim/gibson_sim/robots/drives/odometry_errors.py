"""Covariances of the pose and the twist of wheel odometry, computed from the errors in a robot's file. Pure.

The error of the pose is propagated as in Siegwart, Nourbakhsh and Scaramuzza, "Introduction to Autonomous Mobile Robots" (2011), 5.2.4:
an error of the yaw displaces all later motion. The effect of each error source is propagated separately, not in one matrix, since the errors are
not white noise:

- Wrong radii, a wrong separation and a constant slip last for the whole run. Their effects grow with the distance, not with its square root.
- Random slip is constant over 1 m or 1 rad (``wheel_odometry``), then it is sampled again. Within such a segment its effect grows like
  that of a constant; the effects of completed segments are summed as independent errors, in a matrix: the alphas of Thrun, Burgard and Fox,
  "Probabilistic Robotics" (2005), 5.4.
- Encoders lag by less than a tick, regardless of the distance.

A robot does not know the sign of its systematic errors, so each is modelled as a random number with mean 0 and its size as standard deviation.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

from gibson_sim.robots.sensor_specs import WheelOdometrySpec

Planar = tuple[float, float, float]
"""x (m), y (m), yaw (rad); or forward, left, turn; or their rates."""
Matrix3 = tuple[float, float, float, float, float, float, float, float, float]
"""A 3 x 3 matrix, row by row."""
_NONE: Planar = (0.0, 0.0, 0.0)

_LEAST_POSE = 1e-6
"""Minimum variance of the pose, m^2 and rad^2, since filters divide by variances: a robot settles on its wheels by less than 1 mm and 1 mrad."""
_LEAST_SPEED = 1e-6
"""Minimum variance of the forward speed, (m/s)^2."""
_LEAST_SIDEWAYS = 1e-5
"""Minimum variance of the lateral speed, (m/s)^2: contacts in the engine are compliant, and heavy skidding robots move by some mm/s."""
_LEAST_YAW_RATE = 1e-6
"""Minimum variance of the yaw rate, (rad/s)^2."""
_ROLLING = 0.002
"""Relative rolling error of wheels in the engine, whose contacts are slightly compliant."""
_PIECE_M, _PIECE_RAD = 0.01, 0.02
"""Translation (m) and rotation (rad) after which a motion is propagated; shorter paths are nearly straight."""
_STEERED = 0.0015
"""Unmeasured rotation of a base with steered wheels, rad per square root of a metre: they slide a little while their angle changes."""


class OdometryCovariance(NamedTuple):
    """Covariances of odometry."""

    pose: Matrix3
    """Covariance of x, y (m) and yaw (rad), odom frame."""
    twist: Matrix3
    """Covariance of the speeds forward and to the left (m/s) and the yaw rate (rad/s), base frame."""


class _Motion(NamedTuple):
    """A motion of the base as measured by the wheels, or its rates."""

    forward: float = 0.0
    left: float = 0.0
    turn: float = 0.0
    by_left_wheels: Planar = (0.0, 0.0, 0.0)
    """The part of (forward, left, turn) due to the wheels on the left."""
    distance: float = 0.0
    """Length of the translation, m."""
    angle: float = 0.0
    """Absolute rotation, rad."""
    turning: tuple[float, float] = (0.0, 0.0)
    """``angle`` times the direction of the translation; forward if the base turns in place."""

    def plus(self, other: _Motion) -> _Motion:
        (a, b, c), (p, q, r) = self.by_left_wheels, other.by_left_wheels
        return _Motion(
            self.forward + other.forward, self.left + other.left, self.turn + other.turn, (a + p, b + q, c + r),
            self.distance + other.distance, self.angle + other.angle,
            (self.turning[0] + other.turning[0], self.turning[1] + other.turning[1]),
        )  # fmt: skip

    def over(self, seconds: float) -> _Motion:
        a, b, c = self.by_left_wheels
        return _Motion(
            self.forward / seconds, self.left / seconds, self.turn / seconds, (a / seconds, b / seconds, c / seconds),
            self.distance / seconds, self.angle / seconds, (self.turning[0] / seconds, self.turning[1] / seconds),
        )  # fmt: skip


class OdometryErrors:
    """Covariances of one robot's odometry since its last reset.

    They depend only on the measured motion; reading them has no effect on the state.
    """

    def __init__(
        self,
        spec: WheelOdometrySpec,
        slip: float = 0.0,
        turn_slip: float = 0.0,
        ticks: Sequence[Planar] = (),
        *,
        steered: bool = False,
    ) -> None:
        """Starts at the origin of the odom frame, at rest.

        Args:
            spec: Errors of the odometry.
            slip: Fraction of the distance that the wheels roll and the base does not move.
            turn_slip: Fraction of the rotation that the wheels roll and the base does not make.
            ticks: For each wheel, the motion of the base (forward m, left m, rotation rad) per encoder tick; () = no encoders.
            steered: Whether the robot has steered wheels.
        """
        self._radii = spec.left_radius_factor - 1.0, spec.right_radius_factor - 1.0
        self._scale, self._turn_scale = math.hypot(slip, _ROLLING), math.hypot(spec.separation_factor - 1.0, turn_slip, _ROLLING)
        alphas = spec.alpha1, spec.alpha2 + (_STEERED**2 if steered else 0.0), spec.alpha3, spec.alpha4
        self._slip = tuple(math.sqrt(alpha) for alpha in alphas)
        self._ticks = tuple(ticks)
        self.reset()

    def reset(self) -> None:
        """Restarts with an exact pose."""
        self._yaw = 0.0
        self._lasting = [_NONE] * 4
        """Effects of the persistent errors on the pose, one standard deviation each."""
        self._by_distance, self._by_angle = [_NONE] * 2, [_NONE] * 2
        self._finished: tuple[float, ...] = (0.0,) * 6
        """Covariance of completed slip segments: xx, xy, x yaw, yy, y yaw, yaw yaw."""
        self._distance_left = self._angle_left = 1.0
        self._pending, self._last = _Motion(), _Motion()
        self._dt, self._still = 1.0, 0.0

    def add(self, forward: float, left: float, turn: float, by_left_wheels: Planar, dt: float) -> None:
        """Adds a small motion, as measured by odometry.

        Args:
            forward: Motion along the base's x axis, metres.
            left: Motion along its y axis, metres.
            turn: Rotation, radians, counter-clockwise.
            by_left_wheels: The part of (forward, left, turn) due to the wheels on the robot's left.
            dt: Duration, s, above 0.
        """
        self._dt = dt
        if forward == 0.0 and left == 0.0 and turn == 0.0:
            self._still += dt
            self._last = _Motion()
            return
        distance, angle = math.hypot(forward, left), abs(turn)
        x, y = (forward / distance, left / distance) if distance > 0.0 else (1.0, 0.0)
        self._last = _Motion(forward, left, turn, by_left_wheels, distance, angle, (angle * x, angle * y))
        self._still, self._pending = 0.0, self._pending.plus(self._last)
        if self._pending.distance >= _PIECE_M or self._pending.angle >= _PIECE_RAD:
            self._propagate()

    def covariance(self) -> OdometryCovariance:
        """Returns the current covariances of pose and twist."""
        return OdometryCovariance(self._pose(), self._twist())

    def _propagate(self) -> None:
        motion = self._pending
        self._lasting, self._by_distance, self._by_angle, self._finished = self._moved(motion)
        self._yaw += motion.turn
        self._distance_left -= motion.distance
        self._angle_left -= motion.angle
        if self._distance_left <= 0.0:
            self._finished = _plus_effects(self._finished, self._by_distance)
            self._by_distance, self._distance_left = [_NONE] * 2, 1.0
        if self._angle_left <= 0.0:
            self._finished = _plus_effects(self._finished, self._by_angle)
            self._by_angle, self._angle_left = [_NONE] * 2, 1.0
        self._pending = _Motion()

    def _moved(self, motion: _Motion) -> tuple[list[Planar], list[Planar], list[Planar], tuple[float, ...]]:
        """Returns the effects of all error sources on the pose after another motion."""
        half = self._yaw + motion.turn / 2
        cos, sin = math.cos(half), math.sin(half)
        dx, dy = motion.forward * cos - motion.left * sin, motion.forward * sin + motion.left * cos

        def moved(effect: Planar, error: Planar) -> Planar:
            forward, left, turn = error
            yaw = effect[2] + turn / 2
            x = effect[0] - dy * yaw + forward * cos - left * sin
            return x, effect[1] + dx * yaw + forward * sin + left * cos, effect[2] + turn

        lasting, by_distance, by_angle = self._causes(motion)
        xx, xy, xt, yy, yt, tt = self._finished
        finished = (
            xx - 2 * dy * xt + dy * dy * tt, xy + dx * xt - dy * yt - dx * dy * tt, xt - dy * tt,
            yy + 2 * dx * yt + dx * dx * tt, yt + dx * tt, tt,
        )  # fmt: skip
        return (
            [moved(effect, error) for effect, error in zip(self._lasting, lasting, strict=True)],
            [moved(effect, error) for effect, error in zip(self._by_distance, by_distance, strict=True)],
            [moved(effect, error) for effect, error in zip(self._by_angle, by_angle, strict=True)],
            finished,
        )

    def _causes(self, motion: _Motion) -> tuple[list[Planar], list[Planar], list[Planar]]:
        """Returns one standard deviation of each error of a motion: persistent errors, slip by distance, slip by angle."""
        forward, left, turn = motion.forward, motion.left, motion.turn
        (a, b, c), (on_left, on_right) = motion.by_left_wheels, self._radii
        turn_by_angle, turn_by_distance, slip_by_distance, slip_by_angle = self._slip
        lasting: list[Planar] = [
            (on_left * a, on_left * b, on_left * c),
            (on_right * (forward - a), on_right * (left - b), on_right * (turn - c)),
            (self._scale * forward, self._scale * left, 0.0),
            (0.0, 0.0, self._turn_scale * turn),
        ]
        by_distance: list[Planar] = [
            (0.0, 0.0, turn_by_distance * motion.distance),
            (slip_by_distance * forward, slip_by_distance * left, 0.0),
        ]
        x, y = motion.turning
        return lasting, by_distance, [(0.0, 0.0, turn_by_angle * motion.angle), (slip_by_angle * x, slip_by_angle * y, 0.0)]

    def _pose(self) -> Matrix3:
        lasting, by_distance, by_angle, finished = self._moved(self._pending)
        yaw = self._yaw + self._pending.turn
        cos, sin = math.cos(yaw), math.sin(yaw)
        # An encoder lags by 0 to 1 tick: the mean square is a third.
        lag = [
            ((x * cos - y * sin) / math.sqrt(3.0), (x * sin + y * cos) / math.sqrt(3.0), turn / math.sqrt(3.0))
            for x, y, turn in self._ticks
        ]
        xx, xy, xt, yy, yt, tt = _plus_effects(finished, [*lasting, *by_distance, *by_angle, *lag])
        return (xx + _LEAST_POSE, xy, xt, xy, yy + _LEAST_POSE, yt, xt, yt, tt + _LEAST_POSE)

    def _twist(self) -> Matrix3:
        causes = self._causes(self._last.over(self._dt))
        # The difference of two lags, each uniform over a tick, has a variance of 1/6. Wheels without recent ticks are slower.
        tick = 1.0 / self._dt / math.sqrt(6.0) if self._still == 0.0 else 1.0 / max(self._still, self._dt) / math.sqrt(3.0)
        lag = [(x * tick, y * tick, turn * tick) for x, y, turn in self._ticks]
        xx, xy, xt, yy, yt, tt = _plus_effects((0.0,) * 6, [cause for some in causes for cause in some] + lag)
        return (xx + _LEAST_SPEED, xy, xt, xy, yy + _LEAST_SIDEWAYS, yt, xt, yt, tt + _LEAST_YAW_RATE)


def _plus_effects(matrix: tuple[float, ...], effects: Sequence[Planar]) -> tuple[float, ...]:
    """Returns a symmetric matrix (xx, xy, xt, yy, yt, tt) plus independent effects of one standard deviation each."""
    xx, xy, xt, yy, yt, tt = matrix
    for x, y, t in effects:
        xx, xy, xt, yy, yt, tt = xx + x * x, xy + x * y, xt + x * t, yy + y * y, yt + y * t, tt + t * t
    return xx, xy, xt, yy, yt, tt
