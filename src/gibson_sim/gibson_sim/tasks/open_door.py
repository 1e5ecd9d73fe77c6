"""Open a door by its handle, and go through the doorway."""

from __future__ import annotations

import math

import numpy as np

from gibson_sim.tasks.arm_scripts import Arm, Script, Steps, creep, drive, face, stepped
from gibson_sim.tasks.driving import Driver, pose_xy
from gibson_sim.tasks.episode import Action, Episode, Goal, Item, View
from gibson_sim.tasks.ground import Ground, footprint
from gibson_sim.tasks.placing import free_place, no_room, on_floor
from gibson_sim.tasks.task import Policy, Task, generator
from gibson_sim.types import Vec3

DOOR = "door"
WALL_X, JAMBS = 4.26, (1.75, 2.65)
"""The doorway of scene ``arena``: x of the middle of its wall, y of its two sides, metres."""
HINGE_INSIDE = 0.022
"""Metres from a jamb to the hinge, see docs/objects.md."""
OPEN = math.radians(60.0)
"""A door that is open wider counts as open."""
RADIUS = 0.40
"""Metres: so near to the goal is there."""
AWAY = (1.3, 2.4)
"""Metres of start and goal from the wall."""
_HANDLE = "handle"
_BEFORE = 0.78
"""Metres from the base to the handle where the arm takes it."""
_WIDE = math.radians(95.0)
"""How far a script pulls a door."""
_PULL = 0.12
"""Speed at which it pulls the handle, m/s."""
_LEAD = 0.07
"""Radians that the hand may be ahead of the door: the arm is stiff, and more tears the hand off."""
_SHORT = 0.12
"""Metres from the handle's axis to the tool where it takes hold: nearer, the palm would press against the lever."""
_TRIES = 3
"""Times that it takes the handle anew where it lost it."""


class OpenDoor(Task):
    """The door is closed and opens towards the robot, which starts on either side of it with its hinge left or right."""

    name = "open-door"
    environment = "OpenDoor"
    about = "open a door by its handle and go through; it opens towards the robot"
    scene = "arena"
    robot = "arm_bot"

    def generate(self, seed: int, ground: Ground) -> Episode:
        """Returns the episode of a seed; see ``Task.generate``."""
        if ground.scene.name != "arena":
            raise no_room(self.name, ground, "its doorway is that of scene 'arena'")
        rng = generator(self, seed)
        # The robot is before the wall (side -1) or behind it, the hinge to its left or to its right.
        side, left = (-1.0, 1.0)[int(rng.integers(2))], bool(rng.integers(2))
        hinge_high = left == (side < 0)
        y = JAMBS[1] - HINGE_INSIDE if hinge_high else JAMBS[0] + HINGE_INSIDE
        yaw = -math.pi / 2.0 if hinge_high else math.pi / 2.0
        # A left door opens to +y of its own frame, which has to be the robot's side.
        opens_left = -math.sin(yaw) * side > 0.0
        door = Item(DOOR, "door_90_left" if opens_left else "door_90_right", on_floor(ground, WALL_X, y, yaw))
        xs = ground.floor.centers(np.indices(ground.floor.shape).transpose(1, 2, 0))[..., 0]
        start, goal = (
            free_place(ground, rng, np.asarray((s * (xs - WALL_X) > AWAY[0]) & (s * (xs - WALL_X) < AWAY[1])))
            for s in (side, -side)
        )
        text = f"Open the door and go through it to x = {goal.position[0]:.2f} m, y = {goal.position[1]:.2f} m."
        aim = Goal(text, goal.position, RADIUS, DOOR, "door")
        return Episode(self.name, seed, start, (door,), aim, math.nan, time_limit=120.0)

    def remaining(self, episode: Episode, view: View, ground: Ground) -> float:
        """Returns the straight distance to the goal, metres, and how far the door is from being open, radians, added up."""
        return super().remaining(episode, view, ground) + max(0.0, OPEN - opening(view))

    def scripted(self, episode: Episode, ground: Ground) -> Policy:
        """Returns who takes the handle, pulls the door open by backing up, and drives through."""
        return Script(_Opener(episode, ground).steps)


def opening(view: View) -> float:
    """Returns how far the door is open, radians."""
    hinge, leaf = view.links[f"{DOOR}/world"], view.links[f"{DOOR}/leaf"]
    a, b = np.array(hinge.quat_xyzw), np.array(leaf.quat_xyzw)
    return 2.0 * math.acos(min(1.0, abs(float(a @ b))))


class _Opener:
    def __init__(self, episode: Episode, ground: Ground) -> None:
        self._episode, self._ground, self._arm = episode, ground, Arm(ground.robot)
        self._hinge = np.array(pose_xy(episode.items[0].pose))
        self._side = math.copysign(1.0, episode.start.position[0] - WALL_X)

    def steps(self, view: View) -> Steps:
        """Goes before the handle, takes it, pulls, lets go, goes through."""
        for _ in range(_TRIES):
            view = yield from self._before_handle(view)
            view = yield from self._take(view)
            view = yield from self._pull(view)
            view = yield from creep(view, -0.3, grasp=False)
            if opening(view) > OPEN:
                break
        view = yield from self._arm.move(view, self._arm.named("tucked"))
        return (yield from self._through(view))

    def _before_handle(self, view: View) -> Steps:
        """Stands before the handle, the arm ready."""
        handle = view.links[f"{DOOR}/{_HANDLE}"].position
        if view.distance_to(handle) > _BEFORE + 0.5:
            view = yield from drive(view, Driver(self._ground, (WALL_X + self._side * (_BEFORE + 0.3), handle[1])))
        view = yield from face(view, 0.0 if self._side < 0 else math.pi)
        view = yield from self._arm.move(view, self._arm.named("ready"), grasp=False)
        ahead, _ = view.in_base(handle)
        return (yield from creep(view, ahead - _BEFORE))

    def _take(self, view: View) -> Steps:
        """Brings the hand to the handle and closes it."""
        x, y, z = view.links[f"{DOOR}/{_HANDLE}"].position
        grip: Vec3 = (x + self._side * _SHORT, y, z)
        joints = self._arm.reaching(view, grip)
        if joints is not None:
            view = yield from self._arm.move(view, joints, grasp=False)
        for _ in range(20):
            view = yield Action(grasp=True)
            if view.held:
                break
        return view

    def _pull(self, view: View) -> Steps:
        """Backs up while the hand follows the handle's way about the hinge."""
        x, y, z = self._arm.tool(view).position
        arm = np.array([x, y]) - self._hinge
        radius, first = float(np.linalg.norm(arm)), math.atan2(arm[1], arm[0])
        # Turning towards the side of the robot opens it.
        sense = math.copysign(1.0, arm[1]) * -self._side
        angle, told, reach = 0.0, dict(view.joints), view.in_base((x, y))[0]
        until = view.time + 30.0
        while opening(view) < _WIDE and view.held and view.time < until:
            # The hand may not run away from the door.
            angle = min(angle + 0.1 * _PULL / radius, opening(view) + _LEAD)
            at = first + sense * angle
            point = self._hinge + radius * np.array([math.cos(at), math.sin(at)])
            joints = self._arm.reaching(view, (float(point[0]), float(point[1]), z))
            if joints is not None:
                told = {name: stepped(told[name], position, 0.15) for name, position in joints.items()}
            ahead, left = view.in_base((float(point[0]), float(point[1])))
            linear = max(-0.25, min(0.2, 1.5 * (math.hypot(ahead, left) - reach)))
            # It keeps facing its hand.
            angular = max(-0.4, min(0.4, math.atan2(left, ahead)))
            view = yield Action(linear, angular, joints={n: told[n] for n in (joints or {})}, grasp=True)
        return view

    def _through(self, view: View) -> Steps:
        """Drives to the goal, the leaf of the door being in the way as it stands now."""
        goal = self._episode.goal.position
        assert goal is not None
        leaf = footprint(self._episode.items[0].model, view.links[f"{DOOR}/leaf"])
        driver = Driver(self._ground, goal[:2], obstacles=[leaf], near=RADIUS - 0.05)
        return (yield from drive(view, driver, longest=90.0))
