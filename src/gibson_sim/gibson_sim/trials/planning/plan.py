"""Plans the runs of a scenario: samples the values of each run for each scene, robot and number.

Equal scenarios give plans that are equal bit for bit. The seed of a run depends on the scenario's seed, the scene, the robot and the run's number
among the runs of both, so that further scenes, robots or runs do not change the other runs.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Collection, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from gibson_sim.errors import ConfigError, GibsonSimError
from gibson_sim.maps.floor_map import FloorMap
from gibson_sim.maps.placement import furnished_floor_map
from gibson_sim.quoting import quoted
from gibson_sim.robots.load import load_robot
from gibson_sim.robots.spec import RobotSpec
from gibson_sim.scenes.load import load_scene
from gibson_sim.trials.planning.obstacles import NoRoomError, place_obstacles
from gibson_sim.trials.planning.places import NoPlaceError, choose_places, given_place
from gibson_sim.trials.planning.robots import VariedRobot, check_variants, ranges_of
from gibson_sim.trials.planning.seeds import seed_of, stream
from gibson_sim.trials.planning.site import Bools, Site, swept_door_cells, with_closed_doors
from gibson_sim.trials.records import PlanarPose, RunSpec
from gibson_sim.trials.scenario.load import ScenarioError
from gibson_sim.trials.scenario.spec import SAMPLED, InitialPose, Scenario

_ATTEMPTS = 20
"""Number of starts and goals sampled for a run until there is room for its obstacles."""
_MAX_SIGMAS = 2.0
"""Largest error of the initial pose estimate, standard deviations."""


def plan_runs(
    scenario: Scenario, numbers: Collection[int] = (), on_progress: Callable[[int, int], None] = lambda done, total: None
) -> tuple[RunSpec, ...]:
    """Returns the runs, numbered from 0, starting with those of the first scene and robot.

    Args:
        scenario: scenario of the trial.
        numbers: numbers of the requested runs; empty = all. Other runs are not planned, and scenes without a requested run are not loaded.
        on_progress: called with the number of planned runs and of requested runs.

    Raises:
        ScenarioError: the scenario cannot be satisfied, such as a goal inside a wall; the message names the key.
        ConfigError: a number is not that of a run.
    """
    runs_per_scene = len(scenario.robots) * scenario.runs
    requested = _requested(numbers, len(scenario.scenes) * runs_per_scene)
    robots = [_robot(scenario, k) for k in range(len(scenario.robots))]
    varied = {name: variants for name, (_, variants) in zip(scenario.robots, robots, strict=True)}
    runs: list[RunSpec] = []
    on_progress(0, len(requested))
    for number, name in enumerate(scenario.scenes):
        in_scene = [k for k in requested if k // runs_per_scene == number]
        if not in_scene:
            continue
        sites = _sites(scenario, number, [spec for spec, _ in robots])
        _check_given(scenario, sites)
        for k in in_scene:
            site = sites[k % runs_per_scene // scenario.runs]
            runs.append(replace(_run(scenario, site, varied[site.robot_name], k % scenario.runs, name), number=k))
            on_progress(len(runs), len(requested))
    return tuple(runs)


def _requested(numbers: Collection[int], total: int) -> list[int]:
    """Returns the numbers of the runs to plan, in order.

    Raises:
        ConfigError: a run does not exist.
    """
    for number in numbers:
        if not 0 <= number < total:
            raise ConfigError(f"run {number} does not exist; the plan has runs 0 to {total - 1}")
    return sorted(set(numbers)) if numbers else list(range(total))


def _check_given(scenario: Scenario, sites: Sequence[Site]) -> None:
    """Checks all given starts and goals that a run uses, before any other is sampled.

    Raises:
        ScenarioError: the robot cannot stand at some of them; the error lists all of these.
    """
    mistakes = []
    for site in sites:
        for key, given in (("starts", scenario.starts), ("goals", scenario.goals)):
            for k, text in enumerate(given[: scenario.runs]):
                try:
                    given_place(site, text, _key(key, k, given))
                except NoPlaceError as error:
                    mistakes.append(f"{error.key} {error}")
    if mistakes:
        raise ScenarioError(scenario.path, list(dict.fromkeys(mistakes)))


def _robot(scenario: Scenario, number: int) -> tuple[RobotSpec, VariedRobot | None]:
    """Returns a robot and its variants; None = the robot is the same in all runs."""
    name, key = scenario.robots[number], _key("robots", number, scenario.robots)
    try:
        robot = load_robot(name)
    except GibsonSimError as error:
        raise _error(scenario, f"{key} is {quoted(name)}: {error}") from error
    if robot.drive is None:
        raise _error(scenario, f"{key} is {quoted(name)}, which has no drive; must be a robot that can drive to a goal")
    ranges = ranges_of(scenario.randomise)
    if not ranges:
        return robot, None
    try:
        varied = VariedRobot(name)
        check_variants(varied, ranges)
    except ConfigError as error:
        raise _error(scenario, f"{error} ({key} is {quoted(name)})") from error
    except GibsonSimError as error:
        raise _error(scenario, f"{key} is {quoted(name)}: {error}") from error
    return robot, varied


def _sites(scenario: Scenario, number: int, robots: Sequence[RobotSpec]) -> list[Site]:
    """Returns one site for each robot in a scene; robots of equal height share a map."""
    name, key = scenario.scenes[number], _key("scenes", number, scenario.scenes)
    try:
        scene = load_scene(name)
    except GibsonSimError as error:
        raise _error(scenario, f"{key} is {quoted(name)}: {error}") from error
    try:
        closed, doors = with_closed_doors(scene, scenario.obstacles.closed_doors)
    except ConfigError as error:
        raise _error(scenario, f"obstacles.closed_doors {error}") from error
    maps: dict[float, tuple[FloorMap, Bools | None]] = {}
    sites = []
    for robot_name, robot in zip(scenario.robots, robots, strict=True):
        try:
            if robot.height not in maps:
                swept = swept_door_cells(scene, doors, robot) if doors else None
                maps[robot.height] = furnished_floor_map(closed, robot), swept
        except GibsonSimError as error:
            raise _error(scenario, f"{key} is {quoted(name)}: {error}") from error
        floor, swept = maps[robot.height]
        sites.append(Site(name, robot_name, closed, robot, floor, scene, doors, swept))
    return sites


def _run(scenario: Scenario, site: Site, varied: VariedRobot | None, number: int, scene: str) -> RunSpec:
    """Returns a run; ``number`` counts the runs of this scene and robot."""
    seed = seed_of(scenario.seed, _identity(scenario, scene), _identity(scenario, site.robot_name), number)
    s, g = number % len(scenario.starts), number % len(scenario.goals)
    start, goal = scenario.starts[s], scenario.goals[g]
    keys = (_key("starts", s, scenario.starts), _key("goals", g, scenario.goals))
    attempts = _ATTEMPTS if SAMPLED in (start, goal) else 1
    for attempt in range(attempts):
        try:
            places = choose_places(site, start, goal, scenario.sampling, seed, attempt, keys)
            places, objects, people = place_obstacles(site, places, scenario.obstacles, seed, attempt)
            break
        except NoRoomError as error:
            if attempt == attempts - 1:
                raise _error(scenario, f"{error.key} {error}") from error
        except NoPlaceError as error:
            raise _error(scenario, f"{error.key} {error}") from error
    drawn = {
        name: round(float(stream(seed, "drawn", name).uniform(*limits)), 6)
        for name, limits in (ranges_of(scenario.randomise).items() if varied else ())
    }
    physics: dict[str, Any] = dict(scenario.physics)
    if scenario.randomise.looks:
        physics |= {"randomise": scenario.randomise.looks, "randomise_seed": seed_of(seed, "looks")}
    return RunSpec(
        number=number,
        scene=scene,
        robot=varied.file if varied else site.robot_name,
        seed=seed,
        start=places.start,
        goal=places.goal,
        shortest=places.shortest,
        radius=round(site.robot.radius, 6),
        initial_error=_initial_error(scenario.stack.initial_pose, seed),
        things=objects,
        closed_doors=site.closed_doors,
        people=people,
        physics=physics,
        drawn=drawn,
        files=varied.files(drawn) if varied else {},
    )


def _initial_error(given: InitialPose, seed: int) -> PlanarPose:
    x, y, yaw = np.clip(stream(seed, "initial_pose").standard_normal(3), -_MAX_SIGMAS, _MAX_SIGMAS).tolist()
    # Adding 0.0 removes negative zeros, which JSON would show.
    x, y, yaw = (
        round(float(v), 6) + 0.0 for v in (x * given.error_xy, y * given.error_xy, yaw * math.radians(given.error_yaw_deg))
    )
    return x, y, yaw


def _identity(scenario: Scenario, name: str) -> str:
    """Returns the name of a scene or robot for seeds: its name, or its path relative to the scenario's file, so that folders can move."""
    return os.path.relpath(name, scenario.path.parent) if Path(name).is_absolute() else name


def _key(key: str, number: int, values: Sequence[str]) -> str:
    return f"{key}[{number}]" if len(values) > 1 else key


def _error(scenario: Scenario, mistake: str) -> ScenarioError:
    return ScenarioError(scenario.path, [mistake])
