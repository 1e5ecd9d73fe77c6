"""Start and goal of a run: given, or drawn from the free poses of a scene."""

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
from gibson_sim.trials.scenario_spec import SAMPLED, Sampling

F64 = NDArray[np.float64]
_TRIES = 40
"""Starts that are tried until one has a goal at the right distance."""
_TOO_LONG = 1.014
"""Length of a path on the grid over that of the same path pulled taut, at most."""
_LEAST_WAY = 0.1
"""Least distance of start and goal, metres."""


@dataclass(frozen=True, slots=True)
class Places:
    """Where a run begins and ends."""

    start: PlanarPose
    goal: PlanarPose
    shortest: float
    """Metres."""
    path: F64
    """Corners (K, 2) of the shortest path, world metres."""


class NoPlaceError(ConfigError):
    """No start and goal fulfil a scenario; the message lacks the file. ``key`` is the path of the key."""

    def __init__(self, key: str, message: str) -> None:
        super().__init__(message)
        self.key = key


def places_of(site: Site, start: str, goal: str, sampling: Sampling, seed: int, attempt: int, keys: tuple[str, str]) -> Places:
    """Returns start and goal of a run.

    Args:
        site: scene and robot.
        start: ``sampled``, a named pose or ``x,y,yaw_deg``.
        goal: the same.
        sampling: limits of what is drawn.
        seed: of the run.
        attempt: another number draws other places.
        keys: paths of the keys of start and goal.

    Raises:
        NoPlaceError: there are none.
    """
    given = tuple(given_place(site, text, key) for text, key in zip((start, goal), keys, strict=True))
    if given[0] is not None and (wrong := site.wrong_start(given[0][:2])):
        raise NoPlaceError(keys[0], f"is {quoted(start)}, {wrong}")
    if given[0] is not None and given[1] is not None:
        return _between(site, given[0], given[1], keys)
    rng = stream(seed, "places", attempt)
    clearance = max(sampling.clearance, site.clearance)
    swung = site.swept_distance < clearance
    region = site.free_region(clearance) & ~swung
    low, high = sampling.path_length
    longest = 0.0
    for _ in range(_TRIES):
        fixed = given[0] or given[1]
        first = fixed or _draw(site, rng, clearance, region)
        try:
            distances = site.planner.distances(first[:2])
        except SceneError:  # only a given place can be too narrow for the margin
            distances = site.planner_of(site.robot.radius).distances(first[:2])
        reachable = region & np.isfinite(distances)
        if fixed is not None and not reachable.any():
            # The given place is in another region, such as a room behind a closed door.
            region = reachable = np.asarray(np.isfinite(distances) & ~swung)
        longest = max(longest, float(distances[reachable].max(initial=0.0)))
        within = region & (distances >= min(low * _TOO_LONG, high)) & (distances <= high)
        if (within & site.floor.inflate(clearance)).any():
            second = _draw(site, rng, clearance, within)
            ends = (first, second) if given[1] is None else (second, first)
            return _between(site, *ends, keys)
        if fixed is not None:
            break
    what = f"from {quoted(start if given[0] else goal)} " if given[0] or given[1] else ""
    raise NoPlaceError(
        "sampling.path_length",
        f"is {low:g} to {high:g} m, but scene {quoted(site.scene_name)} has no such way {what}for robot {quoted(site.robot_name)} of radius "
        f"{site.robot.radius:.2f} m, {clearance:.2f} m from obstacles at both ends; the longest that was found is {longest:.1f} m",
    )


def given_place(site: Site, text: str, key: str) -> PlanarPose | None:
    """Returns the pose of a text; None = it is to be drawn.

    Raises:
        NoPlaceError: the robot cannot stand there; with ``key``.
    """
    if text == SAMPLED:
        return None
    try:
        x, y, yaw = site.given_pose(text)
    except ConfigError as error:
        raise NoPlaceError(key, str(error)) from error
    wrong = site.wrong_place((x, y))
    if wrong:
        raise NoPlaceError(key, f"is {quoted(text)}, {wrong}")
    return round(x, 6), round(y, 6), round(yaw, 6)


def _draw(site: Site, rng: np.random.Generator, clearance: float, region: NDArray[np.bool_]) -> PlanarPose:
    try:
        (pose,) = random_free_poses(site.floor, 1, rng, clearance=clearance, region=region)
    except SceneError as error:
        raise NoPlaceError(
            "sampling.clearance",
            f"is such that scene {quoted(site.scene_name)} has no place with {clearance:.2f} m around robot {quoted(site.robot_name)}; "
            "give less, or another scene",
        ) from error
    # A tenth of a millimetre, and exact in JSON.
    return round(pose.position[0], 4), round(pose.position[1], 4), round(yaw_from_quat(pose.quat_xyzw), 5)


def _between(site: Site, start: PlanarPose, goal: PlanarPose, keys: tuple[str, str]) -> Places:
    way = f"{_text(start)} to {_text(goal)} in scene {quoted(site.scene_name)}"
    try:
        shortest, path = site.shortest(start[:2], goal[:2])
    except SceneError as error:
        if site.doors_cut(start[:2], goal[:2]):
            raise NoPlaceError(
                "obstacles.closed_doors", f"leave no path from {way}; leave one open, or give other places"
            ) from error
        raise NoPlaceError(
            keys[1],
            f"cannot be reached: no path leads from {way} for robot {quoted(site.robot_name)} of radius {site.robot.radius:.2f} m",
        ) from error
    if math.dist(start[:2], goal[:2]) < _LEAST_WAY:
        raise NoPlaceError(keys[1], f"is where the run starts: from {way}; must be {_LEAST_WAY:g} m away or more")
    return Places(start, goal, round(shortest, 4), path)


def _text(pose: PlanarPose) -> str:
    return f"({pose[0]:.2f}, {pose[1]:.2f})"
