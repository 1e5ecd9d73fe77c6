"""The end of a run, derived from the report of the trial node, the exited processes and their output."""

from __future__ import annotations

import re
import signal
from dataclasses import dataclass

from gibson_sim.quoting import clipped
from gibson_sim.trials.execution.trial_node import TrialReport
from gibson_sim.trials.records import End

_ERROR = re.compile(r"(?:error: |\[?(?:ERROR|FATAL)\]?:? )(.+)")
_WAITS = re.compile(r"lockstep: waiting for (.+?); [\d.]+ s so far")
_CLOCK = "another node publishes /clock"
"""Error of the physics node; a run's ROS domain has no other simulation."""
_OWN_PARTICIPANTS = ("'record'", "'render'")
"""Lockstep participants of ours besides the trial node, as the physics node names them."""
_MAX_LENGTH = 300
"""Largest length of a quoted line, characters."""


@dataclass(frozen=True, slots=True)
class Ending:
    """The end of a run."""

    end: End
    detail: str


def exit_text(code: int) -> str:
    """Returns a description of an exit code; negative = the signal."""
    if code >= 0:
        return f"ended with code {code}"
    try:
        return f"was killed by {signal.Signals(-code).name}"
    except ValueError:  # real-time signals have no name
        return f"was killed by signal {-code}"


def last_error(output: str) -> str:
    """Returns the last error in the output of a node; empty = none."""
    for line in reversed(output.splitlines()):
        if match := _ERROR.match(line.strip()):
            return clipped(match[1], _MAX_LENGTH)
    return ""


def stack_died(code: int, last_line: str) -> Ending:
    """Returns the end of a run whose stack exited by itself."""
    line = clipped(last_line, _MAX_LENGTH)
    return Ending("stack died", f"the stack {exit_text(code)}" + (f"; its last line: {line}" if line else "; it printed nothing"))


def node_died(name: str, code: int, output: str) -> Ending:
    """Returns the end of a run in which a node exited early."""
    error = last_error(output)
    if _CLOCK in error:
        return Ending(
            "simulation failed", "the stack publishes /clock, which only the simulation may do: run the stack with use_sim_time"
        )
    return Ending("simulation failed", f"the {name} node {exit_text(code)}" + (f": {error}" if error else ""))


def server_died() -> Ending:
    """Returns the end of a run whose node server, the parent of nodes and stack, exited together with all of them."""
    return Ending(
        "simulation failed", "the parent process of nodes and stack ended: killed by the stack or by the out-of-memory killer"
    )


def reported_ending(report: TrialReport, physics_output: str) -> Ending:
    """Returns the end that the trial node reports; a failure of the simulation if time waited for one of our nodes."""
    end: End = report.end  # type: ignore[assignment] # from JSON
    if end != "stack silent":
        return Ending(end, report.detail)
    waits = _WAITS.findall(physics_output)
    if not waits:
        return Ending(end, report.detail)
    if any(name in waits[-1] for name in _OWN_PARTICIPANTS):
        return Ending("simulation failed", f"time waited for {waits[-1]}")
    return Ending(end, f"{report.detail}; physics waited for {clipped(waits[-1], _MAX_LENGTH)}")
