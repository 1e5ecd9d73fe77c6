"""A small extended Kalman filter of a planar robot with wheels and a gyroscope, which believes the covariances that it is given."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

F64 = NDArray[np.float64]
_ACCELERATION, _YAW_ACCELERATION = 1.0, 4.0
"""How quickly the speeds change, m/s^2 and rad/s^2."""
_BIAS_WALK = 1e-5
"""rad/s/sqrt(s)."""
_X, _Y, _YAW, _SPEED, _RATE, _BIAS = range(6)


class PlanarEkf:
    """Estimates x, y (m), yaw (rad), forward speed (m/s), yaw rate (rad/s) and the bias of the gyroscope (rad/s)."""

    def __init__(self, bias_variance: float) -> None:
        """Starts at rest at the origin; ``bias_variance`` is how well the gyroscope's bias is known, (rad/s)^2."""
        self.state: F64 = np.zeros(6)
        self.P: F64 = np.diag([1e-6, 1e-6, 1e-6, 1e-6, 1e-6, bias_variance])

    def predict(self, dt: float) -> None:
        """Goes on by ``dt`` seconds."""
        _, _, yaw, speed, rate, _ = self.state
        middle = yaw + rate * dt / 2
        cos, sin = math.cos(middle), math.sin(middle)
        self.state[:3] += speed * dt * cos, speed * dt * sin, rate * dt
        F = np.eye(6)
        F[_X, _YAW], F[_X, _SPEED] = -speed * dt * sin, dt * cos
        F[_Y, _YAW], F[_Y, _SPEED] = speed * dt * cos, dt * sin
        F[_YAW, _RATE] = dt
        noise = np.array([0.0, 0.0, 0.0, (_ACCELERATION * dt) ** 2, (_YAW_ACCELERATION * dt) ** 2, _BIAS_WALK**2 * dt])
        self.P = F @ self.P @ F.T + np.diag(noise)

    def wheels(self, speed: float, rate: float, covariance: tuple[float, ...]) -> None:
        """Takes in a twist of odometry with the covariance (3, 3), by rows, of forward speed, speed to the left and yaw rate."""
        H = np.zeros((2, 6))
        H[0, _SPEED] = H[1, _RATE] = 1.0
        self._update(np.array([speed, rate]), H, np.array(covariance).reshape(3, 3)[np.ix_([0, 2], [0, 2])])

    def gyroscope(self, rate: float, variance: float) -> None:
        """Takes in a yaw rate with its variance, (rad/s)^2."""
        H = np.zeros((1, 6))
        H[0, _RATE] = H[0, _BIAS] = 1.0
        self._update(np.array([rate]), H, np.array([[variance]]))

    def _update(self, measured: F64, H: F64, R: F64) -> None:
        K = self.P @ H.T @ np.linalg.inv(H @ self.P @ H.T + R)
        self.state += K @ (measured - H @ self.state)
        self.P = (np.eye(6) - K @ H) @ self.P
