"""The arms of all robots of a world: their grippers, their servos, and what robots run into.

``PhysicsWorld`` calls this around every step; what users call is in ``arm_commands.py``.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from gibson_sim.errors import CommandError, RobotError
from gibson_sim.physics.attachments import Attachments
from gibson_sim.physics.body import BodyInWorld
from gibson_sim.physics.bullet import Bullet
from gibson_sim.physics.engine_types import EngineContact
from gibson_sim.physics.grasper import Grasper
from gibson_sim.physics.proximity import Reach
from gibson_sim.physics.robot import RobotInWorld
from gibson_sim.physics.tool_servo import ToolServo
from gibson_sim.quoting import quoted
from gibson_sim.robots.collision_count import STANDING_HEIGHT, STANDING_NORMAL, CollisionCount, CollisionCounter
from gibson_sim.robots.joints.commands import JointCommand
from gibson_sim.robots.joints.grasping import GraspSettings, gripper_move
from gibson_sim.robots.joints.servo import ServoSettings
from gibson_sim.robots.spec import ManipulatorSpec


@dataclass(slots=True)
class _Robot:
    """What one robot has more than joints."""

    one: RobotInWorld
    graspers: dict[str, Grasper]
    servos: dict[str, ToolServo]
    hands: frozenset[int]
    """The engine's numbers of links whose touches are no collisions."""
    base_height: float
    """Metres from what the engine moves as its root up to its base frame, upright."""
    counter: CollisionCounter | None
    """None = nobody asked."""


class Arms:
    """Arms of the robots that are in the world now."""

    def __init__(
        self,
        bullet: Bullet,
        robots: Mapping[str, RobotInWorld],
        bodies: Callable[[], Sequence[BodyInWorld]],
        attachments: Attachments,
        grasping: GraspSettings,
        servo: ServoSettings,
    ) -> None:
        """Knows the robots by the mapping that the world keeps; they come and go.

        Args:
            bullet: The engine.
            robots: By name; it may change.
            bodies: Returns all robots and bodies.
            attachments: What holds links together.
            grasping: How grippers hold.
            servo: How servos move.
        """
        self._bullet, self._robots, self._bodies, self._attachments = bullet, robots, bodies, attachments
        self._grasping, self._servo = grasping, servo
        self._reach = Reach(bullet)
        self._known: dict[str, _Robot] = {}
        self._counted: set[str] = set()
        """Robots whose collisions somebody wants to know: it costs a few percent of a step."""

    def arm(self, robot: str, name: str) -> ManipulatorSpec:
        """Returns an arm; an empty name = the first one. CommandError where there is none."""
        if robot not in self._robots:
            raise CommandError(f"no robot {quoted(robot)} in this world; known: {', '.join(self._robots) or 'none'}")
        try:
            return self._robots[robot].spec.manipulator(name)
        except RobotError as error:
            raise CommandError(str(error)) from error

    def rest(self, robot: str, arm: ManipulatorSpec) -> dict[str, float]:
        """Returns where the joints of an arm start, radians or metres: where they shall be as far as a task leaves them free."""
        start = dict(self._robots[robot].spec.joints)
        return {name: start.get(name, 0.0) for name in arm.joints}

    def grasper(self, robot: str, name: str) -> Grasper:
        """Returns the gripper of an arm."""
        arm = self.arm(robot, name)
        if arm.gripper is None:
            raise CommandError(f"arm {quoted(arm.name)} of robot {quoted(robot)} has no gripper; give it one in its robot.yaml")
        return self._of(robot).graspers[arm.name]

    def tool_servo(self, robot: str, name: str) -> ToolServo:
        """Returns the servo of an arm."""
        return self._of(robot).servos[self.arm(robot, name).name]

    def collisions(self, robot: str, step_hz: int) -> CollisionCount:
        """Returns what a robot ran into since the first such question, or since it was reset."""
        known = self._of(robot)
        if known.counter is None:
            self._counted.add(robot)
            known.counter = CollisionCounter()
        return known.counter.total(step_hz)

    def notice(self, robot: str, command: JointCommand, now_ns: int) -> None:
        """Takes note of a joint command before it is obeyed: one that closes a gripper grasps, and one that opens it lets go.

        A servo whose joints it names stops.
        """
        known = self._of(robot)
        if not known.one.spec.manipulators or known.one.motors is None:
            return
        positions = known.one.joint_positions(self._bullet)
        named = {name: positions[name] for name in known.one.motors.names}
        for arm in known.one.spec.manipulators:
            if not command.names or set(command.names) & set(arm.joints):
                known.servos[arm.name].forget()
            if arm.gripper is None:
                continue
            move = gripper_move(arm.gripper, command, named)
            if move == "closes":
                known.graspers[arm.name].grasp(now_ns)
            elif move == "opens":
                known.graspers[arm.name].release("let go: the gripper opened")

    def before_step(self, now_ns: int, step_ns: int) -> None:
        """Tells the joints of servos how fast to move in the step that begins at ``now_ns``."""
        for known in self._known.values():
            for servo in known.servos.values():
                servo.before_step(now_ns, step_ns)

    def after_step(self, now_ns: int) -> None:
        """Follows up the step that ended at ``now_ns``."""
        for known in self._known.values():
            busy = [grasper for grasper in known.graspers.values() if grasper.is_busy]
            if not busy and known.counter is None:
                continue
            contacts = self._bullet.contacts(known.one.body)
            if known.counter is not None:
                known.counter.add_step(now_ns, self._touches(known, contacts))
            for grasper in busy:
                grasper.after_step(now_ns, contacts)

    def remove(self, robot: str) -> None:
        """Forgets a robot that is about to go."""
        self._known.pop(robot, None)
        self._counted.discard(robot)

    def reset(self) -> None:
        """Forgets everything but whose collisions are counted; call it when all stand where they started."""
        self._known.clear()
        for robot in self._counted:
            self._of(robot)

    def forget_commands(self) -> None:
        """Stops servos, whose commands are of another time; grippers hold on."""
        for known in self._known.values():
            for servo in known.servos.values():
                servo.forget()
            for grasper in known.graspers.values():
                grasper.stop_closing()

    def _of(self, robot: str) -> _Robot:
        if robot not in self._robots:
            raise CommandError(f"no robot {quoted(robot)} in this world; known: {', '.join(self._robots) or 'none'}")
        one = self._robots[robot]
        known = self._known.get(robot)
        if known is None:
            arms = one.spec.manipulators
            graspers = {
                arm.name: Grasper(self._bullet, one, arm, self._attachments, self._reach, self._bodies, self._grasping)
                for arm in arms
                if arm.gripper is not None
            }
            servos = {arm.name: ToolServo(self._bullet, one, arm, self._servo) for arm in arms}
            hands = frozenset(row for grasper in graspers.values() for row in grasper.rows)
            counter = CollisionCounter() if robot in self._counted else None
            height = one.root_state(self._bullet)[0].position[2] - self._bullet.raw_root(one.body)[2]
            known = self._known[robot] = _Robot(one, graspers, servos, hands, height, counter)
        return known

    def _touches(self, known: _Robot, contacts: Sequence[EngineContact]) -> dict[tuple[str, str], float]:
        """Returns what of its contacts are collisions: not the floor below it, nor what its hands touch or hold."""
        floor = self._bullet.raw_root(known.one.body)[2] + known.base_height + STANDING_HEIGHT
        out: dict[tuple[str, str], float] = {}
        for contact in contacts:
            if contact.link in known.hands or (contact.normal[2] > STANDING_NORMAL and contact.position[2] < floor):
                continue
            if any(grasper.held == contact.other for grasper in known.graspers.values()):
                continue
            key = known.one.link_of_row(contact.link), contact.other
            out[key] = max(out.get(key, 0.0), contact.force)
        return out
