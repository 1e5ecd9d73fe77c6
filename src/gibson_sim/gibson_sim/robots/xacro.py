"""Turns descriptions that are not yet plain URDF into it: xacro files, and ``$(optenv NAME default)``.

The xacro package does its work in a process of its own: it finds ROS packages by environment variables, which are this process's alone.
"""

from __future__ import annotations

import hashlib
import os
import re
import subprocess
import sys
import tempfile
import xml.etree.ElementTree as ET
from collections.abc import Mapping
from importlib.util import find_spec
from pathlib import Path

from gibson_sim.errors import RobotError
from gibson_sim.resources import cache_folder
from gibson_sim.robots.mesh_files import package_folders, resolve_mesh

_XACRO = b"<xacro:"
_NO_ELEMENTS = re.compile(rb"<!--.*?-->|<!\[CDATA\[.*?\]\]>|<\?.*?\?>", re.DOTALL)
_OPTIONAL = re.compile(rb"\$\(optenv\s+\w+\s*([^)]*)\)")
_FIND = re.compile(r"\$\(find\s+([A-Za-z0-9_\-]+)\s*\)")
_UNKNOWN_PACKAGE = re.compile(r"package '([^']+)' not found")
_TIMEOUT_S = 120.0


def is_xacro(text: str | bytes, top: ET.Element | None = None) -> bool:
    """Returns whether a description has elements that only xacro understands: includes, properties, calls of macros.

    Their prefix tells: the namespace that it stands for is not the same everywhere, and a part of a file often names none.

    Args:
        text: the XML.
        top: of it; None = it is not well-formed.
    """
    data = text.encode("utf-8", errors="replace") if isinstance(text, str) else text
    if top is None or _XACRO not in data:
        return _XACRO in data
    return _XACRO in _NO_ELEMENTS.sub(b"", data)


def with_defaults(text: bytes) -> bytes:
    """Returns a description with the default in the place of every ``$(optenv NAME default)``.

    The environment does not count: a robot is the same wherever it runs, and who may spawn robots need not see variables.
    """
    return _OPTIONAL.sub(rb"\1", text)


def plain_description(path: Path, arguments: Mapping[str, str]) -> Path:
    """Returns a plain URDF: the file itself, or what it expands to, in a file of the cache, whose meshes have absolute names.

    Args:
        path: A URDF or a xacro.
        arguments: Of the xacro: name and value.

    Raises:
        RobotError: the file cannot be read, the xacro package is not installed, or it refuses the file; one line.
    """
    try:
        data = path.read_bytes()
    except FileNotFoundError as error:
        raise RobotError(f"no URDF at {path}") from error
    except OSError as error:
        raise RobotError(f"{path}: cannot be read: {error.strerror}") from error
    xacro = path.suffix.lower() == ".xacro" or _is_xacro_file(data)
    if arguments and not xacro:
        raise RobotError(f"{path}: xacro_args are given, but this is no xacro")
    if not xacro and not _OPTIONAL.search(data):
        return path
    expanded = _with_absolute_meshes(_expanded(path, arguments) if xacro else with_defaults(data), path)
    return _kept(expanded, path)


def published_description(path: Path) -> str:
    """Returns a URDF as other programs can read it: meshes with relative names, which only its own folder explains, have absolute ones."""
    data = path.read_bytes()
    relative = re.search(rb"""filename\s*=\s*["'](?!\w+://|/)""", data)
    return (_with_absolute_meshes(data, path, relative_only=True) if relative else data).decode("utf-8")


def _is_xacro_file(data: bytes) -> bool:
    try:
        return is_xacro(data, ET.fromstring(data))
    except (ET.ParseError, ValueError, LookupError):
        return is_xacro(data)


def _expanded(path: Path, arguments: Mapping[str, str]) -> bytes:
    """Returns what the xacro package makes of a file."""
    if find_spec("xacro") is None:
        raise RobotError(
            f"{path.absolute()}: is a xacro; install what expands it (pip install xacro), or expand it yourself: "
            f"xacro {path.name} > robot.urdf"
        )
    words = [str(path.absolute()), *(f"{key}:={value}" for key, value in arguments.items())]
    with tempfile.TemporaryDirectory(prefix="gibson_sim_xacro_") as folder:
        wanted = sorted(set(_FIND.findall(path.read_text(encoding="utf-8", errors="replace"))))
        offered: set[str] = set()
        while True:
            for package in wanted:
                _offer(package, path.absolute(), Path(folder))
            offered.update(wanted)
            done = _run(words, Path(folder), path)
            if not done.returncode:
                return done.stdout
            said = done.stderr.decode(errors="replace")
            # Files that it includes name more packages.
            wanted = [name for name in _UNKNOWN_PACKAGE.findall(said) if name not in offered]
            if not wanted:
                raise RobotError(f"{path}: xacro refuses it: {_reason(said)}")


def _run(words: list[str], prefix: Path, path: Path) -> subprocess.CompletedProcess[bytes]:
    given = os.environ.get("AMENT_PREFIX_PATH", "")
    environment = {**os.environ, "AMENT_PREFIX_PATH": f"{prefix}{os.pathsep}{given}" if given else str(prefix)}
    command = [sys.executable, "-c", "import xacro; xacro.main()", *words]
    try:
        return subprocess.run(command, env=environment, capture_output=True, timeout=_TIMEOUT_S, check=False)
    except subprocess.TimeoutExpired as error:
        raise RobotError(f"{path}: xacro was not done after {_TIMEOUT_S:g} s; do its macros call each other?") from error


def _offer(package: str, beside: Path, prefix: Path) -> None:
    """Lets ``$(find <package>)`` find a package where ``package://`` does."""
    folder = next((folder for folder in package_folders(package, beside) if folder.is_dir()), None)
    if folder is None:
        return
    index = prefix / "share" / "ament_index" / "resource_index" / "packages"
    index.mkdir(parents=True, exist_ok=True)
    (index / package).touch()
    (prefix / "share" / package).symlink_to(folder.absolute())


def _reason(said: str) -> str:
    """Returns the line that says what is wrong: the first one, of a traceback the last one."""
    lines = [line.strip() for line in said.splitlines() if line.strip()]
    if not lines:
        return "it gives no reason"
    return lines[-1] if lines[0].startswith("Traceback") else lines[0].removeprefix("error: ")


def _with_absolute_meshes(data: bytes, path: Path, *, relative_only: bool = False) -> bytes:
    """Returns a URDF whose meshes and textures have absolute names: it will be read elsewhere. Those that are missing keep theirs."""
    try:
        top = ET.fromstring(data)
    except (ET.ParseError, ValueError, LookupError) as error:
        raise RobotError(f"{path}: is not XML: {error}") from error
    for element in (*top.iter("mesh"), *top.iter("texture")):
        name = element.get("filename", "")
        if not name or (relative_only and ("://" in name or name.startswith("/"))):
            continue
        found = resolve_mesh(name, path.absolute())
        if found is not None:
            element.set("filename", found.as_uri())
    text: bytes = ET.tostring(top, encoding="utf-8", xml_declaration=True)
    return text


def _kept(data: bytes, path: Path) -> Path:
    """Returns a file of the cache with this content; equal ones share it."""
    name = path.name.split(".")[0] or "robot"
    file = cache_folder("robots") / hashlib.sha256(data).hexdigest()[:24] / f"{name}.urdf"
    if file.is_file() and file.read_bytes() == data:
        return file
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        half = file.with_name(f"{file.name}.{os.getpid()}")
        half.write_bytes(data)
        half.replace(file)
    except OSError as error:
        raise RobotError(f"{file}: cannot be written: {error.strerror}; set XDG_CACHE_HOME to a folder that can") from error
    return file
