"""Forward and inverse kinematics of a chain of joints. Pure arithmetic, without the physics engine.

It does not use PyBullet's solver: with limits and a rest pose, that solver misses most poses that an arm of seven joints can reach, because both only
bias its solution. This solver has hard limits, and the rest pose acts only in the null space of the task.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gibson_sim.description.urdf_model import Mimic, UrdfJoint, UrdfModel
from gibson_sim.errors import CommandError
from gibson_sim.geometry.transforms import Mat4, matrix_from_pose
from gibson_sim.quoting import quoted

F64 = NDArray[np.float64]
_RESTARTS = 24
"""Number of random starting points if the first attempt fails."""
_ITERATIONS = 80
"""Iterations of one attempt."""
_POLISHING = 20
"""Number of final iterations of an attempt without the rest pose."""
_EXACT = 1e-7
"""Error below which the iteration stops, metres and radians."""
_SETTLED = 1e-4
"""Change of the joints in an iteration below which the rest pose is approached as far as possible, radians and metres."""
_REST_GAIN = 0.3
"""Fraction of the distance to the rest pose moved in an iteration, in the null space of the task."""
_REST_DAMPING = 1e-2
"""Damping of the null-space motion towards the rest pose."""
_STALLED = 0.98
"""Ratio of the error to that of ten iterations ago above which an attempt is aborted."""
_DAMPING = 0.05
"""Damping of the least squares per squared metre of error: stable near a stretched arm, fast near the target."""
_FAR = 0.3
"""Error above which the damping does not grow, metres."""
_ROTATION_WEIGHT = 0.5
"""Weight of rotation against translation, m/rad."""
_MAX_STEP = 0.5
"""Maximum motion of a joint in an iteration, radians or metres."""


@dataclass(frozen=True, slots=True)
class ChainSolution:
    """Best joint positions found for a target of the tip of a chain, and the remaining error."""

    names: tuple[str, ...]
    """Moving joints of the chain, the root's first, without those that mimic others."""
    positions: tuple[float, ...]
    """Joint positions within the limits, radians or metres."""
    position_error: float
    """Distance of the tip from the target, metres."""
    angle_error: float
    """Angle between the two, radians; 0 if the orientation does not count."""

    def within(self, position_error: float, angle_error: float) -> bool:
        """Returns whether both errors are at most these, metres and radians."""
        return self.position_error <= position_error and self.angle_error <= angle_error


@dataclass(frozen=True, slots=True)
class _Link:
    """A joint between the root and the tip."""

    joint: UrdfJoint
    T_parent_joint: Mat4
    leader: str
    """Joint that determines its position: itself, or the one that it mimics; empty = fixed."""
    mimic: Mimic | None


@dataclass(frozen=True, slots=True)
class _Axis:
    """The axis of a joint, root frame."""

    leader: str
    factor: float
    """Ratio of its motion to that of its leader."""
    direction: F64
    """Unit vector along the axis, (3,)."""
    origin: F64
    """Point on the axis, (3,), metres."""
    slides: bool


class Chain:
    """The joints between the root of a model and one of its links, including mimic joints."""

    def __init__(self, model: UrdfModel, tip: str, joints: Sequence[str] | None = None) -> None:
        """Finds the chain.

        Args:
            model: The tree of links.
            tip: Link at its end.
            joints: Joints that may move; None = all moving joints of the chain. The other joints keep their positions.

        Raises:
            CommandError: the link does not exist, no joint moves it, or a joint is not in the chain.
        """
        above = {joint.child: joint for joint in model.joints}
        if tip not in {link.name for link in model.links}:
            raise CommandError(f"no link {quoted(tip)}; known: {', '.join(link.name for link in model.links)}")
        path: list[UrdfJoint] = []
        link = tip
        while link in above:
            path.insert(0, above[link])
            link = above[link].parent
        self._path = [
            _Link(joint, matrix_from_pose(joint.pose), "" if joint.kind == "fixed" else _leader(joint), joint.mimic)
            for joint in path
        ]
        moving = list(dict.fromkeys(link.leader for link in self._path if link.leader))
        if not moving:
            raise CommandError(f"no joint moves link {quoted(tip)}; choose a link at the end of an arm")
        for name in joints or ():
            if name not in moving:
                raise CommandError(f"joint {quoted(name)} does not move link {quoted(tip)}; these do: {', '.join(moving)}")
        self.names = tuple(name for name in moving if joints is None or name in joints)
        """Names of the joints that may move, from the root to the tip, without mimic joints."""
        if not self.names:
            raise CommandError(f"no joint of the chain to link {quoted(tip)} may move; name at least one of {', '.join(moving)}")
        limits = [_limits(model, name) for name in self.names]
        self._lower = np.array([lower for lower, _ in limits])
        self._upper = np.array([upper for _, upper in limits])

    def pose(self, positions: Mapping[str, float]) -> Mat4:
        """Returns T_root_tip, (4, 4); missing joints are at 0."""
        return self._forward(positions)[0]

    def jacobian(self, positions: Mapping[str, float]) -> tuple[Mat4, F64]:
        """Returns T_root_tip, (4, 4), and the Jacobian, (6, J), from velocities of ``names`` to the twist of the tip, linear first, root axes."""
        T_root_tip, axes = self._forward(positions)
        return T_root_tip, self._jacobian_of(T_root_tip, axes)

    def solve(
        self,
        target: Mat4,
        start: Mapping[str, float],
        *,
        rest: Mapping[str, float] | None = None,
        orientation: bool = True,
    ) -> ChainSolution:
        """Returns the joint positions that bring the tip to a target (inverse kinematics); deterministic, bit-equal results.

        Args:
            target: T_root_tip, (4, 4).
            start: Current positions, from which the search begins; a near solution is preferred; missing joints are at 0.
            rest: Rest pose of joints, approached in the null space of the task; joints may be missing; None = no rest pose.
            orientation: Whether to match the orientation of the target, or only its position.

        Raises:
            CommandError: a number of the target is not finite.
        """
        if not np.isfinite(target).all():
            raise CommandError("target of the chain has a number that is not finite; give a pose")
        now = np.clip(np.array([start.get(name, 0.0) for name in self.names]), self._lower, self._upper)
        rest_positions = np.array([(rest or {}).get(name, np.nan) for name in self.names])
        rng = np.random.default_rng(0)
        low, high = np.maximum(self._lower, -math.pi), np.minimum(self._upper, math.pi)
        best, least = now, math.inf
        for attempt in range(1 + _RESTARTS):
            begin = now if attempt == 0 else np.clip(rng.uniform(low, np.maximum(low, high)), self._lower, self._upper)
            solution = self._descend(target, begin, start, rest_positions, orientation)
            size = float(np.linalg.norm(self._error(target, solution, start, orientation)[0]))
            if size < least:
                best, least = solution, size
            if least < 10 * _EXACT:
                break
        error, _ = self._error(target, best, start, orientation)
        positions = tuple(best.tolist())
        return ChainSolution(
            self.names, positions, float(np.linalg.norm(error[:3])), float(np.linalg.norm(error[3:])) / _ROTATION_WEIGHT
        )

    def _descend(self, target: Mat4, begin: F64, others: Mapping[str, float], rest_positions: F64, orientation: bool) -> F64:
        """Returns the result of an attempt from ``begin``, by damped least squares over the joints that are not at a limit."""
        q, previous_size = begin, math.inf
        for iteration in range(_ITERATIONS):
            error, jacobian = self._error(target, q, others, orientation)
            size = float(np.linalg.norm(error))
            resting = iteration < _ITERATIONS - _POLISHING and not bool(np.isnan(rest_positions).all())
            if size < _EXACT and not resting:
                break
            if iteration % 10 == 9:
                if size > max(_STALLED * previous_size, 10 * _EXACT):
                    break
                previous_size = size
            step = self._step(q, error, jacobian, rest_positions if resting else None)
            step *= min(1.0, _MAX_STEP / max(float(np.abs(step).max()), 1e-30))
            after: F64 = np.clip(q + step, self._lower, self._upper)
            largest_motion = float(np.abs(after - q).max())
            q = after
            if size < _EXACT and largest_motion < _SETTLED:
                break
        return q

    def _step(self, q: F64, error: F64, jacobian: F64, rest_positions: F64 | None) -> F64:
        """Returns the motion of the joints in an iteration; joints that would pass a limit are excluded one by one."""
        free = np.ones(len(q), dtype=bool)
        step = np.zeros(len(q))
        damping = 1e-12 + _DAMPING * min(float(error @ error), _FAR**2)
        for _ in range(len(q)):
            part = jacobian[:, free]
            step = np.zeros(len(q))
            step[free] = part.T @ np.linalg.solve(part @ part.T + damping * np.eye(len(error)), error)
            if rest_positions is not None:
                step[free] += _REST_GAIN * _self_motion(part, (rest_positions - q)[free])
            stopped = free & (((q <= self._lower) & (step < 0.0)) | ((q >= self._upper) & (step > 0.0)))
            if not stopped.any() or stopped.sum() == free.sum():
                break
            free &= ~stopped
        return step

    def _error(self, target: Mat4, q: F64, others: Mapping[str, float], orientation: bool) -> tuple[F64, F64]:
        """Returns the error from the tip to its target, (6,) or (3,), metres (rotation times ``_ROTATION_WEIGHT``), and the Jacobian of the tip."""
        T_root_tip, axes = self._forward({**others, **dict(zip(self.names, q.tolist(), strict=True))})
        error, jacobian = target[:3, 3] - T_root_tip[:3, 3], self._jacobian_of(T_root_tip, axes)
        if not orientation:
            return error, jacobian[:3]
        jacobian[3:] *= _ROTATION_WEIGHT
        rotation = _ROTATION_WEIGHT * _rotation_vector(target[:3, :3] @ T_root_tip[:3, :3].T)
        return np.concatenate([error, rotation]), jacobian

    def _jacobian_of(self, T_root_tip: Mat4, axes: Sequence[_Axis]) -> F64:
        """Returns the Jacobian, (6, J), from velocities of ``names`` to the twist of the tip, linear first, root axes."""
        out = np.zeros((6, len(self.names)))
        for axis in axes:
            if axis.leader not in self.names:
                continue
            column = out[:, self.names.index(axis.leader)]
            if axis.slides:
                column[:3] += axis.factor * axis.direction
            else:
                column[:3] += axis.factor * _cross(axis.direction, T_root_tip[:3, 3] - axis.origin)
                column[3:] += axis.factor * axis.direction
        return out

    def _forward(self, positions: Mapping[str, float]) -> tuple[Mat4, list[_Axis]]:
        """Returns T_root_tip, and the axes of all moving joints."""
        T: Mat4 = np.eye(4)
        axes: list[_Axis] = []
        for link in self._path:
            T = T @ link.T_parent_joint
            if not link.leader:
                continue
            joint, mimic, position = link.joint, link.mimic, positions.get(link.leader, 0.0)
            factor = 1.0 if mimic is None else mimic.multiplier
            axes.append(_Axis(link.leader, factor, T[:3, :3] @ joint.axis, T[:3, 3], joint.kind == "prismatic"))
            T = T @ joint.motion(position if mimic is None else mimic.position(position))
        return T, axes


def _self_motion(jacobian: F64, desired: F64) -> F64:
    """Returns the projection of ``desired``, (J,), onto the joint motions that do not move the tip, (J,); NaN = no rest position."""
    _, sizes, rows = np.linalg.svd(jacobian)
    free: F64 = rows[int((sizes > 1e-6).sum()) :]
    has_rest = ~np.isnan(desired)
    part = free[:, has_rest]
    amounts = np.linalg.solve(part @ part.T + _REST_DAMPING * np.eye(len(free)), part @ desired[has_rest])
    return np.asarray(amounts @ free)


def _leader(joint: UrdfJoint) -> str:
    return joint.name if joint.mimic is None else joint.mimic.leader


def _limits(model: UrdfModel, name: str) -> tuple[float, float]:
    """Returns the limits of a joint within which its mimic joints are within their limits."""
    lower, upper = -math.inf, math.inf
    for joint in model.joints:
        if joint.kind == "fixed" or _leader(joint) != name or not joint.is_bounded:
            continue
        ends = [joint.lower, joint.upper]
        if joint.mimic is not None:
            if joint.mimic.multiplier == 0.0:
                continue
            ends = sorted((end - joint.mimic.offset) / joint.mimic.multiplier for end in ends)
        if max(lower, ends[0]) <= min(upper, ends[1]):  # a follower that can never keep to both limits does not stop its leader
            lower, upper = max(lower, ends[0]), min(upper, ends[1])
    return lower, upper


def _cross(a: F64, b: F64) -> F64:
    """Returns the cross product a x b, (3,); several times faster than ``np.cross``."""
    (ax, ay, az), (bx, by, bz) = a.tolist(), b.tolist()
    return np.array([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx])


def _rotation_vector(rotation: F64) -> F64:
    """Returns the rotation vector (axis times angle), (3,), radians, of a rotation matrix (3, 3)."""
    twice = np.array([rotation[2, 1] - rotation[1, 2], rotation[0, 2] - rotation[2, 0], rotation[1, 0] - rotation[0, 1]])
    sine, cosine = float(np.linalg.norm(twice)) / 2.0, (float(np.trace(rotation)) - 1.0) / 2.0
    angle = math.atan2(sine, cosine)
    if sine > 1e-6:
        return twice * (angle / (2.0 * sine))
    if cosine > 0.0:
        return twice / 2.0
    # Half a turn: the axis is a column of R + 1.
    column = (rotation + np.eye(3))[:, int(np.argmax(np.diag(rotation)))]
    return np.asarray(column / np.linalg.norm(column) * angle)
