"""``gibson-sim``: the command line, its sub-commands and exit codes."""

from __future__ import annotations

import argparse
import os
import sys
from importlib import import_module

from gibson_sim import __version__
from gibson_sim.cli.parser import ExitCode, Parser, choice_error, table
from gibson_sim.cli.registry import COMMANDS, command_modules, not_installed
from gibson_sim.errors import AlreadyRunningError, GibsonSimError, missing_package
from gibson_sim.interrupts import Interruptible
from gibson_sim.writing import cannot_write, is_disk_error

EPILOG = f"""\
{table()}

first steps:
  gibson-sim run --web                    both nodes, the default scene, and a page for your browser
  gibson-sim drive keyboard               in a second terminal
  gibson-sim run --scene DIR --drive tour --duration 30 --record out/tour --video out/tour.mp4
  gibson-sim doctor                       what works on this machine, and how to fix what does not
"""


def run(words: list[str]) -> int:
    """Runs a sub-command and returns the exit code; errors are one line on stderr.

    Raises:
        SystemExit: the words are not a valid command line, or request help or the version.
    """
    try:
        args = _parser(words).parse_args(words)
    except ImportError as error:
        return int(_fail_import(error))
    interruptible = Interruptible()
    try:
        with interruptible:
            code = args.run(args)
            sys.stdout.flush()
    except AlreadyRunningError as error:
        code = _fail(error, ExitCode.ALREADY_RUNNING)
    except GibsonSimError as error:
        code = ExitCode.INTERRUPTED if interruptible.was_interrupted else _fail(error, ExitCode.ERROR)
    except BrokenPipeError:  # `gibson-sim params | head`
        sys.stderr.close()
        code = ExitCode.OK
    except KeyboardInterrupt:
        code = ExitCode.INTERRUPTED
    except OSError as error:
        if interruptible.was_interrupted:
            code = ExitCode.INTERRUPTED
        elif not is_disk_error(error):
            raise
        else:
            _discard_output()
            code = _fail(cannot_write(error.filename, error), ExitCode.ERROR)
    except Exception as error:
        if interruptible.was_interrupted:
            code = ExitCode.INTERRUPTED
        elif isinstance(error, ImportError):
            code = _fail_import(error)
        else:
            raise
    return int(code)


def _discard_output() -> None:
    """Discards buffered output that cannot be written, which would otherwise raise again at the end of the process."""
    try:
        sys.stdout.flush()
    except OSError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _fail_import(error: ImportError) -> ExitCode:
    """Prints the name of the package that is not installed; re-raises the error if the import failed for another reason."""
    problem = missing_package(error)
    if problem is None:
        raise error
    return _fail(problem, ExitCode.ERROR)


def _fail(error: GibsonSimError, code: ExitCode) -> ExitCode:
    print(f"gibson-sim: error: {error}", file=sys.stderr)
    return code


def _parser(words: list[str]) -> argparse.ArgumentParser:
    """Returns the parser of the sub-command at the beginning of ``words``, or of all sub-commands.

    Imports only the module of that command, since the launcher needs neither PyBullet nor OpenGL.
    """
    parser = Parser(
        prog="gibson-sim",
        description="A ROS 2 simulation server for indoor robots.",
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action="version", version=f"gibson-sim {__version__}")
    command = words[0] if words else ""
    modules = {command: f"gibson_sim.cli.commands.{COMMANDS[command]}"} if command in COMMANDS else command_modules()
    missing = not_installed(words)
    if missing:
        parser.error(missing)
    if command and command not in modules and not command.startswith("-"):
        parser.error(f"command {choice_error(command, modules)}")
    subparsers = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")
    selected = [modules[command]] if command in modules else [] if command == "--version" else modules.values()
    for module in dict.fromkeys(selected):
        import_module(module).add_parser(subparsers)
    return parser
