"""Program that expands one xacro in a process of its own; ``$(find <package>)`` finds the packages that ``package://`` does.

``python -m gibson_sim.description.xacro_process FILE [NAME:=VALUE ...]`` prints the URDF. Includes of files and packages that are not there are left
out: many descriptions include accessories and Gazebo's plugins that the robot itself does not need. A line of the error output that begins with
``LEFT_OUT`` names them. If the rest cannot be expanded without them, that is the error.

Imports nothing of Gibson Sim but ``packages``.
"""

from __future__ import annotations

import importlib
import os
import re
import resource
import sys
import types
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any
from xml.dom import minidom

from gibson_sim.description.packages import MANIFEST, package_folders, where_looked

LIMIT_S = 10
"""Limit of processor time, s: ``${9**9**9}`` never ends."""
LIMIT_BYTES = 2 * 2**30
"""Limit of address space, bytes: ``${'x' * 10**10}`` needs more than a machine has."""
LEFT_OUT = "left out: "
"""Beginning of the lines of the error output about what a description includes and is not there."""
_INDEX = "ament_index_python.packages"
"""Module that xacro uses to find the folder of a package."""
_NOWHERE = "/package-not-found"
"""Folder, which does not exist, in which missing packages are said to be."""
_UNKNOWN_MACRO = "unknown macro name: "
"""xacro's error about a macro that no file defines, before its name."""
_FOR_SIMULATORS = re.compile(r"gazebo|gz_|_gz|ignition|ros2?_control|transmission|plugin", re.IGNORECASE)
"""Names of macros that add what another simulator needs, and no link."""


class Missing:
    """What a description names and is not there."""

    def __init__(self, file: Path) -> None:
        """Nothing is missing yet.

        Args:
            file: The xacro, absolute.
        """
        self._file = file
        self.packages: list[str] = []
        """Names of the packages that were not found."""
        self.files: list[str] = []
        """Included files that are not there, without those of missing packages."""

    def lines(self) -> list[str]:
        """Returns one line for all packages, and one for each file."""
        names = ", ".join(map(repr, self.packages))
        what = f"package {names} is" if len(self.packages) == 1 else f"packages {names} are"
        return [
            *([f"{what} not found: looked in {where_looked(self._file)}"] if names else []),
            *(f"included file {name} is not there" for name in self.files),
        ]

    def note_file(self, path: str) -> None:
        """Notes an included file that is not there."""
        if not path.startswith(_NOWHERE) and path not in self.files:
            self.files.append(path)


def package_finder(file: Path, missing: Missing) -> Callable[[str], str]:
    """Returns a function that returns the folder of a package by its name; one that does not exist for a package that is missing.

    It also looks beside the packages that it has found.

    Args:
        file: The xacro, absolute.
        missing: Gets the packages that are not found.
    """
    beside = [file]

    def folders(package: str) -> Iterator[Path]:
        for place in beside:
            yield from package_folders(package, place)

    def find(package: str) -> str:
        folder = next((folder for folder in folders(package) if folder.is_dir()), None)
        if folder is None:
            if package not in missing.packages:
                missing.packages.append(package)
            return f"{_NOWHERE}/{package}"
        if (inside := folder / MANIFEST) not in beside:
            beside.append(inside)
        return str(folder.absolute())

    return find


def _tolerate(xacro: Any, file: Path, missing: Missing) -> None:
    """Lets xacro leave out included files, and macros for other simulators, that are not there."""
    parse, call = xacro.parse, xacro.handle_macro_call

    def parse_or_nothing(inp: Any, filename: str | None = None) -> Any:
        if inp is None and filename and filename != str(file) and not os.path.isfile(filename):
            missing.note_file(filename)
            return minidom.parseString("<robot/>")
        return parse(inp, filename)

    def call_or_nothing(node: Any, macros: Any, symbols: Any) -> Any:
        try:
            return call(node, macros, symbols)
        except xacro.XacroException as error:
            unknown = str(error) == f"{_UNKNOWN_MACRO}{node.tagName}"
            if not (unknown and missing.lines() and _FOR_SIMULATORS.search(node.tagName)):
                raise
            xacro.replace_node(node, by=None)
            return True

    xacro.parse, xacro.handle_macro_call = parse_or_nothing, call_or_nothing


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
    file = Path(sys.argv[1])
    missing = Missing(file)
    index.get_package_share_directory = package_finder(file, missing)  # type: ignore[attr-defined]
    _tolerate(xacro, file, missing)
    try:
        xacro.main()
    finally:
        sys.stdout.flush()
        for line in missing.lines():
            sys.stderr.write(f"{LEFT_OUT}{line}\n")


if __name__ == "__main__":
    main()
