"""Output of the command-line tools, line by line, and lists of names: a reader of a pipe gets each line at once."""

from __future__ import annotations

import sys
from collections.abc import Collection, Mapping
from typing import TYPE_CHECKING

from gibson_sim.ros.topics.names import is_hidden

if TYPE_CHECKING:
    from gibson_sim.ros.tools.tool import Tool


def print_line(text: str = "") -> None:
    """Prints a line of the result on stdout."""
    sys.stdout.write(text + "\n")
    sys.stdout.flush()


def print_error(text: str) -> None:
    """Prints a line about the progress on stderr."""
    sys.stderr.write(text + "\n")
    sys.stderr.flush()


def print_names(tool: Tool, names: Collection[str]) -> None:
    """Prints names, one per line.

    Raises:
        GibsonSimError: there is none, and no simulation runs.
    """
    if not names and not tool.simulation_runs():
        raise tool.missing_simulation()
    for name in names:
        print_line(name)


def without_hidden(names: Mapping[str, list[str]]) -> dict[str, list[str]]:
    """Returns the names that ``ros2`` lists by default, each with its types."""
    return {name: kinds for name, kinds in names.items() if not is_hidden(name)}


def with_types(names: Mapping[str, list[str]], types: bool) -> list[str]:
    """Returns the sorted names, each with its types on request."""
    return [f"{name} [{', '.join(kinds)}]" if types else name for name, kinds in sorted(names.items())]
