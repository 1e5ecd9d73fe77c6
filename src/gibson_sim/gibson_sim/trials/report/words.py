"""Texts about runs: names, results, and the commands that repeat them."""

from __future__ import annotations

import math
import re
import shlex
from collections.abc import Sequence
from pathlib import Path

from gibson_sim.quoting import clipped
from gibson_sim.trials.records import PlanarPose, RunResult, RunSpec
from gibson_sim.trials.run_folder import BAG, run_folder
from gibson_sim.types import NS_PER_S

_MAX_LENGTH = 400
"""Largest length of a line about a run, characters."""
_NAME = re.compile(r"[^\w-]+")


def scene_name(scene: str) -> str:
    """Returns the name of a scene, without the folders of its file."""
    path = Path(scene)
    return (path.parent.name if path.name in ("scene.yaml", "scene.yml") else path.stem) or scene


def robot_name(robot: str) -> str:
    """Returns the name of a robot, without the folders of its file."""
    path = Path(robot)
    return (path.parent.name if path.name in ("robot.yaml", "robot.yml") else path.stem) or robot


def identifier(text: str) -> str:
    """Returns a text reduced to letters, digits, ``_`` and ``-``."""
    return _NAME.sub("_", text).strip("_") or "_"


def xy_text(pose: PlanarPose) -> str:
    """Returns x and y with one decimal, metres."""
    return f"{pose[0] + 0.0:.1f},{pose[1] + 0.0:.1f}"


def route_text(run: RunSpec) -> str:
    """Returns start and goal as text."""
    return f"{xy_text(run.start)} -> {xy_text(run.goal)}"


def seconds_of(result: RunResult) -> float:
    """Returns the simulation time from the goal to the end, seconds; that of the whole run if no goal was sent."""
    if "time" in result.measures:
        return result.measures["time"]
    outcome = result.outcome
    begin = outcome.goal_ns if outcome.goal_ns >= 0 else 0
    return max(0.0, (outcome.end_ns - begin) / NS_PER_S)


def reason(result: RunResult) -> str:
    """Returns the reason why a run failed, one line."""
    if result.cause is not None:
        return clipped(result.cause.text, _MAX_LENGTH)
    failed = [verdict.text for verdict in result.verdicts if not verdict.passed]
    return clipped(failed[0] if failed else result.outcome.detail or result.outcome.end, _MAX_LENGTH)


def success(result: RunResult) -> str:
    """Returns a summary of a passed run, one line."""
    measures = result.measures
    parts = [f"{result.outcome.end} in {seconds_of(result):.1f} s"]
    length = measures.get("length")
    if length is not None:
        ratio = measures.get("path_ratio", math.nan)
        parts.append(f"{length:.1f} m" + (f" (ratio {ratio:.2f})" if math.isfinite(ratio) else ""))
    return ", ".join(parts)


def run_line(result: RunResult) -> str:
    """Returns a summary of a completed run, one line."""
    run = result.run
    summary = success(result) if result.passed else reason(result)
    return f"{'ok  ' if result.passed else 'FAIL'} {run.number:3d} {scene_name(run.scene)} {route_text(run)}  {summary}"


def replay_command(folder: Path, number: int) -> str:
    """Returns the command that replays a run from its bag, bit for bit.

    Args:
        folder: folder of the trial.
        number: number of the run.
    """
    return shlex.join(["gibson-sim", "replay", str(run_folder(folder, number) / BAG), "--verify"])


def can_be_replayed(folder: Path, result: RunResult) -> bool:
    """Returns whether a run in the folder of a trial has a bag with at least one tick."""
    return result.outcome.end_ns > 0 and (run_folder(folder, result.run.number) / BAG).is_dir()


def rerun_command(file: str, number: int, options: Sequence[str] = ()) -> str:
    """Returns the command that executes a run again, with the stack.

    Args:
        file: scenario file.
        number: number of the run.
        options: command-line options that affect the plan.
    """
    return shlex.join(["gibson-sim", "trial", file, *options, "--run", str(number)])


def plan_table(runs: Sequence[RunSpec]) -> str:
    """Returns a table of the planned runs, one per line, with a header line; the last column only if a run has a value there."""
    rows: list[tuple[str, ...]] = [("run", "scene", "robot", "start", "goal", "shortest", "seed", "obstacles, random values")]
    rows += [
        (
            str(run.number), scene_name(run.scene), robot_name(run.robot), _pose(run.start), _pose(run.goal), f"{run.shortest:.1f} m",
            str(run.seed), _extras(run),
        )
        for run in runs
    ]  # fmt: skip
    if not any(row[-1] for row in rows[1:]):
        rows = [row[:-1] for row in rows]
    widths = [max(len(row[column]) for row in rows) for column in range(len(rows[0]))]
    return "\n".join("  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in rows)


def _pose(pose: PlanarPose) -> str:
    x, y, yaw = pose
    return f"{x + 0.0:.2f},{y + 0.0:.2f},{math.degrees(yaw) + 0.0:.0f}"


def _extras(run: RunSpec) -> str:
    parts = [f"{len(run.things)} objects"] * bool(run.things) + [f"{len(run.closed_doors)} doors closed"] * bool(run.closed_doors)
    parts += [f"{len(run.people)} people"] * bool(run.people)
    parts += [f"{name} {value:.3g}" for name, value in run.drawn.items()]
    return ", ".join(parts)
