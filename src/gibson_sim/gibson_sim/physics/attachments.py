"""What holds two links together for a while: a hand a handle, a gripper a cup. Ball joints and rigid ones, with a greatest force."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from gibson_sim.errors import PhysicsError
from gibson_sim.physics.body import BodyInWorld
from gibson_sim.physics.bullet import Bullet
from gibson_sim.physics.engine import pybullet as p
from gibson_sim.physics.frames import turn
from gibson_sim.types import Quat, Vec3

AttachmentKind = Literal["ball", "fixed"]
ATTACHMENT_KINDS: tuple[AttachmentKind, ...] = ("ball", "fixed")
_AXES = math.sqrt(3.0)
"""The engine limits the force along each axis of the world; along all three at once it is so much larger."""


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
    """N, in any direction, and, for a fixed one, N m about any axis; what pulls harder pulls them apart."""


@dataclass(frozen=True, slots=True)
class AttachmentLoad:
    """What an attachment bore in the last step."""

    force: float
    """N."""
    torque: float
    """N m; 0 for a ball."""


class Attachments:
    """All attachments of one world. They end with either body, and at a reset."""

    def __init__(self, bullet: Bullet, find: Callable[[str], BodyInWorld]) -> None:
        """Holds nothing.

        Args:
            bullet: The engine.
            find: Returns a robot or a body by its name, or raises PhysicsError.
        """
        self._bullet, self._find = bullet, find
        self._held: dict[int, tuple[Attachment, int]] = {}
        """By handle, with the engine's number."""
        self._next = 1

    @property
    def all(self) -> tuple[Attachment, ...]:
        """What is held now, the oldest first."""
        return tuple(attachment for attachment, _ in self._held.values())

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

        The engine limits the force along each axis alone, to a part of ``max_force`` that keeps the whole below it: along an axis of
        the world it holds 58 % of it, along a diagonal of the three all.

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
            raise PhysicsError(f"kind of an attachment is {kind!r}, must be one of {', '.join(ATTACHMENT_KINDS)}")
        if not (math.isfinite(max_force) and max_force > 0.0):
            raise PhysicsError(f"max_force of an attachment is {max_force} N, must be a finite number above 0")
        a, b = self._find(parent), self._find(child)
        row_a, row_b = a.row_of_link(parent_link), b.row_of_link(child_link)
        if (parent, row_a) == (child, row_b):
            raise PhysicsError(f"{parent}/{parent_link} and {child}/{child_link} are one rigid part; attach two that move apart")
        pivot = np.array(a.link_position(self._bullet, parent_link) if point is None else point, dtype=np.float64)
        if not np.isfinite(pivot).all():
            raise PhysicsError(f"point of an attachment is {point}, must be finite")
        at_a, turn_a = _in_inertial(self._bullet.raw_states(a.body)[row_a], pivot)
        at_b, turn_b = _in_inertial(self._bullet.raw_states(b.body)[row_b], pivot)
        client = self._bullet.client
        joint = p.JOINT_POINT2POINT if kind == "ball" else p.JOINT_FIXED
        number = p.createConstraint(
            a.body.uid, row_a - 1, b.body.uid, row_b - 1, joint, [0.0, 0.0, 0.0], at_a, at_b, turn_a, turn_b,
            physicsClientId=client,
        )  # fmt: skip
        p.changeConstraint(number, maxForce=max_force / _AXES, physicsClientId=client)
        handle, self._next = self._next, self._next + 1
        self._held[handle] = Attachment(handle, parent, parent_link, child, child_link, kind, max_force), number
        self._wake(a, b)
        return handle

    def detach(self, handle: int) -> None:
        """Lets go; PhysicsError where nothing of this number is held."""
        attachment, number = self._one(handle)
        p.removeConstraint(number, physicsClientId=self._bullet.client)
        del self._held[handle]
        self._wake(self._find(attachment.parent), self._find(attachment.child))

    def load(self, handle: int) -> AttachmentLoad:
        """Returns what it bore in the last step; PhysicsError where nothing of this number is held."""
        _, number = self._one(handle)
        state = p.getConstraintState(number, physicsClientId=self._bullet.client)
        return AttachmentLoad(math.hypot(*state[:3]), math.hypot(*state[3:]))

    def detach_all(self, body: str | None = None) -> None:
        """Lets go of everything that holds ``body``, or is held by it; None = of everything."""
        for attachment in self.all:
            if body is None or body in (attachment.parent, attachment.child):
                self.detach(attachment.handle)

    def wake_beside(self, body: str) -> None:
        """Wakes what holds ``body``, or is held by it: a body that is put elsewhere pulls at it, however far it is."""
        for attachment, _ in self._held.values():
            if body in (attachment.parent, attachment.child):
                self._wake(self._find(attachment.parent), self._find(attachment.child))

    def _one(self, handle: int) -> tuple[Attachment, int]:
        if handle not in self._held:
            held = ", ".join(str(number) for number in self._held) or "none"
            raise PhysicsError(f"nothing is attached with handle {handle}; attached are: {held}")
        return self._held[handle]

    def _wake(self, *bodies: BodyInWorld) -> None:
        for one in bodies:
            self._bullet.wake(one.body)


def _in_inertial(raw: tuple[float, ...], point: NDArray[np.float64]) -> tuple[list[float], Quat]:
    """Returns a point and the axes of the world, in the inertial frame that ``raw`` (``Bullet.raw_states``) describes."""
    x, y, z, w = raw[3:7]
    inverse = (-x, -y, -z, w)
    return turn(np.array([inverse]), (point - np.array(raw[:3]))[None])[0].tolist(), inverse
