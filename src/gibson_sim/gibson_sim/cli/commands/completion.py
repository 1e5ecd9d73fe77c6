"""``gibson-sim completion``, and the completions of a command line of ``gibson-sim`` for a shell.

argcomplete speaks the protocols of bash, zsh and fish: the shell runs ``gibson-sim`` itself with the line in the environment. An answer
loads only the command that the line names, and asks a running simulation only for names that it alone knows. It never prints an error:
what cannot be found out has no completions.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import time
from collections.abc import Callable, Iterable, Sequence
from importlib import import_module
from typing import Any, NoReturn

from gibson_sim.cli.environment import domain_of, node_environment
from gibson_sim.cli.parser import Parser
from gibson_sim.cli.registry import COMMANDS, command_modules, scene_command_modules
from gibson_sim.client_config import DRIVES
from gibson_sim.errors import ConfigError, GibsonSimError
from gibson_sim.processes.node_process import command_of
from gibson_sim.resources import cache_folder, known_objects, list_robots, list_scenes
from gibson_sim.writing import write_file

SHELLS = ("bash", "zsh", "fish")
TIMEOUT_S = 5.0
"""Timeout for the names of a running simulation, s of wall time."""
CACHE_S = 10.0
"""Maximum age of cached names of a running simulation, s, so that repeated presses of TAB are fast."""

Completer = Callable[..., Iterable[str]]


def add_parser(subparsers: Any) -> None:
    """Adds the sub-command."""
    parser = subparsers.add_parser(
        "completion",
        help="print a script that lets your shell complete commands, options and names by TAB",
        description='bash and zsh: add the line  eval "$(gibson-sim completion bash)"  to ~/.bashrc, or with zsh to ~/.zshrc. '
        "fish: gibson-sim completion fish > ~/.config/fish/completions/gibson-sim.fish",
    )
    parser.add_argument("shell", choices=SHELLS, help="the shell")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Prints the script."""
    try:
        from argcomplete.shell_integration import shellcode
    except ImportError:
        raise ConfigError("completion needs the package argcomplete: pip install argcomplete") from None
    print(shellcode(["gibson-sim"], shell=args.shell))
    return 0


def answer() -> NoReturn:
    """Prints the completions for the shell that runs this process, and exits."""
    try:
        from argcomplete.finders import CompletionFinder

        line = os.environ["COMP_LINE"].encode()[: int(os.environ["COMP_POINT"])].decode(errors="ignore")
        words = line.split()[1:]
        parser = _parser(words if line[-1:].isspace() else words[:-1])
        _attach(parser)
        CompletionFinder()(parser, always_complete_options=False)
    except (Exception, SystemExit):
        pass  # a shell that completes has no place for errors
    os._exit(1)


def _parser(words: Sequence[str]) -> argparse.ArgumentParser:
    """Returns a parser with the command at the beginning of the completed words of a line, and only the names of the others."""
    parser = Parser(prog="gibson-sim")
    parser.add_argument("--version", action="store_true", help="print the version")
    modules = (
        command_modules()
        if not words or words[0] not in COMMANDS
        else {words[0]: f"gibson_sim.cli.commands.{COMMANDS[words[0]]}"}
    )
    _add_named(parser.add_subparsers(), modules, words)
    return parser


def _add_named(subparsers: Any, modules: dict[str, str], words: Sequence[str]) -> None:
    """Adds the sub-command at the beginning of ``words``, importing only its module; without one, the names of all sub-commands."""
    if not words:
        for name in modules:
            subparsers.add_parser(name, help="")
    elif words[0] == "scene":
        _add_named(subparsers.add_parser("scene").add_subparsers(), scene_command_modules(), words[1:])
    elif words[0] in modules:
        import_module(modules[words[0]]).add_parser(subparsers)


def _attach(parser: argparse.ArgumentParser) -> None:
    """Sets the completers of the arguments of a parser and of its sub-commands."""
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for below in action.choices.values():
                _attach(below)
        elif action.nargs != 0 and not hasattr(action, "completer"):
            completer = _completer_of(action)
            if completer is not None:
                action.completer = completer  # type: ignore[attr-defined]


def _completer_of(action: argparse.Action) -> Completer | None:
    """Returns the completer of an argument; None = files."""
    suggestions = getattr(action, "suggestions", ())
    if suggestions:
        return lambda **_: suggestions
    if action.metavar == "ENTITY":
        return _reported("entities")
    if action.dest in _COMPLETERS and action.type in (None, str):
        return _COMPLETERS[action.dest]
    return _nothing if action.type in (int, float) else None


def _nothing(**_: Any) -> Iterable[str]:
    """Returns no completions, for numbers."""
    return ()


def _names(listed: Callable[[], list[str]]) -> Completer:
    """Returns a completer for names of resources, and for files, which are also allowed."""

    def complete(prefix: str, **_: Any) -> Iterable[str]:
        from argcomplete.completers import FilesCompleter

        names = [name for name in listed() if name.startswith(prefix)]
        return names or FilesCompleter()(prefix)

    return complete


def _reported(kind: str) -> Completer:
    """Returns a completer for names that a running simulation reports."""

    def complete(prefix: str, parsed_args: argparse.Namespace, **_: Any) -> Iterable[str]:
        names = _names_of_simulation(parsed_args).get(kind, [])
        return names if prefix.startswith("/") or not prefix else [*names, *(name.removeprefix("/") for name in names)]

    return complete


def _parameters(prefix: str, parsed_args: argparse.Namespace, **_: Any) -> Iterable[str]:
    """Returns the parameters of the node that precedes them on the line."""
    node = str(getattr(parsed_args, "node", "") or "")
    by_node: dict[str, list[str]] = _names_of_simulation(parsed_args).get("parameters", {}) if node else {}
    return by_node.get(f"/{node.removeprefix('/')}", [])


_COMPLETERS: dict[str, Completer] = {
    "scene": _names(list_scenes), "scenes": _names(list_scenes), "world": _names(list_scenes), "robot": _names(list_robots),
    "uri": _names(lambda: [*known_objects(), *list_robots()]), "topic": _reported("topics"), "topics": _reported("topics"),
    "service": _reported("services"), "action": _reported("actions"), "node": _reported("nodes"), "name": _parameters,
    "drive": _names(lambda: list(DRIVES)),
}  # fmt: skip
"""Name of an argument -> completer."""


def _names_of_simulation(args: argparse.Namespace) -> dict[str, Any]:
    """Returns the names in the ROS domain of the line: ``topics``, ``services``, ``actions``, ``nodes``, ``entities``, ``parameters``."""
    environment = node_environment(domain_id=getattr(args, "domain_id", None), reach=getattr(args, "reach", None))
    cache = cache_folder("completion") / f"{domain_of(environment)}-{os.getuid()}.json"
    try:
        if 0.0 <= time.time() - cache.stat().st_mtime < CACHE_S:
            return dict(json.loads(cache.read_text()))
    except (OSError, ValueError):
        pass
    command = command_of("tools.main", json.dumps({"command": "names"}))
    done = subprocess.run(
        command, env=environment, stdin=subprocess.DEVNULL, capture_output=True, text=True, timeout=TIMEOUT_S, check=True
    )
    completions = dict(json.loads(done.stdout.splitlines()[-1]))
    if not completions["nodes"]:
        return completions  # no simulation, or none yet
    try:
        cache.parent.mkdir(parents=True, exist_ok=True)
        write_file(cache, json.dumps(completions), durable=False)
    except (OSError, GibsonSimError):
        pass  # found again at the next press
    return completions
