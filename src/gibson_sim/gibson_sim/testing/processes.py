"""Processes of a test: the simulation and the robot's programs, each with its output in a file without a name, so that nothing is left of it."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import IO

from gibson_sim.errors import AlreadyRunningError, ConfigError, GibsonSimError
from gibson_sim.processes.domain_lock import DomainLock
from gibson_sim.processes.job_folder import VARIABLE
from gibson_sim.processes.node_process import PARENT_VARIABLE
from gibson_sim.quoting import quoted
from gibson_sim.testing.contained_process import contained
from gibson_sim.testing.settings import PARTICIPANT, SimulationSettings

__tracebackhide__ = True
"""pytest shows the line of the test, not those of this module; ``--full-trace`` shows all."""
DOMAINS = "1-101"
"""ROS domains that tests use by default: those whose ports lie below the ones that Linux hands out to others."""
OF_THE_NODES = (PARENT_VARIABLE, VARIABLE)
"""Variables that only the simulation's own nodes may have."""
_MOST_TAIL = 16_000
"""Bytes of an output that a report shows."""
_END_S = 40.0
"""Wall time within which a process that was asked to end must have ended, s."""
_ERROR = re.compile(r"^(?:error: |.*\b(?:ERROR|FATAL)\b[]: ]*)(?P<text>.+)$", re.MULTILINE)
_OWN_WAIT = re.compile(rf"waiting for '{PARTICIPANT}' to finish the tick at [^,]*$")
"""Warning of the simulation that it waits for the test alone, as it should between two calls."""


class OutputFile:
    """Receives the output of a process; can be read at any time."""

    def __init__(self) -> None:
        self._file: IO[bytes] | None = tempfile.TemporaryFile()  # noqa: SIM115 - closed by close
        self._last = ""

    @property
    def stream(self) -> IO[bytes]:
        """For ``subprocess.Popen``."""
        assert self._file is not None, "it is closed"
        return self._file

    def text(self) -> str:
        """Returns the end of what was written, also once it is closed."""
        if self._file is None:
            return self._last
        size = os.fstat(self._file.fileno()).st_size
        return os.pread(self._file.fileno(), _MOST_TAIL, max(0, size - _MOST_TAIL)).decode(errors="replace")

    def close(self) -> None:
        """Frees the file."""
        if self._file is not None:
            self._last = self.text()
            self._file.close()
            self._file = None


class Program:
    """A program of the robot under test."""

    def __init__(self, command: Sequence[str], environment: Mapping[str, str], folder: Path, *, may_fail: bool = False) -> None:
        """Starts it.

        Args:
            command: the program and its arguments, without a shell.
            environment: all of its variables.
            folder: in which it runs.
            may_fail: whether it may end with an exit code other than 0.

        Raises:
            ConfigError: the command is empty, or a text.
        """
        if isinstance(command, str) or not command or not all(isinstance(word, str | os.PathLike) for word in command):
            raise ConfigError(
                f"the command of a program is {quoted(command)}, must be a list: program and arguments, as for subprocess.Popen"
            )
        self.command = tuple(os.fspath(word) for word in command)
        self.may_fail = may_fail
        self._output = OutputFile()
        self._process = subprocess.Popen(
            contained(self.command), env=dict(environment), cwd=folder, stdin=subprocess.DEVNULL, stdout=self._output.stream,
            stderr=subprocess.STDOUT, start_new_session=True,
        )  # fmt: skip

    @property
    def name(self) -> str:
        """The command as one line of limited length."""
        line = " ".join(" ".join(self.command).split())
        return line if len(line) <= 80 else f"{line[:77]}..."

    @property
    def returncode(self) -> int | None:
        """Exit code, 128 + n for signal n; None = it runs."""
        return self._process.poll()

    @property
    def output(self) -> str:
        """The end of what it printed."""
        return self._output.text()

    def check(self) -> None:
        """Raises GibsonSimError if it has failed."""
        code = self.returncode
        if code and not self.may_fail:
            last = next((line for line in reversed(self.output.splitlines()) if line.strip()), "it printed nothing")
            raise GibsonSimError(f"the program `{self.name}` ended with code {code}: {last}")

    def stop(self) -> None:
        """Ends it and all that it started: by SIGINT, and then by SIGTERM and SIGKILL."""
        _end(self._process)
        self._output.close()


class SimulationProcess:
    """A simulation in a process of its own, which ends with this one."""

    def __init__(
        self, settings: SimulationSettings, environment: Mapping[str, str], folder: Path, bag: Path | None = None
    ) -> None:
        """Starts it.

        Args:
            settings: of the simulation.
            environment: its variables, ``ROS_DOMAIN_ID`` among them.
            folder: from which relative paths in the settings count.
            bag: folder of the recording; None = none.
        """
        command = [sys.executable, "-m", "gibson_sim.testing.headless_main", str(os.getpid()), settings.to_text()]
        self._output = OutputFile()
        self._process = subprocess.Popen(
            [*command, *([str(bag)] if bag else [])], env=dict(environment), cwd=folder, stdin=subprocess.DEVNULL,
            stdout=self._output.stream, stderr=subprocess.STDOUT, start_new_session=True,
        )  # fmt: skip

    @property
    def has_ended(self) -> bool:
        """Whether it does not run any more."""
        return self._process.poll() is not None

    @property
    def log(self) -> str:
        """The end of its log, without warnings that time stands still between two calls of the test."""
        return "\n".join(line for line in self._output.text().splitlines() if not _OWN_WAIT.search(line))

    @property
    def waits_for(self) -> str:
        """The last line of its log that says what it waits for; empty if there is none."""
        return next((line for line in reversed(self.log.splitlines()) if "waiting for" in line), "")

    def error(self) -> GibsonSimError:
        """Returns the error with which it ended."""
        found = [match["text"] for match in _ERROR.finditer(self._output.text())]
        code = self._process.poll()
        text = found[-1] if found else _ending(code)
        kind = AlreadyRunningError if "a simulation runs in ROS domain" in text else GibsonSimError
        return kind(text)

    def stop(self) -> None:
        """Ends it in order: its bag is closed."""
        _end(self._process)
        self._output.close()


def _ending(code: int | None) -> str:
    """Returns how a process ended by its exit code, negative for a signal; None = it runs."""
    if code is None:
        return "it runs"
    return f"it ended with code {code}" if code >= 0 else f"it was killed by {signal.Signals(-code).name}"


def _end(process: subprocess.Popen[bytes]) -> None:
    """Sends SIGINT, and SIGKILL to a process that does not obey; waits for its end."""
    if process.poll() is None:
        process.send_signal(signal.SIGINT)
    deadline = time.monotonic() + _END_S
    while process.poll() is None and time.monotonic() < deadline:
        time.sleep(0.01)
    if process.poll() is None:
        process.kill()
    process.wait()


def free_domains(text: str, begin: int) -> Iterator[int]:
    """Yields the ROS domains of a range in which no simulation runs at the moment, beginning somewhere in it.

    Args:
        text: ``first-last``, or one number.
        begin: place in the range at which to begin, modulo its length: processes that begin apart rarely try the same domain.

    Raises:
        ConfigError: the text is no range from 0 to 231, or a simulation runs in each of its domains.
    """
    first, _, last = text.strip().partition("-")
    if not (first.isdecimal() and (last or first).isdecimal() and int(first) <= int(last or first) <= 231):
        raise ConfigError(f"the ROS domains of simulations are {quoted(text)}, must be a range such as {DOMAINS}, from 0 to 231")
    domains = range(int(first), int(last or first) + 1)
    for offset in range(len(domains)):
        domain = domains[(begin + offset) % len(domains)]
        try:
            DomainLock(domain).close()
        except AlreadyRunningError:
            continue
        yield domain
    raise ConfigError(
        f"a simulation runs in each of the ROS domains {text}: stop one, or allow more by the option simulation_domains"
    )


@contextmanager
def variables_set(environment: Mapping[str, str]) -> Iterator[None]:
    """Makes the variables of this process those of an environment in a block, so that nodes made in it find the simulation."""
    before = dict(os.environ)
    _change_variables({name: text for name, text in environment.items() if name not in OF_THE_NODES})
    try:
        yield
    finally:
        _change_variables(before)


def _change_variables(to: Mapping[str, str]) -> None:
    for name in os.environ.keys() - to.keys():
        del os.environ[name]
    os.environ.update({name: text for name, text in to.items() if os.environ.get(name) != text})
