"""``gibson-sim``: the command line."""

from __future__ import annotations

import argparse
import sys

from gibson_sim import __version__
from gibson_sim.cli import bag, bench, clients, compare, doctor, env, export, gallery, params, render, replay, run, scene, top
from gibson_sim.cli.exit_codes import ExitCode, table
from gibson_sim.errors import AlreadyRunningError, GibsonSimError

EPILOG = f"""\
{table()}

first steps:
  gibson-sim run                          both nodes, our own flat
  gibson-sim drive keyboard               in a second terminal
  gibson-sim run --scene DIR --drive tour --duration 30 --record out/tour --video out/tour.mp4
  gibson-sim doctor                       what works on this machine, and how to mend what does not
"""


def main(argv: list[str] | None = None) -> None:
    """Runs a sub-command and ends the process with its exit code; errors are one line on stderr."""
    parser = _parser()
    args = parser.parse_args(argv)
    try:
        code = args.run(args)
    except AlreadyRunningError as error:
        code = _fail(error, ExitCode.ALREADY_RUNNING)
    except GibsonSimError as error:
        code = _fail(error, ExitCode.ERROR)
    except BrokenPipeError:  # `gibson-sim params | head`
        sys.stderr.close()
        code = ExitCode.OK
    except KeyboardInterrupt:
        code = ExitCode.OK
    sys.exit(int(code))


def _fail(error: GibsonSimError, code: ExitCode) -> ExitCode:
    print(f"gibson-sim: error: {error}", file=sys.stderr)
    return code


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="gibson-sim",
        description="A ROS 2 simulation server for indoor robots.",
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action="version", version=f"gibson-sim {__version__}")
    subparsers = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")
    run.add_parser(subparsers)
    clients.add_parsers(subparsers)
    for command in (bag, bench, compare, doctor, env, export, gallery, params, render, replay, scene, top):
        command.add_parser(subparsers)
    return parser


if __name__ == "__main__":
    main()
