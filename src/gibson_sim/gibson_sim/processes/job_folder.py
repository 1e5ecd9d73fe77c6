"""The temporary folder of a job of several processes; the last process to end removes it, even if the launcher was killed.

The launcher locks the folder through a file descriptor that its nodes inherit; the kernel frees the lock when the last of them has
ended. A folder whose lock is free belongs to no running job.
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
"""Note of the physics node after scene, robots and start are loaded and valid: JSON with ``scene``, ``robots`` and ``cameras``."""
READY = "ready"
"""Note of the physics node, empty, after all nodes of the job are ready: time starts now, or with the first request."""
PAGE = "page"
"""Note of the web node: the address of its page; empty = it has ended."""
STATUS = "{}.status"
"""Name of the note that a node updates once a second: JSON, for the status line."""
VARIABLE = "GIBSON_SIM_JOB_FOLDER"
"""Environment variable of the nodes of a job: number of the inherited descriptor, a colon, and the folder."""


class JobFolder:
    """A new temporary folder, locked by this process and by those that inherit ``descriptor``."""

    def __init__(self, parent: Path | None = None) -> None:
        """Creates the folder after removing those of killed jobs. ``parent``: None = the system's folder for temporary files."""
        parent = parent or Path(tempfile.gettempdir())
        remove_abandoned(parent)
        unlocked = Path(tempfile.mkdtemp(prefix="gibson-sim-new-", dir=parent))
        self.descriptor = os.open(unlocked, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
        fcntl.flock(self.descriptor, fcntl.LOCK_EX)
        # Renamed after it is locked: another starting job would remove an unlocked folder as abandoned.
        self.path = unlocked.rename(unlocked.with_name(unlocked.name.replace("gibson-sim-new-", PREFIX)))

    def add_to(self, environment: MutableMapping[str, str]) -> None:
        """Adds the folder to the environment of the job's nodes, which must also inherit ``descriptor``."""
        environment[VARIABLE] = f"{self.descriptor}:{self.path}"

    def close(self) -> None:
        """Removes the folder and its contents."""
        if self.descriptor >= 0:
            shutil.rmtree(self.path, ignore_errors=True)
            os.close(self.descriptor)
            self.descriptor = -1

    def __enter__(self) -> JobFolder:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def note_in_job(name: str, text: str) -> None:
    """Writes a text file into the folder of this process's job; does nothing outside a job."""
    path = os.environ.get(VARIABLE, "").partition(":")[2]
    if path:
        write_file(Path(path) / name, text, durable=False)


def read_note(folder: Path, name: str) -> str | None:
    """Returns the text of a note in the folder of a job; None = missing."""
    try:
        return (folder / name).read_text()
    except OSError:
        return None


def note_of_job(name: str) -> str | None:
    """Returns the text of a note of this process's job; None = missing, or no job."""
    path = os.environ.get(VARIABLE, "").partition(":")[2]
    return read_note(Path(path), name) if path else None


def leave_job() -> None:
    """Releases this process's lock on the folder of its job; removes the folder if no other process holds a lock."""
    number, _, path = os.environ.pop(VARIABLE, "").partition(":")
    if path:
        try:
            os.close(int(number))
        except (OSError, ValueError):  # the variable was inherited without the descriptor
            return
        _remove_if_free(Path(path))


def remove_abandoned(parent: Path) -> list[Path]:
    """Removes the folders of this user's jobs without running processes; returns them."""
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
