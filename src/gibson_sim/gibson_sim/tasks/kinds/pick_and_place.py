"""Take a thing and put it where it is wanted."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from gibson_sim.tasks.episode import Action, Episode, Goal, View, item_body, item_root
from gibson_sim.tasks.furnishing import (
    REACHING,
    STAND,
    Furniture,
    against_a_wall,
    extent,
    height,
    lying,
    middle,
    standing,
    start_before,
)
from gibson_sim.tasks.ground import Ground
from gibson_sim.tasks.kinds.arm_task import ArmTask, hand
from gibson_sim.tasks.placing import TRIES, no_room
from gibson_sim.tasks.scripts.arm import Arm, Script, Steps, creep, wait
from gibson_sim.tasks.scripts.handling import ABOVE, FINGERS, come_near, downwards, go_before, ready, take_from_above
from gibson_sim.tasks.task import Policy, generator
from gibson_sim.types import Vec3

THING = "thing"
THINGS = ("can_soda", "can_food", "cup", "mug", "glass_tumbler", "candle", "fruit_apple", "fruit_orange", "remote_control")
"""What fits between the fingers, and is no taller than a hand holds upright from above."""
SURFACES = ("table_side", "cabinet_drawers", "cabinet_doors")
"""What things are put on: 0.50, 0.72 and 0.76 m high."""
NEAR = 0.03
"""Metres between the middle of the thing and where it shall be: so near is there."""
AT_REST = 0.02
"""m/s: what is slower rests."""
HAND_AWAY = 0.10
"""Metres from the tool to the middle of the thing: nearer, it may still lean on the hand."""
SAME = 1.0 / 3.0
"""Part of the episodes in which both places are on the same surface."""
FROM_EDGE = (0.10, 0.22)
"""Metres from the front edge of a surface to a place on it."""
TO_SIDE = 0.20
"""Metres from the middle of a surface to a place on it, to either side, at most; and ``FROM_EDGE`` from its sides at least."""
APART = 0.15
"""Metres between both places, at least."""
_OVER = 0.08
"""Metres from the top of a thing that stands there to a hand that comes."""
_NEAREST = 0.46
"""Metres from the base to a place: nearer, an arm that points down does not reach it."""
_TRIES = 3
"""Times that a script begins anew."""


class PickAndPlace(ArmTask):
    """The thing stands on a surface, and its place is on another one or on the same."""

    name = "pick-and-place"
    environment = "PickAndPlace"
    about = "take a thing and put it where it is wanted, to within 3 cm"

    def generate(self, seed: int, ground: Ground) -> Episode:
        """Returns the episode of a seed; see ``Task.generate``."""
        Arm(ground.robot)
        rng = generator(self, seed)
        for _ in range(TRIES // 4):
            furniture = _furniture(ground, rng)
            start = start_before(ground, rng, furniture) if furniture else None
            if start is None:
                continue
            model = THINGS[int(rng.integers(len(THINGS)))]
            places = _places(rng, furniture)
            if places is None:
                continue
            place, goal = places
            thing = lying(THING, model, place, float(rng.uniform(-math.pi, math.pi)))
            kind = item_body(thing).semantic_class
            text = f"Put the {kind.replace('_', ' ')} to x = {goal[0]:.2f} m, y = {goal[1]:.2f} m, z = {goal[2]:.2f} m."
            items = (*(one.item for one in furniture), thing)
            return Episode(self.name, seed, start, items, Goal(text, goal, NEAR, THING, kind), math.nan, time_limit=180.0)
        raise no_room(self.name, ground, "no wall has a table before it with free floor for a robot")

    def remaining(self, episode: Episode, view: View, ground: Ground) -> float:
        """Returns how far the thing is from its place, metres, and, while it is not there, how far the hand is from the thing, added up."""
        away = _away(episode, view)
        return away if away <= NEAR else away + math.dist(hand(ground, view), middle(episode.items[-1], view))

    def succeeded(self, episode: Episode, view: View, ground: Ground) -> bool:
        """Returns whether the thing rests at its place, and the hand has let go of it."""
        thing = episode.items[-1]
        rests = view.speeds.get(item_root(thing), 0.0) < AT_REST
        away = math.dist(hand(ground, view), middle(thing, view)) > HAND_AWAY
        return not view.held and rests and away and _away(episode, view) <= NEAR

    def scripted(self, episode: Episode, ground: Ground) -> Policy:
        """Returns who takes the thing from above, carries it, and puts it down."""
        return Script(_Porter(episode, ground).steps)


def _furniture(ground: Ground, rng: np.random.Generator) -> tuple[Furniture, ...]:
    """Returns one or two surfaces: where the thing is, and where it shall be; none where there is no room."""
    count = 1 if rng.random() < SAME else 2
    found: list[Furniture] = []
    for number in range(count):
        model = SURFACES[int(rng.integers(len(SURFACES)))]
        one = against_a_wall(ground, rng, f"surface_{number + 1}", model, found)
        if one is None:
            return ()
        found.append(one)
    return tuple(found)


def _places(rng: np.random.Generator, furniture: Sequence[Furniture]) -> tuple[Vec3, Vec3] | None:
    """Returns where the thing stands and where it shall stand, world metres; None where both found no room."""
    for _ in range(TRIES):
        first = _place(rng, furniture[0])
        # From the middle of a small surface nothing on it is far enough away.
        for _ in range(TRIES):
            second = _place(rng, furniture[-1])
            if math.dist(first, second) >= APART:
                return first, second
    return None


def _place(rng: np.random.Generator, one: Furniture) -> Vec3:
    _, high = extent(one.item.model)
    side = min(TO_SIDE, high[1] - FROM_EDGE[0])
    return one.point(high[0] - float(rng.uniform(*FROM_EDGE)), float(rng.uniform(-side, side)), high[2])


def _away(episode: Episode, view: View) -> float:
    """Returns how far the middle of the thing is from where it shall be, metres."""
    goal, thing = episode.goal.position, episode.items[-1]
    assert goal is not None
    return math.dist(middle(thing, view), (goal[0], goal[1], goal[2] + height(thing.model) / 2.0))


class _Porter:
    """Takes the thing and puts it down, and again where that went wrong."""

    def __init__(self, episode: Episode, ground: Ground) -> None:
        assert episode.goal.position is not None
        self._episode, self._ground, self._arm = episode, ground, Arm(ground.robot)
        self._thing, self._goal = episode.items[-1], episode.goal.position
        self._every = tuple(standing(item) for item in episode.items[:-1])

    def steps(self, view: View) -> Steps:
        """Takes, carries, puts."""
        for _ in range(_TRIES):
            source = min(self._every, key=lambda one: math.dist(one.item.pose.position, middle(self._thing, view)))
            view = yield from self._before(view, source, False)
            view = yield from take_from_above(view, self._arm, self._thing, ABOVE + 0.05)
            if view.held == THING:
                if source is not self._every[-1]:
                    view = yield from creep(view, -REACHING, grasp=True)
                    view = yield from self._before(view, self._every[-1], True)
                view = yield from self._put(view)
            view = yield from creep(view, -REACHING, grasp=False)
            if _away(self._episode, view) <= NEAR:
                break
        return view

    def _before(self, view: View, one: Furniture, grasp: bool) -> Steps:
        """Goes before a surface, the hand above it."""
        view = yield from go_before(view, self._ground, one, self._every, grasp)
        top = one.point(*extent(one.item.model)[1])[2]
        view = yield from ready(
            view, self._arm, top + height(self._thing.model) + _OVER, downwards(view), grasp, low=top + FINGERS
        )
        return (yield from come_near(view, one, STAND - REACHING, grasp))

    def _put(self, view: View) -> Steps:
        """Lowers the thing to its place, and lets go."""
        ahead, _ = view.in_base(self._goal[:2])
        if ahead < _NEAREST:
            view = yield from creep(view, ahead - _NEAREST, grasp=True)
        rotation = downwards(view)
        # Twice above it: on the way the thing may turn a little in the hand.
        for up, speed in ((0.05, 0.15), (0.05, 0.15), (0.003, 0.06)):
            view = yield from self._arm.straight(view, self._over(view, up), rotation, True, speed)
        view = yield from wait(view, 1.0, Action(grasp=False))
        x, y, z = self._arm.tool(view).position
        return (yield from self._arm.straight(view, (x, y, z + ABOVE + height(self._thing.model)), rotation, False, speed=0.08))

    def _over(self, view: View, up: float) -> Vec3:
        """Returns where the tool must be for the thing to be so far above its place, metres."""
        tool, thing = self._arm.tool(view).position, middle(self._thing, view)
        x, y, z = ((g + t - m) for g, t, m in zip(self._goal, tool, thing, strict=True))
        return x, y, z + height(self._thing.model) / 2.0 + up
