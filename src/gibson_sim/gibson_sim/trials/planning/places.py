"""Start and goal of a run: given, or sampled from the free poses of a scene."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gibson_sim.errors import ConfigError, SceneError
from gibson_sim.geometry.transforms import yaw_from_quat
from gibson_sim.maps.free_poses import random_free_poses
from gibson_sim.quoting import quoted
from gibson_sim.trials.planning.seeds import stream
from gibson_sim.trials.planning.site import Site
from gibson_sim.trials.records import PlanarPose
from gibson_sim.trials.scenario.spec import SAMPLED, Sampling

F64 = NDArray[np.float64]
_TRIES = 40
"""Number of starts tried until one has a goal at the right distance."""
_GRID_PATH_RATIO = 1.014
"""Largest ratio of the length of a path on the grid to the length of the same path pulled taut."""
_MIN_DISTANCE = 0.1
"""Least distance between start and goal, metres."""


@dataclass(frozen=True, slots=True)
class Places:
    """Start, goal and shortest path of a run."""

    start: PlanarPose
    goal: PlanarPose
    shortest: float
    """Length of the shortest path, metres."""
    path: F64
    """Corners (K, 2) of the shortest path, map frame, metres."""


class NoPlaceError(ConfigError):
    """No start and goal satisfy a scenario; the message lacks the file. ``key`` is the path of the key."""

    def __init__(self, key: str, message: str) -> None:
        super().__init__(message)
        self.key = key


def choose_places(
    site: Site, start: str, goal: str, sampling: Sampling, seed: int, attempt: int, keys: tuple[str, str]
) -> Places:
    """Returns start, goal and shortest path of a run: given, or sampled.

    Args:
        site: scene and robot.
        start: ``sampled``, a named pose or ``x,y,yaw_deg``.
        goal: given in the same way.
        sampling: limits of the sampling.
        seed: seed of the run.
        attempt: number of the attempt; each attempt samples other places.
        keys: paths of the keys of start and goal.

    Raises:
        NoPlaceError: no start and goal satisfy the limits.
    """
    given = tuple(given_place(site, text, key) for text, key in zip((start, goal), keys, strict=True))
    if given[0] is not None and (problem := site.start_problem(given[0][:2])):
        raise NoPlaceError(keys[0], f"is {quoted(start)}, {problem}")
    if given[0] is not None and given[1] is not None:
        return _between(site, given[0], given[1], keys)
    rng = stream(seed, "places", attempt)
    clearance = max(sampling.clearance, site.space.clearance)
    swung = site.swept_distance < clearance
    region = site.space.largest_region(clearance) & ~swung
    low, high = sampling.path_length
    max_distance = 0.0
    for _ in range(_TRIES):
        fixed = given[0] or given[1]
        first = fixed or _sample(site, rng, clearance, region)
        try:
            distances = site.space.planner.distances(first[:2])
        except SceneError:  # only a given place can be too narrow for the margin
            distances = site.space.planner_of(site.robot.radius).distances(first[:2])
        reachable = region & np.isfinite(distances)
        if fixed is not None and not reachable.any():
            # The given place is in another region, such as a room behind a closed door.
            region = reachable = np.asarray(np.isfinite(distances) & ~swung)
        max_distance = max(max_distance, float(distances[reachable].max(initial=0.0)))
        within = region & (distances >= min(low * _GRID_PATH_RATIO, high)) & (distances <= high)
        if (within & site.floor.inflate(clearance)).any():
            second = _sample(site, rng, clearance, within)
            ends = (first, second) if given[1] is None else (second, first)
            return _between(site, *ends, keys)
        if fixed is not None:
            break
    origin = f"from {quoted(start if given[0] else goal)} " if given[0] or given[1] else ""
    raise NoPlaceError(
        "sampling.path_length",
        f"is {low:g} to {high:g} m, but scene {quoted(site.scene_name)} has no such path {origin}for robot {quoted(site.robot_name)} of radius "
        f"{site.robot.radius:.2f} m, {clearance:.2f} m from obstacles at both ends; the longest path found is {max_distance:.1f} m",
    )


def given_place(site: Site, text: str, key: str) -> PlanarPose | None:
    """Returns the pose that a text gives; None = it is to be sampled.

    Raises:
        NoPlaceError: the robot cannot stand at the pose; with ``key``.
    """
    if text == SAMPLED:
        return None
    try:
        x, y, yaw = site.given_pose(text)
    except ConfigError as error:
        raise NoPlaceError(key, str(error)) from error
    problem = site.place_problem((x, y))
    if problem:
        raise NoPlaceError(key, f"is {quoted(text)}, {problem}")
    return round(x, 6), round(y, 6), round(yaw, 6)


def _sample(site: Site, rng: np.random.Generator, clearance: float, region: NDArray[np.bool_]) -> PlanarPose:
    try:
        (pose,) = random_free_poses(site.floor, 1, rng, clearance=clearance, region=region)
    except SceneError as error:
        raise NoPlaceError(
            "sampling.clearance",
            f"is such that scene {quoted(site.scene_name)} has no place with {clearance:.2f} m around robot {quoted(site.robot_name)}; "
            "give less, or another scene",
        ) from error
    # Resolution of 0.1 mm, exact in JSON.
    return round(pose.position[0], 4), round(pose.position[1], 4), round(yaw_from_quat(pose.quat_xyzw), 5)


def _between(site: Site, start: PlanarPose, goal: PlanarPose, keys: tuple[str, str]) -> Places:
    endpoints = f"{_text(start)} to {_text(goal)} in scene {quoted(site.scene_name)}"
    try:
        shortest, path = site.space.shortest(start[:2], goal[:2])
    except SceneError as error:
        if site.closed_doors_block(start[:2], goal[:2]):
            raise NoPlaceError(
                "obstacles.closed_doors", f"leave no path from {endpoints}; leave one open, or give other places"
            ) from error
        raise NoPlaceError(
            keys[1],
            f"cannot be reached: no path leads from {endpoints} for robot {quoted(site.robot_name)} of radius {site.robot.radius:.2f} m",
        ) from error
    if math.dist(start[:2], goal[:2]) < _MIN_DISTANCE:
        raise NoPlaceError(keys[1], f"is at the start of the run: from {endpoints}; must be {_MIN_DISTANCE:g} m away or more")
    return Places(start, goal, round(shortest, 4), path)


def _text(pose: PlanarPose) -> str:
    return f"({pose[0]:.2f}, {pose[1]:.2f})"
