"""Temporary joints between two links, such as a hand and a handle: ball joints and fixed joints, with a force limit.

The engine limits the force along each world axis. A limit that holds for all directions is built from a cube of equal axis limits around a
feed-forward force: see ``force_bounds``, ``cube_of`` and ``feed_forward`` at the end.
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
"""Bound of the force relative to the limit: the corners of the cube stay within it, and the solver's rounding within 5 %."""
_STEADY = 0.97
"""Fraction of the limit that a steady pull in any direction can reach; a smaller value means a larger cube and less feed-forward force."""
_GROWTH = 0.05
"""Largest increase of the force along an axis from one step to the next, as a fraction of the limit."""
AttachmentKind = Literal["ball", "fixed"]
ATTACHMENT_KINDS: tuple[AttachmentKind, ...] = ("ball", "fixed")
_NOTHING: Vec3 = (0.0, 0.0, 0.0)
_ON_CHILD: dict[AttachmentKind, float] = {"ball": 1.0, "fixed": -1.0}
"""Sign that converts the engine's constraint force to the force on the child, by kind."""


@dataclass(frozen=True, slots=True)
class Attachment:
    """A joint between two links."""

    handle: int
    """Handle, never reused in this world."""
    parent: str
    """Name of a robot or a body."""
    parent_link: str
    child: str
    child_link: str
    kind: AttachmentKind
    """ball: a point of one link coincides with a point of the other; fixed: the links do not rotate relative to each other either."""
    max_force: float
    """Limit in any direction, N, and for a fixed joint also about any axis, N m; a stronger pull separates the links. A steady pull reaches 97 % of
    the limit, and no step exceeds 104 %."""


@dataclass(frozen=True, slots=True)
class AttachmentLoad:
    """Load of an attachment in the last step."""

    force: float
    """Force, N."""
    torque: float
    """Torque, N m; 0 for a ball joint."""


@dataclass(slots=True)
class _Constraint:
    """One attachment in the engine. Forces have the engine's sign, see ``_ON_CHILD``."""

    attachment: Attachment
    number: int
    """Engine id of the constraint."""
    ends: tuple[tuple[BodyInWorld, int, list[float]], ...]
    """Parent and child, each with its row of ``Bullet.raw_states`` and the position of the joint in that row's frame, metres."""
    half: float
    """Limit per axis around the feed-forward force in the next step, N or N m."""
    force: Vec3 = _NOTHING
    """Feed-forward force in the next step, N, world frame."""
    torque: Vec3 = _NOTHING
    """Feed-forward torque in the next step, N m, world frame."""
    borne: tuple[Vec3, Vec3] = (_NOTHING, _NOTHING)
    """Force (N) and torque (N m) in the last step, world frame."""


class Attachments:
    """All attachments of one world. An attachment ends when either body is removed, and at a reset."""

    def __init__(self, bullet: Bullet, find: Callable[[str], BodyInWorld]) -> None:
        """Starts without attachments.

        Args:
            bullet: The engine.
            find: Returns a robot or a body by its name, or raises PhysicsError.
        """
        self._bullet, self._find = bullet, find
        self._constraints: dict[int, _Constraint] = {}
        """Constraints by handle."""
        self._next_handle = 1

    @property
    def all(self) -> tuple[Attachment, ...]:
        """Current attachments, oldest first."""
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
        """Joins two links in their current relative pose, at any distance, without moving them; returns the handle.

        Args:
            parent: Robot or body, usually the holding one.
            parent_link: Link of the parent.
            child: Robot or body, usually the held one.
            child_link: Link of the child.
            kind: Kind of joint.
            max_force: Force limit, see ``Attachment``.
            point: Position of the joint, metres, world frame; None = the origin of the parent's link.

        Raises:
            PhysicsError: a body or link does not exist, both links are the same rigid part, or a number is out of range.
        """
        if kind not in ATTACHMENT_KINDS:
            raise PhysicsError(f"kind of an attachment is {quoted(kind)}, must be one of {', '.join(ATTACHMENT_KINDS)}")
        if not (math.isfinite(max_force) and max_force > 0.0):
            raise PhysicsError(f"max_force of an attachment is {max_force} N, must be a finite number above 0")
        a, b = self._find(parent), self._find(child)
        row_a, row_b = a.row_of_link(parent_link), b.row_of_link(child_link)
        if (parent, row_a) == (child, row_b):
            raise PhysicsError(
                f"{parent}/{parent_link} and {child}/{child_link} are one rigid part; attach links of two rigid parts"
            )
        pivot = np.array(a.link_position(self._bullet, parent_link) if point is None else point, dtype=np.float64)
        if not np.isfinite(pivot).all():
            raise PhysicsError(f"point of an attachment is {point}, must be finite")
        pivot_a, quat_a = _in_inertial(tuple(self._bullet.raw_states(a.engine_body)[row_a].tolist()), pivot)
        pivot_b, quat_b = _in_inertial(tuple(self._bullet.raw_states(b.engine_body)[row_b].tolist()), pivot)
        client = self._bullet.client
        joint = p.JOINT_POINT2POINT if kind == "ball" else p.JOINT_FIXED
        number = p.createConstraint(
            a.engine_body.uid, row_a - 1, b.engine_body.uid, row_b - 1, joint, [0.0, 0.0, 0.0], pivot_a, pivot_b, quat_a, quat_b,
            physicsClientId=client,
        )  # fmt: skip
        handle, self._next_handle = self._next_handle, self._next_handle + 1
        ends = (a, row_a, pivot_a), (b, row_b, pivot_b)
        constraint = _Constraint(Attachment(handle, parent, parent_link, child, child_link, kind, max_force), number, ends, 0.0)
        self._constraints[handle] = constraint
        self._limit(constraint)
        self._wake(a, b)
        return handle

    def detach(self, handle: int) -> None:
        """Removes an attachment; raises PhysicsError if no attachment has this handle."""
        constraint = self._constraint(handle)
        p.removeConstraint(constraint.number, physicsClientId=self._bullet.client)
        del self._constraints[handle]
        self._wake(self._find(constraint.attachment.parent), self._find(constraint.attachment.child))

    def load(self, handle: int) -> AttachmentLoad:
        """Returns the load in the last step; raises PhysicsError if no attachment has this handle."""
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
        """Removes all attachments of ``body``; None = all attachments."""
        for attachment in self.all:
            if body is None or body in (attachment.parent, attachment.child):
                self.detach(attachment.handle)

    def wake_beside(self, body: str) -> None:
        """Wakes the bodies attached to ``body``: a moved body pulls at them at any distance."""
        for attachment in self.all:
            if body in (attachment.parent, attachment.child):
                self._wake(self._find(attachment.parent), self._find(attachment.child))

    def _limit(self, constraint: _Constraint) -> None:
        """Sets the axis limit and the feed-forward force for the next step."""
        max_force = constraint.attachment.max_force
        bounds = [force_bounds(max_force, borne) for borne in constraint.borne]
        half = min(cube_of(max_force, bound) for bound in bounds)
        constraint.force, constraint.torque = (
            feed_forward(borne, bound, half) for borne, bound in zip(constraint.borne, bounds, strict=True)
        )
        if half != constraint.half:
            constraint.half = half
            p.changeConstraint(constraint.number, maxForce=half, physicsClientId=self._bullet.client)

    def _push(self, body: BodyInWorld, row: int, pivot: list[float], sign: float, constraint: _Constraint) -> None:
        """Applies the feed-forward force and torque to one end, at the joint, in the next step."""
        raw, client = self._bullet.raw_states(body.engine_body)[row], self._bullet.client
        point = (raw[:3] + rotate(raw[None, 3:7], np.array([pivot]))[0]).tolist()
        force, torque = [sign * c for c in constraint.force], [sign * c for c in constraint.torque]
        p.applyExternalForce(body.engine_body.uid, row - 1, force, point, p.WORLD_FRAME, physicsClientId=client)
        if any(torque):
            p.applyExternalTorque(body.engine_body.uid, row - 1, torque, p.WORLD_FRAME, physicsClientId=client)

    def _constraint(self, handle: int) -> _Constraint:
        if handle not in self._constraints:
            known = ", ".join(map(str, self._constraints)) or "none"
            raise PhysicsError(f"no attachment has handle {handle}; known: {known}")
        return self._constraints[handle]

    def _wake(self, *bodies: BodyInWorld) -> None:
        for body in bodies:
            self._bullet.wake(body.engine_body)


def force_bounds(limit: float, borne: Sequence[float]) -> Vec3:
    """Returns the largest magnitude of the force along each axis in the next step, N or N m.

    Args:
        limit: Limit for all directions, N or N m.
        borne: Force along each axis in the last step, N or N m.
    """
    x, y, z = (abs(force) for force in borne)
    steady = _STEADY * limit
    # Equal growth along all three axes, up to (x + growth)^2 + (y + growth)^2 + (z + growth)^2 = steady^2.
    total, remaining = x + y + z, steady**2 - x * x - y * y - z * z
    if remaining < 0.0:
        scale = steady / math.hypot(x, y, z)
        return scale * x, scale * y, scale * z
    growth = min(_GROWTH * limit, (math.sqrt(total**2 + 3.0 * remaining) - total) / 3.0)
    return x + growth, y + growth, z + growth


def cube_of(limit: float, bounds: Vec3) -> float:
    """Returns half the edge of the largest cube, N or N m, that stays within the limit at every position within ``bounds``."""
    remaining, half = (_PEAK * limit) ** 2, 0.0
    for count, axis in zip((3, 2, 1), sorted(bounds, reverse=True), strict=True):
        half = math.sqrt(remaining / count)
        if half >= axis:
            break
        remaining -= axis**2
    return half


def feed_forward(borne: Sequence[float], bounds: Vec3, half: float) -> Vec3:
    """Returns the centre of the cube, N or N m: 0 along axes where a cube around zero extends far enough."""
    x, y, z = (math.copysign(max(0.0, far - half), force) for far, force in zip(bounds, borne, strict=True))
    return x, y, z


def _sum(a: Sequence[float], b: Sequence[float]) -> Vec3:
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


def _in_inertial(raw: tuple[float, ...], point: NDArray[np.float64]) -> tuple[list[float], Quat]:
    """Returns a world point and the orientation of the world in the inertial frame given by ``raw``, a row of ``Bullet.raw_states``."""
    x, y, z, w = raw[3:7]
    inverse = (-x, -y, -z, w)
    return rotate(np.array([inverse]), (point - np.array(raw[:3]))[None])[0].tolist(), inverse
