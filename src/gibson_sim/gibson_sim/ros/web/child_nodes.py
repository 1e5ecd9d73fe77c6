"""Nodes that a page starts and ends, each in a separate process: a recorder, a task."""

from __future__ import annotations

import os
import signal
import threading
import time
from collections import deque
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from gibson_sim.bags.storage import RESERVE_FILE
from gibson_sim.client_config import RecordConfig, TaskConfig
from gibson_sim.processes.job_folder import VARIABLE as JOB_VARIABLE
from gibson_sim.processes.node_process import PARENT_VARIABLE, command_of, end_node, node_arguments, start_node


class ChildNode:
    """A node in a separate process, which ends with this process, even if this one is killed."""

    def __init__(self, module: str, config: Any, environment: Mapping[str, str] | None = None) -> None:
        """Starts ``gibson_sim.ros.nodes.<module>``; must be called in a thread that lives long, since the child ends with its parent thread.

        Args:
            module: name of the module.
            config: settings of the node.
            environment: environment of the node; None = that of this process.
        """
        base = os.environ if environment is None else environment
        environment = {name: value for name, value in base.items() if name != JOB_VARIABLE}
        self._tail: deque[str] = deque(maxlen=20)
        self._end_requested = False
        command = command_of(module, *node_arguments(config))
        self._process = start_node(command, {**environment, PARENT_VARIABLE: str(os.getpid())})
        self._reader = threading.Thread(target=self._read, name=f"{module}-output", daemon=True)
        self._reader.start()

    def _read(self) -> None:
        assert self._process.stdout is not None
        with self._process.stdout as output:
            for line in output:
                self._tail.append(line.rstrip())

    @property
    def code(self) -> int | None:
        """Exit code; None = the node runs."""
        return self._process.poll()

    @property
    def error(self) -> str:
        """Last error that the node reported; empty = none."""
        self._reader.join(timeout=1.0)
        return next((line.removeprefix("error: ") for line in reversed(self._tail) if line.startswith("error: ")), "")

    def request_end(self) -> None:
        """Sends SIGINT without waiting; a second call does nothing, since a second SIGINT would end the node without closing its files."""
        if self.code is None and not self._end_requested:
            self._end_requested = True
            self._process.send_signal(signal.SIGINT)

    def end(self) -> None:
        """Ends the node, and waits until it has ended."""
        end_node(self._process, interrupted=self._end_requested)


class Recorder:
    """A recording that starts and ends on request, such as a page's: a record node.

    Args:
        environment: environment of the node; None = that of this process.
    """

    def __init__(self, environment: Mapping[str, str] | None = None) -> None:
        self._environment = environment
        self._child: ChildNode | None = None
        self._folder: Path | None = None
        self._start_s: float | None = None
        self._error = ""

    @property
    def running(self) -> bool:
        """Whether a recording runs."""
        return self._child is not None

    def start(self, *, images: bool, folder: Path) -> str:
        """Starts a recording of all topics; returns its folder.

        Args:
            images: whether to record images too, compressed.
            folder: folder of the bag, which must not exist.
        """
        config = RecordConfig(output=str(folder), record_images="compressed" if images else "none", compression="zstd")
        self._child = ChildNode("record_node", config, self._environment)
        self._folder, self._start_s, self._error = folder, None, ""
        return str(folder)

    def stop(self) -> None:
        """Requests the end of the recording; ``page_values``, which is called once a second, reports when it has ended."""
        if self._child is not None:
            self._child.request_end()

    def page_values(self) -> dict[str, Any]:
        """Returns the values for the page: whether it runs, folder, size (bytes), recording time (s of wall time) and the last error."""
        if self._child is not None and self._child.code is not None:
            self._error = self._reason(self._child)
            self._child = None
        if self._start_s is None and self._folder is not None and self._folder.exists():  # the recorder needs seconds to start
            self._start_s = time.monotonic()
        return {
            "on": self.running,
            "folder": "" if self._folder is None else str(self._folder),
            "bytes": _size(self._folder),
            "seconds": round(time.monotonic() - self._start_s) if self.running and self._start_s is not None else None,
            "error": self._error,
        }

    def _reason(self, child: ChildNode) -> str:
        """Returns the reason why an ended recording is incomplete; empty = it is complete."""
        if self._folder is not None and not self._folder.exists() and not child.error:
            return "nothing was recorded: it was stopped before it had begun"
        if self._folder is not None and self._folder.exists() and not (self._folder / "metadata.yaml").exists():
            return f"the recording was cut off: `gibson-sim bag repair {self._folder}` makes it readable"
        return (child.error or f"the recorder ended with code {child.code}") if child.code else ""

    def close(self) -> None:
        """Ends the recording and waits until its bag is closed."""
        if self._child is not None:
            self._child.end()
            self._child = None


def _size(folder: Path | None) -> int:
    try:
        return sum(entry.stat().st_size for entry in folder.iterdir() if entry.name != RESERVE_FILE) if folder is not None else 0
    except OSError:  # the folder does not exist yet, or a file has just been renamed
        return 0


class TaskRunner:
    """The task that a page has started: a task node."""

    def __init__(self) -> None:
        self._child: ChildNode | None = None
        self._error = ""

    @property
    def running(self) -> bool:
        """Whether a task node started by a page runs."""
        return self._child is not None

    def start(self, task: str, baseline: str, seed: int, run: Mapping[str, Any]) -> None:
        """Starts a task; ``run`` has the settings ``scene`` and ``robot`` of the simulation, if they are known."""
        scene, robot = str(run.get("scene", "")), str(run.get("robot", ""))
        self._child = ChildNode(
            "task_node", TaskConfig(task=task, baseline=baseline, seed=seed, scene=scene, robot=robot, timeout=10.0)
        )
        self._error = ""

    def stop(self) -> None:
        """Requests the end of the task node."""
        if self._child is not None:
            self._child.request_end()

    def page_values(self) -> dict[str, Any]:
        """Returns the values for the page: whether the task node runs, and the last error."""
        if self._child is not None and self._child.code is not None:
            self._error = self._child.error if self._child.code else ""
            self._child = None
        return {"running": self.running, "error": self._error}

    def close(self) -> None:
        """Ends the task node."""
        if self._child is not None:
            self._child.end()
            self._child = None
