"""Joints that hold two links together for a while, such as a hand and a handle: ball joints and rigid ones, with a limit of their force.

The engine limits the force along each axis of the world. The limit for all directions is a cube of equal limits about a feed-forward force: see
``reach_of``, ``cube_of`` and ``feed_forward`` at the end.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from gibson_sim.errors import PhysicsError
from gibson_sim.physics.body import BodyInWorld
from gibson_sim.physics.bullet import Bullet
from gibson_sim.physics.engine import pybullet as p
from gibson_sim.physics.frames import rotate
from gibson_sim.quoting import quoted
from gibson_sim.types import Quat, Vec3

_PEAK = 1.04
"""Fraction of the limit that no force ever exceeds: the corners of the cube, and a little for the solver's rounding, within 5 %."""
_STEADY = 0.97
"""Fraction of the limit that a steady pull in any direction can reach; with less, the cube would be larger and the feed-forward force smaller."""
_GROWTH = 0.05
"""Fraction of the limit by which the force along an axis may grow from one step to the next."""
AttachmentKind = Literal["ball", "fixed"]
ATTACHMENT_KINDS: tuple[AttachmentKind, ...] = ("ball", "fixed")
_NOTHING: Vec3 = (0.0, 0.0, 0.0)
_ON_CHILD: dict[AttachmentKind, float] = {"ball": 1.0, "fixed": -1.0}
"""Sign that makes the engine's constraint force one on the child, by kind."""


@dataclass(frozen=True, slots=True)
class Attachment:
    """Two links that are joined."""

    handle: int
    """Its number, unique in this world for all time."""
    parent: str
    """Name of a robot or a body."""
    parent_link: str
    child: str
    child_link: str
    kind: AttachmentKind
    """ball: a point of each link stays at a point of the other; fixed: they do not rotate relative to each other either."""
    max_force: float
    """Limit in any direction, N, and for a fixed one also about any axis, N m; a stronger pull moves the links apart. A steady pull reaches 97 % of
    it, and no step exceeds 104 %."""


@dataclass(frozen=True, slots=True)
class AttachmentLoad:
    """Load of an attachment in the last step."""

    force: float
    """N."""
    torque: float
    """N m; 0 for a ball."""


@dataclass(slots=True)
class _Constraint:
    """One attachment in the engine. Forces have the engine's sign, see ``_ON_CHILD``."""

    attachment: Attachment
    number: int
    """The engine's number."""
    ends: tuple[tuple[BodyInWorld, int, list[float]], ...]
    """The parent, then the child: its row of ``Bullet.raw_states``, and the position of the joint in that row's frame, metres."""
    half: float
    """Limit of each axis about the feed-forward force in the next step, N or N m."""
    force: Vec3 = _NOTHING
    """Feed-forward force in the next step, N, world frame."""
    torque: Vec3 = _NOTHING
    """Feed-forward torque in the next step, N m, world frame."""
    borne: tuple[Vec3, Vec3] = (_NOTHING, _NOTHING)
    """Force (N) and torque (N m) in the last step, world frame."""


class Attachments:
    """All attachments of one world. They end when either body is removed, and at a reset."""

    def __init__(self, bullet: Bullet, find: Callable[[str], BodyInWorld]) -> None:
        """Starts without any.

        Args:
            bullet: The engine.
            find: Returns a robot or a body by its name, or raises PhysicsError.
        """
        self._bullet, self._find = bullet, find
        self._constraints: dict[int, _Constraint] = {}
        """By handle."""
        self._next_handle = 1

    @property
    def all(self) -> tuple[Attachment, ...]:
        """The attachments now, the oldest first."""
        return tuple(constraint.attachment for constraint in self._constraints.values())

    def attach(
        self,
        parent: str,
        parent_link: str,
        child: str,
        child_link: str,
        *,
        kind: AttachmentKind = "ball",
        max_force: float = 500.0,
        point: Vec3 | None = None,
    ) -> int:
        """Joins two links in their present relative pose, at any distance, so that nothing jumps; returns the handle.

        Args:
            parent: Robot or body, usually the one that holds.
            parent_link: One of its links.
            child: Robot or body, usually the one that is held.
            child_link: One of its links.
            kind: Kind of joint.
            max_force: Limit of the force, see ``Attachment``.
            point: Position of the joint, metres, world frame; None = the origin of the parent's link.

        Raises:
            PhysicsError: there is no such body or link, both are the same, or the force is no number above 0.
        """
        if kind not in ATTACHMENT_KINDS:
            raise PhysicsError(f"kind of an attachment is {quoted(kind)}, must be one of {', '.join(ATTACHMENT_KINDS)}")
        if not (math.isfinite(max_force) and max_force > 0.0):
            raise PhysicsError(f"max_force of an attachment is {max_force} N, must be a finite number above 0")
        a, b = self._find(parent), self._find(child)
        row_a, row_b = a.row_of_link(parent_link), b.row_of_link(child_link)
        if (parent, row_a) == (child, row_b):
            raise PhysicsError(f"{parent}/{parent_link} and {child}/{child_link} are one rigid part; attach two that move apart")
        pivot = np.array(a.link_position(self._bullet, parent_link) if point is None else point, dtype=np.float64)
        if not np.isfinite(pivot).all():
            raise PhysicsError(f"point of an attachment is {point}, must be finite")
        at_a, turn_a = _in_inertial(tuple(self._bullet.raw_states(a.engine_body)[row_a].tolist()), pivot)
        at_b, turn_b = _in_inertial(tuple(self._bullet.raw_states(b.engine_body)[row_b].tolist()), pivot)
        client = self._bullet.client
        joint = p.JOINT_POINT2POINT if kind == "ball" else p.JOINT_FIXED
        number = p.createConstraint(
            a.engine_body.uid, row_a - 1, b.engine_body.uid, row_b - 1, joint, [0.0, 0.0, 0.0], at_a, at_b, turn_a, turn_b,
            physicsClientId=client,
        )  # fmt: skip
        handle, self._next_handle = self._next_handle, self._next_handle + 1
        ends = (a, row_a, at_a), (b, row_b, at_b)
        constraint = _Constraint(Attachment(handle, parent, parent_link, child, child_link, kind, max_force), number, ends, 0.0)
        self._constraints[handle] = constraint
        self._limit(constraint)
        self._wake(a, b)
        return handle

    def detach(self, handle: int) -> None:
        """Removes an attachment; PhysicsError if there is none with this handle."""
        constraint = self._constraint(handle)
        p.removeConstraint(constraint.number, physicsClientId=self._bullet.client)
        del self._constraints[handle]
        self._wake(self._find(constraint.attachment.parent), self._find(constraint.attachment.child))

    def load(self, handle: int) -> AttachmentLoad:
        """Returns the load in the last step; PhysicsError if there is no attachment with this handle."""
        force, torque = self._constraint(handle).borne
        return AttachmentLoad(math.hypot(*force), math.hypot(*torque))

    def before_step(self) -> None:
        """Applies the feed-forward forces; call it before every step."""
        for constraint in self._constraints.values():
            if any(constraint.force) or any(constraint.torque):
                sign = _ON_CHILD[constraint.attachment.kind]
                self._push(*constraint.ends[1], sign, constraint)
                self._push(*constraint.ends[0], -sign, constraint)

    def after_step(self) -> None:
        """Reads the loads; call it after every step."""
        for constraint in self._constraints.values():
            state = p.getConstraintState(constraint.number, physicsClientId=self._bullet.client)
            constraint.borne = _sum(constraint.force, state[:3]), _sum(constraint.torque, state[3:] or _NOTHING)
            self._limit(constraint)

    def detach_all(self, body: str | None = None) -> None:
        """Removes all attachments of ``body``; None = all of them."""
        for attachment in self.all:
            if body is None or body in (attachment.parent, attachment.child):
                self.detach(attachment.handle)

    def wake_beside(self, body: str) -> None:
        """Wakes what is attached to ``body``: a body that was moved pulls at it, however far away it is."""
        for attachment in self.all:
            if body in (attachment.parent, attachment.child):
                self._wake(self._find(attachment.parent), self._find(attachment.child))

    def _limit(self, constraint: _Constraint) -> None:
        """Sets the limit of each axis and the feed-forward force for the next step."""
        most, reaches = (
            constraint.attachment.max_force,
            [reach_of(constraint.attachment.max_force, borne) for borne in constraint.borne],
        )
        half = min(cube_of(most, reach) for reach in reaches)
        constraint.force, constraint.torque = (
            feed_forward(borne, reach, half) for borne, reach in zip(constraint.borne, reaches, strict=True)
        )
        if half != constraint.half:
            constraint.half = half
            p.changeConstraint(constraint.number, maxForce=half, physicsClientId=self._bullet.client)

    def _push(self, body: BodyInWorld, row: int, at: list[float], sign: float, constraint: _Constraint) -> None:
        """Applies the feed-forward force and torque to one end, at the joint, in the next step."""
        raw, client = self._bullet.raw_states(body.engine_body)[row], self._bullet.client
        point = (raw[:3] + rotate(raw[None, 3:7], np.array([at]))[0]).tolist()
        force, torque = [sign * c for c in constraint.force], [sign * c for c in constraint.torque]
        p.applyExternalForce(body.engine_body.uid, row - 1, force, point, p.WORLD_FRAME, physicsClientId=client)
        if any(torque):
            p.applyExternalTorque(body.engine_body.uid, row - 1, torque, p.WORLD_FRAME, physicsClientId=client)

    def _constraint(self, handle: int) -> _Constraint:
        if handle not in self._constraints:
            known = ", ".join(map(str, self._constraints)) or "none"
            raise PhysicsError(f"nothing is attached with handle {handle}; attached are: {known}")
        return self._constraints[handle]

    def _wake(self, *bodies: BodyInWorld) -> None:
        for body in bodies:
            self._bullet.wake(body.engine_body)


def reach_of(limit: float, borne: Sequence[float]) -> Vec3:
    """Returns the greatest force along each axis in the next step, N or N m, not negative.

    Args:
        limit: Limit for all directions, N or N m.
        borne: Force along each axis in the last step.
    """
    x, y, z = (abs(force) for force in borne)
    most = _STEADY * limit
    # Equal growth along all three, up to (x + growth)^2 + (y + growth)^2 + (z + growth)^2 = most^2.
    total, left = x + y + z, most**2 - x * x - y * y - z * z
    if left < 0.0:
        part = most / math.hypot(x, y, z)
        return part * x, part * y, part * z
    growth = min(_GROWTH * limit, (math.sqrt(total**2 + 3.0 * left) - total) / 3.0)
    return x + growth, y + growth, z + growth


def cube_of(limit: float, reach: Vec3) -> float:
    """Returns half the edge of the largest cube, N or N m, that stays within the limit wherever it stands within ``reach``."""
    left, half = (_PEAK * limit) ** 2, 0.0
    for count, axis in zip((3, 2, 1), sorted(reach, reverse=True), strict=True):
        half = math.sqrt(left / count)
        if half >= axis:
            break
        left -= axis**2
    return half


def feed_forward(borne: Sequence[float], reach: Vec3, half: float) -> Vec3:
    """Returns the centre of the cube, N or N m: 0 along axes where a cube about zero reaches far enough."""
    x, y, z = (math.copysign(max(0.0, far - half), force) for far, force in zip(reach, borne, strict=True))
    return x, y, z


def _sum(a: Sequence[float], b: Sequence[float]) -> Vec3:
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


def _in_inertial(raw: tuple[float, ...], point: NDArray[np.float64]) -> tuple[list[float], Quat]:
    """Returns a point and the axes of the world, in the inertial frame that ``raw`` (``Bullet.raw_states``) describes."""
    x, y, z, w = raw[3:7]
    inverse = (-x, -y, -z, w)
    return rotate(np.array([inverse]), (point - np.array(raw[:3]))[None])[0].tolist(), inverse
