"""Program that expands one xacro in a process of its own; ``$(find <package>)`` finds the packages that ``package://`` does.

``python -m gibson_sim.description.xacro_process FILE [NAME:=VALUE ...]`` prints the URDF. Imports nothing of the package but ``mesh_files``.
"""

from __future__ import annotations

import importlib
import resource
import sys
import types
from collections.abc import Callable, Iterator
from pathlib import Path

from gibson_sim.description.mesh_files import package_folders

LIMIT_S = 10
"""Limit of processor time, s: ``${9**9**9}`` never ends."""
LIMIT_BYTES = 2 * 2**30
"""Limit of address space, bytes: ``${'x' * 10**10}`` needs more than a machine has."""
_INDEX = "ament_index_python.packages"
"""Module that xacro uses to find the folder of a package."""


def package_finder(file: Path) -> Callable[[str], str]:
    """Returns a function that returns the folder of a package by its name.

    It also looks beside the packages that it has found.

    Args:
        file: The xacro, absolute.
    """
    beside = [file]

    def folders(package: str) -> Iterator[Path]:
        for place in beside:
            yield from package_folders(package, place)

    def find(package: str) -> str:
        folder = next((folder for folder in folders(package) if folder.is_dir()), None)
        if folder is None:
            # Not an exception, which xacro would print twice.
            raise SystemExit(
                f"error: package {package!r} is not found: it is not beside {file.name} or above it, not in $AMENT_PREFIX_PATH, and no "
                f"Python package; put its folder beside that of {file.name}, or source the workspace that has it"
            )
        if (inside := folder / "package.xml") not in beside:
            beside.append(inside)
        return str(folder.absolute())

    return find


def main() -> None:
    """Expands the file named first on the command line."""
    resource.setrlimit(resource.RLIMIT_CPU, (LIMIT_S, LIMIT_S))
    resource.setrlimit(resource.RLIMIT_AS, (LIMIT_BYTES, LIMIT_BYTES))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    xacro = importlib.import_module("xacro")
    try:
        index = importlib.import_module(_INDEX)
    except ImportError:  # without ROS, xacro lacks only this module
        index = types.ModuleType(_INDEX)
        sys.modules.setdefault(_INDEX.partition(".")[0], types.ModuleType(_INDEX.partition(".")[0]))
        sys.modules[_INDEX] = index
    index.get_package_share_directory = package_finder(Path(sys.argv[1]))  # type: ignore[attr-defined]
    xacro.main()


if __name__ == "__main__":
    main()
