"""The parser of every sub-command: what is wrong with a command line is said in one line, with the nearest of what exists."""

from __future__ import annotations

import argparse
import re
import sys
from collections.abc import Iterable, Sequence
from typing import Any, NoReturn

from gibson_sim.cli.exit_codes import ExitCode
from gibson_sim.quoting import quoted
from gibson_sim.settings import nearest

_NEGATIVE = re.compile(r"-([xyz]$|[0-9.])")
"""Axes and numbers, also several with commas."""


class Parser(argparse.ArgumentParser):
    """An ``argparse`` parser; the parsers of its sub-commands are of this class too."""

    def error(self, message: str) -> NoReturn:
        """Ends the process with one line on stderr instead of the usage of all options."""
        print(f"gibson-sim: error: {message}; see `{self.prog} --help`", file=sys.stderr)
        sys.exit(int(ExitCode.USAGE))

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        """Refuses unknown options here, where the known ones are known."""
        words = list(sys.argv[1:] if args is None else args)
        found, rest = super().parse_known_args(self._joined(words), namespace)
        if rest:
            known = [flag for flag in self._option_string_actions if flag.startswith("--")]
            word = rest[0].partition("=")[0]
            hint = nearest(word, known) if word.startswith("-") else ""
            self.error(f"unrecognized arguments: {' '.join(rest)}" + (f"; {hint}" if hint else ""))
        return found, rest

    def _joined(self, words: list[str]) -> list[str]:
        """Returns words with a value that begins with a minus joined to its option, which argparse takes for an option else."""
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
        raise argparse.ArgumentError(action, choice_error(value, action.choices))


def choice_error(value: object, known: Iterable[object]) -> str:
    """Returns what to say of a value that is none of those known."""
    names: Sequence[str] = [str(name) for name in known]
    hint = nearest(str(value), names)
    return f"{quoted(value)} is unknown; {f'{hint} ' if hint else ''}known: {', '.join(names)}"
