"""Extended Kalman filter of the robot's pose in the path frame: predicted by the estimated motion, corrected by recorded images in view.

The path frame is that of the first node. The other nodes have the poses that the recorded velocities lead to, which is accurate enough over a
few metres.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gibson_path_following.localisation.motions import NS_PER_S
from gibson_path_following.types import RecordedPath, Step

F64 = NDArray[np.float64]
_INITIAL_DEVIATION = (0.3, 0.2, 0.2)
"""Standard deviations of the initial pose: along the path, across it, heading; metres and radians."""
_MOTION_DEVIATION_RATIO = 0.12
"""Standard deviation of a motion, as a share of it."""
_MIN_MOTION_DEVIATION = (0.01, 0.005, 0.015)
"""Least standard deviations of the motion between two views: forward, sideways, heading; metres and radians."""
_HEADING_DRIFT = 0.05
"""Standard deviation of the heading per metre driven, rad/m."""
_MIN_DEVIATION = (0.03, 0.03, 0.02)
"""Least standard deviations of a measured relative pose: x, y, yaw; metres and radians."""
_DEVIATION_PER_ERROR = np.array([2.6, 1.3, 1.3])
"""Standard deviations of x, y, yaw of a measured relative pose per mean absolute error that the network predicts; that of x is larger because the
network underestimates the distance ahead."""
_INFORMATION_WEIGHT = 0.25
"""Weight of the information of one measurement: errors of successive views are correlated."""
_PARALLAX = 0.5
"""Column shift per lateral offset from a node, rad/m: that of objects 2 m away."""
_SHIFT_DEVIATION = 0.08
"""Standard deviation of a turn that a column shift measures, radians."""
_SHIFT_GATE = 9.0
"""Squared normalised innovation beyond which such a turn is rejected."""
_GATE = 25.0
"""Squared Mahalanobis distance beyond which a measured relative pose is rejected."""


@dataclass(frozen=True, slots=True)
class OffsetCalibration:
    """Relation between the lateral offsets that a network predicts and the true ones.

    A network that is trained on squared or absolute errors predicts the prior where it is in doubt. A robot is seldom far from its path, so that
    predicted offsets are too small. A filter that took them as measurements would count that prior again in every view.
    """

    ratio: float = 1.0
    """Mean predicted offset per true offset."""
    deviation: float = 0.0
    """Standard deviation of the predicted offset divided by ``ratio``, metres."""


def node_poses(path: RecordedPath) -> F64 | None:
    """Returns (N, 3), float64: x, y, yaw of the nodes in the path frame, integrated from the recorded velocities; None = there are none.

    Each segment is scaled to the distance between its nodes.
    """
    if not any(node.velocities for node in path.nodes[:-1]):
        return None
    poses = [(0.0, 0.0, 0.0)]
    for node, following in zip(path.nodes[:-1], path.nodes[1:], strict=True):
        x, y, yaw, driven = *poses[-1], 0.0
        start_x, start_y = x, y
        ends = [time for time, _ in node.velocities[1:]] + [following.stamp_ns - node.stamp_ns]
        for (start, velocity), end in zip(node.velocities, ends, strict=True):
            seconds = max(0, end - start) / NS_PER_S
            x, y, yaw = pose_after_arc((x, y, yaw), velocity.linear * seconds, velocity.angular * seconds)
            driven += abs(velocity.linear) * seconds
        scale = (following.distance - node.distance) / driven if driven > 1e-3 else 1.0
        poses.append((start_x + scale * (x - start_x), start_y + scale * (y - start_y), yaw))
    return np.array(poses)


def pose_after_arc(pose: tuple[float, float, float], distance: float, turn: float) -> tuple[float, float, float]:
    """Returns the pose x, y, yaw after an arc of a length, metres, and a turn, radians; same frame as ``pose``."""
    x, y, yaw = pose
    half = 0.5 * turn
    chord = distance * (math.sin(half) / half if abs(half) > 1e-6 else 1.0)
    return x + chord * math.cos(yaw + half), y + chord * math.sin(yaw + half), yaw + turn


class PoseFilter:
    """Pose of the robot in the path frame, and its covariance."""

    def __init__(self, offsets: OffsetCalibration = OffsetCalibration()) -> None:
        """Begins at the origin of the path frame, without uncertainty; call ``reset`` before the first prediction.

        Args:
            offsets: calibration of the network whose relative poses correct the filter.
        """
        self._offsets = offsets
        self.pose: F64 = np.zeros(3)
        """(3,): x, y, yaw in the path frame, metres and radians."""
        self.covariance: F64 = np.zeros((3, 3))
        """(3, 3): its covariance."""

    def reset(self, pose: F64) -> None:
        """Begins anew at a pose (3,) on the path, path frame, with the initial covariance."""
        self.pose = np.array(pose, dtype=np.float64)
        turn = _rotation(self.pose[2])
        self.covariance = turn @ np.diag(np.square(_INITIAL_DEVIATION)) @ turn.T

    def predict(self, step: Step) -> None:
        """Predicts the pose by the estimated motion since the previous view."""
        distance, turn = step.distance, step.turn
        previous = self.pose
        x, y, yaw = (float(value) for value in previous)
        self.pose = np.array(pose_after_arc((x, y, yaw), distance, turn))
        jacobian = np.eye(3)
        jacobian[:2, 2] = -(self.pose[1] - previous[1]), self.pose[0] - previous[0]
        deviations = (
            math.hypot(_MOTION_DEVIATION_RATIO * distance, _MIN_MOTION_DEVIATION[0]),
            math.hypot(0.3 * _MOTION_DEVIATION_RATIO * distance, _MIN_MOTION_DEVIATION[1]),
            math.hypot(_MOTION_DEVIATION_RATIO * turn, _HEADING_DRIFT * distance, _MIN_MOTION_DEVIATION[2]),
        )
        rotation = _rotation(self.pose[2])
        self.covariance = jacobian @ self.covariance @ jacobian.T + rotation @ np.diag(np.square(deviations)) @ rotation.T

    def correct(self, node: F64, measured: F64, mean_error: F64, weight: float = 1.0, path_pose: F64 | None = None) -> bool:
        """Corrects the pose by the measured relative pose of a node; returns whether the measurement passed the gate.

        Args:
            node: (3,), pose of the node, path frame, metres and radians.
            measured: (3,), pose of the node, robot frame, metres and radians.
            mean_error: (3,), mean absolute errors of ``measured``.
            weight: weight of its information: errors of measurements from one image are correlated.
            path_pose: (3,), pose of the path at the robot's station, path frame, from which lateral offsets are calibrated; None = no calibration.
        """
        x, y, yaw = self.pose
        c, s = math.cos(yaw), math.sin(yaw)
        dx, dy = node[0] - x, node[1] - y
        expected = np.array([c * dx + s * dy, c * dy - s * dx, node[2] - yaw])
        noise = np.diag(np.square(_DEVIATION_PER_ERROR * mean_error) + np.square(_MIN_DEVIATION))
        if path_pose is not None:
            position, rotation = _measured_position(node, measured)
            normal = np.array([-math.sin(path_pose[2]), math.cos(path_pose[2])])
            lateral = np.append(-rotation.T @ normal, 0.0)
            measured = measured + (1.0 / self._offsets.ratio - 1.0) * float((position - path_pose[:2]) @ normal) * lateral
            noise = noise + self._offsets.deviation**2 * np.outer(lateral, lateral)
        noise = noise / (_INFORMATION_WEIGHT * weight)
        innovation = measured - expected
        innovation[2] = math.remainder(innovation[2], 2.0 * math.pi)
        jacobian = np.array([[-c, -s, expected[1]], [s, -c, -expected[0]], [0.0, 0.0, -1.0]])
        innovation_covariance = jacobian @ self.covariance @ jacobian.T + noise
        if float(innovation @ np.linalg.solve(innovation_covariance, innovation)) > _GATE:
            return False
        gain = np.linalg.solve(innovation_covariance, jacobian @ self.covariance).T
        self.pose = self.pose + gain @ innovation
        remaining = np.eye(3) - gain @ jacobian
        self.covariance = remaining @ self.covariance @ remaining.T + gain @ noise @ gain.T
        return True

    def correct_heading(self, node: F64, turn: float) -> bool:
        """Corrects the pose by the column shift against a node near by; returns whether the measurement passed the gate.

        Args:
            node: (3,), pose of the node, path frame, metres and radians.
            turn: turn after which the view would match the node's, radians, positive to the left. A lateral offset shifts near objects, too: by
                ``_PARALLAX``.
        """
        yaw = float(self.pose[2])
        s, c = math.sin(yaw), math.cos(yaw)
        ahead, left, yaw_difference = relative_pose(self.pose, node)
        innovation = math.remainder(turn - yaw_difference - _PARALLAX * left, 2.0 * math.pi)
        jacobian = np.array([_PARALLAX * s, -_PARALLAX * c, -1.0 - _PARALLAX * ahead])
        variance = float(jacobian @ self.covariance @ jacobian) + _SHIFT_DEVIATION**2
        if innovation**2 > _SHIFT_GATE * variance:
            return False
        gain = self.covariance @ jacobian / variance
        self.pose = self.pose + gain * innovation
        self.covariance = self.covariance - np.outer(gain, gain) * variance
        return True

    def correct_station(self, path_pose: F64, deviation: float) -> None:
        """Corrects the pose along the path alone.

        Args:
            path_pose: (3,), pose of the path at the measured station, path frame, metres and radians.
            deviation: standard deviation of the station, metres.
        """
        jacobian = np.array([math.cos(path_pose[2]), math.sin(path_pose[2]), 0.0])
        innovation = float(jacobian @ (path_pose - self.pose))
        variance = float(jacobian @ self.covariance @ jacobian) + deviation**2
        gain = self.covariance @ jacobian / variance
        self.pose = self.pose + gain * innovation
        self.covariance = self.covariance - np.outer(gain, gain) * variance


def lateral_offset(node: F64) -> F64:
    """Returns (...,), float64: lateral offset of a robot from a node, in the node's frame, metres, positive to the left.

    Args:
        node: (..., 3), pose of the node, robot frame: x, y, yaw; metres and radians.
    """
    x, y, yaw = np.moveaxis(node, -1, 0)
    return np.asarray(np.sin(yaw) * x - np.cos(yaw) * y)


def _measured_position(node: F64, measured: F64) -> tuple[F64, F64]:
    """Returns the position (2,) of the robot that a measured relative pose means, path frame, metres, and the rotation (2, 2), robot to path frame.

    Args:
        node: (3,), pose of the node, path frame.
        measured: (3,), pose of the node, robot frame.
    """
    yaw = float(node[2] - measured[2])
    c, s = math.cos(yaw), math.sin(yaw)
    rotation = np.array([[c, -s], [s, c]])
    return node[:2] - rotation @ measured[:2], rotation


def relative_pose(frm: F64, to: F64) -> tuple[float, float, float]:
    """Returns the pose ``to`` (3,) in the frame of the pose ``frm`` (3,): x, y, yaw; metres and radians, yaw in [-pi, pi]."""
    dx, dy = float(to[0] - frm[0]), float(to[1] - frm[1])
    c, s = math.cos(frm[2]), math.sin(frm[2])
    return c * dx + s * dy, c * dy - s * dx, math.remainder(float(to[2] - frm[2]), 2.0 * math.pi)


def _rotation(yaw: float) -> F64:
    """Returns (3, 3): rotation of x, y, yaw by an angle, radians."""
    c, s = math.cos(yaw), math.sin(yaw)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
