"""What holds two links together for a while: a hand a handle, a gripper a cup. Ball joints and rigid ones, with a greatest force.

``force_limits`` says how the engine's limits for each axis, and a part of the force that is given in advance, make one for all directions.
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
from gibson_sim.physics.frames import turn
from gibson_sim.quoting import quoted
from gibson_sim.types import Quat, Vec3

_MOST = 1.04
"""Part of the limit that no force ever exceeds: the corners of the cube, and a little for the solver's rounding below 5 %."""
_STEADY = 0.97
"""Part of the limit that a pull in any direction bears; less and the cube would be larger, and what is given in advance less."""
_GROWTH = 0.05
"""Part of the limit by which an axis may bear more in the next step than in the last one."""


def reach_of(limit: float, borne: Sequence[float]) -> Vec3:
    """Returns how far each axis may be pulled in the next step, N or N m, not negative.

    Args:
        limit: Of the whole, N or N m.
        borne: What the axes bore in the last step.
    """
    x, y, z = (abs(force) for force in borne)
    most = _STEADY * limit
    # The same growth for all three, as far as their sum stays within: (x + growth)^2 + (y + growth)^2 + (z + growth)^2 = most^2.
    total, left = x + y + z, most**2 - x * x - y * y - z * z
    if left < 0.0:
        part = most / math.hypot(x, y, z)
        return part * x, part * y, part * z
    growth = min(_GROWTH * limit, (math.sqrt(total**2 + 3.0 * left) - total) / 3.0)
    return x + growth, y + growth, z + growth


def cube_of(limit: float, reach: Vec3) -> float:
    """Returns half the edge of the largest cube that can stand anywhere within the limit and reach so far, N or N m."""
    left, half = (_MOST * limit) ** 2, 0.0
    for count, axis in zip((3, 2, 1), sorted(reach, reverse=True), strict=True):
        half = math.sqrt(left / count)
        if half >= axis:
            break
        left -= axis**2
    return half


def given_in_advance(borne: Sequence[float], reach: Vec3, half: float) -> Vec3:
    """Returns the middle of the cube, N or N m: 0 along axes along which it reaches far enough about zero."""
    x, y, z = (math.copysign(max(0.0, far - half), force) for far, force in zip(reach, borne, strict=True))
    return x, y, z


AttachmentKind = Literal["ball", "fixed"]
ATTACHMENT_KINDS: tuple[AttachmentKind, ...] = ("ball", "fixed")
_NOTHING: Vec3 = (0.0, 0.0, 0.0)
_ON_CHILD: dict[AttachmentKind, float] = {"ball": 1.0, "fixed": -1.0}
"""Sign of the force on the child by what the engine says of a constraint of each kind."""


@dataclass(frozen=True, slots=True)
class Attachment:
    """Two links that are held together."""

    handle: int
    """Its number, which no other attachment of this world ever has."""
    parent: str
    """Name of a robot or a body."""
    parent_link: str
    child: str
    child_link: str
    kind: AttachmentKind
    """ball: one point of each stays where the other's is; fixed: they do not turn against each other either."""
    max_force: float
    """N, in any direction, and, for a fixed one, N m about any axis; what pulls harder pulls them apart. See ``force_limits``: a steady
    pull is borne up to 97 % of it, and in no step more than 104 %."""


@dataclass(frozen=True, slots=True)
class AttachmentLoad:
    """What an attachment bore in the last step."""

    force: float
    """N."""
    torque: float
    """N m; 0 for a ball."""


@dataclass(slots=True)
class _Held:
    """One attachment in the engine. Forces are as the engine tells them: those on the child, or on the parent."""

    attachment: Attachment
    number: int
    """The engine's."""
    ends: tuple[tuple[BodyInWorld, int, list[float]], ...]
    """The parent, then the child: which row of ``Bullet.raw_states`` moves it, and where the joint is in that row's frame, metres."""
    half: float
    """Limit of each axis in the next step, N or N m."""
    force: Vec3 = _NOTHING
    """Given in advance in the next step, N, world frame."""
    torque: Vec3 = _NOTHING
    """N m."""
    borne: tuple[Vec3, Vec3] = (_NOTHING, _NOTHING)
    """Force and torque in the last step."""


class Attachments:
    """All attachments of one world. They end with either body, and at a reset."""

    def __init__(self, bullet: Bullet, find: Callable[[str], BodyInWorld]) -> None:
        """Holds nothing.

        Args:
            bullet: The engine.
            find: Returns a robot or a body by its name, or raises PhysicsError.
        """
        self._bullet, self._find = bullet, find
        self._held: dict[int, _Held] = {}
        """By handle."""
        self._next = 1

    @property
    def all(self) -> tuple[Attachment, ...]:
        """What is held now, the oldest first."""
        return tuple(held.attachment for held in self._held.values())

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
        """Holds two links together as they lie now, at whatever distance: nothing jumps. Returns the handle.

        Args:
            parent: Robot or body, usually what holds.
            parent_link: One of its links.
            child: Robot or body, usually what is held.
            child_link: One of its links.
            kind: How.
            max_force: See ``Attachment``.
            point: Where they are joined, metres, world frame; None = at the origin of the parent's link.

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
        at_a, turn_a = _in_inertial(tuple(self._bullet.raw_states(a.body)[row_a].tolist()), pivot)
        at_b, turn_b = _in_inertial(tuple(self._bullet.raw_states(b.body)[row_b].tolist()), pivot)
        client = self._bullet.client
        joint = p.JOINT_POINT2POINT if kind == "ball" else p.JOINT_FIXED
        number = p.createConstraint(
            a.body.uid, row_a - 1, b.body.uid, row_b - 1, joint, [0.0, 0.0, 0.0], at_a, at_b, turn_a, turn_b,
            physicsClientId=client,
        )  # fmt: skip
        handle, self._next = self._next, self._next + 1
        ends = (a, row_a, at_a), (b, row_b, at_b)
        held = _Held(Attachment(handle, parent, parent_link, child, child_link, kind, max_force), number, ends, 0.0)
        self._held[handle] = held
        self._limit(held)
        self._wake(a, b)
        return handle

    def detach(self, handle: int) -> None:
        """Lets go; PhysicsError where nothing of this number is held."""
        held = self._one(handle)
        p.removeConstraint(held.number, physicsClientId=self._bullet.client)
        del self._held[handle]
        self._wake(self._find(held.attachment.parent), self._find(held.attachment.child))

    def load(self, handle: int) -> AttachmentLoad:
        """Returns what it bore in the last step; PhysicsError where nothing of this number is held."""
        force, torque = self._one(handle).borne
        return AttachmentLoad(math.hypot(*force), math.hypot(*torque))

    def before_step(self) -> None:
        """Gives what is given in advance; call it before every step."""
        for held in self._held.values():
            if any(held.force) or any(held.torque):
                sign = _ON_CHILD[held.attachment.kind]
                self._push(*held.ends[1], sign, held)
                self._push(*held.ends[0], -sign, held)

    def after_step(self) -> None:
        """Reads what all bore; call it after every step."""
        for held in self._held.values():
            state = p.getConstraintState(held.number, physicsClientId=self._bullet.client)
            held.borne = _sum(held.force, state[:3]), _sum(held.torque, state[3:] or _NOTHING)
            self._limit(held)

    def detach_all(self, body: str | None = None) -> None:
        """Lets go of everything that holds ``body``, or is held by it; None = of everything."""
        for attachment in self.all:
            if body is None or body in (attachment.parent, attachment.child):
                self.detach(attachment.handle)

    def wake_beside(self, body: str) -> None:
        """Wakes what holds ``body``, or is held by it: a body that is put elsewhere pulls at it, however far it is."""
        for attachment in self.all:
            if body in (attachment.parent, attachment.child):
                self._wake(self._find(attachment.parent), self._find(attachment.child))

    def _limit(self, held: _Held) -> None:
        """Sets the limit of each axis, and what is given in advance, for the next step."""
        most, reaches = held.attachment.max_force, [reach_of(held.attachment.max_force, borne) for borne in held.borne]
        half = min(cube_of(most, reach) for reach in reaches)
        held.force, held.torque = (given_in_advance(borne, reach, half) for borne, reach in zip(held.borne, reaches, strict=True))
        if half != held.half:
            held.half = half
            p.changeConstraint(held.number, maxForce=half, physicsClientId=self._bullet.client)

    def _push(self, one: BodyInWorld, row: int, at: list[float], sign: float, held: _Held) -> None:
        """Gives one end the force at the joint, and the torque, in the next step."""
        raw, client = self._bullet.raw_states(one.body)[row], self._bullet.client
        point = (raw[:3] + turn(raw[None, 3:7], np.array([at]))[0]).tolist()
        force, torque = [sign * c for c in held.force], [sign * c for c in held.torque]
        p.applyExternalForce(one.body.uid, row - 1, force, point, p.WORLD_FRAME, physicsClientId=client)
        if any(torque):
            p.applyExternalTorque(one.body.uid, row - 1, torque, p.WORLD_FRAME, physicsClientId=client)

    def _one(self, handle: int) -> _Held:
        if handle not in self._held:
            held = ", ".join(str(number) for number in self._held) or "none"
            raise PhysicsError(f"nothing is attached with handle {handle}; attached are: {held}")
        return self._held[handle]

    def _wake(self, *bodies: BodyInWorld) -> None:
        for one in bodies:
            self._bullet.wake(one.body)


def _sum(a: Sequence[float], b: Sequence[float]) -> Vec3:
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


def _in_inertial(raw: tuple[float, ...], point: NDArray[np.float64]) -> tuple[list[float], Quat]:
    """Returns a point and the axes of the world, in the inertial frame that ``raw`` (``Bullet.raw_states``) describes."""
    x, y, z, w = raw[3:7]
    inverse = (-x, -y, -z, w)
    return turn(np.array([inverse]), (point - np.array(raw[:3]))[None])[0].tolist(), inverse
