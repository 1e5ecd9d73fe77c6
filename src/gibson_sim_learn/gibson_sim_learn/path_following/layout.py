"""What stands elsewhere than in the recording, and what stands on the path: drawn for one drive. Pure."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gibson_sim.description.body import BodySpec
from gibson_sim.geometry.rasterise import Grid
from gibson_sim.geometry.transforms import pose_from_xyz_rpy
from gibson_sim.maps.bodies import body_triangles
from gibson_sim.maps.floor_map import FloorMap
from gibson_sim.scenes.spec import SceneSpec
from gibson_sim.tasks.episode import Item, item_body
from gibson_sim.tasks.furnishing import extent
from gibson_sim.tasks.ground import Ground, footprint
from gibson_sim.trials.execution.walking import person_urdf
from gibson_sim.trials.records import Person
from gibson_sim_learn.path_following.cases import START_ROOM
from gibson_sim_learn.path_following.oracle import beside_line, dense, is_passable

F64 = NDArray[np.float64]
THINGS = ("chair_wooden", "stool", "box_cardboard", "basket", "bin_waste", "table_side")
"""Objects that are put where there was none, and on paths."""
PERSON = "person"
_PERSON_SHARE = 0.4
"""Probability that an obstacle is a person."""
_PERSON_RADIUS, _PERSON_HEIGHT = 0.2, 1.7
"""Of the capsule, metres."""
_NEW_SHARE = 0.5
"""Probability that a moved thing is new, where the scene has one that can be moved."""
_ROOM = 0.12
"""Clearance that a moved thing leaves the robot on its path, metres."""
_WAY_ROUND = 0.10
"""Clearance that a way round an obstacle leaves the robot, metres."""
_BESIDE = 2.0
"""Largest distance of a moved thing from the path, metres."""
_FROM_ENDS = 1.0
"""Least distance of an obstacle from the path's ends along it, metres."""
_ACROSS = 0.2
"""Largest distance of an obstacle's middle from the path, metres."""
_TRIES = 80
_LEAST_SIZE = 0.2
"""Things whose bounding box is smaller along all axes are not worth moving, metres."""
_LARGEST_SIZE = 1.2
"""Larger ones stay, metres."""
_HEAVY = ("cabinet", "fridge", "oven", "door", "window")
"""Semantic classes of what stays where it is."""


@dataclass(frozen=True, slots=True)
class Layout:
    """The bodies of a drive, and the map that they make."""

    bodies: tuple[BodySpec, ...]
    """All bodies of the scene, in their places, and those that were added."""
    floor: FloorMap
    """With all that stands on it."""
    moved: tuple[str, ...] = ()
    """Names of bodies that stand elsewhere or are new."""
    obstacles: tuple[str, ...] = ()
    """Names of bodies on the path."""


ThingMaker = Callable[[np.random.Generator, str], Item]
"""Makes a thing at the origin, whose name begins with the text."""


def draw_layout(
    ground: Ground,
    line: ArrayLike,
    moved: int,
    obstacles: int,
    rng: np.random.Generator,
    make_thing: ThingMaker | None = None,
) -> Layout:
    """Returns the bodies of a drive; fewer are moved, and stand on the path, where there is no room for more.

    Args:
        ground: scene, robot and map, see ``path_ground``.
        line: where the path leads, (K, 2), world frame, metres; moved things leave it free.
        moved: number of things that stand elsewhere or are new.
        obstacles: number of things or people on the path, with a way round.
        rng: of the draws; another number of things changes nothing else that is drawn from it.
        make_thing: makes what is new; None = one of ``THINGS``, and on the path also a person.
    """
    first, second = (np.random.default_rng(rng.integers(2**63)) for _ in range(2))
    layout = Layout(ground.scene.bodies, ground.floor)
    mover = _Mover(ground, line, make_thing or usual_thing)
    for k in range(moved):
        layout = mover.move(layout, k, first)
    for k in range(obstacles):
        layout = _obstructed(ground, line, layout, k, second, make_thing or usual_obstacle)
    return layout


class _Mover:
    """Puts things elsewhere."""

    def __init__(self, ground: Ground, line: ArrayLike, make: ThingMaker) -> None:
        self._ground, self._line, self._make = ground, dense(line)[0], make
        self._movable = [body for body in ground.scene.bodies if _is_movable(body, ground)]
        self._near = beside_line(ground.floor, line, _BESIDE)

    def move(self, layout: Layout, number: int, rng: np.random.Generator) -> Layout:
        left = [body for body in self._movable if body.name not in layout.moved]
        is_new = not left or rng.random() < _NEW_SHARE
        if is_new:
            item = self._make(rng, "new")
            body = item_body(replace(item, name=f"{item.name}_{number + 1}"))
            others, floor = layout.bodies, layout.floor
        else:
            body = left[int(rng.integers(len(left)))]
            others = tuple(other for other in layout.bodies if other.name != body.name)
            floor = layout.floor  # where it stood stays blocked on the map: things lean on each other
        outline, height = _outline(body), self._ground.floor.floor_z - _lowest(body)
        cells = np.argwhere(self._near & floor.free)
        for _ in range(_TRIES):
            x, y = (float(c) for c in floor.centers(cells[int(rng.integers(len(cells)))]) + rng.uniform(-0.02, 0.02, 2))
            yaw = float(rng.uniform(-math.pi, math.pi))
            corners = _placed(outline, x, y, yaw)
            covered = Grid(floor.resolution, floor.origin, floor.shape).cover(corners[None])
            if (covered & ~floor.free).any() or not covered.any():
                continue
            filled = replace(floor, occupied=floor.occupied | covered)
            if not self._leaves_the_path(floor, filled):
                continue
            placed = replace(body, start=pose_from_xyz_rpy((x, y, height), (0.0, 0.0, yaw)))
            return replace(layout, bodies=(*others, placed), floor=filled, moved=(*layout.moved, body.name))
        return layout

    def _leaves_the_path(self, before: FloorMap, after: FloorMap) -> bool:
        """Returns whether the path keeps its clearance, or enough, and its beginning enough for a start beside it."""
        radius = self._ground.robot.radius
        least = np.minimum(before.clearance(self._line), radius + _ROOM)
        least[0] = min(float(before.clearance(self._line[0])), radius + START_ROOM)
        return bool((after.clearance(self._line) >= least).all())


def _obstructed(
    ground: Ground, line: ArrayLike, layout: Layout, number: int, rng: np.random.Generator, make: ThingMaker
) -> Layout:
    """Returns the layout with one more thing or person on the path."""
    points, arc = dense(line)
    floor = layout.floor
    item = make(rng, "on_path")
    item = replace(item, name=f"{item.name}_{number + 1}")
    made = item_body(item)
    outline = _outline(made)
    for _ in range(_TRIES):
        k = int(np.searchsorted(arc, rng.uniform(_FROM_ENDS, max(_FROM_ENDS, arc[-1] - _FROM_ENDS))))
        k = min(max(k, 1), len(points) - 1)
        along = (points[k] - points[k - 1]) / max(float(np.linalg.norm(points[k] - points[k - 1])), 1e-9)
        across = float(rng.uniform(-_ACROSS, _ACROSS))
        x, y = float(points[k, 0] - across * along[1]), float(points[k, 1] + across * along[0])
        yaw = float(rng.uniform(-math.pi, math.pi))
        low = 0.0 if item.text else extent(item.model)[0][2]
        pose = pose_from_xyz_rpy((x, y, floor.floor_z - low), (0.0, 0.0, yaw))
        corners = footprint(item.model, pose) if not item.text else _placed(outline, x, y, yaw * (item.model != PERSON))
        covered = Grid(floor.resolution, floor.origin, floor.shape).cover(corners[None])
        if (covered & ~floor.free).any() or not covered.any():
            continue
        filled = replace(floor, occupied=floor.occupied | covered)
        ends = (points[0], points[-1])
        if min(float(filled.clearance(end)) for end in ends) < ground.robot.radius + _WAY_ROUND:
            continue
        if not is_passable(filled, line, ground.robot.radius + _WAY_ROUND):
            continue
        body = replace(made, start=pose)
        return replace(layout, bodies=(*layout.bodies, body), floor=filled, obstacles=(*layout.obstacles, body.name))
    return layout


def usual_thing(rng: np.random.Generator, name: str) -> Item:
    """Returns one of ``THINGS``."""
    model = THINGS[int(rng.integers(len(THINGS)))]
    return Item(f"{name}_{model}", model, pose_from_xyz_rpy((0.0, 0.0, 0.0)))


def usual_obstacle(rng: np.random.Generator, name: str) -> Item:
    """Returns a person, or one of ``THINGS``."""
    if rng.random() >= _PERSON_SHARE:
        return usual_thing(rng, name)
    text = person_urdf(Person(PERSON, (), 0.0, _PERSON_RADIUS, _PERSON_HEIGHT))
    return Item(f"{name}_{PERSON}", PERSON, pose_from_xyz_rpy((0.0, 0.0, 0.0)), text)


def _is_movable(body: BodySpec, ground: Ground) -> bool:
    """Returns whether a body stands on the floor, bears nothing, and is neither tiny nor built in."""
    if body.static or body.semantic_class in _HEAVY or abs(body.start.position[2] - ground.floor.floor_z) > 0.1:
        return False
    corners, _ = body_triangles(SceneSpec("thing", ground.scene.root, "", (), (), bodies=(body,)))
    if not len(corners):
        return False
    low, high = corners.min(axis=0), corners.max(axis=0)
    if not _LEAST_SIZE <= float((high - low).max()) <= _LARGEST_SIZE:
        return False
    above = [other.start.position for other in ground.scene.bodies if other is not body]
    return not any(low[0] <= x <= high[0] and low[1] <= y <= high[1] and z > low[2] + 0.05 for x, y, z in above)


def _own_triangles(body: BodySpec) -> F64:
    """Returns the corners (N, 3) of a body's collision shapes, root frame, metres."""
    alone = replace(body, start=pose_from_xyz_rpy((0.0, 0.0, 0.0)))
    corners, _ = body_triangles(SceneSpec("thing", alone.model.path.parent, "", (), (), bodies=(alone,)))
    return corners


def _outline(body: BodySpec) -> F64:
    """Returns the corners (4, 2) of a body's footprint, root frame, metres, counter-clockwise."""
    corners = _own_triangles(body)
    (x0, y0), (x1, y1) = corners[:, :2].min(axis=0), corners[:, :2].max(axis=0)
    return np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]])


def _lowest(body: BodySpec) -> float:
    """Returns the height of a body's lowest point above its root, metres."""
    return float(_own_triangles(body)[:, 2].min())


def _placed(outline: ArrayLike | Sequence[Sequence[float]], x: float, y: float, yaw: float) -> F64:
    """Returns an outline (4, 2) at a pose, world frame, metres."""
    c, s = math.cos(yaw), math.sin(yaw)
    return np.asarray(np.asarray(outline, dtype=np.float64) @ np.array([[c, s], [-s, c]]) + (x, y))
