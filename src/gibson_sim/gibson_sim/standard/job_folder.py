"""The temporary folder of a job of several processes: it is removed by whichever of them ends last, however the launcher ended.

The launcher holds a lock on the folder through a file descriptor that its nodes inherit; the kernel frees the lock when the last of
them is gone. A folder whose lock is free belongs to no living job.
"""

from __future__ import annotations

import fcntl
import os
import shutil
import tempfile
from collections.abc import MutableMapping
from pathlib import Path

from gibson_sim.writing import write_file

PREFIX = "gibson-sim-job-"
LOADED = "loaded"
"""Note of the physics node that scene, robots and start have been taken: the names of the cameras, a line each."""
VARIABLE = "GIBSON_SIM_JOB_FOLDER"
"""Environment variable of the nodes of a job: number of the inherited descriptor, a colon, and the folder."""


class JobFolder:
    """A new temporary folder, held by this process and by those that inherit ``descriptor``."""

    def __init__(self, parent: Path | None = None) -> None:
        """Makes the folder; folders that killed jobs left behind are removed first. ``parent``: None = that of temporary files."""
        parent = parent or Path(tempfile.gettempdir())
        remove_abandoned(parent)
        made = Path(tempfile.mkdtemp(prefix="gibson-sim-new-", dir=parent))
        self.descriptor = os.open(made, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
        fcntl.flock(self.descriptor, fcntl.LOCK_EX)
        # Only now: another job that starts would take a folder without a lock for abandoned.
        self.path = made.rename(made.with_name(made.name.replace("gibson-sim-new-", PREFIX)))

    def add_to(self, environment: MutableMapping[str, str]) -> None:
        """Tells the nodes of the job by their environment; they must inherit ``descriptor`` too."""
        environment[VARIABLE] = f"{self.descriptor}:{self.path}"

    def close(self) -> None:
        """Removes the folder with all that is in it."""
        if self.descriptor >= 0:
            shutil.rmtree(self.path, ignore_errors=True)
            os.close(self.descriptor)
            self.descriptor = -1

    def __enter__(self) -> JobFolder:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def note_in_job(name: str, text: str) -> None:
    """Leaves a file with a text in the folder of the job that this process is a part of, if it is part of one."""
    path = os.environ.get(VARIABLE, "").partition(":")[2]
    if path:
        write_file(Path(path) / name, text, durable=False)


def leave_job() -> None:
    """Gives up this process's hold on the folder of the job that it is a part of, and removes it where nobody else has one."""
    number, _, path = os.environ.pop(VARIABLE, "").partition(":")
    if path:
        try:
            os.close(int(number))
        except (OSError, ValueError):  # inherited by a process that was started in another way
            return
        _remove_if_free(Path(path))


def remove_abandoned(parent: Path) -> list[Path]:
    """Removes the folders of jobs of this user of which no process is left; returns them."""
    return [path for path in parent.glob(f"{PREFIX}*") if _remove_if_free(path)]


def _remove_if_free(path: Path) -> bool:
    try:
        descriptor = os.open(path, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW | os.O_CLOEXEC)
    except OSError:
        return False
    try:
        if os.fstat(descriptor).st_uid != os.getuid():
            return False
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        shutil.rmtree(path, ignore_errors=True)
        return not path.exists()
    except OSError:
        return False
    finally:
        os.close(descriptor)
