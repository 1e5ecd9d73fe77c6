"""Program that expands one xacro in a separate process; ``$(find <package>)`` searches the same places as ``package://``.

``python -m gibson_sim.description.xacro_process FILE [NAME:=VALUE ...]`` prints the URDF. Includes of missing files and packages are left out:
many descriptions include accessories and Gazebo plugins that the robot itself does not need. Lines of standard error that begin with
``LEFT_OUT`` name them. It is an error if the other files cannot be expanded without them.

Imports only ``packages`` of Gibson Sim.
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

from gibson_sim.description.packages import MANIFEST, package_folders, searched_places

LIMIT_S = 10
"""Limit of CPU time, s: ``${9**9**9}`` never ends."""
LIMIT_BYTES = 2 * 2**30
"""Limit of the address space, bytes: ``${'x' * 10**10}`` needs more memory than most machines have."""
LEFT_OUT = "left out: "
"""Prefix of the lines of standard error about missing includes."""
_INDEX = "ament_index_python.packages"
"""Module that xacro uses to find the folder of a package."""
_NOWHERE = "/package-not-found"
"""Nonexistent folder that is returned for missing packages."""
_UNKNOWN_MACRO = "unknown macro name: "
"""Prefix of xacro's error about an undefined macro, before the name of the macro."""
_FOR_SIMULATORS = re.compile(r"gazebo|gz_|_gz|ignition|ros2?_control|transmission|plugin", re.IGNORECASE)
"""Pattern of the names of macros that add elements for other simulators, but no links."""


class Missing:
    """Missing packages and files of a description."""

    def __init__(self, file: Path) -> None:
        """Creates an empty list.

        Args:
            file: The xacro, absolute.
        """
        self._file = file
        self.packages: list[str] = []
        """Names of the missing packages."""
        self.files: list[str] = []
        """Included files that do not exist, except those of missing packages."""

    def lines(self) -> list[str]:
        """Returns one line for all packages, and one for each file."""
        names = ", ".join(map(repr, self.packages))
        what = f"package {names} is" if len(self.packages) == 1 else f"packages {names} are"
        return [
            *([f"{what} not found: looked in {searched_places(self._file)}"] if names else []),
            *(f"included file {name} does not exist" for name in self.files),
        ]

    def add_file(self, path: str) -> None:
        """Records an included file that does not exist."""
        if not path.startswith(_NOWHERE) and path not in self.files:
            self.files.append(path)


def package_finder(file: Path, missing: Missing) -> Callable[[str], str]:
    """Returns a function from the name of a package to its folder, which does not exist for a missing package.

    The function also searches beside the packages that it has already found.

    Args:
        file: The xacro, absolute.
        missing: Receives the missing packages.
    """
    beside = [file]

    def folders(package: str) -> Iterator[Path]:
        for file_beside in beside:
            yield from package_folders(package, file_beside)

    def find(package: str) -> str:
        folder = next((folder for folder in folders(package) if folder.is_dir()), None)
        if folder is None:
            if package not in missing.packages:
                missing.packages.append(package)
            return f"{_NOWHERE}/{package}"
        if (manifest := folder / MANIFEST) not in beside:
            beside.append(manifest)
        return str(folder.absolute())

    return find


def _tolerate(xacro: Any, file: Path, missing: Missing) -> None:
    """Patches xacro to leave out missing included files, and undefined macros for other simulators."""
    parse, call = xacro.parse, xacro.handle_macro_call

    def parse_or_nothing(inp: Any, filename: str | None = None) -> Any:
        if inp is None and filename and filename != str(file) and not os.path.isfile(filename):
            missing.add_file(filename)
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
    """Expands the file in the first command-line argument."""
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
