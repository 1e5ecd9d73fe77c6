"""Turns descriptions that are not yet plain URDF into it: xacro files, and ``$(optenv NAME default)``.

The xacro package does its work in a process of its own (``xacro_process``), which may be stopped, and in which alone it finds packages as we do.
"""

from __future__ import annotations

import hashlib
import os
import re
import signal
import subprocess
import sys
import tempfile
import xml.etree.ElementTree as ET
from collections.abc import Mapping
from importlib.util import find_spec
from pathlib import Path

from gibson_sim.description.mesh_files import resolve_mesh
from gibson_sim.description.xacro_process import LIMIT_S
from gibson_sim.errors import RobotError, TextError
from gibson_sim.quoting import clipped
from gibson_sim.reading import is_file, parse_xml, read_file
from gibson_sim.resources import cache_folder

_XACRO = b"<xacro:"
_NO_ELEMENTS = {b"<!--": b"-->", b"<![CDATA[": b"]]>", b"<?": b"?>"}
"""What holds text that looks like elements: its beginning, and its end."""
# None of these goes back over what it has read: a file of strangers may be made to let it.
_NO_ELEMENT = re.compile(b"|".join(re.escape(begin) for begin in _NO_ELEMENTS))
_OPTIONAL = re.compile(rb"\$\(optenv\s+\w+(?:\s([^()]*))?\)")
_ARGUMENT = re.compile(rb"<xacro:arg\s([^<>]*)")
_ARGUMENT_NAME = re.compile(rb"""name\s*=\s*["'](\w+)["']""")
_TIMEOUT_S = 60.0
"""Wall time; ``xacro_process`` ends itself after ``LIMIT_S`` of processor time."""
_MODULE = "gibson_sim.description.xacro_process"
"""Program that expands a xacro."""
_LONGEST_REASON = 1000
_MOST_SAID = 65536
"""Bytes of what xacro says that are looked at."""
_ERRORS = ("error: ", "XML parsing error: ")
"""How xacro begins the line of an error."""


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
    at = 0
    while (begin := _NO_ELEMENT.search(data, at)) is not None:
        if _XACRO in data[at : begin.start()]:
            return True
        mark = _NO_ELEMENTS[begin[0]]
        end = data.find(mark, begin.end())
        if end < 0:
            return False
        at = end + len(mark)
    return _XACRO in data[at:]


def with_defaults(text: bytes) -> bytes:
    """Returns a description with the default in the place of every ``$(optenv NAME default)``.

    The environment does not count: a robot is the same wherever it runs, and who may spawn robots need not see variables.
    """
    return _OPTIONAL.sub(lambda found: (found[1] or b"").lstrip(), text)


def plain_description(path: Path, arguments: Mapping[str, str]) -> Path:
    """Returns a plain URDF: the file itself, or what it expands to, in a file of the cache, whose meshes have absolute names.

    Args:
        path: A URDF or a xacro.
        arguments: Of the xacro: name and value.

    Raises:
        RobotError: the file cannot be read, the xacro package is not installed, or it refuses the file; one line.
    """
    try:
        data = read_file(path)
    except FileNotFoundError as error:
        raise RobotError(f"no URDF at {path}") from error
    except OSError as error:
        raise RobotError(f"{path}: cannot be read: {error.strerror}") from error
    xacro = path.suffix.lower() == ".xacro" or _is_xacro_file(data)
    if arguments and not xacro:
        raise RobotError(f"{path}: xacro_args are given, but this is no xacro")
    if not xacro and not _OPTIONAL.search(data):
        return path
    return keep_description(_expanded(path, arguments) if xacro else with_defaults(data), path)


def published_description(path: Path) -> str:
    """Returns a URDF as other programs can read it: meshes with relative names, which only its own folder explains, have absolute ones."""
    data = read_file(path)
    relative = re.search(rb"""filename\s*=\s*["'](?!\w+://|/)""", data)
    return (_with_absolute_meshes(data, path, relative_only=True) if relative else data).decode("utf-8")


def _is_xacro_file(data: bytes) -> bool:
    try:
        return is_xacro(data, parse_xml(data))
    except TextError:
        return is_xacro(data)


def _expanded(path: Path, arguments: Mapping[str, str]) -> bytes:
    """Returns what the xacro package makes of a file."""
    if find_spec("xacro") is None:
        raise RobotError(
            f"{path.absolute()}: is a xacro; install what expands it (pip install xacro), or expand it yourself: "
            f"xacro {path.name} > robot.urdf"
        )
    words = [str(path.absolute()), *(f"{key}:={value}" for key, value in arguments.items())]
    # Away from the current folder, whose files could stand for modules.
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(os.path.abspath(entry) for entry in sys.path if entry)}
    command = [sys.executable, "-m", _MODULE, *words]
    try:
        done = subprocess.run(command, env=environment, cwd=os.sep, capture_output=True, timeout=_TIMEOUT_S, check=False)
    except subprocess.TimeoutExpired as error:
        raise RobotError(f"{path}: xacro was not done after {_TIMEOUT_S:g} s; do its macros call each other?") from error
    if done.returncode == -signal.SIGXCPU:
        raise RobotError(f"{path}: xacro was not done after {LIMIT_S} s; do its macros call each other?")
    if done.returncode:
        reason = clipped(_reason(done.stderr[-_MOST_SAID:].decode(errors="replace")), _LONGEST_REASON)
        raise RobotError(f"{path}: xacro refuses it: {reason}{_takes(path, arguments, reason)}")
    _check_robot(path, done.stdout)
    return done.stdout


def _check_robot(path: Path, data: bytes) -> None:
    """Refuses what a xacro expands to where it is no robot, with the name of the xacro; who reads it says what else is wrong."""
    try:
        top = parse_xml(data)
    except TextError:
        return
    if top.tag == "sdf":
        raise RobotError(f"{path}: expands to an SDF model, which is spawned as a body; give a URDF or a xacro of one")
    if top.find("link") is None:
        raise RobotError(f"{path}: expands to no <link>; if it has macros alone, give the xacro that calls them")


def _takes(path: Path, arguments: Mapping[str, str], reason: str) -> str:
    """Returns what to say of arguments that a xacro has and that it was not given; nothing where a package is lacking."""
    try:
        found = [_ARGUMENT_NAME.search(argument) for argument in _ARGUMENT.findall(read_file(path))]
    except OSError:
        return ""
    declared = [name[1].decode(errors="replace") for name in found if name is not None]
    lacking = [name for name in dict.fromkeys(declared) if name not in arguments]
    if not lacking or "package " in reason:
        return ""
    names = ", ".join(lacking[:8])
    how = "gibson-sim scene robot FILE --xacro-arg NAME:=VALUE --write robot.yaml"
    return f"; it takes the arguments {names}: give them as xacro_args in a robot.yaml: {how}"


def _reason(said: str) -> str:
    """Returns the line that says what is wrong: the error, which warnings may precede; of a traceback the last line."""
    lines = [line.strip() for line in said.splitlines() if line.strip()]
    if not lines:
        return "it gives no reason"
    error = next((line for line in lines if line.startswith(_ERRORS)), None)
    return (error or lines[-1 if lines[0].startswith("Traceback") else 0]).removeprefix("error: ")


def _with_absolute_meshes(data: bytes, path: Path, *, relative_only: bool = False) -> bytes:
    """Returns a URDF whose meshes and textures have absolute names: it will be read elsewhere. Those that are missing keep theirs."""
    try:
        top = parse_xml(data)
    except TextError as error:
        raise RobotError(f"{path}: {error}").telling(error.public) from error
    for element in (*top.iter("mesh"), *top.iter("texture")):
        name = element.get("filename", "")
        if not name or (relative_only and ("://" in name or name.startswith("/"))):
            continue
        found = resolve_mesh(name, path.absolute())
        if found is not None:
            element.set("filename", found.as_uri())
    text: bytes = ET.tostring(top, encoding="utf-8", xml_declaration=True)
    return text


def keep_description(data: bytes, path: Path) -> Path:
    """Returns a file of the cache with a URDF that was made from the one at ``path``, its meshes with absolute names; equal ones share it.

    Raises:
        RobotError: it is no XML, or cannot be written.
    """
    data = _with_absolute_meshes(data, path)
    name = path.name.split(".")[0] or "robot"
    file = cache_folder("robots") / hashlib.sha256(data).hexdigest()[:24] / f"{name}.urdf"
    if is_file(file) and file.read_bytes() == data:
        return file
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        # In a folder of its own: other threads and processes may write the same robot.
        with tempfile.TemporaryDirectory(dir=file.parent, prefix=".half_") as folder:
            half = Path(folder) / file.name
            half.write_bytes(data)
            half.replace(file)
    except OSError as error:
        raise RobotError(f"{file}: cannot be written: {error.strerror}; set XDG_CACHE_HOME to a folder that can") from error
    return file
