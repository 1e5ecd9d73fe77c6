"""``gibson-sim bench table2``: visual path following in simulation; the paper's Table 2 is the same measurement with a real robot."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gibson_sim.cli.quiet import quiet
from gibson_sim.cli.report_file import add_report_options, print_progress, write_json
from gibson_sim.cli.workers import add_workers, backend_of
from gibson_sim.errors import ConfigError

if TYPE_CHECKING:
    from gibson_sim_bench.path_following.plan import Table2Plan

DEFAULT_FOLDER = "out/table2"


def add_parser(kinds: Any) -> None:
    """Adds the sub-command."""
    parser = kinds.add_parser(
        "table2",
        help="visual path following in simulation: success, coverage and collisions by method, with confidence intervals",
        description="Runs in lockstep from seeds, in this process or in workers. A second call with the same folder resumes where the first "
        "ended; with more runs, domains or methods it adds them. The results are sim-to-sim, without a real robot.",
    )
    parser.add_argument("--runs", type=int, default=100, metavar="N", help="runs of each case, domain and method (default: 100)")
    parser.add_argument("--cases", default="6.6,8.4,12.7", metavar="A,B", help="lengths of paths, metres (default: 6.6,8.4,12.7)")
    parser.add_argument(
        "--domains",
        default="",
        metavar="A,B",
        help="names of domains, see docs/benchmarks/path_following.md (default: all but development)",
    )
    parser.add_argument(
        "--methods",
        default="",
        metavar="A,B",
        help="oracle, learned, teach_repeat, blind, random (default: all; learned if there is a network); learned and teach_repeat also with "
        "+goggles, +histogram or +grey_world",
    )
    parser.add_argument("--scenes", default="", metavar="A,B", help="scenes (default: those held out from training)")
    parser.add_argument(
        "--paths", type=int, default=10, metavar="N", help="paths of each case, in all scenes together (default: 10)"
    )
    parser.add_argument(
        "--camera", choices=("pinhole", "fisheye_pair"), default="pinhole", help="cameras of the robot (default: pinhole)"
    )
    parser.add_argument("--model", default="", metavar="FILE", help="network of learned, ONNX (default: the one that is shipped)")
    parser.add_argument(
        "--goggles", default="", metavar="FILE", help="network of methods with +goggles, ONNX (default: the one that is shipped)"
    )
    parser.add_argument("--seed", type=int, default=0, help="random seed of paths, conditions and noise (default: 0)")
    parser.add_argument(
        "--folder",
        type=Path,
        default=Path(DEFAULT_FOLDER),
        metavar="DIR",
        help=f"folder of the runs and the page (default: {DEFAULT_FOLDER})",
    )
    parser.add_argument("--no-strips", action="store_true", help="make no film strips")
    parser.add_argument("--report-only", action="store_true", help="run nothing; report the runs in the folder")
    add_workers(parser, "paths")
    add_report_options(parser)
    parser.set_defaults(run=run)


@quiet()
def run(args: argparse.Namespace) -> int:
    """Makes the missing runs, prints the report, and writes page, Markdown and JSON into the folder."""
    from gibson_sim.writing import write_file
    from gibson_sim_bench import timing
    from gibson_sim_bench.path_following.plan import parts_of
    from gibson_sim_bench.path_following.report import report_page, report_text
    from gibson_sim_bench.path_following.store import Store
    from gibson_sim_bench.path_following.strips import write_strips
    from gibson_sim_bench.path_following.table import Table2, cells_of, differences_of

    plan = plan_of(args)
    backend = backend_of(args, "paths", default=1)
    assert backend is not None
    store = Store(args.folder, plan)
    errors = [] if args.report_only else store.run(backend, print_progress)
    results = store.results().values()
    if not results:
        raise ConfigError(f"{args.folder}: holds no run of this plan{f'; {errors[0]}' if errors else ''}")
    planned = len(results) + sum(map(len, store.missing().values()))
    compared = [("learned", "teach_repeat"), *((name, base) for name in plan.methods for base, kind in [parts_of(name)] if kind)]
    found = Table2(
        timing.now(),
        timing.version(),
        timing.machine(),
        timing.cores(),
        plan.as_json(),
        store.policy,
        cells_of(results),
        tuple(one for pair in compared for one in differences_of(results, *pair)),
        planned,
        tuple(errors),
        store.goggles,
    )
    strips = {} if args.no_strips else write_strips(store, results, print_progress)
    write_json(args.folder / "table2.json", found.as_json())
    write_json(args.json, found.as_json())
    write_file(args.folder / "table2.md", report_text(found, markdown=True) + "\n")
    write_file(args.folder / "table2.html", report_page(found, strips, args.folder))
    print(report_text(found, markdown=args.markdown))
    print_progress(f"page: {args.folder / 'table2.html'}")
    return 1 if errors else 0


def plan_of(args: argparse.Namespace) -> Table2Plan:
    """Returns the plan of the options.

    Raises:
        ConfigError: an option is invalid.
    """
    from gibson_sim_bench.path_following.plan import METHODS, Table2Plan, parts_of
    from gibson_sim_bench.path_following.runs import goggles_digest, policy_digest

    default = Table2Plan()
    methods = _words(args.methods) or tuple(name for name in METHODS if name != "learned" or policy_digest(args.model))
    plan = Table2Plan(
        runs=args.runs,
        lengths=tuple(sorted({_metres(text) for text in _words(args.cases)})) or default.lengths,
        domains=_words(args.domains) or default.domains,
        methods=methods,
        scenes=_words(args.scenes) or default.scenes,
        paths=args.paths,
        camera=args.camera,
        seed=args.seed,
        model=str(Path(args.model).absolute()) if args.model else "",
        goggles=str(Path(args.goggles).absolute()) if args.goggles else "",
    )
    parts = {part for name in methods for part in parts_of(name)}
    if "learned" in parts and not policy_digest(args.model):
        raise ConfigError(
            "method learned needs a network: train one with gibson-sim learn path-following, and name it with --model"
        )
    if "goggles" in parts and not goggles_digest(args.goggles):
        raise ConfigError(
            "methods with +goggles need a network: train one with gibson-sim learn goggles, and name it with --goggles"
        )
    return plan


def _words(text: str) -> tuple[str, ...]:
    return tuple(dict.fromkeys(word for word in text.split(",") if word))


def _metres(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise ConfigError(f"--cases: {text!r} must be numbers joined by commas, metres, such as 6.6,8.4,12.7") from None
