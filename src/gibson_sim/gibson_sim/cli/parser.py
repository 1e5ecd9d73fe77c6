"""Argument parser and exit codes of all sub-commands. Errors are one line that names the nearest valid option."""

from __future__ import annotations

import argparse
import difflib
import re
import sys
from collections.abc import Iterable, Sequence
from enum import IntEnum
from typing import Any, NoReturn

from gibson_sim import interrupts
from gibson_sim.quoting import quoted
from gibson_sim.settings import nearest


class ExitCode(IntEnum):
    """Exit codes; ``MEANING`` describes them."""

    OK = 0
    ERROR = 1
    USAGE = 2
    ALREADY_RUNNING = 3
    NODE_DIED = 4
    RECORDING_ENDED_EARLY = 5
    REPLAY_DIFFERS = 6
    INTERRUPTED = interrupts.INTERRUPTED


MEANING = {
    ExitCode.OK: "success; also if an open-ended command (run, record, top, drive) was stopped by Ctrl-C or SIGTERM",
    ExitCode.ERROR: "the command failed: one line on stderr says why; trial: a run failed",
    ExitCode.USAGE: "the command line is invalid",
    ExitCode.ALREADY_RUNNING: "a simulation runs in this ROS domain already; for top: none does",
    ExitCode.NODE_DIED: "a node crashed or was killed",
    ExitCode.RECORDING_ENDED_EARLY: "the run continued, but recording stopped early (disk full); the bag is readable",
    ExitCode.REPLAY_DIFFERS: "replay --verify: the run differs from the recorded one; the report names the first tick and topics",
    ExitCode.INTERRUPTED: "Ctrl-C interrupted the command before it finished or while it started (the process dies of SIGINT, as shells expect)",
}
_MISTAKEN = {
    "--headless": "leave it out: there is no window; --no-render makes no images",
    "--gui": "leave it out: --web serves a page for your browser",
}
"""Option of other simulators -> hint."""
_MISTAKEN_COMMANDS = {
    "pub": "there is no `topic pub`: a robot stops when commands stop, so a single one moves it only for a moment; drive with "
    "`gibson-sim drive forward`, or with a file of lines `linear angular seconds`; send goals with `gibson-sim goal X,Y`"
}
"""Sub-command of other tools -> hint."""
_NEGATIVE = re.compile(r"-([xyz]$|[0-9.])")
"""Pattern of negative axes and numbers, and of lists that begin with one."""


class Parser(argparse.ArgumentParser):
    """An ``argparse`` parser with one-line errors; the parsers of its sub-commands have the same class."""

    def error(self, message: str) -> NoReturn:
        """Exits with one line on stderr, without the usage text."""
        print(f"gibson-sim: error: {message}; see `{self.prog} --help`", file=sys.stderr)
        sys.exit(int(ExitCode.USAGE))

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        """Rejects unknown options in the parser that knows the valid ones, for the hint."""
        words = list(sys.argv[1:] if args is None else args)
        namespace_parsed, rest = super().parse_known_args(self._joined(words), namespace)
        if rest:
            known = [flag for flag in self._option_string_actions if flag.startswith("--")]
            word = rest[0].partition("=")[0]
            hint = _MISTAKEN.get(word) or (_nearest_option(word, known) if word.startswith("-") else "")
            if not hint and "--scene" in known and not word.startswith("-"):
                hint = f"is it a scene? --scene {word}"
            self.error(f"unrecognized arguments: {' '.join(rest)}" + (f"; {hint}" if hint else ""))
        return namespace_parsed, rest

    def _joined(self, words: list[str]) -> list[str]:
        """Joins values that begin with a minus to their options, since argparse would treat them as options."""
        out: list[str] = []
        for word in words:
            action = self._option_string_actions.get(out[-1]) if out else None
            if action is not None and action.nargs is None and _NEGATIVE.match(word) and word not in self._option_string_actions:
                out[-1] = f"{out[-1]}={word}"
            else:
                out.append(word)
        return out

    def _check_value(self, action: argparse.Action, value: Any) -> None:
        if action.choices is None or value in action.choices:
            return
        if isinstance(action, argparse._SubParsersAction) and value in _MISTAKEN_COMMANDS:
            self.error(_MISTAKEN_COMMANDS[value])
        raise argparse.ArgumentError(action, choice_error(value, action.choices))


def _nearest_option(word: str, known: Iterable[str]) -> str:
    """Returns the hint to the most similar option; the dashes, which all options have, do not make two of them similar."""
    matches = difflib.get_close_matches(word.lstrip("-"), [flag.lstrip("-") for flag in known], n=1, cutoff=0.6)
    return f"did you mean {quoted(f'--{matches[0]}')}?" if matches else ""


def choice_error(value: object, known: Iterable[object]) -> str:
    """Returns the error text for an unknown value, with the nearest known one."""
    names: Sequence[str] = [str(name) for name in known]
    hint = nearest(str(value), names)
    return f"{quoted(value)} is unknown; {f'{hint} ' if hint else ''}known: {', '.join(names)}"


def table() -> str:
    """Returns the exit codes as text, one per line."""
    return "exit codes:\n" + "\n".join(f"{int(code):>3}  {text}" for code, text in MEANING.items())
