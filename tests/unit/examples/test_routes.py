"""The courses of the trials."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest

from gibson_examples.errors import MapError, SettingError
from gibson_examples.geometry import parse_pose
from gibson_examples.judging import Run, initial_error, track_clearance
from gibson_examples.routes import COURSES, Course, Doorway, course_of
from unit.examples.drawing import grid_of

DOOR = Doorway("door", (2.0, 1.0), (2.0, 3.0))


@pytest.mark.parametrize(
    ("track", "crossed"),
    [
        ([(1.0, 2.0), (3.0, 2.0)], True),
        ([(3.0, 2.0), (1.0, 2.5)], True),
        ([(1.0, 4.0), (3.0, 4.0)], False),
        ([(1.0, 2.0), (1.9, 2.0), (1.0, 2.0)], False),
        ([(1.0, 0.0), (1.0, 5.0)], False),
    ],
)
def test_doorway_is_crossed_where_the_track_goes_between_its_ends(track: list[tuple[float, float]], crossed: bool) -> None:
    assert DOOR.crossed_by(np.array(track)) is crossed


def test_doorway_must_have_walls_at_its_ends_and_nothing_between() -> None:
    rows = ["#####.....#####", *["..............."] * 3]
    good = Course("0,0", (Doorway("gap", (0.5, 0.35), (1.0, 0.35)),), ())
    good.check(grid_of(*rows))
    beside = Course("0,0", (Doorway("gap", (0.5, 0.35), (0.75, 0.35)),), ())
    with pytest.raises(MapError, match="doorway gap is none on this map"):
        beside.check(grid_of(*rows))
    with pytest.raises(MapError, match="doorway gap is none on this map"):
        good.check(grid_of("#" * 15, *rows[1:]))


@pytest.mark.parametrize("name", COURSES)
def test_course_has_ten_goals_and_consecutive_ones_are_far_apart(name: str) -> None:
    course = COURSES[name]
    poses = [parse_pose(course.start, "start"), *course.poses()]
    assert len(poses) == 11
    assert min(a.distance(b) for a, b in pairwise(poses)) > 2.0


def test_course_is_found_by_the_file_of_its_scene() -> None:
    assert course_of("/data/worlds/small_house.world") is COURSES["small_house"]
    with pytest.raises(SettingError, match="has no course, must be one of flat, small_house"):
        course_of("garage")


def test_errors_of_initial_poses_are_seeded_and_bounded() -> None:
    errors = [initial_error(3, run) for run in range(200)]
    assert errors == [initial_error(3, run) for run in range(200)]
    assert errors[0] != initial_error(4, 0)
    assert np.std([e.x for e in errors]) == pytest.approx(0.1, rel=0.25)
    assert max(abs(e.x) for e in errors) <= 0.2
    assert max(abs(e.yaw) for e in errors) <= math.radians(10.0) + 1e-12


def test_clearance_of_a_track_is_its_smallest() -> None:
    grid = grid_of("#.........", resolution=1.0)
    clearance, where = track_clearance(grid, np.array([(5.5, 0.5), (2.5, 0.5), (7.5, 0.5)]))
    assert clearance == pytest.approx(1.5)
    assert where == (2.5, 0.5)


def run_with(**changes: object) -> Run:
    values: dict[str, object] = {
        "goal": "1,1,0", "status": "reached 1,1,0", "error": 0.1, "heading_error_deg": 1.0, "clearance": 0.3, "closest": (0.0, 0.0), "length": 9.0,
        "duration": 20.0, "doorways": ("a", "b"), "recoveries": 0, "localisation_error": 0.0, "localisation_error_max": 0.0,
    }  # fmt: skip
    return Run(**{**values, **changes})  # type: ignore[arg-type]


@pytest.mark.parametrize(
    "changes", [{"status": "failed 1,1,0: stuck"}, {"error": 0.26}, {"clearance": 0.17}, {"doorways": ("a",)}]
)
def test_run_counts_only_if_near_untouched_and_through_two_doorways(changes: dict[str, object]) -> None:
    assert run_with().passed
    assert not run_with(**changes).passed
