"""Runs a program with all its descendants as one unit, which ends on request or when the starting process ends for any reason.

``python -m gibson_sim.testing.contained_process PARENT_PID PROGRAM ...`` runs a program in its own session. Orphans of the program become
children of this process (PR_SET_CHILD_SUBREAPER, prctl(2)), so that no descendant is lost, not even a daemon. The exit code is that of the
program, 128 + n for signal n. Imports only the standard library.
"""

from __future__ import annotations

import ctypes
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

GRACE_S = ((signal.SIGINT, 5.0), (signal.SIGTERM, 2.0), (signal.SIGKILL, 5.0))
"""Signals that end the program and its descendants, each with the wall time until the next signal, seconds."""
NOT_FOUND = 127
"""Exit code if the program cannot be started, as in a shell."""
_PR_SET_PDEATHSIG, _PR_SET_CHILD_SUBREAPER = 1, 36
"""Options of prctl(2)."""
_PERIOD_S = 0.02


def contained_command(command: Sequence[str]) -> list[str]:
    """Returns the command line that runs a program contained in this process, with all its descendants."""
    return [sys.executable, "-m", "gibson_sim.testing.contained_process", str(os.getpid()), *command]


def end_with_parent(parent_pid: int) -> None:
    """Requests SIGTERM for this process when its parent ends; exits immediately if the parent has already ended."""
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)
    if os.getppid() != parent_pid:
        sys.exit(1)


def main() -> int:
    """Runs the program; returns its exit code."""
    parent_pid, command = int(sys.argv[1]), sys.argv[2:]
    received: list[int] = []
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda number, _: received.append(number))
    ctypes.CDLL(None).prctl(_PR_SET_CHILD_SUBREAPER, 1)
    end_with_parent(parent_pid)
    try:
        program = subprocess.Popen(command, stdin=subprocess.DEVNULL, start_new_session=True, preexec_fn=_end_with_parent)
    except OSError as error:
        sys.stderr.write(f"error: {command[0]} cannot be started: {error.strerror}\n")
        return NOT_FOUND
    code = None
    while not received and code is None:
        code = _reap(program.pid)
        time.sleep(0.0 if code is not None else _PERIOD_S)
    for number, seconds in GRACE_S:
        if code is None and number == signal.SIGINT:
            _send(-program.pid, number)  # to the whole process group, as Ctrl-C does, such as `ros2 launch` with its nodes
        elif number != signal.SIGINT:
            for pid in _descendants(os.getpid()):
                _send(pid, number)
        deadline = time.monotonic() + seconds
        while time.monotonic() < deadline:
            exit_code = _reap(program.pid)
            code = exit_code if code is None else code
            if not any(_descendants(os.getpid())) or (code is not None and number == signal.SIGINT):
                break
            time.sleep(_PERIOD_S)
        if not any(_descendants(os.getpid())):
            break
    return code if code is not None else 128 + signal.SIGKILL


def _end_with_parent() -> None:
    """Makes the program end if this process is killed. Safe between fork and exec, since this process has one thread."""
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)


def _reap(program_pid: int) -> int | None:
    """Reaps ended children; returns the exit code of the program if it is among them, 128 + n for signal n."""
    program_code = None
    while True:
        try:
            pid, status = os.waitpid(-1, os.WNOHANG)
        except ChildProcessError:
            return program_code
        if not pid:
            return program_code
        if pid == program_pid:
            code = os.waitstatus_to_exitcode(status)
            program_code = code if code >= 0 else 128 - code


def _descendants(pid: int) -> Iterator[int]:
    """Yields the ids of all descendants of a process."""
    try:
        children = [int(text) for task in Path(f"/proc/{pid}/task").iterdir() for text in (task / "children").read_text().split()]
    except OSError:
        return
    for child in children:
        yield child
        yield from _descendants(child)


def _send(pid: int, number: int) -> None:
    try:
        os.kill(pid, number)
    except ProcessLookupError:
        pass


if __name__ == "__main__":
    sys.exit(main())
