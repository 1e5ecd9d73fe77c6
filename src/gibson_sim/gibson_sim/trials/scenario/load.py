"""Loads a scenario file and checks it as far as possible without loading scenes and robots."""

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
from gibson_sim.trials.predicates import predicate_problem
from gibson_sim.trials.scenario.keys import ALL, MAX_RUNS, SCENARIO
from gibson_sim.trials.scenario.kinds import Location
from gibson_sim.trials.scenario.spec import Obstacles, Randomisation, Scenario, StackSpec, Verdicts

FOLDER = "trials"
"""Folder below ``config`` with the scenario files that are found by name."""
_MAX_BYTES = 1_000_000
"""Largest size of a scenario file, bytes."""
_PYTHON = ("python", "python3")
"""Program names that stand for the interpreter of this process."""
_MAX_LENGTH = 2000
"""Largest length of a mistake, characters."""
_MAX_LISTED = 3
"""Number of further mistakes whose keys a message names."""


class ScenarioError(ConfigError):
    """A scenario file has mistakes or cannot be satisfied. The message is the first mistake."""

    def __init__(self, file: Path, mistakes: Sequence[str]) -> None:
        self.mistakes = tuple(clipped(f"{file}: {mistake}", _MAX_LENGTH) for mistake in mistakes)
        """All mistakes, one line each."""
        more = [mistake.split(" ", 1)[0].rstrip(":") for mistake in mistakes[1:]]
        keys = ", ".join(more[:_MAX_LISTED]) + (", ..." if len(more) > _MAX_LISTED else "")
        super().__init__(f"{self.mistakes[0]}{f' ({len(more)} more: {keys})' if more else ''}")


def load_scenario(path: str | Path) -> Scenario:
    """Returns the scenario in a file, complete and checked; relative paths in it are relative to its folder.

    Args:
        path: a file, or the name of one under ``config/trials`` of a share folder.

    Raises:
        ScenarioError: a key or a value is not allowed, or a file or program that it names does not exist.
        ConfigError: the file does not exist or is not YAML.
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
    top = Location("", mistakes)
    if not isinstance(document, Mapping):
        if document is None:
            top.note(f"is empty, must be {SCENARIO.allowed}")
        else:
            top.refuse(document, SCENARIO.allowed)
        raise ScenarioError(file, mistakes)
    values = SCENARIO.values(document, top)
    # Files, resources and programs of correct values are checked even if others have mistakes: all are reported together.
    values = _Resolver(file, document, top).resolve(SCENARIO.correct_values(document) if mistakes else values)
    if mistakes:
        raise ScenarioError(file, mistakes)
    return Scenario(file.stem, file, **values)


class _Resolver:
    """Resolves the files, resources and programs that a scenario names."""

    def __init__(self, file: Path, document: Mapping[str, Any], top: Location) -> None:
        """``top``: location of the document, with the mistakes recorded when it was read."""
        self._folder, self._document, self._top = file.parent, document, top
        self._reading_mistakes = tuple(top.mistakes)

    def resolve(self, values: Mapping[str, Any]) -> dict[str, Any]:
        """Returns the values with names that do not depend on the current folder; records those that do not exist.

        Args:
            values: values of the keys of a scenario that the document has, all correct.
        """
        resolvers: dict[str, Callable[[Any], Any]] = {
            "scenes": self._scenes,
            "robots": self._robots,
            "stack": self._stack,
            "obstacles": self._obstacles,
            "randomise": self._randomise,
            "verdicts": self._verdicts,
        }
        resolved = {**values, **{key: resolve(values[key]) for key, resolve in resolvers.items() if key in values}}
        self._check_number_of_runs(resolved)
        self._check_physics(resolved)
        return resolved

    def _had_mistakes(self, *keys: str) -> bool:
        """Returns whether values of these keys had mistakes when they were read."""
        return any(
            mistake.startswith(tuple(f"{key}{end}" for end in " .[")) for key in keys for mistake in self._reading_mistakes
        )

    def _check_number_of_runs(self, values: Mapping[str, Any]) -> None:
        if "runs" not in values or self._had_mistakes("scenes", "robots"):
            return
        robots = len(values.get("robots", ("the default",)))
        runs = len(values["scenes"]) * robots * values["runs"]
        if runs > MAX_RUNS:
            self._top.key("runs").note(
                f"is {values['runs']}, which yields {runs} runs of {len(values['scenes'])} scenes and {robots} robots, "
                f"must be at most {MAX_RUNS} together"
            )

    def _path(self, text: str) -> Path:
        """Returns the path for a text, relative to the folder of the file."""
        return self._folder / os.path.expanduser(text)

    def _locations(self, count: int, *keys: str) -> list[Location]:
        """Returns the locations of the values of a key: a list or a single value."""
        location = self._top
        content: Any = self._document
        for key in keys:
            location, content = location.key(key), content.get(key, {})
        return [location.item(i) if isinstance(content, list) else location for i in range(count)]

    def _scenes(self, given: tuple[str, ...]) -> tuple[str, ...]:
        locations = self._locations(len(given), "scenes")
        if given == (ALL,):
            return tuple(list_scenes())
        known = list_scenes()
        scenes = tuple(self._resolved(text, at, find_scene, known) for text, at in zip(given, locations, strict=True))
        _check_duplicates(scenes, locations)
        return scenes

    def _robots(self, given: tuple[str, ...]) -> tuple[str, ...]:
        locations, known, robots = self._locations(len(given), "robots"), list_robots(), []
        for text, at in zip(given, locations, strict=True):
            if "=" in text or "," in text:
                at.refuse(text, "one robot, which drives alone; give a list to test several in turn")
            else:
                robots.append(self._resolved(text, at, find_robot, known))
        _check_duplicates(robots, locations)
        return tuple(robots)

    def _resolved(self, text: str, at: Location, find: Callable[[str], Path], known: Sequence[str]) -> str:
        """Returns a known name unchanged, and a file or folder as an absolute path."""
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
            at.key("folder").refuse(str(stack.folder), f"a folder; {folder} does not exist")
        program = stack.command[0]
        if program in _PYTHON:
            program = sys.executable
        elif self._had_mistakes("stack.folder", "stack.environment"):
            pass  # where to search it is unknown
        elif "/" in program:
            path = folder / os.path.expanduser(program)
            program = str(path) if program.startswith("~") else program
            if not (is_file(path) and os.access(path, os.X_OK)):
                problem = "cannot be executed" if is_file(path) else "does not exist"
                at.key("command").note(f"is {quoted(' '.join(stack.command))}: {path} {problem}")
        else:
            search = stack.environment.get("PATH", os.environ.get("PATH", os.defpath))
            if shutil.which(program, path=search) is None:
                at.key("command").note(
                    f"is {quoted(' '.join(stack.command))}: the program {quoted(program)} is not found in PATH; install it, source the "
                    "workspace that has it, or give its path"
                )
        # Each rule is a lockstep participant named after its topic.
        topics = [rule.split()[0].strip("/") for rule in stack.lockstep]
        for i, rule_at in enumerate(self._locations(len(topics), "stack", "lockstep")):
            if topics[i] in topics[:i]:
                rule_at.note(
                    f"is {quoted(stack.lockstep[i])}, a second rule for topic {quoted(topics[i])}, must be one rule for each topic"
                )
        return replace(stack, folder=folder, command=(program, *stack.command[1:]))

    def _obstacles(self, obstacles: Obstacles) -> Obstacles:
        if ALL in obstacles.closed_doors and len(obstacles.closed_doors) > 1:
            self._top.key("obstacles").key("closed_doors").note("has both all and names of doors, must have one or the other")
        known = known_objects()
        rules = []
        for rule, location in zip(obstacles.spawn, self._locations(len(obstacles.spawn), "obstacles", "spawn"), strict=True):
            path = self._path(rule.object)
            if rule.object not in known and not (is_file(path) or is_folder(path)):
                hint = nearest(rule.object, known)
                location.key("object").refuse(
                    rule.object, f"a file, or an object of the catalogue, see docs/objects.md{f'; {hint}' if hint else ''}"
                )
            rules.append(rule if rule.object in known else replace(rule, object=os.path.normpath(path)))
        return replace(obstacles, spawn=tuple(rules))

    def _randomise(self, randomise: Randomisation) -> Randomisation:
        text = randomise.looks
        if not text:
            return randomise
        at = self._top.key("randomise").key("looks")
        path = self._path(text)
        try:
            file = path if is_file(path) else find_config(text, "randomisation")
            load_rules(file)
        except (ConfigError, SceneError) as error:
            at.note(f"is {quoted(text)}: {error}")
            return randomise
        return replace(randomise, looks=os.path.normpath(path)) if is_file(path) else randomise

    def _check_physics(self, values: Mapping[str, Any]) -> None:
        if "physics" not in values or "stack" not in values or self._had_mistakes("stack.lockstep"):
            return
        try:
            PhysicsConfig.of(**values["physics"], lockstep=bool(values["stack"].lockstep))
        except ConfigError as error:
            self._top.key("physics").note(f"is not allowed: {error}")

    def _verdicts(self, verdicts: Verdicts) -> Verdicts:
        # A predicate may lie beside the scenario file, as the stack does.
        folders = (str(self._folder), *sys.path)
        locations = self._locations(len(verdicts.predicates), "verdicts", "predicates")
        for text, at in zip(verdicts.predicates, locations, strict=True):
            problem = predicate_problem(text, folders)
            if problem:
                at.note(f"is {quoted(text)}: {problem}")
        return verdicts


def _check_duplicates(values: Sequence[str], locations: Sequence[Location]) -> None:
    for i, (value, at) in enumerate(zip(values, locations, strict=False)):
        if value in values[:i]:
            at.note(f"is {quoted(value)}, which is a duplicate; give each once, and increase runs instead")
