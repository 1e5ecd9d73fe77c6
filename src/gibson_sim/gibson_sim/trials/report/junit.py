"""JUnit XML of a trial for CI systems, one test case per run. The schema is that of Jenkins' xUnit plugin and Ant's JUnit task."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from xml.etree import ElementTree

from gibson_sim.trials.records import RunResult
from gibson_sim.trials.report.results import TrialResults
from gibson_sim.trials.report.words import (
    can_be_replayed,
    identifier,
    reason,
    replay_command,
    rerun_command,
    robot_name,
    route_text,
    scene_name,
    seconds_of,
    success,
)

FILE = "junit.xml"
_NOT_IN_XML = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")
"""Characters that XML 1.0 does not allow, escaped or unescaped."""


def junit_xml(trial: TrialResults, folder: Path, options: Sequence[str] = ()) -> bytes:
    """Returns the content of the file.

    Args:
        trial: the results.
        folder: folder of the trial.
        options: command-line options that affect the plan.
    """
    errors = sum(_is_error(result) for result in trial.failed)
    counts = {"tests": len(trial.results), "failures": len(trial.failed) - errors, "errors": errors}
    attributes = {name: str(count) for name, count in counts.items()} | {"time": f"{sum(map(seconds_of, trial.results)):.3f}"}
    root = ElementTree.Element("testsuites", {"name": _clean(trial.name), **attributes})
    suite = ElementTree.SubElement(root, "testsuite", {"name": _clean(trial.name), **attributes, "skipped": "0"})
    if trial.started:
        suite.set("timestamp", trial.started.partition("+")[0])
    if trial.machine.get("name"):
        suite.set("hostname", _clean(str(trial.machine["name"])))
    for result in trial.results:
        _add_case(suite, result, trial.file, folder, options)
    ElementTree.indent(root)
    text: bytes = ElementTree.tostring(root, encoding="utf-8", xml_declaration=True)
    return text + b"\n"


def _add_case(suite: ElementTree.Element, result: RunResult, file: str, folder: Path, options: Sequence[str]) -> None:
    run = result.run
    case = ElementTree.SubElement(
        suite,
        "testcase",
        {
            "name": f"{run.number:04d} {route_text(run)}",
            "classname": f"{identifier(scene_name(run.scene))}.{identifier(robot_name(run.robot))}",
            "time": f"{seconds_of(result):.3f}",
        },
    )
    lines = []
    if not result.passed:
        kind = result.cause.kind if result.cause else result.outcome.end
        problem = ElementTree.SubElement(
            case, "error" if _is_error(result) else "failure", {"message": _clean(reason(result)), "type": kind}
        )
        problem.text = _clean("\n".join(f"{verdict.name}: {verdict.text}" for verdict in result.verdicts if not verdict.passed))
        if can_be_replayed(folder, result):
            lines.append(f"replay bit for bit: {replay_command(folder, run.number)}")
        lines.append(f"run again: {rerun_command(file, run.number, options)}")
    else:
        lines.append(success(result))
    ElementTree.SubElement(case, "system-out").text = _clean("\n".join(lines))


def _is_error(result: RunResult) -> bool:
    """Returns whether a run failed through no fault of the stack."""
    return not result.passed and (result.cause is not None and result.cause.kind == "simulation failed")


def _clean(text: str) -> str:
    return _NOT_IN_XML.sub("�", text)
