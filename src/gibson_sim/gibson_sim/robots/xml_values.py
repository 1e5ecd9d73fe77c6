"""Values in the attributes of XML elements; every complaint names file, place, element and attribute. Pure."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from pathlib import Path

from gibson_sim.errors import RobotError
from gibson_sim.geometry.transforms import pose_from_xyz_rpy
from gibson_sim.types import Pose, Vec3


class XmlValues:
    """Reads the values of one file."""

    def __init__(self, path: Path) -> None:
        self.path = path.absolute()

    def origin(self, element: ET.Element, where: str) -> Pose:
        """Returns the pose in the ``<origin>`` of an element; the identity where there is none."""
        item = element.find("origin")
        if item is None:
            return Pose()
        zero = (0.0, 0.0, 0.0)
        xyz = self.vector(item, "xyz", where) if item.get("xyz") else zero
        rpy = self.vector(item, "rpy", where) if item.get("rpy") else zero
        return pose_from_xyz_rpy(xyz, rpy)

    def positive(self, values: tuple[float, ...], where: str) -> tuple[float, ...]:
        """Returns the values where all are above 0."""
        if min(values) <= 0:
            raise RobotError(f"{self.path}: {where}: size {values} must be above 0 in every direction")
        return values

    def text(self, element: ET.Element, key: str) -> str:
        """Returns an attribute that is not empty."""
        value = element.get(key, "").strip()
        if not value:
            raise RobotError(f"{self.path}: a <{element.tag}> has no {key}")
        return value

    def vector(self, element: ET.Element, key: str, where: str) -> Vec3:
        """Returns three finite numbers."""
        x, y, z = self.numbers(element, key, 3, where)
        return (x, y, z)

    def optional(self, element: ET.Element, key: str, where: str, default: float = 0.0) -> float:
        """Returns a finite number, or the default where the attribute is not there."""
        return self.numbers(element, key, 1, where)[0] if element.get(key) else default

    def numbers(self, element: ET.Element, key: str, count: int, where: str) -> tuple[float, ...]:
        """Returns so many finite numbers."""
        raw = element.get(key, "")
        try:
            values = tuple(float(part) for part in raw.split())
        except ValueError:
            values = ()
        if len(values) != count or not all(map(math.isfinite, values)):
            wanted = "a finite number" if count == 1 else f"{count} finite numbers"
            raise RobotError(f'{self.path}: {where}: <{element.tag} {key}="{raw}">, must be {wanted}')
        return values
