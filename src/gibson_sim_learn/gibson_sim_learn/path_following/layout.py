"""Layout of one drive: objects moved since the recording, and obstacles on the path. Pure."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gibson_sim.description.body import BodySpec
from gibson_sim.geometry.transforms import pose_from_xyz_rpy
from gibson_sim.maps.bodies import body_triangles
from gibson_sim.maps.floor_map import FloorMap
from gibson_sim.scenes.spec import SceneSpec
from gibson_sim.tasks.episode import Item, item_body
from gibson_sim.tasks.furnishing import extent
from gibson_sim.tasks.ground import Ground, footprint
from gibson_sim.trials.execution.walking import person_urdf
from gibson_sim.trials.records import Person
from gibson_sim_learn.path_following.cases import START_CLEARANCE
from gibson_sim_learn.path_following.oracle import is_passable, near_line, resampled

F64 = NDArray[np.float64]
OBJECT_MODELS = ("chair_wooden", "stool", "box_cardboard", "basket", "bin_waste", "table_side")
"""Models of added objects, and of obstacles."""
PERSON = "person"
_PERSON_SHARE = 0.4
"""Probability that an obstacle is a person."""
_PERSON_RADIUS, _PERSON_HEIGHT = 0.2, 1.7
"""Radius and height of the capsule, metres."""
_ADDED_SHARE = 0.5
"""Probability that a moved object is an added one, where the scene has one that can be moved."""
_PATH_CLEARANCE = 0.12
"""Least clearance of the robot on the path from a moved object, metres."""
_DETOUR_CLEARANCE = 0.10
"""Least clearance of the robot on a detour around an obstacle, metres."""
_MAX_DISTANCE = 2.0
"""Largest distance of a moved object from the path, metres."""
_FROM_ENDS = 1.0
"""Least distance along the path of an obstacle from its ends, metres."""
_MAX_OFFSET = 0.2
"""Largest lateral offset of an obstacle's centre from the path, metres."""
_ATTEMPTS = 80
"""Random poses that are tried for an object."""
_MIN_SIZE = 0.2
"""Largest edge of the bounding box below which an object is not moved, metres."""
_MAX_SIZE = 1.2
"""Largest edge of the bounding box above which an object is not moved, metres."""
_HEAVY = ("cabinet", "fridge", "oven", "door", "window")
"""Semantic classes of objects that are not moved."""


@dataclass(frozen=True, slots=True)
class Layout:
    """Bodies of a drive, and the map with them."""

    bodies: tuple[BodySpec, ...]
    """Bodies of the scene at their poses, and added ones."""
    floor: FloorMap
    """Map of the floor with all bodies."""
    moved: tuple[str, ...] = ()
    """Names of bodies that were moved or added since the recording."""
    obstacles: tuple[str, ...] = ()
    """Names of bodies on the path."""


ItemMaker = Callable[[np.random.Generator, str], Item]
"""Returns an item at the origin; its name begins with the text."""


def draw_layout(
    ground: Ground,
    line: ArrayLike,
    moved: int,
    obstacles: int,
    rng: np.random.Generator,
    make_item: ItemMaker | None = None,
) -> Layout:
    """Returns the layout of a drive; it has fewer moved objects and obstacles where there is no room for more.

    Args:
        ground: scene, robot and map, see ``path_ground``.
        line: corners (K, 2) of the path, world frame, metres; moved objects keep their clearance from it.
        moved: number of objects that are moved or added.
        obstacles: number of obstacles, objects or people, on the path, with a detour around them.
        rng: of the draws; the counts do not change what else is drawn from it.
        make_item: returns added objects and obstacles; None = one of ``OBJECT_MODELS``, and for obstacles also a person.
    """
    first, second = (np.random.default_rng(rng.integers(2**63)) for _ in range(2))
    layout = Layout(ground.scene.bodies, ground.floor)
    mover = _ObjectMover(ground, line, make_item or table2_object)
    for k in range(moved):
        layout = mover.move(layout, k, first)
    for k in range(obstacles):
        layout = _with_obstacle(ground, line, layout, k, second, make_item or table2_obstacle)
    return layout


class _ObjectMover:
    """Moves or adds objects near the path."""

    def __init__(self, ground: Ground, line: ArrayLike, make: ItemMaker) -> None:
        self._ground, self._line, self._make = ground, resampled(line)[0], make
        self._movable = [body for body in ground.scene.bodies if _is_movable(body, ground)]
        self._near = near_line(ground.floor, line, _MAX_DISTANCE)

    def move(self, layout: Layout, number: int, rng: np.random.Generator) -> Layout:
        """Returns the layout with one more object moved or added; ``number``: of the object, for its name."""
        candidates = [body for body in self._movable if body.name not in layout.moved]
        is_added = not candidates or rng.random() < _ADDED_SHARE
        if is_added:
            item = self._make(rng, "new")
            body = item_body(replace(item, name=f"{item.name}_{number + 1}"))
            others, floor = layout.bodies, layout.floor
        else:
            body = candidates[int(rng.integers(len(candidates)))]
            others = tuple(other for other in layout.bodies if other.name != body.name)
            floor = layout.floor  # its old place stays occupied on the map: objects lean on each other
        outline, height = _outline(body), self._ground.floor.floor_z - _lowest(body)
        cells = np.argwhere(self._near & floor.free)
        for _ in range(_ATTEMPTS):
            x, y = (float(c) for c in floor.centers(cells[int(rng.integers(len(cells)))]) + rng.uniform(-0.02, 0.02, 2))
            yaw = float(rng.uniform(-math.pi, math.pi))
            corners = _placed(outline, x, y, yaw)
            covered = floor.grid.cover(corners[None])
            if (covered & ~floor.free).any() or not covered.any():
                continue
            filled = replace(floor, occupied=floor.occupied | covered)
            if not self._keeps_clearance(floor, filled):
                continue
            placed = replace(body, start=pose_from_xyz_rpy((x, y, height), (0.0, 0.0, yaw)))
            return replace(layout, bodies=(*others, placed), floor=filled, moved=(*layout.moved, body.name))
        return layout

    def _keeps_clearance(self, before: FloorMap, after: FloorMap) -> bool:
        """Returns whether the path keeps its clearance, or ``_PATH_CLEARANCE``, and its beginning enough for a start beside it."""
        radius = self._ground.robot.radius
        least = np.minimum(before.clearance(self._line), radius + _PATH_CLEARANCE)
        least[0] = min(float(before.clearance(self._line[0])), radius + START_CLEARANCE)
        return bool((after.clearance(self._line) >= least).all())


def _with_obstacle(
    ground: Ground, line: ArrayLike, layout: Layout, number: int, rng: np.random.Generator, make: ItemMaker
) -> Layout:
    """Returns the layout with one more obstacle on the path; ``number``: of the obstacle, for its name."""
    points, arc = resampled(line)
    floor = layout.floor
    item = make(rng, "on_path")
    item = replace(item, name=f"{item.name}_{number + 1}")
    made = item_body(item)
    outline = _outline(made)
    for _ in range(_ATTEMPTS):
        k = int(np.searchsorted(arc, rng.uniform(_FROM_ENDS, max(_FROM_ENDS, arc[-1] - _FROM_ENDS))))
        k = min(max(k, 1), len(points) - 1)
        along = (points[k] - points[k - 1]) / max(float(np.linalg.norm(points[k] - points[k - 1])), 1e-9)
        across = float(rng.uniform(-_MAX_OFFSET, _MAX_OFFSET))
        x, y = float(points[k, 0] - across * along[1]), float(points[k, 1] + across * along[0])
        yaw = float(rng.uniform(-math.pi, math.pi))
        low = 0.0 if item.text else extent(item.model)[0][2]
        pose = pose_from_xyz_rpy((x, y, floor.floor_z - low), (0.0, 0.0, yaw))
        corners = footprint(item.model, pose) if not item.text else _placed(outline, x, y, yaw * (item.model != PERSON))
        covered = floor.grid.cover(corners[None])
        if (covered & ~floor.free).any() or not covered.any():
            continue
        filled = replace(floor, occupied=floor.occupied | covered)
        ends = (points[0], points[-1])
        if min(float(filled.clearance(end)) for end in ends) < ground.robot.radius + _DETOUR_CLEARANCE:
            continue
        if not is_passable(filled, line, ground.robot.radius + _DETOUR_CLEARANCE):
            continue
        body = replace(made, start=pose)
        return replace(layout, bodies=(*layout.bodies, body), floor=filled, obstacles=(*layout.obstacles, body.name))
    return layout


def table2_object(rng: np.random.Generator, name: str) -> Item:
    """Returns one of ``OBJECT_MODELS``."""
    model = OBJECT_MODELS[int(rng.integers(len(OBJECT_MODELS)))]
    return Item(f"{name}_{model}", model, pose_from_xyz_rpy((0.0, 0.0, 0.0)))


def table2_obstacle(rng: np.random.Generator, name: str) -> Item:
    """Returns a person, or one of ``OBJECT_MODELS``."""
    if rng.random() >= _PERSON_SHARE:
        return table2_object(rng, name)
    text = person_urdf(Person(PERSON, (), 0.0, _PERSON_RADIUS, _PERSON_HEIGHT))
    return Item(f"{name}_{PERSON}", PERSON, pose_from_xyz_rpy((0.0, 0.0, 0.0)), text)


def _is_movable(body: BodySpec, ground: Ground) -> bool:
    """Returns whether a body can be moved: it stands on the floor, supports nothing, and is neither tiny nor built in."""
    if body.static or body.semantic_class in _HEAVY or abs(body.start.position[2] - ground.floor.floor_z) > 0.1:
        return False
    corners, _ = body_triangles(SceneSpec("object", ground.scene.root, "", (), (), bodies=(body,)))
    if not len(corners):
        return False
    low, high = corners.min(axis=0), corners.max(axis=0)
    if not _MIN_SIZE <= float((high - low).max()) <= _MAX_SIZE:
        return False
    above = [other.start.position for other in ground.scene.bodies if other is not body]
    return not any(low[0] <= x <= high[0] and low[1] <= y <= high[1] and z > low[2] + 0.05 for x, y, z in above)


def _own_triangles(body: BodySpec) -> F64:
    """Returns the vertices (N, 3) of a body's collision shapes, root frame, metres."""
    alone = replace(body, start=pose_from_xyz_rpy((0.0, 0.0, 0.0)))
    corners, _ = body_triangles(SceneSpec("object", alone.model.path.parent, "", (), (), bodies=(alone,)))
    return corners


def _outline(body: BodySpec) -> F64:
    """Returns the corners (4, 2) of a body's footprint, root frame, metres, counter-clockwise."""
    corners = _own_triangles(body)
    (x0, y0), (x1, y1) = corners[:, :2].min(axis=0), corners[:, :2].max(axis=0)
    return np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]])


def _lowest(body: BodySpec) -> float:
    """Returns z of a body's lowest point, root frame, metres."""
    return float(_own_triangles(body)[:, 2].min())


def _placed(outline: ArrayLike | Sequence[Sequence[float]], x: float, y: float, yaw: float) -> F64:
    """Returns an outline (4, 2), root frame, at a pose x, y, yaw, world frame, metres and radians: (4, 2), world frame."""
    c, s = math.cos(yaw), math.sin(yaw)
    return np.asarray(np.asarray(outline, dtype=np.float64) @ np.array([[c, s], [-s, c]]) + (x, y))
