"""Find an object of a class: approach it with the object in view."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from gibson_sim.errors import SceneError
from gibson_sim.maps.paths import PathPlanner
from gibson_sim.tasks.episode import Action, Episode, Goal, Item, Observation, item_body, item_root
from gibson_sim.tasks.ground import Ground
from gibson_sim.tasks.placing import TRIES, free_place, no_room, on_floor
from gibson_sim.tasks.scripts.driving import Driver, pose_xy, turn_towards
from gibson_sim.tasks.task import Policy, Task, generator
from gibson_sim.types import Pose

NEAR = 1.0
"""Distance to the object within which it counts as found, metres."""
MODELS = (
    "ball", "basket", "bin_waste", "bottle_wine", "box_cardboard", "chair_wooden", "stool", "teapot", "toy_ball", "vase", "book_stack",
    "table_side",
)  # fmt: skip
DISTRACTORS = 5
"""Number of objects of other classes."""
HIDDEN = 2.0
"""Minimum length of the path from the start to the object, metres."""
_SPACE = 0.35
"""Minimum distance from the centre of an object to walls and furniture, metres."""


class ObjectSearch(Task):
    """Objects of several classes stand on the floor; one of them has the target class, and its position is unknown."""

    name = "object-search"
    environment = "ObjectSearch"
    about = "find an object of a class: be within 1 m of it, with it in view"

    def generate(self, seed: int, ground: Ground) -> Episode:
        """Returns the episode of a seed; see ``Task.generate``."""
        rng = generator(self, seed)
        start = free_place(ground, rng)
        distances = ground.space.planner.distances(pose_xy(start))
        models = _distinct_classes(rng)
        for _ in range(TRIES):
            items = _scatter(ground, rng, models, np.asarray(np.isfinite(distances)))
            if len(items) < len(models):
                continue
            target = items[0]
            xy = pose_xy(target.pose)
            row, column = ground.floor.cells(xy)
            distance = float(distances[row, column])
            if distance >= HIDDEN and math.isfinite(distance) and not ground.sees(start, [xy])[0]:
                name = item_body(target).semantic_class
                article = "an" if name[0] in "aeiou" else "a"
                goal = Goal(f"Find {article} {name.replace('_', ' ')}.", None, NEAR, target.name, name)
                return Episode(self.name, seed, start, items, goal, distance - NEAR, time_limit=180.0)
        raise no_room(self.name, ground, "no object can be placed out of view of the start")

    def remaining(self, episode: Episode, obs: Observation, ground: Ground) -> float:
        """Returns the straight-line distance to the object, metres."""
        return obs.distance_to(_target(episode, obs))

    def succeeded(self, episode: Episode, obs: Observation, ground: Ground) -> bool:
        """Returns whether the object is near and in view."""
        return bool(ground.sees(obs.base, [_target(episode, obs)], NEAR)[0])

    def scripted(self, episode: Episode, ground: Ground) -> Policy:
        """Returns a policy that explores the nearest unseen floor until the object is in view, then drives to it."""
        return _SearchPolicy(episode, ground)


def _target(episode: Episode, obs: Observation) -> tuple[float, float]:
    item = next(item for item in episode.items if item.name == episode.goal.target)
    return pose_xy(obs.links[item_root(item)])


def _distinct_classes(rng: np.random.Generator) -> list[str]:
    """Returns objects of different classes, in random order."""
    by_class: dict[str, str] = {}
    for number in rng.permutation(len(MODELS)):
        model = MODELS[int(number)]
        by_class.setdefault(item_body(Item("any", model, Pose())).semantic_class, model)
    return list(by_class.values())[: DISTRACTORS + 1]


def _scatter(ground: Ground, rng: np.random.Generator, models: list[str], region: NDArray[np.bool_]) -> tuple[Item, ...]:
    """Returns items on free floor at a distance from each other; fewer than ``models`` if there is no room."""
    cells = np.argwhere(region & (ground.floor.distance_to_obstacle >= max(_SPACE, ground.space.clearance)))
    items: list[Item] = []
    for number in rng.permutation(len(cells))[: 20 * len(models)]:
        if len(items) == len(models):
            break
        x, y = ground.floor.centers(cells[number]).tolist()
        if any(math.dist((x, y), pose_xy(other.pose)) < 2.0 * _SPACE for other in items):
            continue
        pose = on_floor(ground, x, y, float(rng.uniform(-math.pi, math.pi)))
        items.append(Item(f"thing_{len(items) + 1}", models[len(items)], pose))
    return tuple(items)


class _SearchPolicy:
    """Drives to the nearest unseen floor, makes a full turn, and repeats; remembers the position of the object once it has been in view."""

    COARSE_M = 0.25
    """Spacing of the floor points that are marked as seen, metres."""
    SPIN_S = 2.0 * math.pi / 1.0
    """Duration of a full turn at 1 rad/s, seconds."""

    def __init__(self, episode: Episode, ground: Ground) -> None:
        self._episode, self._ground = episode, ground
        floor = ground.floor
        step = max(1, round(self.COARSE_M / floor.resolution))
        grid = np.zeros(floor.shape, dtype=bool)
        grid[step // 2 :: step, step // 2 :: step] = True
        self._points = floor.centers(np.argwhere(grid & floor.free & floor.largest_free_region(0.0)))
        self._unseen = np.ones(len(self._points), dtype=bool)
        self._driver: Driver | None = None
        self._spin_until = self.SPIN_S
        self._found: tuple[float, float] | None = None

    def act(self, obs: Observation) -> Action:
        """Returns the next action."""
        self._update_seen(obs)
        if self._found is not None:
            return self._approach(obs, self._found)
        if obs.time < self._spin_until:
            return Action(angular=1.0)
        if self._driver is None:
            self._driver = self._next(obs)
            if self._driver is None:
                return Action(angular=1.0)
        if self._driver.done(obs) or self._driver.blocked:
            self._driver, self._spin_until = None, obs.time + self.SPIN_S
        return self._driver.act(obs) if self._driver else Action(angular=1.0)

    def _update_seen(self, obs: Observation) -> None:
        """Marks the floor points in view as seen, and remembers the position of the object if it is in view."""
        target = _target(self._episode, obs)
        if self._ground.sees(obs.base, [target])[0]:
            if self._found is None:
                self._driver = None
            self._found = target
        unseen = np.flatnonzero(self._unseen)
        self._unseen[unseen[self._ground.sees(obs.base, self._points[unseen])]] = False

    def _next(self, obs: Observation) -> Driver | None:
        """Returns a driver to the nearest unseen floor point; None = no reachable point is unseen."""
        if not self._unseen.any():
            self._unseen[:] = True
        planner: PathPlanner = self._ground.space.planner
        try:
            distances = planner.distances(obs.xy)
        except SceneError:
            return None
        cells = self._ground.floor.cells(self._points[self._unseen])
        unseen_distances = distances[cells[:, 0], cells[:, 1]]
        unseen_distances[unseen_distances < 0.5] = np.inf
        if not np.isfinite(unseen_distances).any():
            self._unseen[:] = False
            return None
        x, y = self._points[self._unseen][int(unseen_distances.argmin())].tolist()
        return Driver(self._ground, (x, y), self._episode.items, near=0.3)

    def _approach(self, obs: Observation, target: tuple[float, float]) -> Action:
        """Drives to the object, then turns to face it."""
        if obs.distance_to(target) < NEAR - 0.1:
            x, y = obs.xy
            return Action(angular=turn_towards(obs, math.atan2(target[1] - y, target[0] - x)))
        if self._driver is None:
            self._driver = Driver(self._ground, target, self._others(), near=NEAR - 0.15)
        return self._driver.act(obs)

    def _others(self) -> tuple[Item, ...]:
        return tuple(item for item in self._episode.items if item.name != self._episode.goal.target)
