"""Reads a scenario file, and checks all of it that can be checked without loading scenes and robots."""

from __future__ import annotations

import os
import shutil
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from gibson_sim.config import PhysicsConfig
from gibson_sim.errors import ConfigError, GibsonSimError, SceneError, TextError
from gibson_sim.quoting import clipped, quoted
from gibson_sim.reading import is_file, is_folder, read_yaml_file
from gibson_sim.resources import find_config, find_robot, find_scene, known_objects, list_robots, list_scenes
from gibson_sim.scenes.randomise import load_rules
from gibson_sim.settings import nearest
from gibson_sim.trials.scenario.keys import ALL, MOST_RUNS, SCENARIO
from gibson_sim.trials.scenario.kinds import Place
from gibson_sim.trials.scenario.predicates import wrong_predicate
from gibson_sim.trials.scenario_spec import Obstacles, Scenario, StackSpec, Verdicts

FOLDER = "trials"
"""Folder of ``config`` with the scenario files that are found by name."""
_MAX_BYTES = 1_000_000
"""Largest size of a scenario file."""
_PYTHON = ("python", "python3")
"""Programs of a stack that stand for the interpreter of this process."""
_LONGEST = 2000
"""Characters of a mistake."""
_MOST_LISTED = 3
"""Further mistakes whose places a message names."""


class ScenarioError(ConfigError):
    """A scenario file has mistakes, or cannot be met. The message is the first mistake."""

    def __init__(self, file: Path, mistakes: Sequence[str]) -> None:
        self.mistakes = tuple(clipped(f"{file}: {mistake}", _LONGEST) for mistake in mistakes)
        """All mistakes, one line each."""
        more = [mistake.split(" ", 1)[0].rstrip(":") for mistake in mistakes[1:]]
        named = ", ".join(more[:_MOST_LISTED]) + (", ..." if len(more) > _MOST_LISTED else "")
        super().__init__(f"{self.mistakes[0]}{f' ({len(more)} more: {named})' if more else ''}")


def load_scenario(path: str | Path) -> Scenario:
    """Returns the scenario in a file, complete and checked; relative paths in it are those from its folder.

    Args:
        path: a file, or the name of one under ``config/trials`` of a share folder.

    Raises:
        ScenarioError: a key or a value is wrong, or something that it names is not there.
        ConfigError: there is no such file, or it is no YAML.
    """
    file = Path(os.path.expanduser(path))
    file = (file if is_file(file) else find_config(path, FOLDER)).absolute()
    try:
        document = read_yaml_file(file, _MAX_BYTES)
    except OSError as error:
        raise ConfigError(f"{file}: cannot be read: {error.strerror or error}") from error
    except TextError as error:
        raise ConfigError(f"{file}: {error}") from error
    mistakes: list[str] = []
    top = Place("", mistakes)
    if not isinstance(document, Mapping):
        if document is None:
            top.note(f"is empty, must be {SCENARIO.words}")
        else:
            top.refuse(document, SCENARIO.words)
        raise ScenarioError(file, mistakes)
    values = SCENARIO.values(document, top)
    if mistakes:
        raise ScenarioError(file, mistakes)
    scenario = _Resolver(file, document, top).resolve(Scenario(file.stem, file, **values))
    if mistakes:
        raise ScenarioError(file, mistakes)
    return scenario


class _Resolver:
    """Finds what a scenario names: files, resources, programs."""

    def __init__(self, file: Path, document: Mapping[str, Any], top: Place) -> None:
        self._folder, self._document, self._top = file.parent, document, top

    def resolve(self, scenario: Scenario) -> Scenario:
        """Returns the scenario with names that are found from anywhere; notes what is not there."""
        scenes = self._scenes(scenario.scenes)
        robots = self._robots(scenario.robots)
        runs = len(scenes) * len(robots) * scenario.runs
        if runs > MOST_RUNS:
            self._top.key("runs").note(
                f"is {scenario.runs}, which makes {runs} runs of {len(scenes)} scenes and {len(robots)} robots, "
                f"must be at most {MOST_RUNS} together"
            )
        return replace(
            scenario,
            scenes=scenes,
            robots=robots,
            stack=self._stack(scenario.stack),
            obstacles=self._obstacles(scenario.obstacles),
            randomise=replace(scenario.randomise, looks=self._looks(scenario.randomise.looks)),
            physics=self._physics(scenario),
            verdicts=self._verdicts(scenario.verdicts),
        )

    def _path(self, text: str) -> Path:
        """Returns the path that a text stands for, from the folder of the file."""
        return self._folder / os.path.expanduser(text)

    def _places(self, count: int, *keys: str) -> list[Place]:
        """Returns the places of the values under a key: a list, or one value alone."""
        place = self._top
        content: Any = self._document
        for key in keys:
            place, content = place.key(key), content.get(key, {})
        return [place.item(i) if isinstance(content, list) else place for i in range(count)]

    def _scenes(self, given: tuple[str, ...]) -> tuple[str, ...]:
        places = self._places(len(given), "scenes")
        if given == (ALL,):
            return tuple(list_scenes())
        known = list_scenes()
        out = tuple(self._found(text, at, find_scene, known) for text, at in zip(given, places, strict=True))
        _check_twice(out, places)
        return out

    def _robots(self, given: tuple[str, ...]) -> tuple[str, ...]:
        places, known, out = self._places(len(given), "robots"), list_robots(), []
        for text, at in zip(given, places, strict=True):
            if "=" in text or "," in text:
                at.refuse(text, "one robot, which drives alone; make a list of those that shall take turns")
            else:
                out.append(self._found(text, at, find_robot, known))
        _check_twice(out, places)
        return tuple(out)

    def _found(self, text: str, at: Place, find: Callable[[str], Path], known: Sequence[str]) -> str:
        """Returns a name as it is, and a file or folder as an absolute path."""
        if text in known:
            return text
        path = self._path(text)
        if is_file(path) or is_folder(path):
            return os.path.normpath(path)
        try:
            return str(find(text))
        except GibsonSimError as error:
            at.note(f"is {quoted(text)}: {error}")
            return text

    def _stack(self, stack: StackSpec) -> StackSpec:
        at = self._top.key("stack")
        folder = Path(os.path.normpath(self._path(str(stack.folder))))
        if not is_folder(folder):
            at.key("folder").refuse(str(stack.folder), f"a folder; there is none at {folder}")
        program = stack.command[0]
        if program in _PYTHON:
            program = sys.executable
        elif "/" in program:
            path = folder / os.path.expanduser(program)
            program = str(path) if program.startswith("~") else program
            if not (is_file(path) and os.access(path, os.X_OK)):
                what = "cannot be executed" if is_file(path) else "is not there"
                at.key("command").note(f"is {quoted(' '.join(stack.command))}: {path} {what}")
        else:
            search = stack.environment.get("PATH", os.environ.get("PATH", os.defpath))
            if shutil.which(program, path=search) is None:
                at.key("command").note(
                    f"is {quoted(' '.join(stack.command))}: the program {quoted(program)} is not found in PATH; install it, source the "
                    "workspace that has it, or give its path"
                )
        # Each rule is a participant of lockstep that has the name of its topic.
        topics = [rule.split()[0].strip("/") for rule in stack.lockstep]
        for i, rule_at in enumerate(self._places(len(topics), "stack", "lockstep")):
            if topics[i] in topics[:i]:
                rule_at.note(
                    f"is {quoted(stack.lockstep[i])}, a second rule for topic {quoted(topics[i])}, must be one for each topic"
                )
        return replace(stack, folder=folder, command=(program, *stack.command[1:]))

    def _obstacles(self, obstacles: Obstacles) -> Obstacles:
        if ALL in obstacles.closed_doors and len(obstacles.closed_doors) > 1:
            self._top.key("obstacles").key("closed_doors").note("has all and names of doors, must have one or the other")
        known = known_objects()
        rules = []
        for rule, place in zip(obstacles.spawn, self._places(len(obstacles.spawn), "obstacles", "spawn"), strict=True):
            path = self._path(rule.object)
            if rule.object not in known and not (is_file(path) or is_folder(path)):
                hint = nearest(rule.object, known)
                place.key("object").refuse(
                    rule.object, f"a file, or an object of the catalogue, see docs/objects.md{f'; {hint}' if hint else ''}"
                )
            rules.append(rule if rule.object in known else replace(rule, object=os.path.normpath(path)))
        return replace(obstacles, spawn=tuple(rules))

    def _looks(self, text: str) -> str:
        if not text:
            return text
        at = self._top.key("randomise").key("looks")
        path = self._path(text)
        try:
            found = path if is_file(path) else find_config(text, "randomisation")
            load_rules(found)
        except (ConfigError, SceneError) as error:
            at.note(f"is {quoted(text)}: {error}")
            return text
        return os.path.normpath(path) if is_file(path) else text

    def _physics(self, scenario: Scenario) -> dict[str, Any]:
        try:
            PhysicsConfig(**scenario.physics, lockstep=bool(scenario.stack.lockstep))
        except ConfigError as error:
            self._top.key("physics").note(f"cannot be: {error}")
        return scenario.physics

    def _verdicts(self, verdicts: Verdicts) -> Verdicts:
        # A predicate may lie beside the scenario file, as the stack does.
        folders = (str(self._folder), *sys.path)
        places = self._places(len(verdicts.predicates), "verdicts", "predicates")
        for text, at in zip(verdicts.predicates, places, strict=True):
            wrong = wrong_predicate(text, folders)
            if wrong:
                at.note(f"is {quoted(text)}: {wrong}")
        return verdicts


def _check_twice(values: Sequence[str], places: Sequence[Place]) -> None:
    for i, (value, at) in enumerate(zip(values, places, strict=False)):
        if value in values[:i]:
            at.note(f"is {quoted(value)}, which is there twice; give each once, and more runs")
