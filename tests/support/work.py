"""Functions of units of work, which worker processes import."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

from gibson_sim.errors import ConfigError
from gibson_sim.jobs.units import Context

_BEGUN = 0
"""Units of this process."""


def square(arguments: Any, folder: Path, context: Context) -> Any:
    (folder / "square.txt").write_text(str(arguments["x"] ** 2))
    context.progress(f"{arguments['x']} is done")
    return {"square": arguments["x"] ** 2}


def after(arguments: Any, folder: Path, context: Context) -> Any:
    """Returns once a pipe has a writer, and closes it."""
    return Path(arguments["pipe"]).read_text()


def count(arguments: Any, folder: Path, context: Context) -> Any:
    global _BEGUN
    _BEGUN += 1
    return _BEGUN


def cores(arguments: Any, folder: Path, context: Context) -> Any:
    return sorted(os.sched_getaffinity(0))


def echo(arguments: Any, folder: Path, context: Context) -> Any:
    for k in range(arguments.get("lines", 0)):
        context.progress(str(k))
    for name, size in arguments.get("files", {}).items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(b"x" * size)
    return arguments


def read(arguments: Any, folder: Path, context: Context) -> Any:
    path = context.path(arguments["path"])
    return [path.name, path.read_text(), os.access(path, os.X_OK)]


def refuse(arguments: Any, folder: Path, context: Context) -> Any:
    raise ConfigError("the value is 7, must be 8")


def divide(arguments: Any, folder: Path, context: Context) -> Any:
    subprocess.run([sys.executable, "-c", "print('a child speaks')"], check=True)
    return 1 / arguments["x"]


def no_json(arguments: Any, folder: Path, context: Context) -> Any:
    return {1, 2}


def leave(arguments: Any, folder: Path, context: Context) -> Any:
    sys.exit(3)


def die(arguments: Any, folder: Path, context: Context) -> Any:
    os.kill(os.getpid(), arguments["signal"])


def die_once(arguments: Any, folder: Path, context: Context) -> Any:
    """Dies at the first attempt, with a file half written and a child; tells at the second what it found."""
    found = sorted(path.name for path in folder.iterdir())
    note = Path(arguments["note"])
    if not note.exists():
        (folder / "half").write_text("half")
        child = subprocess.Popen(["sleep", "infinity"], start_new_session=True)
        note.write_text(str(child.pid))
        os.kill(os.getpid(), signal.SIGKILL)
    (folder / "whole").write_text("whole")
    return found


def wait(arguments: Any, folder: Path, context: Context) -> Any:
    """Tells its process and a child's on a pipe, and waits: until it is told to stop, or for ever if it is deaf."""
    child = subprocess.Popen(["sleep", "infinity"], start_new_session=True)
    with open(arguments["pipe"], "w") as pipe:
        pipe.write(f"{os.getpid()} {child.pid} {os.getppid()}\n")
    while arguments.get("deaf") or not context.stop():
        os.sched_yield()
    return "stopped"


def wait_once(arguments: Any, folder: Path, context: Context) -> Any:
    """Waits for ever at the first attempt, as ``wait``, with a file half written; tells at the second what it found."""
    found = sorted(path.name for path in folder.iterdir())
    note = Path(arguments["note"])
    if not note.exists():
        note.touch()
        (folder / "half").write_text("half")
        wait({**arguments, "deaf": True}, folder, context)
    (folder / "whole").write_text("whole")
    return found
