"""Expands xacro files and ``$(optenv NAME default)`` to plain URDF.

The xacro package runs in a process of its own (``xacro_process``), which can be stopped, and in which it finds packages as ``package://`` does.
"""

from __future__ import annotations

import hashlib
import logging
import os
import re
import signal
import subprocess
import sys
import tempfile
import xml.etree.ElementTree as ET
from collections.abc import Mapping, Sequence
from functools import lru_cache
from importlib.util import find_spec
from pathlib import Path

from gibson_sim.description.mesh_files import resolve_mesh
from gibson_sim.description.xacro_process import LEFT_OUT, LIMIT_S
from gibson_sim.errors import RobotError, TextError
from gibson_sim.quoting import clipped
from gibson_sim.reading import is_file, parse_xml, read_file
from gibson_sim.resources import cache_folder

logger = logging.getLogger(__name__)

_XACRO = b"<xacro:"
_SECTIONS_WITHOUT_ELEMENTS = {b"<!--": b"-->", b"<![CDATA[": b"]]>", b"<?": b"?>"}
"""Begin and end of sections whose text is no elements."""
# None of these patterns backtracks: an untrusted file could exploit that.
_SECTION = re.compile(b"|".join(re.escape(begin) for begin in _SECTIONS_WITHOUT_ELEMENTS))
_OPTIONAL = re.compile(rb"\$\(optenv\s+\w+(?:\s([^()]*))?\)")
_ARGUMENT = re.compile(rb"<xacro:arg\s([^<>]*)")
_ARGUMENT_NAME = re.compile(rb"""name\s*=\s*["'](\w+)["']""")
_TIMEOUT_S = 60.0
"""Wall-time limit, s; ``xacro_process`` ends itself after ``LIMIT_S`` of processor time."""
_MODULE = "gibson_sim.description.xacro_process"
"""Program that expands a xacro."""
_LONGEST_REASON = 1000
"""Characters of an error that a message quotes."""
_MAX_OUTPUT = 65536
"""Bytes at the end of xacro's output that are searched for its error."""
_ERRORS = ("error: ", "XML parsing error: ")
"""Beginnings of the lines in which xacro reports an error."""


def is_xacro(text: str | bytes, top: ET.Element | None = None) -> bool:
    """Returns whether a description has xacro elements: includes, properties, calls of macros.

    They are recognised by their prefix: its namespace is not the same everywhere, and a part of a file often declares none.

    Args:
        text: The XML.
        top: Its outermost element; None = it is not well-formed.
    """
    data = text.encode("utf-8", errors="replace") if isinstance(text, str) else text
    if top is None or _XACRO not in data:
        return _XACRO in data
    at = 0
    while (begin := _SECTION.search(data, at)) is not None:
        if _XACRO in data[at : begin.start()]:
            return True
        mark = _SECTIONS_WITHOUT_ELEMENTS[begin[0]]
        end = data.find(mark, begin.end())
        if end < 0:
            return False
        at = end + len(mark)
    return _XACRO in data[at:]


def with_defaults(text: bytes) -> bytes:
    """Returns a description with every ``$(optenv NAME default)`` replaced by its default.

    The environment does not count: a robot is the same wherever it runs, and clients that spawn robots must not read variables.
    """
    return _OPTIONAL.sub(lambda found: (found[1] or b"").lstrip(), text)


def plain_description(path: Path, arguments: Mapping[str, str]) -> Path:
    """Returns a plain URDF: the file itself, or its expansion in a file of the cache, whose meshes have absolute names.

    Args:
        path: A URDF or a xacro.
        arguments: Arguments of the xacro: name and value.

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
    """Returns a URDF for other programs: mesh names relative to its folder become absolute."""
    data = read_file(path)
    relative = re.search(rb"""filename\s*=\s*["'](?!\w+://|/)""", data)
    return (_with_absolute_meshes(data, path, relative_only=True) if relative else data).decode("utf-8")


def _is_xacro_file(data: bytes) -> bool:
    try:
        return is_xacro(data, parse_xml(data))
    except TextError:
        return is_xacro(data)


def _expanded(path: Path, arguments: Mapping[str, str]) -> bytes:
    """Returns the expansion of a file by the xacro package."""
    if find_spec("xacro") is None:
        raise RobotError(
            f"{path.absolute()}: is a xacro; install what expands it (pip install xacro), or expand it yourself: "
            f"xacro {path.name} > robot.urdf"
        )
    words = [str(path.absolute()), *(f"{key}:={value}" for key, value in arguments.items())]
    # Not in the current folder, whose files could shadow modules.
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(os.path.abspath(entry) for entry in sys.path if entry)}
    command = [sys.executable, "-m", _MODULE, *words]
    try:
        done = subprocess.run(command, env=environment, cwd=os.sep, capture_output=True, timeout=_TIMEOUT_S, check=False)
    except subprocess.TimeoutExpired as error:
        raise RobotError(f"{path}: xacro was not done after {_TIMEOUT_S:g} s; do its macros call each other?") from error
    if done.returncode == -signal.SIGXCPU:
        raise RobotError(f"{path}: xacro was not done after {LIMIT_S} s; do its macros call each other?")
    output = done.stderr[-_MAX_OUTPUT:].decode(errors="replace").splitlines()
    left_out = [line.removeprefix(LEFT_OUT) for line in output if line.startswith(LEFT_OUT)]
    if done.returncode:
        reason = clipped(_reason([line for line in output if not line.startswith(LEFT_OUT)]), _LONGEST_REASON)
        missing = "".join(f"{line}; without it " for line in left_out)
        raise RobotError(f"{path}: {missing}xacro refuses it: {reason}{_missing_arguments(path, arguments)}")
    _check_robot(path, done.stdout, left_out)
    for line in left_out:
        _warn_once(f"{path.name}: {line}; what it includes from there is left out")
    return done.stdout


def _check_robot(path: Path, data: bytes, left_out: Sequence[str]) -> None:
    """Raises RobotError, with the name of the xacro, if it expands to no robot; the reader of the URDF reports other errors."""
    try:
        top = parse_xml(data)
    except TextError:
        return
    if top.tag == "sdf":
        raise RobotError(f"{path}: expands to an SDF model, which is spawned as a body; give a URDF or a xacro of one")
    if top.find("link") is None:
        missing = "".join(f"{line}; without it the file " for line in left_out)
        raise RobotError(f"{path}: {missing}expands to no <link>; if it has macros alone, give the xacro that calls them")


def _missing_arguments(path: Path, arguments: Mapping[str, str]) -> str:
    """Returns the part of a message about arguments of a xacro that were not given."""
    try:
        found = [_ARGUMENT_NAME.search(argument) for argument in _ARGUMENT.findall(read_file(path))]
    except OSError:
        return ""
    declared = [name[1].decode(errors="replace") for name in found if name is not None]
    missing = [name for name in dict.fromkeys(declared) if name not in arguments]
    if not missing:
        return ""
    names = ", ".join(missing[:8])
    how = "gibson-sim scene robot --new FILE --xacro-arg NAME:=VALUE"
    return f"; it takes the arguments {names}: give them as xacro_args in a robot.yaml: {how}"


@lru_cache(maxsize=256)
def _warn_once(line: str) -> None:
    """Logs a warning, once in a process: a robot is expanded each time that it is loaded."""
    logger.warning("%s", line)


def _reason(output: Sequence[str]) -> str:
    """Returns the line with the error, which warnings may precede; the last line of a traceback."""
    lines = [line.strip() for line in output if line.strip()]
    if not lines:
        return "it gives no reason"
    error = next((line for line in lines if line.startswith(_ERRORS)), None)
    return (error or lines[-1 if lines[0].startswith("Traceback") else 0]).removeprefix("error: ")


def _with_absolute_meshes(data: bytes, path: Path, *, relative_only: bool = False) -> bytes:
    """Returns a URDF with absolute names of meshes and textures, for a copy in another folder; missing files keep their names."""
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
    """Writes a URDF made from the one at ``path`` to the cache, with absolute mesh names, and returns the file; equal ones share it.

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
        # Written in a folder of its own, since other threads and processes may write the same robot.
        with tempfile.TemporaryDirectory(dir=file.parent, prefix=".half_") as folder:
            half = Path(folder) / file.name
            half.write_bytes(data)
            half.replace(file)
    except OSError as error:
        raise RobotError(f"{file}: cannot be written: {error.strerror}; set XDG_CACHE_HOME to a folder that can") from error
    return file
