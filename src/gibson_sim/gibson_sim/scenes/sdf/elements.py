"""Reads SDF files and the values of their elements: names, numbers, flags and poses."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from gibson_sim.description.omissions import OmissionKind
from gibson_sim.errors import SceneError, TextError
from gibson_sim.geometry.transforms import matrix_from_pose, matrix_from_quat, pose_from_xyz_rpy
from gibson_sim.quoting import quoted
from gibson_sim.reading import is_file, parse_xml, read_file, without_default_namespace
from gibson_sim.scenes.builder import SceneBuilder
from gibson_sim.types import Vec3

Element = ElementTree.Element
F64 = NDArray[np.float64]
_COMMENT = re.compile(rb"<!--.*?-->", re.DOTALL)
_START_TAG = re.compile(rb"<[A-Za-z_][\w.-]*")
"""Beginning of the outermost element."""
_PREFIX = re.compile(rb"[<\s]/?([A-Za-z_][\w.-]*):[A-Za-z_]")
_DECLARED = re.compile(rb"xmlns:([A-Za-z_][\w.-]*)\s*=")
_MAX_PREFIXES = 100
"""Maximum number of prefixes that are declared."""
Warn = Callable[[str, OmissionKind], None]
"""Receives a warning and its kind."""


def read_sdf(builder: SceneBuilder, path: Path) -> Element:
    """Returns the root element of an SDF file, and adds the file to the scene's digest.

    Raises:
        SceneError: the file cannot be read, or is not XML.
    """
    try:
        return parse_sdf(builder.read_bytes(path))
    except TextError as e:
        raise SceneError(f"{path}: {e}").with_public(e.public) from e


def parse_sdf(text: bytes) -> Element:
    """Returns the outermost element of an XML text, whose prefixes, such as that of <gz:type>, need not be declared, as in Gazebo.

    Raises:
        TextError: as ``parse_xml``.
    """
    try:
        return without_default_namespace(parse_xml(text))
    except TextError as error:
        if "unbound prefix" not in str(error):
            raise
        start = _START_TAG.search(_COMMENT.sub(lambda found: b" " * len(found[0]), text))
        if start is None:
            raise
        declared = set(_DECLARED.findall(text))
        prefixes = sorted({prefix for prefix in _PREFIX.findall(text) if prefix not in declared | {b"xml", b"xmlns"}})
        names = b"".join(b' xmlns:%s="urn:%s"' % (prefix, prefix) for prefix in prefixes[:_MAX_PREFIXES])
        return without_default_namespace(parse_xml(text[: start.end()] + names + text[start.end() :]))


def sdf_files(folder: Path) -> list[Path]:
    """Returns the candidate SDF files of a model folder: those in its model.config, the newest version first, then model.sdf."""
    named: list[tuple[tuple[int, ...], Path]] = []
    config = folder / "model.config"
    try:
        for element in parse_xml(read_file(config)).iterfind("sdf") if is_file(config) else ():
            named.append((sdf_version(element), folder / (element.text or "").strip()))
    except (OSError, TextError):
        # Without a readable model.config only the default name remains.
        named = []
    return [path for _, path in sorted(named, reverse=True)] + [folder / "model.sdf"]


def sdf_version(element: Element) -> tuple[int, ...]:
    """Returns the version of an <sdf> element, such as (1, 7); () = it has none."""
    return tuple(int(part) for part in element.get("version", "").split(".") if part.isdecimal())


def name_of(element: Element) -> str:
    """Returns the name of an element: its attribute ``name``, or the <name> of an <include>."""
    return element.get("name", "") or text_of(element, "name")


def text_of(element: Element, path: str) -> str:
    """Returns the text in a descendant, without blanks at its ends; "" if there is none."""
    return (element.findtext(path) or "").strip()


def is_true(text: str | None) -> bool:
    """Returns the value of a boolean, False if it is missing."""
    return (text or "").strip().lower() in ("1", "true")


def number(word: str) -> float:
    """Returns a number, which may be infinite or NaN.

    Raises:
        ValueError: it is none.
    """
    if "_" in word:  # Python reads 1_0 as 10
        raise ValueError(f"{quoted(word)} is not a number")
    return float(word)


def numbers(text: str | None, counts: tuple[int, ...]) -> list[float] | None:
    """Returns the numbers in an element's text; None if one is not finite, or their count is not in ``counts``."""
    try:
        values = [number(word) for word in (text or "").split()]
    except ValueError:
        return None
    return values if len(values) in counts and all(map(math.isfinite, values)) else None


def pose_matrix(parent: Element, where: str, warn: Warn) -> F64:
    """Returns the pose (4, 4) in an element's <pose>, in the frame that it is relative to; the identity if it is missing.

    Args:
        parent: the element.
        where: what it is, for warnings.
        warn: receives the warning about an invalid pose, in whose place the identity is returned.
    """
    element = parent.find("pose")
    if element is None or not (element.text or "").strip():
        return np.eye(4)
    format = element.get("rotation_format", "").strip() or "euler_rpy"
    if format not in ("euler_rpy", "quat_xyzw"):
        text = f"{where}: rotation_format of <pose> is {quoted(format)}, must be euler_rpy or quat_xyzw; zero is used"
        warn(text, OmissionKind.INVALID)
        return np.eye(4)
    quaternion = format == "quat_xyzw"
    values = numbers(element.text, (7,) if quaternion else (6,))
    if values is None:
        text = " ".join((element.text or "").split())
        count = "seven numbers, x y z and a quaternion x y z w" if quaternion else "six numbers, x y z roll pitch yaw"
        warn(f"{where}: <pose> {quoted(text)} is not {count}; zero is used", OmissionKind.INVALID)
        return np.eye(4)
    xyz: Vec3 = (values[0], values[1], values[2])
    if quaternion:
        if is_true(element.get("degrees")):
            warn(f"{where}: degrees of a <pose> does not apply to a quaternion; it has no effect", OmissionKind.OTHER)
        matrix = np.eye(4)
        quat = np.array(values[3:])
        matrix[:3, :3] = matrix_from_quat(quat / np.linalg.norm(quat)) if quat.any() else np.eye(3)
        matrix[:3, 3] = xyz
        return matrix
    roll, pitch, yaw = values[3:]
    if is_true(element.get("degrees")):
        roll, pitch, yaw = math.radians(roll), math.radians(pitch), math.radians(yaw)
    return matrix_from_pose(pose_from_xyz_rpy(xyz, (roll, pitch, yaw)))
