"""Processes of a test: the simulation and the robot's programs, each with its output in an unnamed file that leaves no trace."""

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
from gibson_sim.processes.domain_lock import DomainLock, domains_in_use
from gibson_sim.processes.job_folder import VARIABLE
from gibson_sim.processes.node_process import PARENT_VARIABLE
from gibson_sim.quoting import quoted
from gibson_sim.testing.contained_process import contained_command
from gibson_sim.testing.settings import PARTICIPANT, SimulationSettings

__tracebackhide__ = True
"""pytest shows the line of the test instead of lines of this module; ``--full-trace`` shows all."""
DOMAINS = "1-101"
"""Default range of ROS domains for tests: those whose ports lie below the kernel's ephemeral ports."""
NODE_VARIABLES = (PARENT_VARIABLE, VARIABLE)
"""Environment variables reserved for the simulation's own nodes."""
_MAX_TAIL = 16_000
"""Size of the end of an output that a report shows, bytes."""
_END_S = 40.0
"""Wall time for a process to end after SIGINT, s."""
_ERROR = re.compile(r"^(?:error: |.*\b(?:ERROR|FATAL)\b[]: ]*)(?P<text>.+)$", re.MULTILINE)
_OWN_WAIT = re.compile(rf"waiting for '{PARTICIPANT}' to finish the tick at [^,]*$")
"""Warning of the simulation that it waits only for the test, which is normal between two calls."""


class OutputFile:
    """Unnamed file for the output of a process; readable at any time."""

    def __init__(self) -> None:
        self._file: IO[bytes] | None = tempfile.TemporaryFile()  # noqa: SIM115 - closed by close
        self._last = ""

    @property
    def stream(self) -> IO[bytes]:
        """File object for ``subprocess.Popen``."""
        assert self._file is not None, "it is closed"
        return self._file

    def text(self) -> str:
        """Returns the end of the output, also after ``close``."""
        if self._file is None:
            return self._last
        size = os.fstat(self._file.fileno()).st_size
        return os.pread(self._file.fileno(), _MAX_TAIL, max(0, size - _MAX_TAIL)).decode(errors="replace")

    def close(self) -> None:
        """Closes the file."""
        if self._file is not None:
            self._last = self.text()
            self._file.close()
            self._file = None


class Program:
    """A program of the robot under test."""

    def __init__(self, command: Sequence[str], environment: Mapping[str, str], folder: Path, *, may_fail: bool = False) -> None:
        """Starts the program.

        Args:
            command: program and arguments, without a shell.
            environment: complete environment.
            folder: working folder.
            may_fail: whether a nonzero exit code is allowed.

        Raises:
            ConfigError: the command is empty, or not a list.
        """
        if isinstance(command, str) or not command or not all(isinstance(word, str | os.PathLike) for word in command):
            raise ConfigError(
                f"the command of a program is {quoted(command)}, must be a list: program and arguments, as for subprocess.Popen"
            )
        self.command = tuple(os.fspath(word) for word in command)
        self.may_fail = may_fail
        self._output = OutputFile()
        self._process = subprocess.Popen(
            contained_command(self.command), env=dict(environment), cwd=folder, stdin=subprocess.DEVNULL, stdout=self._output.stream,
            stderr=subprocess.STDOUT, start_new_session=True,
        )  # fmt: skip

    @property
    def name(self) -> str:
        """The command as one line of limited length."""
        line = " ".join(" ".join(self.command).split())
        return line if len(line) <= 80 else f"{line[:77]}..."

    @property
    def returncode(self) -> int | None:
        """Exit code, 128 + n for signal n; None = the program is running."""
        return self._process.poll()

    @property
    def output(self) -> str:
        """The end of the program's output."""
        return self._output.text()

    def check(self) -> None:
        """Raises GibsonSimError if the program has failed."""
        code = self.returncode
        if code and not self.may_fail:
            last = next((line for line in reversed(self.output.splitlines()) if line.strip()), "it printed nothing")
            raise GibsonSimError(f"the program `{self.name}` ended with code {code}: {last}")

    def stop(self) -> None:
        """Ends the program and its descendants with SIGINT, then SIGTERM and SIGKILL."""
        _end(self._process)
        self._output.close()


class SimulationProcess:
    """A simulation in its own process, which ends with this process."""

    def __init__(
        self, settings: SimulationSettings, environment: Mapping[str, str], folder: Path, bag: Path | None = None
    ) -> None:
        """Starts the simulation.

        Args:
            settings: settings of the simulation.
            environment: complete environment, including ``ROS_DOMAIN_ID``.
            folder: folder to which relative paths in the settings refer.
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
        """Whether the process has ended."""
        return self._process.poll() is not None

    @property
    def log(self) -> str:
        """The end of the log, without warnings that time waits between two calls of the test."""
        return "\n".join(line for line in self._output.text().splitlines() if not _OWN_WAIT.search(line))

    @property
    def waits_for(self) -> str:
        """The last line of the log about what the simulation waits for; empty = none."""
        return next((line for line in reversed(self.log.splitlines()) if "waiting for" in line), "")

    def error(self) -> GibsonSimError:
        """Returns the error with which the simulation ended."""
        errors = [match["text"] for match in _ERROR.finditer(self._output.text())]
        code = self._process.poll()
        text = errors[-1] if errors else _exit_text(code)
        kind = AlreadyRunningError if "a simulation runs in ROS domain" in text else GibsonSimError
        return kind(text)

    def stop(self) -> None:
        """Ends the simulation gracefully, so that its bag is closed."""
        _end(self._process)
        self._output.close()


def _exit_text(code: int | None) -> str:
    """Returns a description of an exit code; negative = the signal, None = the process is running."""
    if code is None:
        return "it is running"
    return f"it ended with code {code}" if code >= 0 else f"it was killed by {signal.Signals(-code).name}"


def _end(process: subprocess.Popen[bytes]) -> None:
    """Sends SIGINT, then SIGKILL if the process does not end; waits for its end."""
    if process.poll() is None:
        process.send_signal(signal.SIGINT)
    deadline = time.monotonic() + _END_S
    while process.poll() is None and time.monotonic() < deadline:
        time.sleep(0.01)
    if process.poll() is None:
        process.kill()
    process.wait()


def free_domains(text: str, begin: int) -> Iterator[int]:
    """Yields the ROS domains of a range in which no simulation is running, from a given position onwards; first those without any node.

    Args:
        text: ``first-last``, or a single number.
        begin: first position in the range, modulo its length; different positions keep processes from trying the same domain.

    Raises:
        ConfigError: the text is not a range within 0 to 231, or a simulation runs in each of its domains.
    """
    first, _, last = text.strip().partition("-")
    if not (first.isdecimal() and (last or first).isdecimal() and int(first) <= int(last or first) <= 231):
        raise ConfigError(f"the ROS domains of simulations are {quoted(text)}, must be a range such as {DOMAINS}, from 0 to 231")
    domains = range(int(first), int(last or first) + 1)
    begin %= len(domains)
    in_use = domains_in_use()
    for domain in sorted([*domains[begin:], *domains[:begin]], key=in_use.__contains__):
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
    """Replaces the environment of this process within a block, so that nodes created in it find the simulation."""
    previous = dict(os.environ)
    _replace_environment({name: text for name, text in environment.items() if name not in NODE_VARIABLES})
    try:
        yield
    finally:
        _replace_environment(previous)


def _replace_environment(variables: Mapping[str, str]) -> None:
    for name in os.environ.keys() - variables.keys():
        del os.environ[name]
    os.environ.update({name: text for name, text in variables.items() if os.environ.get(name) != text})
