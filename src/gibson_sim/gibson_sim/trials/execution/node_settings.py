"""Settings of the nodes of a run, and checks of a stack before it is started."""

from __future__ import annotations

import math
import os
import re
import shutil
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from gibson_sim.client_config import RecordConfig, TrialConfig
from gibson_sim.config import PhysicsConfig, RenderConfig
from gibson_sim.errors import ConfigError, EnvironmentProblemError
from gibson_sim.quoting import quoted
from gibson_sim.reach import LOCAL, reach_variables
from gibson_sim.settings import nearest, setting_fields
from gibson_sim.trials.execution.trial_node import INPUT, MARKER, REPORT
from gibson_sim.trials.records import RunSpec
from gibson_sim.trials.run_folder import BAG
from gibson_sim.trials.scenario.spec import GoalInterface, Scenario, StackSpec

MAX_TICK_S = 86_400.0
"""Timeout of the physics node for a lockstep tick, seconds: the trial node, which knows whether the stack has a goal, ends a run earlier."""
_TYPE = re.compile(r"([a-z][a-z0-9_]*)/(action|srv)/[A-Za-z]\w*")
_MAX_LISTED = 10
"""Number of types of a package that a message lists."""
POSE_TYPE = "geometry_msgs/PoseStamped"
"""Type of the field of an action's goal or a service's request that receives the pose."""
_NOT_A_NAME = re.compile(r"[^\w-]")


@dataclass(frozen=True, slots=True)
class NodeSettings:
    """Settings of all nodes of a run."""

    physics: PhysicsConfig
    record: RecordConfig
    trial: TrialConfig
    render: RenderConfig


def check_stack(stack: StackSpec) -> None:
    """Checks a stack before it is started.

    Raises:
        ConfigError: the type of the goal or a lockstep rule is malformed, or the goal type has no field for a pose.
        EnvironmentProblemError: the program or a message package is not installed.
    """
    if not stack.command:
        raise ConfigError("stack.command is empty, must be a program and its arguments")
    path = {**os.environ, **stack.environment}.get("PATH")
    program = stack.command[0]
    exists = (stack.folder / program).exists() if "/" in program else shutil.which(program, path=path)
    if not exists:
        raise EnvironmentProblemError(f"stack.command: program {quoted(program)} not found; install it, or give its path")
    if not stack.folder.is_dir():
        raise ConfigError(f"stack.folder is {quoted(str(stack.folder))}, must be a folder that exists")
    packages = ["lifecycle_msgs"] if stack.ready.node else []
    if stack.goal.kind in ("action", "service"):
        match = _TYPE.fullmatch(stack.goal.type)
        folder = {"action": "action", "service": "srv"}[stack.goal.kind]
        if match is None or match[2] != folder:
            raise ConfigError(
                f"stack.goal.type is {quoted(stack.goal.type)}, must be package/{folder}/Name, such as nav2_msgs/action/NavigateToPose"
            )
        packages.append(match[1])
    for package in packages:
        if find_spec(package) is None:
            raise EnvironmentProblemError(
                f"the interface of the stack uses package {quoted(package)}, which this Python cannot import: install it, or "
                "source the ROS workspace that has it"
            )
    if stack.goal.kind in ("action", "service"):
        _check_goal(stack.goal)
    participants_of(stack, ())


def _check_goal(goal: GoalInterface) -> None:
    """Checks that a package has the type of a goal, with a field for the pose; reads the generated source without importing it.

    Raises:
        ConfigError: the package lacks the type, or the type lacks the field.
    """
    package, folder, name = goal.type.split("/")
    spec = find_spec(package)
    folder_path = Path(next(iter(spec.submodule_search_locations or ("",))) if spec else "") / folder
    part = f"{name}_{'Goal' if folder == 'action' else 'Request'}"
    texts = [file.read_text(errors="replace") for file in sorted(folder_path.glob("_*.py"))]
    if not texts:
        return  # from another generator; the trial node reports errors
    source = next((text for text in texts if re.search(rf"^class {part}\(", text, re.MULTILINE)), None)
    if source is None:
        names = sorted(match for text in texts for match in re.findall(r"^class ([A-Za-z0-9]+)\(metaclass", text, re.MULTILINE))
        hint = nearest(name, names)
        raise ConfigError(
            f"stack.goal.type is {quoted(goal.type)}, which package {package} does not have; {f'{hint} ' if hint else ''}"
            f"known: {', '.join(names[:_MAX_LISTED])}"
        )
    table = re.search(rf"^class {part}\(.*?_fields_and_field_types = \{{(.*?)\}}", source, re.MULTILINE | re.DOTALL)
    fields = dict(re.findall(r"'(\w+)': '([^']+)'", table[1])) if table else {}
    if table and fields.get(goal.field) != POSE_TYPE:
        field_texts = ", ".join(f"{field} ({kind})" for field, kind in fields.items())
        raise ConfigError(
            f"stack.goal.field is {quoted(goal.field)}, must be a field of type {POSE_TYPE} of {goal.type}, which has {field_texts or 'none'}"
        )


def participants_of(stack: StackSpec, own: tuple[str, ...]) -> str:
    """Returns the setting ``participants`` of the physics node: our nodes, and the rules of a stack, each with a name.

    Raises:
        ConfigError: a rule is malformed.
    """
    rules = []
    for rule in stack.lockstep:
        named_rule = rule if "=" in rule else f"{_NOT_A_NAME.sub('_', rule.split()[0].strip('/')) if rule.split() else ''}={rule}"
        rules.append(named_rule)
    text = "; ".join((*own, *rules))
    PhysicsConfig.of(lockstep=True, participants=text)
    from gibson_sim.standard.lockstep import parse_participants

    parse_participants(text)
    return text


def node_settings(scenario: Scenario, run: RunSpec, folder: Path, job: Path) -> NodeSettings:
    """Returns the settings of the nodes of a run.

    Args:
        scenario: scenario of the trial.
        run: one of its runs.
        folder: folder of the run.
        job: folder for files exchanged between the nodes.

    Raises:
        ConfigError: a setting has a value that is not allowed.
    """
    known = {f.name for f in setting_fields(PhysicsConfig)}
    unknown = sorted(run.physics.keys() - known)
    if unknown:
        raise ConfigError(
            f"physics has {quoted(unknown[0])}, which is not a setting of the physics node; see `gibson-sim params`"
        )
    renders = scenario.record.images != "none"
    values: dict[str, Any] = {
        **run.physics,
        "scene": run.scene,
        "robot": run.robot,
        "seed": run.seed,
        "start": ",".join(repr(float(v)) for v in (run.start[0], run.start[1], math.degrees(run.start[2]))),
        "start_paused": True,
        "digests": True,
        "duration": 0.0,
        "wait_for": "scene_state:2,robots:2,cameras:1" if renders else "scene_state:1,robots:2",
        "summary_path": str(job / "physics.json"),
    }
    if scenario.stack.lockstep:
        participants = participants_of(scenario.stack, ("trial", "record", "render") if renders else ("trial", "record"))
        values |= {"lockstep": True, "rate": 0.0, "participants": participants, "participant_timeout": MAX_TICK_S}
        values["on_timeout"] = "stop"
    else:
        values |= {"lockstep": False, "participants": "", "pipelined": False}
    for name, value in values.items():
        if isinstance(value, str) and value in run.files:
            values[name] = str(folder / value)
    return NodeSettings(
        PhysicsConfig.of(**values),
        RecordConfig(output=str(folder / BAG), record_images=scenario.record.images, summary_path=str(job / "record.json")),
        TrialConfig(input=str(job / INPUT), output=str(job / REPORT)),
        RenderConfig(digests=True, summary_path=str(job / "render.json")),
    )


def stack_environment(stack: StackSpec, domain: int, marker: str, base: Mapping[str, str]) -> dict[str, str]:
    """Returns the complete environment of a stack.

    Args:
        stack: stack, which may set variables.
        domain: ROS domain.
        marker: text that identifies the processes of this run.
        base: environment of this process.
    """
    values = dict(base)
    for name, value in reach_variables(base, LOCAL).items():
        if value:
            values[name] = value
        else:
            values.pop(name, None)
    values.setdefault("PYTHONUNBUFFERED", "1")  # otherwise the last line of a crashing program would be lost
    values |= {**stack.environment, "ROS_DOMAIN_ID": str(domain), MARKER: marker}
    return values
