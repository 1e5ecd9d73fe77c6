"""Lists of names of a ROS domain."""

from __future__ import annotations

from collections.abc import Collection, Mapping

from gibson_sim.ros.tools.output import print_line
from gibson_sim.ros.tools.tool import Tool
from gibson_sim.ros.topics.names import is_hidden


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
