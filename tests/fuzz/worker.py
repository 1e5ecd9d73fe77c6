"""Tries mutants in a process of its own, so that a crash or a hang is seen, and survived: one line of JSON in, one out."""

from __future__ import annotations

import faulthandler
import json
import os
import random
import resource
import shutil
import signal
import sys
import time
import traceback
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any, TextIO

_MOST_BYTES = 24 * 2**30
"""Limit of the address space, bytes: the kernel refuses larger allocations, which are then reported."""


def main() -> None:
    """Answers requests until its input ends."""
    replies = os.fdopen(os.dup(1), "w", buffering=1)
    # What libraries print does not belong among the replies.
    os.dup2(2, 1)
    faulthandler.enable()
    faulthandler.register(signal.SIGUSR1, all_threads=True)
    resource.setrlimit(resource.RLIMIT_AS, (_MOST_BYTES, _MOST_BYTES))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    warnings.simplefilter("always")
    serve(sys.stdin, replies)


def serve(requests: TextIO, replies: TextIO) -> None:
    """Answers requests, one a line."""
    _say(replies, {"ready": True})
    for line in requests:
        _say(replies, answer(json.loads(line)))


def _say(replies: TextIO, reply: dict[str, Any]) -> None:
    replies.write(json.dumps(reply) + "\n")
    replies.flush()


def mutator_of(target: str, seed: int, number: int, most: int = sys.maxsize) -> Any:
    """Returns what makes mutant ``number``, with the first ``most`` of its changes; a number below 0 stands for an input without any."""
    from fuzz.grammar import Mutator

    rng = random.Random(f"{target} {seed} {number}")
    made = Mutator(rng, harsh=rng.random() < 0.4)
    if number < 0:
        made.harsh = False
        made.times = lambda: 0  # type: ignore[method-assign]
    made.most = most
    return made


def answer(request: dict[str, Any]) -> dict[str, Any]:
    """Makes a mutant, where it is not there, and tries it: (target, folder) or (target, seed, number, most, folder)."""
    from fuzz.targets import FILES, TARGETS, copy_mutant, write_mutant
    from fuzz.trial import SUSPICIOUS_S

    target, folder = TARGETS[request["target"]], Path(request["folder"])
    if "number" in request:
        shutil.rmtree(folder, ignore_errors=True)
        write_mutant(
            target, mutator_of(request["target"], request["seed"], request["number"], request.get("most", sys.maxsize)), folder
        )
    kept = folder.with_name(folder.name + ".kept")
    copy_mutant(folder, kept, pipe=False)
    outcome = try_mutant(target, folder / FILES)
    if outcome.slowest_s > SUSPICIOUS_S and not outcome.faults:
        # What is done once per process, as compiling shaders, does not count.
        copy_mutant(kept, folder)
        outcome = try_mutant(target, folder / FILES)
    fault = slow_fault(outcome, lambda: _unchanged_s(request["target"], folder.with_name(folder.name + ".unchanged")))
    if fault:
        outcome.faults.append(fault)
    return outcome.to_json()


def slow_fault(outcome: Any, unchanged_s: Callable[[], float]) -> str:
    """Returns why a mutant is too slow; empty if it is not.

    No time is allowed or forbidden by itself, as machines differ and are busy: ``unchanged_s`` measures, only where it is needed, what the
    trial of the unchanged input takes here and now, seconds of processor time.
    """
    from fuzz.trial import SLOW_FACTOR, SUSPICIOUS_S

    if outcome.slowest_s <= SUSPICIOUS_S:
        return ""
    usual_s = unchanged_s()
    if outcome.slowest_s <= SLOW_FACTOR * usual_s:
        return ""
    return f"slow: {outcome.slowest} takes {outcome.slowest_s:.1f} s of processor time, the whole trial without a change {usual_s:.1f} s"


def _unchanged_s(name: str, folder: Path) -> float:
    """Returns the processor time of the trial of the unchanged input of a target, seconds."""
    from fuzz.targets import FILES, TARGETS, write_mutant

    shutil.rmtree(folder, ignore_errors=True)
    write_mutant(TARGETS[name], mutator_of(name, 0, -1), folder)
    begin = time.process_time()
    try_mutant(TARGETS[name], folder / FILES)
    return time.process_time() - begin


def try_mutant(target: Any, files: Path) -> Any:
    """Returns the outcome of one trial."""
    from fuzz.trial import LIMIT_MB, Outcome, Refused, Trial, forget_peak, memory_mb, peak_mb

    trial = Trial(Outcome())
    forget_peak()
    before_mb = memory_mb()
    outcome = trial.outcome
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        try:
            target.run(files, trial)
        except Refused:
            pass
        # Also MemoryError: on another machine the allocation might have succeeded.
        except Exception as error:
            outcome.trace = traceback.format_exc()
            trial.fault(f"foreign exception: {_where(error)}: {type(error).__name__}: {str(error)[:200]}")
    outcome.peak_mb = max(0.0, peak_mb() - before_mb)
    if outcome.peak_mb > LIMIT_MB:
        trial.fault(f"memory: {outcome.peak_mb:.0f} MB, at most {LIMIT_MB:.0f} MB are allowed")
    outcome.warnings = sorted(
        {f"{Path(w.filename).name}:{w.lineno}: {w.category.__name__}: {w.message}" for w in caught if "gibson" in w.filename}
    )
    if trial.times:
        outcome.slowest, outcome.slowest_s = max(trial.times.items(), key=lambda item: item[1])
    return outcome


def _where(error: BaseException) -> str:
    """Returns the innermost place in our code."""
    frames = traceback.extract_tb(error.__traceback__)
    ours = [f for f in frames if "/gibson_sim/" in f.filename] or list(frames)
    return f"{Path(ours[-1].filename).name}:{ours[-1].lineno} ({ours[-1].name})"


if __name__ == "__main__":
    main()
