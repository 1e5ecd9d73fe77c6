"""``make fuzz ARGS="--seconds 3600"``: tries mutants for a while, says what came of them, and keeps those with faults."""

from __future__ import annotations

import argparse
import itertools
import sys
import tempfile
import time
from pathlib import Path

from fuzz.runner import Fuzzer
from fuzz.targets import TARGETS

SERVICES = "services"
"""The target that is a running simulation."""
_REQUESTS = 400
"""Of one simulation; then another one is started."""


def main() -> int:
    """Returns 1 where a mutant has a fault."""
    parser = argparse.ArgumentParser(prog="fuzz", description=__doc__)
    parser.add_argument("--seconds", type=float, default=60.0, help="how long, wall time (default 60)")
    parser.add_argument("--seed", type=int, default=1, help="another one makes other mutants (default 1)")
    parser.add_argument("--first", type=int, default=0, help="number of the first mutant (default 0)")
    parser.add_argument("--count", type=int, default=0, help="mutants of each target; 0 = as many as there is time for")
    parser.add_argument(
        "--targets",
        default=",".join(TARGETS),
        help=f"some of {', '.join(TARGETS)}, separated by commas; or services alone: requests to a running simulation",
    )
    parser.add_argument("--out", type=Path, default=Path("out/fuzz"), help="folder that gets what is found (default out/fuzz)")
    parser.add_argument("--replay", type=Path, help="try a mutant again that lies in a folder below --out")
    args = parser.parse_args()
    with Fuzzer(args.seed, args.out) as fuzzer:
        if args.replay:
            reply = fuzzer.try_folder((args.replay / "target").read_text().strip(), args.replay / "mutant")
            print(
                "\n".join([*reply["faults"], reply.get("error", ""), reply.get("trace", "")]).strip()
                or f"reached {reply['reached']}"
            )
            return 1 if reply["faults"] else 0
        targets = args.targets.split(",")
        unknown = [name for name in targets if name not in (*TARGETS, SERVICES)]
        if unknown:
            parser.error(f"unknown target {', '.join(unknown)}; known: {', '.join((*TARGETS, SERVICES))}")
        if SERVICES in targets:
            return _services(args.seed, args.seconds)
        numbers = range(args.first, args.first + args.count) if args.count else itertools.count(args.first)
        try:
            fuzzer.try_numbers(targets, iter(numbers), time.monotonic() + args.seconds)
        except KeyboardInterrupt:
            pass
        print("\n".join(fuzzer.tally.lines()))
        return 1 if fuzzer.tally.findings else 0


def _services(seed: int, seconds: float) -> int:
    """Fuzzes one simulation after the other; returns 1 where one has a fault."""
    from fuzz import services
    from support.simulation import Listener, new_context

    until, faults = time.monotonic() + seconds, 0
    context = new_context()
    listener = Listener(context)
    try:
        for number in itertools.count(seed):
            with tempfile.TemporaryDirectory(prefix="gibson_fuzz_") as folder:
                sim = services.start(Path(folder))
                try:
                    report = services.ServiceFuzzer(sim, listener, Path(folder), number).run(_REQUESTS, until)
                finally:
                    code = sim.stop()
                print("\n".join([f"seed {number}, exit code {code}", *report.lines()]), flush=True)
                faults += len(report.faults) + (code != 0)
            if time.monotonic() > until:
                return 1 if faults else 0
    finally:
        listener.close()
        context.try_shutdown()
    return 0


if __name__ == "__main__":
    sys.exit(main())
