"""``gibson-sim replay``: replays a recorded run from its settings and inputs, and verifies that the result is the same."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from gibson_sim.bags.digest_comparison import verification_from_json
from gibson_sim.bags.replaying import RunFacts, read_facts
from gibson_sim.cli.console import say
from gibson_sim.cli.environment import add_network, environment_of, require_nodes
from gibson_sim.cli.job import CAMERAS, STATE_TOPIC, Job, check_new_bag, run_job
from gibson_sim.cli.names import check_names
from gibson_sim.cli.options import add_settings, given, settings_from_args
from gibson_sim.cli.parser import ExitCode
from gibson_sim.client_config import RecordConfig, ReplayConfig
from gibson_sim.config import PhysicsConfig, RenderConfig
from gibson_sim.errors import ConfigError, RecordError
from gibson_sim.settings import setting_fields

_PHYSICS = ("scene", "robot", "start", "rate", "seed", "randomise", "randomise_seed", "views", "participant_timeout")
_RENDER = ("egl_device", "egl_uuid", "egl_library", "cameras", "asset_roots", "cache")
"""Settings that may differ from the recorded ones. Inputs are stored by step, so ``step_hz`` and ``publish_hz`` may not."""
_OF_THE_RUN = (
    "summary_path",
    "wait_for",
    "participants",
    "duration",
    "lockstep",
    "pipelined",
    "digests",
    "start_paused",
    "on_timeout",
)
"""Settings of start, end and output of the recorded run, which do not affect its results."""


def add_parser(subparsers: Any) -> None:
    """Adds the sub-command."""
    parser = subparsers.add_parser(
        "replay",
        help="replay a recorded run from its bag, and verify that the result is the same",
        description="Starts the nodes with the settings in the bag, sends its inputs again, and ends where the recorded run ended. "
        "Options override recorded settings.",
    )
    parser.add_argument("bag", metavar="DIR", help="folder of the bag")
    how = parser.add_mutually_exclusive_group()
    how.add_argument(
        "--lockstep",
        action="store_true",
        help="wait for every input before its step; the default if the bag has the topic `inputs`",
    )
    how.add_argument("--free", action="store_true", help="do not wait for inputs; the default for other bags")
    parser.add_argument(
        "--verify", action="store_true", help="compare the digests of every tick with the bag's; exit code 6 if they differ"
    )
    parser.add_argument("--no-render", action="store_true", help="run physics only, without images")
    add_settings(parser, PhysicsConfig, _PHYSICS, default="that of the bag")
    add_settings(parser, RenderConfig, _RENDER, default="that of the bag")
    record = parser.add_argument_group("record")
    record.add_argument("--record", metavar="DIR", help="record the replay into this folder, which must not exist")
    add_settings(record, RecordConfig, ("topics", "record_images", "compression", "reserve_mb"))
    add_network(parser)
    parser.add_argument("--summary", metavar="FILE.json", help="also write the measurements to this file")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Replays the run; returns the exit code."""
    require_nodes()
    facts = read_facts(args.bag)
    _check(args, facts)
    environment = environment_of(args)
    code, reports = run_job(lambda folder: _plan(args, facts, folder), environment)
    return _report(reports.get("replay", {}), code)


def _check(args: argparse.Namespace, facts: RunFacts) -> None:
    """Checks that the bag has inputs or commands, and digests for ``--verify``.

    Raises:
        RecordError: the bag does not contain them.
    """
    if args.verify and not facts.has_digests:
        raise RecordError(f"bag {args.bag} has no digests to compare with: record with `gibson-sim run --digests --record ...`")
    if not (facts.has_journal or facts.has_commands):
        raise RecordError(
            f"bag {args.bag} has nothing to replay: neither `inputs`, nor cmd_vel, joint_trajectory or joint_command of a robot"
        )


def _plan(args: argparse.Namespace, facts: RunFacts, folder: Path) -> Job:
    """Returns the job.

    Raises:
        GibsonSimError: an option is invalid; no process has been started.
    """
    job = Job(folder, summary=Path(args.summary) if args.summary else None)
    lockstep = args.lockstep or (facts.has_journal and not args.free)
    render = not args.no_render and ("render" in facts.settings or not facts.settings)
    waits = {STATE_TOPIC: 1 + render}
    if args.record:
        job.bag, job.keep_bag = Path(args.record), True
        record = {"output": str(job.bag), "summary_path": str(folder / "record.json")}
        settings = settings_from_args(RecordConfig, args, duration=0.0, **record)
        check_new_bag(job.bag, settings.reserve_mb)
        job.configs["record"] = settings
        waits.update(
            {STATE_TOPIC: waits[STATE_TOPIC] + 1, **({CAMERAS: 1} if render and settings.record_images != "none" else {})}
        )
    physics = _settings(PhysicsConfig, facts.settings.get("physics", {}), args, _PHYSICS)
    physics = {
        **physics,
        "lockstep": lockstep,
        "participants": "; ".join(["replay"] + ["render"] * render + ["record"] * bool(args.record)) if lockstep else "",
        "digests": args.verify or bool(args.record),
        "wait_for": ",".join(f"{topic}:{count}" for topic, count in waits.items()),
        "summary_path": str(folder / "physics.json"),
    }
    config = PhysicsConfig.of(**physics)
    check_names(config)
    job.configs["replay"] = ReplayConfig(
        bag=args.bag,
        lockstep=lockstep,
        verify=args.verify,
        images=render,
        step_hz=config.time.step_hz,
        publish_hz=config.time.publish_hz,
        summary_path=str(folder / "replay.json"),
    )
    job.configs["physics"] = config
    if render:  # stopped last, since time waits for it and physics would warn
        drawn = _settings(RenderConfig, facts.settings.get("render", {}), args, _RENDER)
        drawn = {**drawn, "digests": config.topics.digests, "summary_path": str(folder / "render.json")}
        job.configs["render"] = RenderConfig(**drawn)
    return job


def _settings(cls: type[Any], recorded: Mapping[str, Any], args: argparse.Namespace, names: tuple[str, ...]) -> dict[str, Any]:
    """Returns recorded settings, overridden by options.

    Raises:
        ConfigError: the bag has a setting unknown to this version.
    """
    known = {f.name for f in setting_fields(cls)}
    unknown = sorted(recorded.keys() - known)
    if unknown:
        raise ConfigError(
            f"the bag has settings that this version does not know: {', '.join(unknown)}; use the version that recorded it"
        )
    settings = {name: value for name, value in recorded.items() if name not in _OF_THE_RUN}
    return {**settings, **given(args, names)}


def _report(report: Mapping[str, Any], code: int) -> int:
    """Prints the result of the replay; returns the exit code of the command."""
    if not report:
        return code
    what = "inputs at their steps" if report["journal"] or report["lockstep"] else "commands at their times"
    say(f"replay: {report['inputs']} {what}, {'in lockstep' if report['lockstep'] else 'free'}")
    if not report["finished"]:
        epoch, step = report["reached"]
        say(
            f"replay: ended early, in epoch {epoch} at step {step}; the recorded run ended in epoch {report['end'][0]} at {report['end'][1]}"
        )
    if report["verification"] is None:
        return code
    verification = verification_from_json(report["verification"])
    for line in verification.lines():
        say(f"verify: {line}")
    if not verification.is_equal:
        for kind, other in report["other_surroundings"].items():
            for name, (before, now) in other.items():
                say(f"verify: {kind}: {name} is {now}, was {before}")
    return code or (ExitCode.OK if verification.is_equal else ExitCode.REPLAY_DIFFERS)
