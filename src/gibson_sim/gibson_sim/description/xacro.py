"""Expands xacro files and ``$(optenv NAME default)`` to plain URDF.

The xacro package runs in a separate process (``xacro_process``), which can be stopped, and which finds packages in the same places as
``package://``.
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
from gibson_sim.reading import is_file, parse_xml, read_file, without_default_namespace
from gibson_sim.resources import cache_folder

logger = logging.getLogger(__name__)

_XACRO = b"<xacro:"
_SECTIONS_WITHOUT_ELEMENTS = {b"<!--": b"-->", b"<![CDATA[": b"]]>", b"<?": b"?>"}
"""Begin -> end of sections whose text does not contain elements."""
# These patterns must not backtrack, which an untrusted file could exploit.
_SECTION = re.compile(b"|".join(re.escape(begin) for begin in _SECTIONS_WITHOUT_ELEMENTS))
_OPTIONAL = re.compile(rb"\$\(optenv\s+\w+(?:\s([^()]*))?\)")
_ARGUMENT = re.compile(rb"<xacro:arg\s([^<>]*)")
_ARGUMENT_NAME = re.compile(rb"""name\s*=\s*["'](\w+)["']""")
_TIMEOUT_S = 60.0
"""Wall-time limit, s; ``xacro_process`` exits after ``LIMIT_S`` of CPU time."""
_MODULE = "gibson_sim.description.xacro_process"
"""Module that expands a xacro, run as a program."""
_LONGEST_REASON = 1000
"""Maximum length of an error that a message quotes, characters."""
_MAX_OUTPUT = 65536
"""Maximum size of the end of xacro's output that is searched for its error, bytes."""
_ERRORS = ("error: ", "XML parsing error: ")
"""Prefixes of the lines in which xacro reports an error."""


def is_xacro(text: str | bytes, top: ET.Element | None = None) -> bool:
    """Returns whether a description has xacro elements: includes, properties, macro calls.

    They are recognised by their prefix, since the namespace varies, and included files often do not declare it.

    Args:
        text: The XML.
        top: Its outermost element; None = the XML is not well-formed.
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

    The environment is ignored: a robot must not depend on the machine, and clients that spawn robots must not read variables.
    """
    return _OPTIONAL.sub(lambda match: (match[1] or b"").lstrip(), text)


def plain_description(path: Path, arguments: Mapping[str, str]) -> Path:
    """Returns the path of a plain URDF: the file itself, or its expansion in the cache, whose mesh paths are absolute.

    Args:
        path: A URDF or a xacro.
        arguments: Argument name of the xacro -> value.

    Raises:
        RobotError: the file cannot be read, the xacro package is not installed, or it rejects the file; one line.
    """
    try:
        data = read_file(path)
    except FileNotFoundError as error:
        raise RobotError(f"no URDF at {path}") from error
    except OSError as error:
        raise RobotError(f"{path}: cannot be read: {error.strerror}") from error
    xacro = path.suffix.lower() == ".xacro" or _is_xacro_file(data)
    if arguments and not xacro:
        raise RobotError(f"{path}: xacro_args are given, but this is not a xacro")
    if not xacro and not _OPTIONAL.search(data):
        return path
    return cache_description(_expand(path, arguments) if xacro else with_defaults(data), path)


def published_description(path: Path) -> str:
    """Returns the text of a URDF for other programs, with relative mesh paths made absolute."""
    data = read_file(path)
    relative = re.search(rb"""filename\s*=\s*["'](?!\w+://|/)""", data)
    return (_with_absolute_meshes(data, path, relative_only=True) if relative else data).decode("utf-8")


def _is_xacro_file(data: bytes) -> bool:
    try:
        return is_xacro(data, parse_xml(data))
    except TextError:
        return is_xacro(data)


def _expand(path: Path, arguments: Mapping[str, str]) -> bytes:
    """Returns the URDF that the xacro package expands a file to."""
    if find_spec("xacro") is None:
        raise RobotError(
            f"{path.absolute()}: is a xacro; install the package xacro (pip install xacro), or expand the file yourself: "
            f"xacro {path.name} > robot.urdf"
        )
    words = [str(path.absolute()), *(f"{key}:={value}" for key, value in arguments.items())]
    # Do not run in the current folder, whose files could shadow modules.
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(os.path.abspath(entry) for entry in sys.path if entry)}
    command = [sys.executable, "-m", _MODULE, *words]
    try:
        process = subprocess.run(command, env=environment, cwd=os.sep, capture_output=True, timeout=_TIMEOUT_S, check=False)
    except subprocess.TimeoutExpired as error:
        raise RobotError(f"{path}: xacro did not finish within {_TIMEOUT_S:g} s; do its macros call each other?") from error
    if process.returncode == -signal.SIGXCPU:
        raise RobotError(f"{path}: xacro did not finish within {LIMIT_S} s; do its macros call each other?")
    output = process.stderr[-_MAX_OUTPUT:].decode(errors="replace").splitlines()
    left_out = [line.removeprefix(LEFT_OUT) for line in output if line.startswith(LEFT_OUT)]
    if process.returncode:
        reason = clipped(_reason([line for line in output if not line.startswith(LEFT_OUT)]), _LONGEST_REASON)
        missing = "".join(f"{line}; without it " for line in left_out)
        raise RobotError(f"{path}: {missing}xacro rejects it: {reason}{_missing_arguments(path, arguments)}")
    _check_robot(path, process.stdout, left_out)
    for line in left_out:
        _warn_once(f"{path.name}: {line}; its includes are left out")
    return process.stdout


def _check_robot(path: Path, data: bytes, left_out: Sequence[str]) -> None:
    """Raises RobotError, with the name of the xacro, if it does not expand to a robot; the URDF parser reports other errors."""
    try:
        top = parse_xml(data)
    except TextError:
        return
    without_default_namespace(top)
    if top.tag == "sdf":
        raise RobotError(f"{path}: expands to an SDF model, which is spawned as a body; give a URDF or a xacro of one")
    if top.find("link") is None:
        missing = "".join(f"{line}; without it the file " for line in left_out)
        raise RobotError(f"{path}: {missing}expands to no <link>; if it only defines macros, give the xacro that calls them")


def _missing_arguments(path: Path, arguments: Mapping[str, str]) -> str:
    """Returns the part of an error message about missing arguments of a xacro."""
    try:
        matches = [_ARGUMENT_NAME.search(argument) for argument in _ARGUMENT.findall(read_file(path))]
    except OSError:
        return ""
    declared = [name[1].decode(errors="replace") for name in matches if name is not None]
    missing = [name for name in dict.fromkeys(declared) if name not in arguments]
    if not missing:
        return ""
    names = ", ".join(missing[:8])
    how = "gibson-sim scene robot --new FILE --xacro-arg NAME:=VALUE"
    return f"; it has the arguments {names}: give them as xacro_args in a robot.yaml: {how}"


@lru_cache(maxsize=256)
def _warn_once(line: str) -> None:
    """Logs a warning once per process, since a robot is expanded each time that it is loaded."""
    logger.warning("%s", line)


def _reason(output: Sequence[str]) -> str:
    """Returns the line with the error, which may follow warnings; for a traceback the last line."""
    lines = [line.strip() for line in output if line.strip()]
    if not lines:
        return "it gives no reason"
    error = next((line for line in lines if line.startswith(_ERRORS)), None)
    return (error or lines[-1 if lines[0].startswith("Traceback") else 0]).removeprefix("error: ")


def _with_absolute_meshes(data: bytes, path: Path, *, relative_only: bool = False) -> bytes:
    """Returns a URDF with absolute paths of meshes and textures, for a copy in another folder; names of missing files do not change."""
    try:
        top = parse_xml(data)
    except TextError as error:
        raise RobotError(f"{path}: {error}").with_public(error.public) from error
    without_default_namespace(top)
    for element in (*top.iter("mesh"), *top.iter("texture")):
        name = element.get("filename", "")
        if not name or (relative_only and ("://" in name or name.startswith("/"))):
            continue
        file = resolve_mesh(name, path.absolute())
        if file is not None:
            element.set("filename", file.as_uri())
    text: bytes = ET.tostring(top, encoding="utf-8", xml_declaration=True)
    return text


def cache_description(data: bytes, path: Path) -> Path:
    """Writes a URDF derived from the one at ``path`` to the cache, with absolute mesh paths, and returns the file; equal ones share it.

    Raises:
        RobotError: the data are not XML, or the file cannot be written.
    """
    data = _with_absolute_meshes(data, path)
    name = path.name.split(".")[0] or "robot"
    file = cache_folder("robots") / hashlib.sha256(data).hexdigest()[:24] / f"{name}.urdf"
    if is_file(file) and file.read_bytes() == data:
        return file
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        # Write in a separate folder, since other threads and processes may write the same robot.
        with tempfile.TemporaryDirectory(dir=file.parent, prefix=".half_") as folder:
            draft = Path(folder) / file.name
            draft.write_bytes(data)
            draft.replace(file)
    except OSError as error:
        raise RobotError(f"{file}: cannot be written: {error.strerror}; set XDG_CACHE_HOME to a writable folder") from error
    return file
