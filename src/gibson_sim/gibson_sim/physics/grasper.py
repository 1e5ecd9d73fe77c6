"""One gripper in the engine: grasping, holding and releasing objects."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

from gibson_sim.errors import CommandError
from gibson_sim.physics.attachments import AttachmentKind, Attachments
from gibson_sim.physics.body import BodyInWorld
from gibson_sim.physics.bullet import Bullet
from gibson_sim.physics.engine_types import EngineContact
from gibson_sim.physics.proximity import Proximity
from gibson_sim.physics.robot import RobotInWorld
from gibson_sim.quoting import quoted
from gibson_sim.robots.joints.grasping import Candidate, GraspSettings, GraspState, best_candidate, hinge_of, release_reason
from gibson_sim.robots.spec import ManipulatorSpec
from gibson_sim.types import NS_PER_S, Vec3

CLOSING_NS = NS_PER_S
"""Time after the command to close in which a sticky gripper grasps an object that its fingers touch, simulation time, ns."""
_NEAREST_WITHIN = 1.0
"""Distance within which the nearest link is reported if none is in reach, metres."""
_RELEASED, _REMOVED = "let go: on command", "the held object was removed"


class Grasper:
    """The gripper of one arm."""

    def __init__(
        self,
        bullet: Bullet,
        robot: BodyInWorld,
        arm: ManipulatorSpec,
        attachments: Attachments,
        proximity: Proximity,
        bodies: Callable[[], Sequence[BodyInWorld]],
        settings: GraspSettings,
    ) -> None:
        """Starts without a held object.

        Args:
            bullet: The engine.
            robot: Robot of the gripper.
            arm: Arm of the gripper.
            attachments: Joints to held objects.
            proximity: Finds links near a point.
            bodies: Returns all robots and bodies of the world.
            settings: Rules of grasping.
        """
        self._bullet, self._robot, self._arm, self._attachments, self._proximity = bullet, robot, arm, attachments, proximity
        self._bodies, self._settings = bodies, settings
        self.rows = hand_rows(robot, arm.tip_link)
        """Engine indices of the links of the hand: the rigid group of the tool, and all links below it."""
        self._handle: int | None = None
        """Handle of the attachment to the held object."""
        self._hinge: tuple[BodyInWorld, str] | None = None
        """Body and joint of the held door."""
        self._closes_until_ns = -1
        self._reason = ""

    @property
    def is_busy(self) -> bool:
        """Whether ``after_step`` must be called."""
        return self._handle is not None or self._closes_until_ns >= 0

    @property
    def held(self) -> str:
        """Name of the body held by a joint; empty = none."""
        return next((a.child for a in self._attachments.all if a.handle == self._handle), "")

    def grasp(self, now_ns: int, target: str = "") -> None:
        """Grasps the object in reach; ``state`` reports the result.

        Args:
            now_ns: Simulation time.
            target: The only robot or body that may be grasped; empty = any.

        Raises:
            CommandError: the target does not exist in the world, or is the robot itself.
        """
        others = [body for body in self._bodies() if body is not self._robot and target in ("", body.name)]
        if target and not others:
            known = ", ".join(body.name for body in self._bodies() if body is not self._robot) or "nothing"
            raise CommandError(
                f"arm {quoted(self._arm.name)} cannot grasp {quoted(target)}: it is not in this world; there are: {known}"
            )
        if self.held:
            return
        mode = self._settings.mode
        self._closes_until_ns = -1
        if mode == "physical":
            self._reason = "only friction holds objects"
        elif mode == "assisted":
            self._grasp_nearest(others)
        elif not self._grasp_touched(self._bullet.contacts(self._robot.engine_body), others):
            self._closes_until_ns = now_ns + CLOSING_NS

    def release(self, reason: str = _RELEASED) -> None:
        """Releases the held object; ``reason`` is recorded if an object was held or about to be grasped."""
        reason = reason if self.is_busy else ""
        if self.held and self._handle is not None:
            self._attachments.detach(self._handle)
        self._handle, self._hinge, self._closes_until_ns, self._reason = None, None, -1, reason

    def stop_closing(self) -> None:
        """Ends the time in which a sticky gripper grasps an object that its fingers touch."""
        self._closes_until_ns = -1

    def after_step(self, now_ns: int, contacts: Sequence[EngineContact]) -> None:
        """Grasps an object that the fingers touch, and releases an object that pulls too hard or a door that is open too far.

        Args:
            now_ns: Simulation time.
            contacts: Contacts of the robot in the step that ended at ``now_ns``.
        """
        if self._handle is None:
            if not self._grasp_touched(contacts, self._bodies()) and now_ns >= self._closes_until_ns:
                self._closes_until_ns, self._reason = -1, "the fingers closed without touching a movable link"
            return
        if not self.held:
            self.release(_REMOVED)
            return
        force = self._attachments.load(self._handle).force
        reason = release_reason(self._settings, force, self._opening())
        if reason:
            self.release(reason)

    def state(self) -> GraspState:
        """Returns the current state of the grasp."""
        mode, name = self._settings.mode, self._arm.name
        for attachment in self._attachments.all:
            if attachment.handle == self._handle:
                load = self._attachments.load(attachment.handle)
                return GraspState(name, mode, True, attachment.child, attachment.child_link, load.force, load.torque)
        if mode == "physical":
            return self._friction()
        return GraspState(name, mode, reason=_REMOVED if self._handle is not None else self._reason)

    def _grasp_nearest(self, others: Sequence[BodyInWorld]) -> None:
        settings, point = self._settings, self._robot.link_position(self._bullet, self._arm.tip_link)
        candidate = best_candidate(self._proximity.movable_links(point, others, settings.distance), settings.distance)
        if candidate is not None:
            self._attach(candidate, None)
            return
        nearest = best_candidate(self._proximity.movable_links(point, others, _NEAREST_WITHIN), _NEAREST_WITHIN)
        hint = "" if nearest is None else f"; {nearest.body}/{nearest.link} is at {nearest.distance:.3f} m"
        self._reason = f"no movable link is within {settings.distance:g} m of {self._arm.tip_link}{hint}"

    def _grasp_touched(self, contacts: Sequence[EngineContact], others: Sequence[BodyInWorld]) -> bool:
        """Grasps a movable link that the hand touches; returns whether there was one."""
        by_name = {body.name: body for body in others if body is not self._robot}
        points: dict[Candidate, Vec3] = {}
        for contact in contacts:
            other = by_name.get(contact.other)
            if contact.link in self.rows and other is not None and not (other.static and contact.other_link == -1):
                link = other.link_at(self._bullet, contact.other_link, contact.position)
                # The candidate with the largest contact force is the best one.
                points[Candidate(other.name, link, -contact.force)] = contact.position
        candidate = best_candidate(points, 1.0)
        if candidate is not None:
            self._attach(candidate, points[candidate])
        return candidate is not None

    def _attach(self, candidate: Candidate, point: Vec3 | None) -> None:
        """Joins the tool to a link: by a ball joint at the tool's origin (``point`` = None), or by a fixed joint at a contact point."""
        kind: AttachmentKind = "ball" if point is None else "fixed"
        self._handle = self._attachments.attach(
            self._robot.name, self._arm.tip_link, candidate.body, candidate.link,
            kind=kind, max_force=self._settings.max_force, point=point,
        )  # fmt: skip
        self._closes_until_ns, self._reason = -1, ""
        body = next(body for body in self._bodies() if body.name == candidate.body)
        hinge = None if isinstance(body, RobotInWorld) else hinge_of(body.model, candidate.link)
        self._hinge = None if hinge is None else (body, hinge)

    def _opening(self) -> float | None:
        """Returns the angle of the held door, radians; None = no door."""
        if self._hinge is None:
            return None
        body, joint = self._hinge
        return self._bullet.joint_angles(body.engine_body, [body.engine_body.joint_indices[joint]])[0]

    def _friction(self) -> GraspState:
        """Returns the object held by friction: of the bodies in contact with at least two links of the hand, the one with the largest force."""
        touched: dict[str, set[int]] = {}
        forces: dict[tuple[str, str], float] = {}
        bodies = {body.name: body for body in self._bodies() if body is not self._robot}
        for contact in self._bullet.contacts(self._robot.engine_body):
            if contact.link in self.rows and contact.other in bodies and contact.force > 0.0:
                touched.setdefault(contact.other, set()).add(contact.link)
                link = bodies[contact.other].link_at(self._bullet, contact.other_link, contact.position)
                forces[contact.other, link] = forces.get((contact.other, link), 0.0) + contact.force
        held = {key: force for key, force in forces.items() if len(touched[key[0]]) > 1}
        if not held:
            return GraspState(
                self._arm.name, "physical", reason=self._reason and "no two links of the hand touch the same object"
            )
        body, link = max(held, key=lambda key: (held[key], key))
        return GraspState(self._arm.name, "physical", True, body, link, sum(f for key, f in held.items() if key[0] == body))


def hand_rows(robot: BodyInWorld, tool: str) -> frozenset[int]:
    """Returns the engine indices of the rigid group of a link, and of all links below it."""
    hand = {link for link in robot.links if robot.row_of_link(link) == robot.row_of_link(tool)}
    parents = {joint.child: joint.parent for joint in robot.model.joints}
    hand |= {link for link in robot.links if _is_below(link, hand, parents)}
    return frozenset(robot.row_of_link(link) - 1 for link in hand)


def _is_below(link: str, hand: set[str], parents: Mapping[str, str]) -> bool:
    while link in parents:
        link = parents[link]
        if link in hand:
            return True
    return False
