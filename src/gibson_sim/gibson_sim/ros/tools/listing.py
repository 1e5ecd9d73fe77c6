"""Lists of names of a ROS domain."""

from __future__ import annotations

from collections.abc import Collection, Mapping

from gibson_sim.ros.tools.output import print_line
from gibson_sim.ros.tools.tool import Tool


def print_names(tool: Tool, names: Collection[str]) -> None:
    """Prints names, one per line.

    Raises:
        GibsonSimError: there is none, and no simulation runs.
    """
    if not names and not tool.simulation_runs():
        raise tool.missing_simulation()
    for name in names:
        print_line(name)


def with_types(names: Mapping[str, list[str]], types: bool) -> list[str]:
    """Returns the sorted names, each with its types on request."""
    return [f"{name} [{', '.join(kinds)}]" if types else name for name, kinds in sorted(names.items())]
