"""Where a robot is beside its path: an extended Kalman filter in the frame of the path, moved by what the robot is believed to have made,
corrected by recorded images that were seen from here.

The frame of a path is that of its first node; its nodes lie where the recorded velocities lead. Over a few metres that is true enough.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gibson_path_following.motions import NS_PER_S
from gibson_path_following.types import RecordedPath, Step

F64 = NDArray[np.float64]
_START = (0.3, 0.2, 0.2)
"""Standard deviation at the start along the path, across it, and of the heading: metres and radians."""
_RATIO_DEVIATION = 0.12
"""Standard deviation of a motion that is believed, as a share of it."""
_DRIFT = (0.01, 0.005, 0.015)
"""Standard deviation of a motion between two views, however small: ahead, beside, heading."""
_TURN_PER_METRE = 0.05
"""Standard deviation of the turn that driving a metre adds, radians."""
_FLOOR = (0.03, 0.03, 0.02)
"""Least standard deviation of a sighting, metres and radians."""
_TRUST = np.array([2.6, 1.3, 1.3])
"""Standard deviation of a sighting by the mean absolute error that the network expects: it takes what is ahead for nearer than it is."""
_NEW = 0.25
"""Share of a sighting that counts: those of views that follow each other are alike wrong."""
_PARALLAX = 0.5
"""Radians by which columns shift for each metre that the robot is beside a node: that of things 2 m away."""
_COLUMNS_DEVIATION = 0.08
"""Standard deviation of a turn by columns, radians."""
_COLUMNS_GATE = 9.0
"""Squared innovation, by its variance, beyond which a turn by columns counts as wrong."""
_GATE = 25.0
"""Squared Mahalanobis distance beyond which a sighting counts as wrong."""


@dataclass(frozen=True, slots=True)
class OffsetTold:
    """How what a network tells of the offset from a recorded image, to its side, relates to the true offset.

    A network that is trained on squared or absolute errors tells what is likely: seldom is a robot far beside its path, so that in doubt it is
    told nearer to it. Taken as a measurement, that would count the same again in every view.
    """

    ratio: float = 1.0
    """Mean of what it tells, divided by what is true."""
    deviation: float = 0.0
    """Standard deviation of what it tells, once divided by the ratio, metres."""


def node_poses(path: RecordedPath) -> F64 | None:
    """Returns (N, 3): x, y, yaw of the nodes in the frame of the first one, by the recorded velocities; None = there are none.

    The length of each part is that of the nodes' distances.
    """
    if not any(node.velocities for node in path.nodes[:-1]):
        return None
    poses = [(0.0, 0.0, 0.0)]
    for node, after in zip(path.nodes[:-1], path.nodes[1:], strict=True):
        x, y, yaw, driven = *poses[-1], 0.0
        begin_x, begin_y = x, y
        ends = [time for time, _ in node.velocities[1:]] + [after.stamp_ns - node.stamp_ns]
        for (start, velocity), end in zip(node.velocities, ends, strict=True):
            seconds = max(0, end - start) / NS_PER_S
            x, y, yaw = moved((x, y, yaw), velocity.linear * seconds, velocity.angular * seconds)
            driven += abs(velocity.linear) * seconds
        scale = (after.distance - node.distance) / driven if driven > 1e-3 else 1.0
        poses.append((begin_x + scale * (x - begin_x), begin_y + scale * (y - begin_y), yaw))
    return np.array(poses)


def moved(pose: tuple[float, float, float], distance: float, turn: float) -> tuple[float, float, float]:
    """Returns a pose x, y, yaw after an arc of a length, metres, and a turn, radians."""
    x, y, yaw = pose
    half = 0.5 * turn
    chord = distance * (math.sin(half) / half if abs(half) > 1e-6 else 1.0)
    return x + chord * math.cos(yaw + half), y + chord * math.sin(yaw + half), yaw + turn


class PoseFilter:
    """A pose and its covariance."""

    def __init__(self, offsets: OffsetTold = OffsetTold()) -> None:
        """Knows nothing.

        Args:
            offsets: of the network whose sightings it will have.
        """
        self._offsets = offsets
        self.pose: F64 = np.zeros(3)
        """x, y, yaw in the frame of the path, metres and radians."""
        self.covariance: F64 = np.zeros((3, 3))

    def reset(self, pose: F64) -> None:
        """Begins near a pose (3,) on the path."""
        self.pose = np.array(pose, dtype=np.float64)
        turn = _rotation(self.pose[2])
        self.covariance = turn @ np.diag(np.square(_START)) @ turn.T

    def move(self, step: Step) -> None:
        """Moves by what the robot made since the view before."""
        distance, turn = step.distance, step.turn
        before = self.pose
        x, y, yaw = (float(value) for value in before)
        self.pose = np.array(moved((x, y, yaw), distance, turn))
        jacobian = np.eye(3)
        jacobian[:2, 2] = -(self.pose[1] - before[1]), self.pose[0] - before[0]
        noise = (
            math.hypot(_RATIO_DEVIATION * distance, _DRIFT[0]),
            math.hypot(0.3 * _RATIO_DEVIATION * distance, _DRIFT[1]),
            math.hypot(_RATIO_DEVIATION * turn, _TURN_PER_METRE * distance, _DRIFT[2]),
        )
        rotation = _rotation(self.pose[2])
        self.covariance = jacobian @ self.covariance @ jacobian.T + rotation @ np.diag(np.square(noise)) @ rotation.T

    def correct(self, node: F64, seen: F64, error: F64, weight: float = 1.0, level: F64 | None = None) -> bool:
        """Corrects the pose by a node that was seen; returns whether the sighting was plausible.

        Args:
            node: (3,), pose of the node in the frame of the path.
            seen: (3,), its pose in the frame of the robot.
            error: (3,), mean absolute errors of that.
            weight: share of the information that counts: sightings in one image are alike wrong.
            level: (3,), pose on the path that is level with the robot, from which offsets are told too small; None = those are not corrected.
        """
        x, y, yaw = self.pose
        c, s = math.cos(yaw), math.sin(yaw)
        dx, dy = node[0] - x, node[1] - y
        expected = np.array([c * dx + s * dy, c * dy - s * dx, node[2] - yaw])
        noise = np.diag(np.square(_TRUST * error) + np.square(_FLOOR))
        if level is not None:
            position, rotation = _told_position(node, seen)
            normal = np.array([-math.sin(level[2]), math.cos(level[2])])
            across = np.append(-rotation.T @ normal, 0.0)
            seen = seen + (1.0 / self._offsets.ratio - 1.0) * float((position - level[:2]) @ normal) * across
            noise = noise + self._offsets.deviation**2 * np.outer(across, across)
        noise = noise / (_NEW * weight)
        innovation = seen - expected
        innovation[2] = math.remainder(innovation[2], 2.0 * math.pi)
        jacobian = np.array([[-c, -s, expected[1]], [s, -c, -expected[0]], [0.0, 0.0, -1.0]])
        spread = jacobian @ self.covariance @ jacobian.T + noise
        if float(innovation @ np.linalg.solve(spread, innovation)) > _GATE:
            return False
        gain = np.linalg.solve(spread, jacobian @ self.covariance).T
        self.pose = self.pose + gain @ innovation
        left = np.eye(3) - gain @ jacobian
        self.covariance = left @ self.covariance @ left.T + gain @ noise @ gain.T
        return True

    def correct_heading(self, node: F64, turn: float) -> bool:
        """Corrects the pose by the turn after which the columns of a view look as at a node near by; returns whether that was plausible.

        Args:
            node: (3,), pose of the node in the frame of the path.
            turn: radians to the left. What is near shifts the columns, too, if the robot is beside the node: by ``_PARALLAX``.
        """
        yaw = float(self.pose[2])
        s, c = math.sin(yaw), math.cos(yaw)
        ahead, beside, difference = relative(self.pose, node)
        innovation = math.remainder(turn - difference - _PARALLAX * beside, 2.0 * math.pi)
        jacobian = np.array([_PARALLAX * s, -_PARALLAX * c, -1.0 - _PARALLAX * ahead])
        spread = float(jacobian @ self.covariance @ jacobian) + _COLUMNS_DEVIATION**2
        if innovation**2 > _COLUMNS_GATE * spread:
            return False
        gain = self.covariance @ jacobian / spread
        self.pose = self.pose + gain * innovation
        self.covariance = self.covariance - np.outer(gain, gain) * spread
        return True

    def correct_along(self, at: F64, deviation: float) -> None:
        """Corrects the pose along the path.

        Args:
            at: (3,), pose on the path that is level with the robot.
            deviation: standard deviation of that along the path, metres.
        """
        jacobian = np.array([math.cos(at[2]), math.sin(at[2]), 0.0])
        innovation = float(jacobian @ (at - self.pose))
        spread = float(jacobian @ self.covariance @ jacobian) + deviation**2
        gain = self.covariance @ jacobian / spread
        self.pose = self.pose + gain * innovation
        self.covariance = self.covariance - np.outer(gain, gain) * spread


def offset_of(seen: F64) -> F64:
    """Returns (...,): how far to the left of a node the robot is that sees it at poses (..., 3), in the node's frame, metres."""
    x, y, yaw = np.moveaxis(seen, -1, 0)
    return np.asarray(np.sin(yaw) * x - np.cos(yaw) * y)


def _told_position(node: F64, seen: F64) -> tuple[F64, F64]:
    """Returns where a robot is (2,) that sees a node at a pose (3,) in its frame, and the rotation (2, 2) of its frame into that of the path."""
    yaw = float(node[2] - seen[2])
    c, s = math.cos(yaw), math.sin(yaw)
    rotation = np.array([[c, -s], [s, c]])
    return node[:2] - rotation @ seen[:2], rotation


def relative(frm: F64, to: F64) -> tuple[float, float, float]:
    """Returns the pose ``to`` (3,) in the frame of the pose ``frm`` (3,): x, y, yaw."""
    dx, dy = float(to[0] - frm[0]), float(to[1] - frm[1])
    c, s = math.cos(frm[2]), math.sin(frm[2])
    return c * dx + s * dy, c * dy - s * dx, math.remainder(float(to[2] - frm[2]), 2.0 * math.pi)


def _rotation(yaw: float) -> F64:
    c, s = math.cos(yaw), math.sin(yaw)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
