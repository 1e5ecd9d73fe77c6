"""Courses of the trials: two scenes with their doorways, and ten goals each. Independent of ROS.

A doorway is the straight line between the ends of two walls, read off the map of the scene. A trial checks that both ends are
at obstacles and the middle is free.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from gibson_examples.errors import MapError, SettingError
from gibson_examples.geometry import F64, Pose2D, parse_pose
from gibson_examples.grid import Grid, distance_to

JAMB = 0.15
"""Largest distance of a doorway's end from an obstacle of the map, metres."""


@dataclass(frozen=True, slots=True)
class Doorway:
    """An opening between the ends of two walls."""

    name: str
    a: tuple[float, float]
    """One end, map frame, metres."""
    b: tuple[float, float]
    """The other end."""

    @property
    def width(self) -> float:
        """Metres."""
        return math.dist(self.a, self.b)

    def crossed_by(self, track: F64) -> bool:
        """Returns whether a track (N, 2), metres, passes the doorway."""
        a, along = np.asarray(self.a), np.subtract(self.b, self.a)
        offsets = track - a
        side = along[0] * offsets[:, 1] - along[1] * offsets[:, 0]
        fraction = offsets @ along / float(along @ along)
        change = side[1:] * side[:-1] < 0
        between = (fraction[1:] + fraction[:-1]) / 2
        return bool((change & (between > 0) & (between < 1)).any())


@dataclass(frozen=True, slots=True)
class Course:
    """Start and goals in a scene: each goal is the start of the next run."""

    start: str
    """x,y,yaw_deg."""
    doorways: tuple[Doorway, ...]
    goals: tuple[str, ...]
    """x,y,yaw_deg each; at least two doorways are between successive goals."""

    def poses(self) -> list[Pose2D]:
        """Returns the goals as poses in the map frame."""
        return [parse_pose(goal, "goal of a course") for goal in self.goals]

    def check(self, grid: Grid) -> None:
        """Checks that the doorways are openings in this map.

        Raises:
            MapError: a doorway is not.
        """
        distance = distance_to(grid.occupied, grid.resolution)
        for doorway in self.doorways:
            ends = grid.values(distance, [doorway.a, doorway.b], np.inf)
            middle = np.add(doorway.a, doorway.b) / 2
            if ends.max() > JAMB or grid.values(distance, middle, 0.0) < JAMB:
                raise MapError(
                    f"doorway {doorway.name} is none on this map: its ends are {ends[0]:.2f} and {ends[1]:.2f} m from the walls "
                    f"(at most {JAMB}), its middle {grid.values(distance, middle, 0.0):.2f} m; is this the right scene?"
                )


COURSES = {
    "flat": Course(
        start="2.6,7.2,-90",
        doorways=(
            Doorway("bedroom", (2.05, 5.35), (2.85, 5.35)),
            Doorway("study", (7.05, 5.35), (7.85, 5.35)),
            Doorway("living room", (3.65, 3.95), (4.45, 3.95)),
            Doorway("kitchen", (6.05, 3.95), (6.85, 3.95)),
            Doorway("living room to kitchen", (5.2, 1.1), (5.2, 2.25)),
        ),
        goals=(
            "7.4,6.6,90",
            "4.2,2.8,-90",
            "2.8,7.5,90",
            "6.2,2.8,-90",
            "7.0,7.6,180",
            "1.9,0.8,0",
            "2.0,6.0,180",
            "6.1,3.3,90",
            "3.2,6.1,0",
            "8.2,7.2,0",
        ),
    ),
    "small_house": Course(
        start="7.0,-3.0,90",
        doorways=(
            Doorway("bedroom", (-2.48, 0.6), (-2.48, -2.8)),
            Doorway("gym", (-2.4, 3.1), (4.67, 3.1)),
            Doorway("kitchen", (4.67, 1.95), (4.87, -4.4)),
        ),
        goals=(
            "-7.5,-0.5,180",
            "1.5,4.5,90",
            "5.6,2.3,90",
            "-5.5,-3.0,180",
            "-1.5,4.9,0",
            "8.7,0.2,90",
            "-8.8,-2.8,-90",
            "7.0,-1.5,0",
            "2.2,5.0,0",
            "-4.5,2.0,-90",
        ),
    ),
}
"""Scene name -> course."""


def course_of(scene: str) -> Course:
    """Returns the course of a scene, given by name or file.

    Raises:
        SettingError: the scene has no course.
    """
    for name, course in COURSES.items():
        if name in scene:
            return course
    raise SettingError(f"scene {scene!r} has no course, must be one of {', '.join(COURSES)}, or a file with that name")
