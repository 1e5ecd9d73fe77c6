"""Finds the contacts of a bag's robots and their durations: from collision counts, contact points and bumpers. Pure."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

from gibson_sim.bags.reader import BagReader, TopicInfo

COLLISIONS, CONTACTS, BUMPER = "gibson_msgs/msg/CollisionCount", "gibson_msgs/msg/Contacts", "std_msgs/msg/Bool"
_PAUSE_S = 0.15
"""Maximum interruption within one contact, s: bodies chatter, and contacts are published at 30 Hz."""
_PRESS_S = 0.5
"""Shortest contact that is called pressing, s; a shorter one is a touch."""
_WALL_TIME_NS = 10**18
"""Log time, ns, from which on it is wall time: September 2001."""
_STANDING_NORMAL = 0.7
"""Minimum vertical component of the contact normal of a supporting surface, for bags without collision counts."""


@dataclass(frozen=True, slots=True)
class Touch:
    """A contact of a robot with one other object, without longer interruption."""

    robot: str
    """Namespace of the robot's topics without slashes; empty for a single robot."""
    other: str
    """Name of the other body or shape; empty = only a bumper was recorded, which does not report it."""
    begin: float
    """Time of the first contact, s."""
    end: float
    """Time of the last contact, s."""
    force: float = 0.0
    """Maximum normal force at one contact point, N; 0 = unknown."""
    movable: bool = False
    """Whether the other object is a body that physics moves, and not a static shape."""
    lasts: bool = False
    """Whether the contact had not ended when the recording did."""

    @property
    def is_press(self) -> bool:
        """Whether the contact lasted, unlike a bump."""
        return self.end - self.begin >= _PRESS_S

    def text(self) -> str:
        """Returns the touch as a phrase: ``pressed against wall_11 from 22.0 s to 23.4 s, with up to 28 N``."""
        subject = f"{self.robot}: " if self.robot else ""
        force = f", with up to {self.force:.0f} N" if self.force >= 0.5 else ""
        if not self.is_press:
            event = f"touched {self.other}" if self.other else "the bumper was hit"
            return f"{subject}{event} at {self.begin:.1f} s{force}"
        verb = ("pushed" if self.movable else "pressed against") if self.other else "the bumper was pressed"
        until = "the end of the recording" if self.lasts else f"{self.end:.1f} s"
        return f"{subject}{f'{verb} {self.other}'.strip()} from {self.begin:.1f} s to {until}{force}"


@dataclass(slots=True)
class _Open:
    """A touch in progress."""

    begin: float
    end: float
    force: float = 0.0
    movable: bool = False


@dataclass(slots=True)
class _Robot:
    """State of one robot while the bag is read."""

    name: str
    body: str
    """Name of its body in contacts; empty = unknown."""
    counted: bool
    """Whether its collisions are counted in the bag: contacts outside of collisions are then those of standing and grasping."""
    has_contacts: bool
    now_s: float = 0.0
    ongoing: bool = False
    count: int | None = None
    """Collisions so far; None = no count has arrived."""
    greatest: float = 0.0
    opened: dict[str, _Open] = field(default_factory=dict)
    closed: list[Touch] = field(default_factory=list)


class TouchFinder:
    """Collects the touches of all robots of a bag, message by message, in the order of the bag.

    Args:
        infos: topics of the bag.
        robots: namespaces of the robots without slashes; empty for a single robot.
        bodies: namespace -> name of the robot's body in contacts, if known.
    """

    def __init__(self, infos: Mapping[str, TopicInfo], robots: Iterable[str], bodies: Mapping[str, str]) -> None:
        self._robot_of: dict[str, _Robot] = {}
        """Topic of collisions or of a bumper -> its robot."""
        self._contacts = [name for name, info in infos.items() if info.type_name == CONTACTS and info.count]
        self._robots: list[_Robot] = []
        for name in robots:
            prefix = f"/{name}/" if name else "/"
            robot_infos = {topic: info for topic, info in infos.items() if topic.startswith(prefix) and info.count}
            counts = [topic for topic, info in robot_infos.items() if info.type_name == COLLISIONS]
            bumpers = [t for t, info in robot_infos.items() if info.type_name == BUMPER and "bumper" in t.removeprefix(prefix)]
            body = bodies.get(name, name)
            robot = _Robot(name, body, counted=bool(counts), has_contacts=bool(self._contacts and body))
            self._robots.append(robot)
            # One source for each robot, the most detailed one.
            for topic in counts or ([] if robot.has_contacts else bumpers):
                self._robot_of.setdefault(topic, robot)
        self.topics: tuple[str, ...] = (*self._robot_of, *(self._contacts if any(r.has_contacts for r in self._robots) else ()))
        """Topics whose messages ``add`` needs."""

    def needs(self, topic: str) -> bool:
        """Returns whether a message of the topic, now, changes anything; contacts without a collision do not."""
        if topic in self._robot_of:
            return True
        return topic in self._contacts and any(r.has_contacts and (r.ongoing or not r.counted) for r in self._robots)

    def add(self, topic: str, time_s: float, message: Any) -> None:
        """Adds a message of one of ``topics``; times, s, must not decrease."""
        robot = self._robot_of.get(topic)
        if robot is None:
            self._add_contacts(time_s, message)
        elif hasattr(message, "data"):
            robot.now_s = time_s
            if message.data:
                self._touch(robot, "", time_s)
        else:
            self._add_count(robot, time_s, message)
        for one in self._robots:
            self._close_old(one, time_s)

    def _add_count(self, robot: _Robot, time_s: float, message: Any) -> None:
        """Adds a collision count. Recorded contacts describe a collision in more detail after it has begun."""
        began = robot.count is not None and message.count > robot.count
        if began or (message.ongoing and not robot.has_contacts):
            grown = began and message.greatest_force > robot.greatest
            self._touch(robot, str(message.last_body), time_s, float(message.greatest_force) if grown else 0.0)
        robot.now_s, robot.ongoing = time_s, bool(message.ongoing)
        robot.count, robot.greatest = int(message.count), float(message.greatest_force)

    def _add_contacts(self, time_s: float, message: Any) -> None:
        for robot in self._robots:
            if not robot.has_contacts or (robot.counted and not robot.ongoing):
                continue
            robot.now_s = time_s
            for contact in message.contacts:
                if contact.body_a == robot.body:
                    other, link, rises = contact.body_b, contact.link_b, contact.normal.z
                elif contact.body_b == robot.body:
                    other, link, rises = contact.body_a, contact.link_a, -contact.normal.z
                else:
                    continue
                if rises < _STANDING_NORMAL and other != robot.body:
                    self._touch(robot, str(other), time_s, float(contact.force), movable=bool(link))

    def _touch(self, robot: _Robot, other: str, time_s: float, force: float = 0.0, *, movable: bool = False) -> None:
        touch = robot.opened.setdefault(other, _Open(time_s, time_s))
        touch.end, touch.force, touch.movable = time_s, max(touch.force, force), movable or touch.movable

    def _close_old(self, robot: _Robot, time_s: float) -> None:
        for other in [other for other, touch in robot.opened.items() if time_s - touch.end > _PAUSE_S]:
            self._close(robot, other)

    def _close(self, robot: _Robot, other: str, *, lasts: bool = False) -> None:
        touch = robot.opened.pop(other)
        robot.closed.append(Touch(robot.name, other, touch.begin, touch.end, touch.force, touch.movable, lasts))

    def touches(self) -> tuple[Touch, ...]:
        """Returns all touches in the order of their beginnings; ends those in progress."""
        for robot in self._robots:
            for other in list(robot.opened):
                self._close(robot, other, lasts=robot.now_s - robot.opened[other].end <= _PAUSE_S)
        return tuple(sorted((touch for robot in self._robots for touch in robot.closed), key=lambda t: (t.begin, t.robot)))


def origin_ns(bag: BagReader) -> int:
    """Returns the log time, ns, from which seconds are counted: 0 in a bag of simulation time, else that of the first message."""
    begin = bag.span_ns[0]
    return begin if begin > _WALL_TIME_NS else 0


def robot_namespaces(infos: Mapping[str, TopicInfo]) -> tuple[str, ...]:
    """Returns the namespaces of the robots of a bag without slashes, by their odometry, ``""`` for one without a namespace.

    A real robot's bag, whose odometry has another name, is that of one robot.
    """
    endings = ("/ground_truth/odom", "/odom")
    topics = [name for name, info in infos.items() if info.type_name == "nav_msgs/msg/Odometry" and info.count]
    namespaces = {topic[: -len(ending)].strip("/") for topic in topics for ending in endings if topic.endswith(ending)}
    # /left/ground_truth/odom ends with /odom, too; beside /odom, /wheel/odom belongs to the same robot.
    names = sorted(name for name in namespaces if not name.endswith("ground_truth"))
    return tuple(names) if names and "" not in names else ("",)


def robot_bodies(bag: BagReader, robots: Iterable[str]) -> dict[str, str]:
    """Returns the name of each robot's body in contacts: the body of the scene that has the child frame of its odometry as a link."""
    infos, bodies = bag.topics(), {name: name for name in robots if name}
    scenes = [name for name, info in infos.items() if info.type_name == "gibson_msgs/msg/Scene" and info.count]
    odometry = [name for name in ("/odom", "/ground_truth/odom") if name in infos and infos[name].count]
    if not scenes or not odometry or "" not in robots:
        return bodies
    frame = bag.first(odometry[0]).child_frame_id
    owners = [link.rpartition("/")[0] for link in bag.first(scenes[0]).links if link.rpartition("/")[2] == frame]
    if len(owners) == 1:
        bodies[""] = owners[0]
    return bodies
