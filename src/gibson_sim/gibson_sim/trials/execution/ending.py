"""How a run ended: told from the report of the trial node, the processes that ended, and what they wrote."""

from __future__ import annotations

import re
import signal
from dataclasses import dataclass

from gibson_sim.quoting import clipped
from gibson_sim.trials.execution.plan import TrialReport
from gibson_sim.trials.records import End

_ERROR = re.compile(r"(?:error: |\[?(?:ERROR|FATAL)\]?:? )(.+)")
_WAITS = re.compile(r"lockstep: waiting for (.+?); [\d.]+ s so far")
_CLOCK = "another node publishes /clock"
"""Error of physics; no other simulation is in the ROS domain of a run."""
_OURS = ("'record'", "'render'")
"""Our participants of lockstep, beside the trial node, as physics names them."""
_LONGEST = 300
"""Characters of a line that is quoted."""


@dataclass(frozen=True, slots=True)
class Ending:
    """How a run ended."""

    end: End
    detail: str


def how_it_ended(code: int) -> str:
    """Returns an exit code in words."""
    if code >= 0:
        return f"ended with code {code}"
    try:
        return f"was killed by {signal.Signals(-code).name}"
    except ValueError:  # real-time signals have no name
        return f"was killed by signal {-code}"


def last_error(output: str) -> str:
    """Returns the last error in the output of a node; empty = there is none."""
    for line in reversed(output.splitlines()):
        if match := _ERROR.match(line.strip()):
            return clipped(match[1], _LONGEST)
    return ""


def stack_died(code: int, last_line: str) -> Ending:
    """Returns the end of a run whose stack ended by itself."""
    line = clipped(last_line, _LONGEST)
    return Ending(
        "stack died", f"the stack {how_it_ended(code)}" + (f"; its last line: {line}" if line else "; it printed nothing")
    )


def node_died(name: str, code: int, output: str) -> Ending:
    """Returns the end of a run one of whose nodes ended too early."""
    error = last_error(output)
    if _CLOCK in error:
        return Ending(
            "simulation failed", "the stack publishes /clock, which the simulation alone may do: let it run with use_sim_time"
        )
    return Ending("simulation failed", f"the {name} node {how_it_ended(code)}" + (f": {error}" if error else ""))


def server_died() -> Ending:
    """Returns the end of a run whose node server, the parent of nodes and stack, ended, and all of them with it."""
    return Ending("simulation failed", "the parent process of nodes and stack ended: killed by the stack, or for lack of memory")


def reported(report: TrialReport, physics_output: str) -> Ending:
    """Returns the end that the trial node reports. If time waited for one of our nodes, the stack is not to blame."""
    end: End = report.end  # type: ignore[assignment] # of JSON
    if end != "stack silent":
        return Ending(end, report.detail)
    waits = _WAITS.findall(physics_output)
    if not waits:
        return Ending(end, report.detail)
    if any(name in waits[-1] for name in _OURS):
        return Ending("simulation failed", f"time waited for {waits[-1]}")
    return Ending(end, f"{report.detail}; physics waited for {clipped(waits[-1], _LONGEST)}")
