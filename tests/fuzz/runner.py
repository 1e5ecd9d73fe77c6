"""Runs mutants in workers, watches them, counts, and keeps what it finds in a folder that can be tried again."""

from __future__ import annotations

import json
import os
import re
import select
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import Any

from fuzz.targets import copy_mutant

HANG_S = 300.0
"""Wall time after which a worker counts as hung: longer than anything takes on a busy machine."""
MUTANTS_OF_A_WORKER = 400
"""Then another one begins: what leaks is seen, and does no harm."""
LEAK_MB = 500.0
"""By so much a worker may grow over its life."""
_TESTS = Path(__file__).resolve().parents[1]


_MOST_CHANGES = 9
"""So many are tried one after the other to make a mutant smaller."""


def _kind(reply: dict[str, Any]) -> str:
    """Returns what kind of fault it is: up to the numbers."""
    return re.split(r"\d", str(reply["faults"][0]))[0]


class Worker:
    """A process that tries mutants."""

    def __init__(self, log: Path) -> None:
        """Starts it; ``log`` gets what it prints, a stack at a crash."""
        self.log, self.tried = log, 0
        path = os.pathsep.join([str(_TESTS), *filter(None, [os.environ.get("PYTHONPATH")])])
        with log.open("wb") as out:
            self._process = subprocess.Popen(
                [sys.executable, "-m", "fuzz.worker"],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=out,
                env={**os.environ, "PYTHONPATH": path},
            )
        self._waiting = b""
        self.reply(HANG_S)

    def ask(self, **request: Any) -> None:
        """Sends a request."""
        assert self._process.stdin is not None
        self.tried += 1
        try:
            self._process.stdin.write(json.dumps(request).encode() + b"\n")
            self._process.stdin.flush()
        except BrokenPipeError:
            pass

    def reply(self, patience_s: float) -> dict[str, Any]:
        """Returns its reply; of one that crashed or hangs, what became of it as ``died``."""
        assert self._process.stdout is not None
        deadline, descriptor = time.monotonic() + patience_s, self._process.stdout.fileno()
        while b"\n" not in self._waiting:
            ready, _, _ = select.select([descriptor], [], [], max(0.0, deadline - time.monotonic()))
            if not ready:
                self._process.send_signal(signal.SIGUSR1)
                time.sleep(1.0)
                self.close()
                return {"died": f"hang: no answer within {patience_s:.0f} s"}
            data = os.read(descriptor, 1 << 16)
            if not data:
                code = self._process.wait()
                name = signal.Signals(-code).name if code < 0 else f"exit code {code}"
                return {"died": f"crash: the process ended with {name}"}
            self._waiting += data
        line, _, self._waiting = self._waiting.partition(b"\n")
        reply: dict[str, Any] = json.loads(line)
        return reply

    @property
    def memory_mb(self) -> float:
        """What it has in use."""
        try:
            lines = Path(f"/proc/{self._process.pid}/status").read_text().splitlines()
        except OSError:
            return 0.0
        return next((int(line.split()[1]) / 1024 for line in lines if line.startswith("VmRSS")), 0.0)

    @property
    def alive(self) -> bool:
        """Whether it runs."""
        return self._process.poll() is None

    def close(self) -> None:
        """Ends it."""
        self._process.kill()
        self._process.wait()
        for pipe in (self._process.stdin, self._process.stdout):
            if pipe is not None:
                pipe.close()


@dataclass(slots=True)
class Finding:
    """A mutant with a fault."""

    target: str
    number: int
    faults: list[str]
    folder: Path | None = None


@dataclass(slots=True)
class Tally:
    """What was tried, and what came of it."""

    tried: Counter[str] = field(default_factory=Counter)
    loaded: Counter[str] = field(default_factory=Counter)
    deep: Counter[str] = field(default_factory=Counter)
    """Mutants that came to physics, to the renderer, or to what messages say."""
    slowest_s: dict[str, float] = field(default_factory=dict)
    peak_mb: dict[str, float] = field(default_factory=dict)
    warnings: Counter[str] = field(default_factory=Counter)
    refusals: Counter[str] = field(default_factory=Counter)
    findings: list[Finding] = field(default_factory=list)

    def add(self, target: str, reply: dict[str, Any]) -> None:
        """Counts a reply."""
        self.tried[target] += 1
        self.loaded[target] += reply.get("reached", "refused") != "refused"
        self.deep[target] += bool(reply.get("deep"))
        self.slowest_s[target] = max(self.slowest_s.get(target, 0.0), reply.get("slowest_s", 0.0))
        self.peak_mb[target] = max(self.peak_mb.get(target, 0.0), reply.get("peak_mb", 0.0))
        self.warnings.update(reply.get("warnings", ()))

    @property
    def deep_share(self) -> float:
        """Which share of all mutants came deep."""
        return sum(self.deep.values()) / max(1, sum(self.tried.values()))

    def lines(self) -> list[str]:
        """Returns a table for people."""
        rows = ["target     mutants  loaded    deep  slowest (s)  most memory (MB)"]
        for name, count in self.tried.items():
            rows.append(
                f"{name:10} {count:7d} {self.loaded[name] / count:7.0%} {self.deep[name] / count:7.0%}"
                f" {self.slowest_s[name]:12.2f} {self.peak_mb[name]:17.0f}"
            )
        rows.append(f"all        {sum(self.tried.values()):7d} {'':7} {self.deep_share:7.0%}")
        rows += [f"warning, {count} times: {text}" for text, count in self.warnings.most_common(20)]
        rows += [
            f"FAULT {f.target} {f.number}: {fault}" + (f" [{f.folder}]" if f.folder else "")
            for f in self.findings
            for fault in f.faults
        ]
        return [*rows, f"{len(self.findings)} mutants with faults"]


class Fuzzer:
    """Tries mutants one after the other in one worker at a time."""

    def __init__(self, seed: int, out: Path | None) -> None:
        """Makes it ready.

        Args:
            seed: with target and number it decides every mutant.
            out: folder that gets the findings; None = they are not kept.
        """
        self.seed, self.out, self.tally = seed, out, Tally()
        self._temporary = tempfile.TemporaryDirectory(prefix="gibson_fuzz_")
        self._top = Path(self._temporary.name)
        self._worker: Worker | None = None
        self._at_start_mb = 0.0

    def __enter__(self) -> Fuzzer:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        if self._worker is not None:
            self._worker.close()
        self._temporary.cleanup()

    def try_numbers(self, targets: Sequence[str], numbers: Iterator[int], until: float = float("inf")) -> None:
        """Tries each number on each target, until a time of the monotonic clock."""
        for number in numbers:
            for target in targets:
                if time.monotonic() > until:
                    return
                self.try_one(target, number)

    def try_one(self, target: str, number: int) -> dict[str, Any]:
        """Tries one mutant and counts it."""
        folder = self._top / "mutant"
        reply = self._asked(target=target, seed=self.seed, number=number, folder=str(folder))
        self.tally.add(target, reply)
        if reply["faults"]:
            self._keep(target, number, self._with_fewer_changes(target, number, reply, folder), folder)
        self._retire()
        return reply

    def _with_fewer_changes(self, target: str, number: int, reply: dict[str, Any], folder: Path) -> dict[str, Any]:
        """Returns the reply to the mutant with the fewest of its first changes that has the same kind of fault; it lies in the folder then."""
        for most in (*range(_MOST_CHANGES), sys.maxsize):
            fewer = self._asked(target=target, seed=self.seed, number=number, folder=str(folder), most=most)
            if fewer["faults"] and _kind(fewer) == _kind(reply):
                return fewer
        return reply

    def try_folder(self, target: str, folder: Path) -> dict[str, Any]:
        """Tries a mutant that was kept, on a copy of it."""
        copy = self._top / "mutant"
        copy_mutant(folder, copy)
        return self._asked(target=target, folder=str(copy))

    def _asked(self, **request: Any) -> dict[str, Any]:
        if self._worker is None or not self._worker.alive:
            self._worker = Worker(self._top / "worker.log")
            self._at_start_mb = 0.0
        self._worker.ask(**request)
        reply = self._worker.reply(HANG_S)
        if "died" in reply:
            stack = self._worker.log.read_text(errors="replace")[-6000:]
            self._worker.close()
            self._worker = None
            return {"faults": [reply["died"]], "trace": stack, "reached": "crash"}
        return reply

    def _retire(self) -> None:
        """Ends a worker that has tried enough; one that grew too much is a finding."""
        worker = self._worker
        if worker is None:
            return
        if worker.tried == MUTANTS_OF_A_WORKER // 4:
            self._at_start_mb = worker.memory_mb
        if worker.tried >= MUTANTS_OF_A_WORKER:
            grown = worker.memory_mb - self._at_start_mb
            if grown > LEAK_MB:
                self.tally.findings.append(
                    Finding("all", -1, [f"leak: the worker grew by {grown:.0f} MB over {worker.tried} mutants"])
                )
            worker.close()
            self._worker = None

    def _keep(self, target: str, number: int, reply: dict[str, Any], folder: Path) -> None:
        finding = Finding(target, number, reply["faults"])
        self.tally.findings.append(finding)
        kept = folder.with_name(folder.name + ".kept")
        if self.out is None or not (kept.exists() or folder.exists()):
            return
        finding.folder = self.out / f"{target}_{self.seed}_{number}"
        copy_mutant(kept if kept.exists() else folder, finding.folder / "mutant", pipe=False)
        text = "\n".join([*reply["faults"], "", reply.get("error", ""), "", reply.get("trace", "")])
        (finding.folder / "finding.txt").write_text(text, errors="backslashreplace")
        (finding.folder / "target").write_text(target)
