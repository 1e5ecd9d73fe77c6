"""Serialises messages of a fixed layout (CDR), and images; ``publisher.publish(bytes)`` sends the bytes unchanged.

Filling and serializing a message object takes 10 to 100 microseconds in Python; these serializers take one to five, because only the numbers
change from tick to tick: strings, lengths, covariances and padding are laid out once. Subscribers receive the same bytes in both cases.

Imports no ROS: the encoding is XCDR 1, little-endian, which every RTPS implementation reads.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gibson_sim.types import NS_PER_S, JointStates, SceneState

_ENCAPSULATION = b"\x00\x01\x00\x00"
_STAMP = struct.Struct("<iI")
_NO_COVARIANCE = (0.0,) * 36
_COVARIANCE = struct.Struct("<36d")
_ISOTROPIC = struct.Struct("<9d")


def image_to_bytes(pixels: NDArray[Any], encoding: str, stamp_ns: int, frame_id: str) -> bytes:
    """Returns the same bytes as ``serialize_message(image_to_msg(...))``; ``pixels`` are C-contiguous, (H, W) or (H, W, C)."""
    height, width = pixels.shape[:2]
    head = struct.pack("<iI", *divmod(stamp_ns, NS_PER_S)) + _string(frame_id)
    head += bytes(-len(head) % 4) + struct.pack("<II", height, width) + _string(encoding)
    head += b"\x00"  # little-endian
    head += bytes(-len(head) % 4) + struct.pack("<II", pixels.strides[0], pixels.nbytes)
    return b"".join((_ENCAPSULATION, head, pixels.data.cast("B")))


def restamped(data: bytes, stamp_ns: int) -> bytes:
    """Returns a serialised message that begins with a Header, with a new stamp."""
    start = len(_ENCAPSULATION)
    return data[:start] + _STAMP.pack(*divmod(stamp_ns, NS_PER_S)) + data[start + _STAMP.size :]


class FastClock:
    """Serializer of rosgraph_msgs/Clock."""

    def serialize(self, stamp_ns: int) -> bytes:
        """Returns the message for a simulation time, ns."""
        return _ENCAPSULATION + _STAMP.pack(*divmod(stamp_ns, NS_PER_S))


class FastTf:
    """Serializer of tf2_msgs/TFMessage with fixed frames.

    Args:
        frames: (parent, child) frames of each transform.
    """

    def __init__(self, frames: Sequence[tuple[str, str]]) -> None:
        layout = _Layout()
        layout.number("I", len(frames))
        for parent, child in frames:
            layout.header(parent)
            layout.string(child)
            layout.variables("7d")
        self._pack, self._constants = layout.finish()
        self._count = len(frames)

    def serialize(self, stamp_ns: int, poses: Sequence[Sequence[float]]) -> bytes:
        """Returns the message.

        Args:
            stamp_ns: stamp of all transforms, ns.
            poses: T_parent_child in the order of ``frames``: x y z (m), qx qy qz qw each. A list of lists is fastest.

        Raises:
            ValueError: the number of poses differs from the number of frames.
        """
        if len(poses) != self._count:
            raise ValueError(f"there are {len(poses)} poses, the message is laid out for {self._count} frames")
        sec, nanosec = divmod(stamp_ns, NS_PER_S)
        constants = iter(self._constants)
        values: list[bytes | float] = []
        for pose in poses:
            values += (next(constants), sec, nanosec, next(constants), *pose)
        return self._pack(*values, next(constants))


class FastOdometry:
    """Serializer of nav_msgs/Odometry with fixed frames.

    Args:
        parent: frame of the pose.
        child: frame of the twist.
    """

    def __init__(self, parent: str, child: str) -> None:
        layout = _Layout()
        layout.header(parent)
        layout.string(child)
        layout.variables("7d")
        layout.block(36)
        layout.variables("6d")
        layout.block(36)
        self._pack, self._constants = layout.finish()

    def serialize(
        self,
        stamp_ns: int,
        position: Sequence[float],
        quat_xyzw: Sequence[float],
        linear: Sequence[float],
        angular: Sequence[float],
        pose_covariance: Sequence[float] = _NO_COVARIANCE,
        twist_covariance: Sequence[float] = _NO_COVARIANCE,
    ) -> bytes:
        """Returns the message. Tuples are fastest.

        Args:
            stamp_ns: stamp of the message, ns.
            position: translation of T_parent_child, m.
            quat_xyzw: rotation of T_parent_child.
            linear: linear velocity in the child frame, m/s.
            angular: angular velocity in the child frame, rad/s.
            pose_covariance: covariance of the pose, (6, 6) row-major; default = zeros.
            twist_covariance: covariance of the twist, (6, 6) row-major; default = zeros.
        """
        start, frames, *padding = self._constants
        pose_part = *position, *quat_xyzw, padding[0], _COVARIANCE.pack(*pose_covariance)
        twist_part = *linear, *angular, padding[2], _COVARIANCE.pack(*twist_covariance)
        return self._pack(start, *divmod(stamp_ns, NS_PER_S), frames, *pose_part, padding[1], *twist_part, padding[3])


class FastJointStates:
    """Serializer of sensor_msgs/JointState with fixed joints.

    Args:
        names: names of the joints.
        frame_id: frame of the header.
    """

    def __init__(self, names: Sequence[str], frame_id: str = "") -> None:
        layout, count = _Layout(), len(names)
        layout.header(frame_id)
        layout.number("I", count)
        for name in names:
            layout.string(name)
        for _ in range(3):
            layout.number("I", count)
            if count:
                layout.variables(f"{count}d")
        self._pack, self._constants = layout.finish()
        self._count = count

    def serialize(self, stamp_ns: int, joints: JointStates) -> bytes:
        """Returns the message for joints in the order of ``names``.

        Raises:
            ValueError: the number of joints differs from the number of ``names``.
        """
        stamp = divmod(stamp_ns, NS_PER_S)
        if len(joints.names) != self._count:
            raise ValueError(f"there are {len(joints.names)} joints, the message is laid out for {self._count} joints")
        if not self._count:
            return self._pack(self._constants[0], *stamp, self._constants[1])
        start, names, before_velocities, before_efforts, end = self._constants
        positions, velocities, efforts = joints.positions.tolist(), joints.velocities.tolist(), joints.efforts.tolist()
        return self._pack(start, *stamp, names, *positions, before_velocities, *velocities, before_efforts, *efforts, end)


class FastImu:
    """Serializer of sensor_msgs/Imu with a fixed frame and a fixed covariance of the orientation.

    Args:
        frame_id: frame of the sensor.
        orientation_covariance: covariance of the orientation, (3, 3) row-major; the first element is -1 if there is no orientation (REP 145).
    """

    def __init__(self, frame_id: str, orientation_covariance: Sequence[float] = _NO_COVARIANCE[:9]) -> None:
        layout = _Layout()
        layout.header(frame_id)
        layout.variables("4d")
        layout.doubles(orientation_covariance)
        for _ in range(2):
            layout.variables("3d")
            layout.block(9)
        self._pack, self._constants = layout.finish()

    def serialize(
        self,
        stamp_ns: int,
        quat_xyzw: Sequence[float],
        angular: Sequence[float],
        linear: Sequence[float],
        angular_variance: float = 0.0,
        linear_variance: float = 0.0,
    ) -> bytes:
        """Returns the message.

        Args:
            stamp_ns: stamp of the message, ns.
            quat_xyzw: orientation of the sensor.
            angular: angular velocity in its frame, rad/s.
            linear: specific force in its frame, m/s^2.
            angular_variance: variance of each component of ``angular``, (rad/s)^2.
            linear_variance: variance of each component of ``linear``, (m/s^2)^2.
        """
        start, frame, after_quat, *padding = self._constants
        a, b, o = angular_variance, linear_variance, 0.0
        angular_part = *angular, padding[0], _ISOTROPIC.pack(a, o, o, o, a, o, o, o, a)
        linear_part = *linear, padding[2], _ISOTROPIC.pack(b, o, o, o, b, o, o, o, b)
        stamp = divmod(stamp_ns, NS_PER_S)
        return self._pack(start, *stamp, frame, *quat_xyzw, after_quat, *angular_part, padding[1], *linear_part, padding[3])


class FastSceneState:
    """Serializer of gibson_msgs/SceneState with a fixed number of links.

    Args:
        frame_id: the world frame.
        links: number of links.
    """

    def __init__(self, frame_id: str, links: int) -> None:
        layout = _Layout()
        layout.header(frame_id)
        layout.variables("QQQ")
        layout.variables("I")
        layout.number("I", 7 * links)
        if links:
            layout.block(7 * links)
        layout.number("I", 6 * links)
        if links:
            layout.block(6 * links)
        self._pack, self._constants = layout.finish()
        self._poses = np.empty((links, 7), "<f8")

    def serialize(self, state: SceneState, due_cameras: Sequence[int], epoch: int = 0, epoch_step: int = 0) -> bytes:
        """Returns the message for a state; the other arguments are fields of SceneState.msg.

        Raises:
            ValueError: the number of links of the state differs from that of the layout.
        """
        poses, count = self._poses, len(due_cameras)
        # Checked since NumPy would broadcast a single row.
        if len(state.links) != len(poses):
            raise ValueError(f"the state has {len(state.links)} links, the message is laid out for {len(poses)} links")
        poses[:, :3], poses[:, 3:] = state.positions, state.quats_xyzw
        start, frame, between, *rest = self._constants
        values = [start, *divmod(state.stamp_ns, NS_PER_S), frame, state.revision, state.step, epoch_step, between, epoch]
        if len(poses):
            before_poses, before_twists, end = rest
            values += [before_poses, poses.tobytes(), before_twists, state.twists.tobytes(), end]
        else:
            values += rest
        return self._pack(*values) + struct.pack(f"<{count + 1}I", count, *due_cameras)


class FastTickDone:
    """Serializer of gibson_msgs/TickDone with the event DONE.

    Args:
        event: value of TickDone.DONE.
        participant: name of the participant.
        sent: topic of each command that was sent.
    """

    def __init__(self, event: int, participant: str, sent: Sequence[str]) -> None:
        layout = _Layout()
        layout.number("B", event)
        layout.string(participant)
        layout.variables("iI")
        layout.string("")
        layout.number("I", len(sent))
        for topic in sent:
            layout.string(topic)
        self._pack, self._constants = layout.finish()

    def serialize(self, sec: int, nanosec: int) -> bytes:
        """Returns the message for the tick with this stamp."""
        start, end = self._constants
        return self._pack(start, sec, nanosec, end)


class RelativePoses:
    """Computes poses of links in the frames of other links.

    Args:
        pairs: (parent, child) of each pose, as rows of a state.
    """

    def __init__(self, pairs: Sequence[tuple[int, int]]) -> None:
        self._pairs = tuple(pairs)

    def of(self, positions: NDArray[np.float64], quats_xyzw: NDArray[np.float64]) -> list[tuple[float, ...]]:
        """Returns T_parent_child of each pair: x y z (m), qx qy qz qw with qw >= 0.

        It uses plain floats: for the few joints of a robot they take a tenth of the time of arrays.

        Args:
            positions: positions of all links, (L, 3), m, world frame.
            quats_xyzw: orientations of all links, (L, 4), unit quaternions, world frame.
        """
        p, q = positions.tolist(), quats_xyzw.tolist()
        return [_relative(p[parent], q[parent], p[child], q[child]) for parent, child in self._pairs]


def _relative(
    parent: Sequence[float], parent_quat: Sequence[float], child: Sequence[float], child_quat: Sequence[float]
) -> tuple[float, ...]:
    """Returns T_parent_child of two poses in the same frame."""
    x, y, z, w = parent_quat
    a, b, c, d = child_quat
    px, py, pz = child[0] - parent[0], child[1] - parent[1], child[2] - parent[2]
    # v rotated by the inverse of q: v - 2 w (q x v) + 2 q x (q x v).
    tx, ty, tz = 2.0 * (y * pz - z * py), 2.0 * (z * px - x * pz), 2.0 * (x * py - y * px)
    qw = w * d + x * a + y * b + z * c
    sign = -1.0 if qw < 0.0 else 1.0
    return (
        px - w * tx + y * tz - z * ty,
        py - w * ty + z * tx - x * tz,
        pz - w * tz + x * ty - y * tx,
        sign * (w * a - x * d - y * c + z * b),
        sign * (w * b + x * c - y * d - z * a),
        sign * (w * c - x * b + y * a - z * d),
        sign * qw,
    )


class _Layout:
    """Builds the layout of a message: constant bytes, and variable numbers between them."""

    def __init__(self) -> None:
        self._format = "<"
        self._pending, self._size = bytearray(_ENCAPSULATION), 0
        self._constants: list[bytes] = []

    def number(self, kind: str, value: int) -> None:
        """Adds a constant integer of a ``struct`` format character."""
        self._align(struct.calcsize(f"<{kind}"))
        self._pending += struct.pack(f"<{kind}", value)

    def string(self, text: str) -> None:
        """Adds a constant string."""
        data = text.encode() + b"\0"
        self.number("I", len(data))
        self._pending += data

    def doubles(self, values: Sequence[float]) -> None:
        """Adds constant float64 values."""
        self._align(8)
        self._pending += struct.pack(f"<{len(values)}d", *values)

    def variables(self, kinds: str) -> None:
        """Adds variable numbers: ``struct`` format characters of one size, such as ``iI`` or ``7d``."""
        self._align(struct.calcsize(f"<{kinds[-1]}"))
        self._flush_constants()
        self._format += kinds
        self._size = struct.calcsize(self._format)

    def block(self, count: int) -> None:
        """Adds ``count`` variable float64 values, which are passed as one bytes object."""
        self._align(8)
        self._flush_constants()
        self._format += f"{8 * count}s"
        self._size = struct.calcsize(self._format)

    def header(self, frame_id: str) -> None:
        """Adds a std_msgs/Header with a variable stamp."""
        self.variables("iI")
        self.string(frame_id)

    def finish(self) -> tuple[Callable[..., bytes], list[bytes]]:
        """Returns the pack function, and the constants that must be passed before, between and after the numbers."""
        self._flush_constants()
        return struct.Struct(self._format).pack, self._constants

    def _align(self, size: int) -> None:
        self._pending += bytes(-(self._size + len(self._pending) - len(_ENCAPSULATION)) % size)

    def _flush_constants(self) -> None:
        self._constants.append(bytes(self._pending))
        self._format += f"{len(self._pending)}s"
        self._size, self._pending = struct.calcsize(self._format), bytearray()


def _string(text: str) -> bytes:
    data = text.encode() + b"\x00"
    return struct.pack("<I", len(data)) + data
