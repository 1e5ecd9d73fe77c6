"""Exit codes of ``gibson-sim``; ``--help`` prints this table."""

from __future__ import annotations

from enum import IntEnum

from gibson_sim import interrupts


class ExitCode(IntEnum):
    """What the exit code says."""

    OK = 0
    ERROR = 1
    USAGE = 2
    ALREADY_RUNNING = 3
    NODE_DIED = 4
    RECORDING_ENDED_EARLY = 5
    REPLAY_DIFFERS = 6
    INTERRUPTED = interrupts.INTERRUPTED


MEANING = {
    ExitCode.OK: "done; or stopped by Ctrl-C or SIGTERM where it goes on until then (run, record, top, drive)",
    ExitCode.ERROR: "it cannot be done: one line on stderr says why",
    ExitCode.USAGE: "the command line is wrong",
    ExitCode.ALREADY_RUNNING: "a simulation runs in this ROS domain already; for top: none does",
    ExitCode.NODE_DIED: "a node crashed or was killed",
    ExitCode.RECORDING_ENDED_EARLY: "the run went on, but recording stopped early (disk full); the bag is readable",
    ExitCode.REPLAY_DIFFERS: "replay --verify: the run is not the recorded one; the report names the first tick and topics that differ",
    ExitCode.INTERRUPTED: "Ctrl-C ended it before it was done, or while it started (the process dies of SIGINT, as shells expect)",
}


def table() -> str:
    """Returns the codes as text, one a line."""
    return "exit codes:\n" + "\n".join(f"{int(code):>3}  {text}" for code, text in MEANING.items())
