"""One trial of one mutant: every call of a public function is timed, its errors are judged, and what it took is told."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, TypeVar

from fuzz.grammar import SECRET, SECRET_NUMBER
from gibson_sim.errors import GibsonSimError

T = TypeVar("T")
SUSPICIOUS_S = 10.0
"""Processor time from which on a call is compared with what the unchanged input takes on this machine at that moment, seconds."""
SLOW_FACTOR = 20.0
"""A suspicious call is a fault if it takes more than this many times as long as the whole trial of the unchanged input."""
LIMIT_MB = 600.0
"""Megabytes that a mutant may need for a moment."""
LONGEST_MESSAGE = 5000
"""Characters."""
_MEGA = 2**20


class Refused(Exception):
    """The mutant was refused with an error of ours, as it should be; nothing more can be tried."""


@dataclass(slots=True)
class Outcome:
    """What became of a mutant."""

    reached: str = "refused"
    """refused, loaded, or the last part that it came to: physics, renderer, messages, ..."""
    deep: bool = False
    """It came to physics, to the renderer, or to what the messages of a recording say."""
    faults: list[str] = field(default_factory=list)
    """One line each; none = all is well."""
    warnings: list[str] = field(default_factory=list)
    """Warnings of Python that reached a user, one line each."""
    error: str = ""
    """With what it was refused."""
    slowest: str = ""
    slowest_s: float = 0.0
    peak_mb: float = 0.0
    trace: str = ""

    def to_json(self) -> dict[str, Any]:
        """Returns it as plain types."""
        return asdict(self)


@dataclass(slots=True)
class Trial:
    """Counts what a mutant does."""

    outcome: Outcome = field(default_factory=Outcome)
    times: dict[str, float] = field(default_factory=dict)
    """Processor time of each call, seconds."""

    def call(
        self, name: str, function: Callable[..., T], *args: Any, secret: bool = False, go_on: bool = False, **kwargs: Any
    ) -> T:
        """Calls a public function and returns what it returns.

        Args:
            name: of the call, for people.
            function: what to call.
            args: its arguments.
            secret: its error is told to clients, and must hold nothing of a file.
            go_on: an error does not end the trial: it returns None.
            kwargs: more arguments.

        Raises:
            Refused: it raised an error of ours.
        """
        cpu, wall = time.process_time(), time.monotonic()
        try:
            return function(*args, **kwargs)
        except GibsonSimError as error:
            self.judge(name, error, secret=secret)
            if go_on:
                return None  # type: ignore[return-value]
            raise Refused from error
        finally:
            # Other processes make wall time longer, threads make CPU time longer; what it takes is no more than either.
            took = min(time.process_time() - cpu, time.monotonic() - wall)
            self.times[name] = max(took, self.times.get(name, 0.0))

    def judge(self, name: str, error: GibsonSimError, *, secret: bool) -> None:
        """Looks at the text of an error."""
        text = str(error)
        self.outcome.error = f"{name}: {type(error).__name__}: {text[:300]}"
        if "\n" in text:
            self.fault(f"{name}: the message of {type(error).__name__} has several lines: {text[:200]!r}")
        if len(text) > LONGEST_MESSAGE:
            self.fault(f"{name}: the message of {type(error).__name__} has {len(text)} characters: {text[:200]!r}")
        if not text.strip():
            self.fault(f"{name}: {type(error).__name__} says nothing")
        if secret:
            self.reply(name, text)

    def reply(self, name: str, text: str) -> None:
        """Searches what a client is told for what stands in files."""
        if SECRET in text or str(SECRET_NUMBER) in text:
            self.fault(f"{name}: the reply holds the content of a file: {text[:300]!r}")

    def reach(self, what: str) -> None:
        """Notes that it came so far."""
        self.outcome.reached = what
        self.outcome.deep = self.outcome.deep or what not in ("refused", "loaded")

    def fault(self, text: str) -> None:
        """Notes a fault."""
        self.outcome.faults.append(" ".join(text.split()))


def memory_mb() -> float:
    """Returns the memory that this process has in use."""
    return _status("VmRSS")


def peak_mb() -> float:
    """Returns the most that this process has had in use since ``forget_peak``."""
    return _status("VmHWM")


def forget_peak() -> None:
    """Lets the count of the most begin anew."""
    Path("/proc/self/clear_refs").write_text("5")


def _status(key: str) -> float:
    line = next(line for line in Path("/proc/self/status").read_text().splitlines() if line.startswith(key))
    return int(line.split()[1]) * 1024 / _MEGA
