"""Open a drawer or a cabinet door by its handle, and fetch the thing that is inside."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gibson_sim.geometry.transforms import Mat4, invert, matrix_from_pose, transform_points
from gibson_sim.tasks.episode import Action, Episode, Goal, Item, View, item_body
from gibson_sim.tasks.furnishing import Furniture, against_a_wall, extent, height, lying, middle, standing, start_before
from gibson_sim.tasks.ground import Ground
from gibson_sim.tasks.kinds.arm_task import ArmTask, hand
from gibson_sim.tasks.placing import TRIES, no_room
from gibson_sim.tasks.scripts.arm import Arm, Script, Steps, creep, face, pointing, wait
from gibson_sim.tasks.scripts.handling import CLOSES_S, come_near, downwards, go_before, grip, ready, take_from_above
from gibson_sim.tasks.task import Policy, generator
from gibson_sim.types import Vec3

CABINET, THING = "cabinet", "thing"
IN_DRAWERS = ("can_soda", "can_food", "cup", "mug", "glass_tumbler", "candle")
ON_SHELVES = ("can_soda", "can_food", "bottle_water", "glass_tumbler", "candle")
"""What fits between the fingers; what stands on a shelf is taken from the front, so it has no handle."""
OPEN_M, OPEN_RAD = 0.20, math.radians(60.0)
"""A drawer, and a door, that is open farther counts as open."""
CLEAR = 0.10
"""Metres from the middle of the thing to the cabinet and its drawer: so far away it is out."""
_BOARD = 0.177
"""Metres from the middle of a cabinet to the back of its fronts; the numbers are those of docs/objects.md."""
_HANDLE_OUT = 0.042
"""Metres from there to the middle of the bars of handles."""
_DRAWERS_Z = (0.075, 0.285, 0.495)
_DRAWER_FLOOR, _DRAWER_DEEP, _DRAWER_HIGH = 0.024, 0.37, 0.204
_DRAWER_HANDLE_Z, _DOOR_HANDLE_Z = 0.131, 0.46
_SHELF_Z, _HINGE_Y, _DOOR_HANDLE_Y = 0.418, 0.40, 0.034
_BEHIND = 0.55
"""Metres that are free behind the place before the cabinet: a robot backs up there."""
_FINGERS = 0.03
"""Metres from the middle of a handle to each finger before they close: the handles of both doors are near to each other."""
_BEFORE = {True: 0.75, False: 0.98}
"""Metres from the base to the handle where the hand takes it, of drawers and of doors."""
_SHORT = {True: 0.014, False: 0.045}
"""Metres from the middle of a bar to the tool: the finger tips are 3 cm ahead of it, a drawer's front 2.4 cm behind the bar. A door turns
against the hand, so that its bar must not be between the fingers.
"""
_PULLED = {True: 0.29, False: math.radians(87.0)}
"""How far a script opens."""
_PULL = 0.10
"""Speed of the handle, m/s."""
_LEAD = 0.07
"""Radians that the hand may be ahead of a door."""
_ASIDE = 0.06
"""Metres that the hand goes away from a door while it lets go."""
_FETCH = 0.72
"""Metres from the base to a thing on a shelf where the hand takes it."""
_TRIES = 3


@dataclass(frozen=True, slots=True)
class Part:
    """A drawer or a door of the cabinet."""

    link: str
    slides: bool
    low: float
    """Drawers: lower edge at the front, metres above the floor."""
    side: float
    """Doors: 1 = the left one, seen from inside, whose hinge is at +y; -1 = the other."""

    @property
    def enough(self) -> float:
        """Metres or radians from which on it counts as open."""
        return OPEN_M if self.slides else OPEN_RAD

    @property
    def handle(self) -> Vec3:
        """Middle of the bar, in the frame of its link."""
        return (
            (_HANDLE_OUT, 0.0, _DRAWER_HANDLE_Z)
            if self.slides
            else (_HANDLE_OUT, self.side * (_DOOR_HANDLE_Y - _HINGE_Y), _DOOR_HANDLE_Z)
        )

    def opening(self, view: View) -> float:
        """Returns how far it is open, metres or radians."""
        T_body_part = invert(matrix_from_pose(view.links[f"{CABINET}/body"])) @ self.pose(view)
        return float(T_body_part[0, 3] - _BOARD) if self.slides else math.atan2(self.side * T_body_part[1, 0], T_body_part[0, 0])

    def pose(self, view: View) -> Mat4:
        """Returns T_world_part."""
        return matrix_from_pose(view.links[f"{CABINET}/{self.link}"])

    def clearance(self, view: View, thing: Item) -> float:
        """Returns how far the middle of a thing is from the box about the closed cabinet and, of a drawer, from that of the drawer, metres."""
        point = middle(thing, view)
        away = _to_box(invert(matrix_from_pose(view.links[f"{CABINET}/body"])), point, *extent(_MODELS[self.slides]))
        if not self.slides:
            return away
        box = (-_DRAWER_DEEP, -0.3, 0.0), (_HANDLE_OUT + 0.006, 0.3, _DRAWER_HIGH)
        return min(away, _to_box(invert(self.pose(view)), point, *box))


_MODELS = {True: "cabinet_drawers", False: "cabinet_doors"}
_PARTS = (
    *(Part(f"drawer_{number}", True, low, 0.0) for number, low in enumerate(_DRAWERS_Z, 1)),
    Part("door_left", False, 0.0, 1.0), Part("door_right", False, 0.0, -1.0),
)  # fmt: skip


class OpenCabinet(ArmTask):
    """One of three drawers, or one of two doors; all are closed, and behind or in one of them is the thing."""

    name = "open-cabinet-and-fetch"
    environment = "OpenCabinet"
    about = "open a drawer or a cabinet door by its handle, and fetch the thing that is inside"

    def generate(self, seed: int, ground: Ground) -> Episode:
        """Returns the episode of a seed; see ``Task.generate``. Even seeds are drawers, odd ones doors."""
        Arm(ground.robot)
        rng = generator(self, seed)
        drawer = seed % 2 == 0
        for _ in range(TRIES // 4):
            cabinet = against_a_wall(ground, rng, CABINET, _MODELS[drawer], beside=0.05 if drawer else 0.20, behind=_BEHIND)
            start = start_before(ground, rng, (cabinet,)) if cabinet else None
            if cabinet is None or start is None:
                continue
            parts = [part for part in _PARTS if part.slides == drawer]
            part = parts[int(rng.integers(len(parts)))]
            thing = _inside(rng, cabinet, part)
            kind = item_body(thing).semantic_class
            text = f"Open {part.link.replace('_', ' ')} of the cabinet and fetch the {kind}."
            goal = Goal(text, thing.pose.position, CLEAR, THING, kind)
            return Episode(self.name, seed, start, (cabinet.item, thing), goal, math.nan, time_limit=180.0)
        raise no_room(self.name, ground, "no wall has a cabinet before it with free floor for a robot that backs up")

    def remaining(self, episode: Episode, view: View, ground: Ground) -> float:
        """Returns how far the drawer or door is from being open, metres or radians, how far the thing is from being out, and how far the
        hand is from a thing that it does not hold, metres, added up.
        """
        part = part_of(episode)
        reach = 0.0 if view.held == THING else math.dist(hand(ground, view), middle(episode.items[1], view))
        return max(0.0, part.enough - part.opening(view)) + max(0.0, CLEAR - part.clearance(view, episode.items[1])) + reach

    def succeeded(self, episode: Episode, view: View, ground: Ground) -> bool:
        """Returns whether the hand holds the thing outside of the cabinet, and the drawer or door is open."""
        part = part_of(episode)
        return view.held == THING and part.opening(view) >= part.enough and part.clearance(view, episode.items[1]) >= CLEAR

    def scripted(self, episode: Episode, ground: Ground) -> Policy:
        """Returns who takes the handle, pulls, lets go, and takes the thing from above or from the front."""
        return Script(_Fetcher(episode, ground).steps)


def part_of(episode: Episode) -> Part:
    """Returns the drawer or door that the thing is behind."""
    cabinet, thing = episode.items
    _, y, z, _ = (invert(matrix_from_pose(cabinet.pose)) @ (*thing.pose.position, 1.0)).tolist()
    slides = cabinet.model == _MODELS[True]
    return min(
        (part for part in _PARTS if part.slides == slides), key=lambda part: (abs(z - _DRAWER_FLOOR - part.low), -part.side * y)
    )


def _inside(rng: np.random.Generator, cabinet: Furniture, part: Part) -> Item:
    """Returns a thing at a random place in a closed drawer, or on the shelf behind a closed door."""
    names = IN_DRAWERS if part.slides else ON_SHELVES
    model, yaw = names[int(rng.integers(len(names)))], float(rng.uniform(-math.pi, math.pi))
    if part.slides:
        x, y, z = _BOARD - float(rng.uniform(0.08, 0.20)), float(rng.uniform(-0.15, 0.15)), part.low + _DRAWER_FLOOR
    else:
        x, y, z = float(rng.uniform(-0.02, 0.10)), part.side * float(rng.uniform(0.12, 0.26)), _SHELF_Z
    return lying(THING, model, cabinet.point(x, y, z), yaw)


def _to_box(T_box_world: Mat4, point: Vec3, low: Vec3, high: Vec3) -> float:
    """Returns how far a world point is from a box, metres; 0 inside."""
    local = transform_points(T_box_world, np.array([point]))[0]
    return float(np.linalg.norm(local - np.clip(local, low, high)))


class _Fetcher:
    """Opens, lets go, goes back, and fetches; and again where the handle slipped away."""

    def __init__(self, episode: Episode, ground: Ground) -> None:
        self._ground, self._arm = ground, Arm(ground.robot)
        self._cabinet, self._thing, self._part = standing(episode.items[0]), episode.items[1], part_of(episode)
        c, s = math.cos(self._cabinet.yaw), math.sin(self._cabinet.yaw)
        self._ahead, self._left = np.array([c, s, 0.0]), np.array([-s, c, 0.0])
        self._level = pointing(self._ahead, self._left)

    def steps(self, view: View) -> Steps:
        """Opens it, and takes the thing."""
        for _ in range(_TRIES):
            view = yield from go_before(view, self._ground, self._cabinet, (self._cabinet,))
            if self._part.opening(view) < self._part.enough:
                view = yield from self._take_handle(view)
                view = yield from (self._draw(view) if self._part.slides else self._swing(view))
                view = yield from (wait(view, 1.0, Action(grasp=False)) if self._part.slides else self._leave_door(view))
                view = yield from creep(view, -0.25, grasp=False)
            if self._part.opening(view) >= self._part.enough:
                # The arm turned the base a little as it pulled; beside an open door there is not much room.
                view = yield from face(view, self._cabinet.yaw, 0.01)
                view = yield from (self._from_drawer(view) if self._part.slides else self._from_shelf(view))
                if view.held == THING:
                    break
            view = yield from creep(view, -0.25, grasp=False)
            view = yield from ready(view, self._arm, self._handle(view)[2], self._level, False)
        return view

    def _handle(self, view: View) -> NDArray[np.float64]:
        return np.asarray(transform_points(self._part.pose(view), np.array([self._part.handle]))[0])

    def _take_handle(self, view: View) -> Steps:
        """Brings the hand to the bar and closes it: its fingers above and below that of a drawer, beside that of a door."""
        slides = self._part.slides
        rotation = pointing(self._ahead, (0.0, 0.0, 1.0) if slides else self._left)
        handle = self._handle(view)
        ready_to_hold = {name: _FINGERS for name in self._arm.fingers}
        view = yield from ready(view, self._arm, float(handle[2]), rotation, low=float(handle[2]))
        view = yield from self._arm.move(view, ready_to_hold, tolerance=0.003)
        ahead, _ = view.in_base(tuple(handle[:2].tolist()))
        view = yield from creep(view, ahead - _BEFORE[slides])
        for back in (0.10, _SHORT[slides]):
            x, y, z = (self._handle(view) - back * self._ahead).tolist()
            view = yield from self._arm.straight(view, (x, y, z), rotation, speed=0.1)
        return (yield from wait(view, CLOSES_S, Action(grasp=True)))

    def _draw(self, view: View) -> Steps:
        """Backs up, the arm being stiff."""
        until = view.time + 8.0
        while view.held and self._part.opening(view) < _PULLED[True] and view.time < until:
            view = yield Action(linear=-_PULL, grasp=True)
        return view

    def _swing(self, view: View) -> Steps:
        """Leads the handle about the hinge; the hand points to the cabinet all the time."""
        body = matrix_from_pose(view.links[f"{CABINET}/body"])
        hinge = transform_points(body, np.array([(_BOARD, self._part.side * _HINGE_Y, 0.0)]))[0]
        begin = np.array(self._arm.tool(view).position) - hinge
        radius, z = float(np.hypot(*begin[:2])), self._arm.tool(view).position[2]
        angle, until = 0.0, view.time + 20.0
        told: Mapping[str, float] = {name: view.joints[name] for name in self._arm.joints}
        while view.held and self._part.opening(view) < _PULLED[False] and view.time < until:
            angle = min(angle + 0.1 * _PULL / radius, self._part.opening(view) + _LEAD)
            c, s = math.cos(self._part.side * angle), math.sin(self._part.side * angle)
            x, y = hinge[0] + c * begin[0] - s * begin[1], hinge[1] + s * begin[0] + c * begin[1]
            told = self._arm.nearer(view, told, np.array([x, y, z]), self._level)
            view = yield Action(joints=told, grasp=True)
        return view

    def _leave_door(self, view: View) -> Steps:
        """Lets go and draws the hand aside from the open door: its fingers, as they open, would push the door back."""
        outwards = self._part.pose(view)[:3, 0]
        x, y, z = (np.array(self._arm.tool(view).position) + _ASIDE * outwards).tolist()
        view = yield from self._arm.straight(view, (x, y, z), self._level, False, speed=0.1)
        return (yield from wait(view, 0.5, Action(grasp=False)))

    def _from_drawer(self, view: View) -> Steps:
        """Takes the thing from above, lifts it out, and backs up."""
        up = self._part.low + _DRAWER_HIGH
        view = yield from ready(view, self._arm, up + 0.12, downwards(view), False, low=grip(self._thing, view)[2])
        view = yield from come_near(view, self._cabinet, 0.33, False, beyond=self._part.opening(view))
        view = yield from take_from_above(view, self._arm, self._thing, up + CLEAR + 0.03 - middle(self._thing, view)[2])
        return (yield from creep(view, -0.25, grasp=view.held == THING))

    def _from_shelf(self, view: View) -> Steps:
        """Takes the thing from the front, and backs up."""
        x, y, z = middle(self._thing, view)
        half = height(self._thing.model) / 2.0
        z += min(max(half, 0.05), 0.08) - half
        _, left = view.in_base((x, y))
        view = yield from ready(view, self._arm, z, self._level, False, low=z, left=left)
        ahead, _ = view.in_base((x, y))
        view = yield from creep(view, ahead - _FETCH, grasp=False)
        for back in (0.15, 0.0):
            px, py, _ = (np.array([x, y, z]) - back * self._ahead).tolist()
            view = yield from self._arm.straight(view, (px, py, z), self._level, False, speed=0.1)
        view = yield from wait(view, CLOSES_S, Action(grasp=True))
        x, y, z = self._arm.tool(view).position
        view = yield from self._arm.straight(view, (x, y, z + 0.03), self._level, True, speed=0.08)
        return (yield from creep(view, -0.45, grasp=True))
