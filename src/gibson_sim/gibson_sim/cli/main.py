"""``gibson-sim``: the command line."""

from __future__ import annotations

import argparse
import sys
from importlib import import_module

from gibson_sim import __version__
from gibson_sim.cli.exit_codes import ExitCode, table
from gibson_sim.errors import AlreadyRunningError, GibsonSimError

MODULE_OF = {
    "run": "run", "drive": "clients", "record": "clients", "snapshot": "clients", "bag": "bag", "bench": "bench", "compare": "compare",
    "demo": "demo", "doctor": "doctor", "env": "env", "export": "export", "gallery": "gallery", "params": "params", "render": "render",
    "replay": "replay", "scene": "scene", "task": "task", "top": "top",
}  # fmt: skip
"""Sub-command -> module of this package that has it. Only that module is loaded: a launcher needs neither PyBullet nor OpenGL."""
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
    words = sys.argv[1:] if argv is None else argv
    args = _parser(words[0] if words else "").parse_args(words)
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


def _parser(command: str) -> argparse.ArgumentParser:
    """Returns the parser of a sub-command, or of all where it is none."""
    parser = argparse.ArgumentParser(
        prog="gibson-sim",
        description="A ROS 2 simulation server for indoor robots.",
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action="version", version=f"gibson-sim {__version__}")
    subparsers = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")
    for module in dict.fromkeys([MODULE_OF[command]] if command in MODULE_OF else MODULE_OF.values()):
        import_module(f"gibson_sim.cli.{module}").add_parser(subparsers)
    return parser


if __name__ == "__main__":
    main()
