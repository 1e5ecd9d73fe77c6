"""The JSON schema of scenario files: it is the file in ``config``, its keys are those of the loader, and both refuse the same."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any, get_args, get_type_hints

import pytest
import yaml

from gibson_sim.config import PhysicsConfig
from gibson_sim.settings import setting_fields
from gibson_sim.trials.scenario.keys import SCENARIO, SET_BY_TRIAL, schema, schema_text
from gibson_sim.trials.scenario.kinds import Location
from gibson_sim.trials.scenario.load import load_scenario
from gibson_sim.trials.scenario.spec import GoalInterface, Scenario

CONFIG = Path(__file__).parents[3] / "config"
WHOLE = """
scenes: [flat, arena]
robots: [gibson_bot]
runs: 3
seed: 4
starts: [sampled]
goals: ['1,2,90', sampled]
sampling: {path_length: [3, 9], clearance: 0.4}
obstacles:
  spawn: [{object: mug, count: 2, at: path}]
  closed_doors: [all]
  people: [{path: [[1, 2], [3, 4]], speed: 1, radius: 0.3, height: 1.8}]
randomise: {looks: example, slip: 0.1, noise: [1, 2], latency: 0.1, friction: [0.5, 1], payload: 1}
physics: {rate: 2.0, step_hz: 480, map: 'on', views: follow, publish_map_tf: true}
limits: {time: 60, wall_time: 100, silence: 5}
record: {images: none, keep: all}
verdicts:
  reached: {within: 0.3, yaw_within_deg: 10}
  collisions: 0
  clearance: 0.1
  stay_within: [{name: room, corners: [[0, 0], [9, 0], [0, 9]]}]
  stay_out_of: [{name: hole, corners: [[0, 0], [9, 0], [0, 9]]}]
  path_ratio: 2
  time: 50
  max_acceleration: 2
  rates: [{topic: scan, least: 9}]
  alive: true
  predicates: ['json:loads']
stack:
  command: [python, -m, stack]
  environment: {A: b}
  folder: .
  restart: each
  ready: {topic: a, service: b, node: c, within: 10}
  initial_pose: {topic: initialpose, sigma_xy: 0.1, sigma_yaw_deg: 5, error_xy: 0.1, error_yaw_deg: 3}
  goal: {action: go, type: a_msgs/action/Go, field: pose}
  status: {topic: status, reached: there, failed: 'no+'}
  lockstep: [cmd_vel after odom]
"""
"""Every key of the schema once, but for settings of physics and other ways to give a goal."""
Steps = tuple[str | int, ...]
"""Path of a value in a document."""


def is_valid(value: Any, form: dict[str, Any]) -> bool:
    """Returns whether a value fulfils a schema: all keywords that ours has."""
    checks: dict[str, Callable[[Any], bool]] = {
        "anyOf": lambda forms: any(is_valid(value, one) for one in forms),
        "not": lambda one: not is_valid(value, one),
        "const": lambda constant: value == constant,
        "enum": lambda values: value in values,
        "type": lambda types: any(_is_type(value, name) for name in ([types] if isinstance(types, str) else types)),
        "minimum": lambda limit: not _is_type(value, "number") or value >= limit,
        "maximum": lambda limit: not _is_type(value, "number") or value <= limit,
        "minLength": lambda limit: not isinstance(value, str) or len(value) >= limit,
        "maxLength": lambda limit: not isinstance(value, str) or len(value) <= limit,
        "pattern": lambda pattern: not isinstance(value, str) or re.search(pattern, value) is not None,
        "minItems": lambda limit: not isinstance(value, list) or len(value) >= limit,
        "maxItems": lambda limit: not isinstance(value, list) or len(value) <= limit,
        "items": lambda one: not isinstance(value, list) or all(is_valid(item, one) for item in value),
        "prefixItems": lambda forms: not isinstance(value, list) or all(map(is_valid, value, forms)),
        "required": lambda names: not isinstance(value, dict) or all(name in value for name in names),
        "maxProperties": lambda limit: not isinstance(value, dict) or len(value) <= limit,
        "propertyNames": lambda one: not isinstance(value, dict) or all(is_valid(name, one) for name in value),
        "properties": lambda known: (
            not isinstance(value, dict) or all(is_valid(content, known[name]) for name, content in value.items() if name in known)
        ),
        "additionalProperties": lambda one: (
            not isinstance(value, dict)
            or all(
                one is not False and is_valid(content, one)
                for name, content in value.items()
                if name not in form.get("properties", {})
            )
        ),
        **dict.fromkeys(("$schema", "title", "description", "default"), lambda _: True),
    }
    return all(checks[keyword](content) for keyword, content in form.items())


def _is_type(value: Any, name: str) -> bool:
    number = isinstance(value, (int, float)) and not isinstance(value, bool) and math.isfinite(value)
    return {
        "object": isinstance(value, dict), "array": isinstance(value, list), "string": isinstance(value, str), "null": value is None,
        "boolean": isinstance(value, bool), "number": number, "integer": number and float(value).is_integer(),
    }[name]  # fmt: skip


def places(value: Any, steps: Steps = ()) -> Iterator[Steps]:
    """Yields the path of every value of a document, but for names of variables."""
    if steps:
        yield steps
    items = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, content in items:
        if steps != ("stack", "environment"):
            yield from places(content, (*steps, key))


def with_value(document: Any, steps: Steps, value: Any) -> Any:
    """Returns a copy of a document with another value at a path."""
    if not steps:
        return value
    if isinstance(document, dict) and steps[0] not in document:
        return {**document, steps[0]: value}
    copy: Any = dict(document) if isinstance(document, dict) else list(document)
    copy[steps[0]] = with_value(document[steps[0]], steps[1:], value)
    return copy


def without(document: Any, steps: Steps) -> Any:
    """Returns a copy of a document without the key at a path."""
    if len(steps) == 1:
        return {key: value for key, value in document.items() if key != steps[0]}
    copy: Any = dict(document) if isinstance(document, dict) else list(document)
    copy[steps[0]] = without(document[steps[0]], steps[1:])
    return copy


def mistakes(document: Any) -> list[str]:
    """Returns the mistakes of form that the loader finds; empty = none."""
    found: list[str] = []
    top = Location("", found)
    if isinstance(document, dict):
        SCENARIO.values(document, top)
    else:
        top.refuse(document, SCENARIO.words)
    return found


def test_the_shipped_schema_is_that_of_the_loader() -> None:
    assert (CONFIG / "trial.schema.json").read_text(encoding="utf-8") == schema_text(), (
        "write it anew: gibson-sim trial --schema > config/trial.schema.json"
    )


def test_the_keys_are_the_fields_of_the_scenario() -> None:
    def check(cls: type, known: dict[str, Any]) -> None:
        hints = get_type_hints(cls)
        own = {f.name for f in fields(cls)} - ({"name", "path"} if cls is Scenario else set())
        assert set(known) == own, cls
        for name in own:
            inner = next(
                (arg for arg in (hints[name], *get_args(hints[name])) if isinstance(arg, type) and is_dataclass(arg)), None
            )
            if inner is not None and inner is not GoalInterface:
                form = _mapping(known[name])
                assert form is not None, name
                check(inner, form["properties"])

    check(Scenario, schema()["properties"])


def _mapping(form: dict[str, Any]) -> dict[str, Any] | None:
    """Returns the schema of the mappings that a schema allows, alone or as items of a list."""
    if "properties" in form:
        return form
    for one in (*form.get("anyOf", ()), *([form["items"]] if "items" in form else ())):
        if (found := _mapping(one)) is not None:
            return found
    return None


def test_settings_of_physics_are_all_but_those_that_a_trial_sets() -> None:
    known = {f.name for f in setting_fields(PhysicsConfig)}
    assert set(SET_BY_TRIAL) <= known
    assert set(schema()["properties"]["physics"]["properties"]) == known - set(SET_BY_TRIAL)


def test_every_key_says_what_it_means() -> None:
    def check(form: Any, path: str) -> None:
        if isinstance(form, dict):
            for name, content in form.get("properties", {}).items():
                assert content.get("description", "").endswith((".", ")")) or path.endswith("physics"), f"{path}.{name}"
                check(content, f"{path}.{name}")
            for one in (*form.get("anyOf", ()), form.get("items")):
                check(one, path)

    check(schema(), "")


def test_the_documentation_names_every_key() -> None:
    page = (CONFIG.parent / "docs" / "trial_file.md").read_text(encoding="utf-8")

    def check(form: Any) -> None:
        if isinstance(form, dict):
            for name, content in form.get("properties", {}).items():
                assert re.search(rf"`[^`]*\b{name}\b[^`]*`", page), name
                if name != "physics":
                    check(content)
            for one in (*form.get("anyOf", ()), form.get("items")):
                check(one)

    check(schema())


def test_defaults_of_the_schema_are_allowed_by_it() -> None:
    def check(form: Any) -> None:
        if isinstance(form, dict):
            if "default" in form:
                assert is_valid(form["default"], form), form
            for content in (*form.get("properties", {}).values(), *form.get("anyOf", ()), form.get("items")):
                check(content)

    check(schema())


def test_the_whole_file_is_accepted_by_both(tmp_path: Path) -> None:
    (tmp_path / "trial.yaml").write_text(WHOLE)
    assert load_scenario(tmp_path / "trial.yaml").record.keep == "all"
    assert is_valid(yaml.safe_load(WHOLE), schema())


@pytest.mark.parametrize("name", sorted(path.name for path in (CONFIG / "trials").iterdir()))
def test_shipped_scenarios_fulfil_the_schema_and_name_it(name: str) -> None:
    text = (CONFIG / "trials" / name).read_text(encoding="utf-8")
    assert text.startswith("# yaml-language-server: $schema=../trial.schema.json\n")
    assert is_valid(yaml.safe_load(text), schema())


WRONG = [{"wrong": 1}, [[["wrong"]]], -1e9, 1e9, 0.5e-9, "", "\u00e9 \u2026", None, True, 123456.5]
"""Values of which each kind refuses some."""


def test_every_key_refuses_wrong_values_with_its_path_and_so_does_the_schema() -> None:
    document, form = yaml.safe_load(WHOLE), schema()
    for steps in places(document):
        path = "".join(f"[{step}]" if isinstance(step, int) else f".{step}" for step in steps).removeprefix(".")
        refused = 0
        for value in WRONG:
            changed = with_value(document, steps, value)
            found = mistakes(changed)
            refused += bool(found)
            for line in found:
                told = line.split(" ", 1)[0].rstrip(":")
                # A pair of numbers, and the words of a command, are one value.
                assert told.startswith(path) or path.startswith(f"{told}["), (path, value, line)
                assert "\n" not in line
            # No schema can say which of two numbers is the larger.
            if not any("[smallest, largest]" in line for line in found):
                assert bool(found) == (not is_valid(changed, form)), (path, value, found)
        assert refused >= 3, path


def test_an_unknown_key_and_a_missing_one_are_refused_by_both() -> None:
    document, form = yaml.safe_load(WHOLE), schema()
    for steps in [(), *places(document)]:
        inner = document
        for step in steps:
            inner = inner[step]
        if isinstance(inner, dict) and steps != ("stack", "environment"):
            changed = with_value(document, (*steps, "no_such_key"), 1)
            path = "".join(f"[{step}]" if isinstance(step, int) else f".{step}" for step in (*steps, "no_such_key"))
            assert [line.split(" ", 1)[0] for line in mistakes(changed)] == [path.removeprefix(".")]
            assert not is_valid(changed, form), path
    for steps in (
        ("stack",),
        ("scenes",),
        ("stack", "command"),
        ("verdicts", "rates", 0, "least"),
        ("obstacles", "spawn", 0, "object"),
    ):
        changed = without(document, steps)
        assert len(mistakes(changed)) == 1, steps
        assert not is_valid(changed, form), steps
