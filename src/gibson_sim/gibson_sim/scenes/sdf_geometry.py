"""Numbers, shapes and colours of SDF."""

from __future__ import annotations

import math
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from gibson_sim.quoting import clipped
from gibson_sim.robots.spec import Shape, ShapeKind
from gibson_sim.types import Rgba, Vec3

Element = ElementTree.Element
F64 = NDArray[np.float64]
PRIMITIVES = {"box": ("size",), "sphere": ("radius",), "cylinder": ("radius", "length")}
"""Shape -> the elements that say how large it is."""
PLANE_THICKNESS = 0.01
"""Metres; of the box that stands for a plane."""
_SCRIPT_COLORS: dict[str, Rgba] = {
    "White": (1.0, 1.0, 1.0, 1.0), "Grey": (0.7, 0.7, 0.7, 1.0), "DarkGrey": (0.18, 0.18, 0.18, 1.0),
    "Black": (0.0, 0.0, 0.0, 1.0), "Red": (1.0, 0.0, 0.0, 1.0), "Green": (0.0, 1.0, 0.0, 1.0), "Blue": (0.0, 0.0, 1.0, 1.0),
    "Yellow": (1.0, 1.0, 0.0, 1.0), "Orange": (1.0, 0.5, 0.0, 1.0), "Purple": (1.0, 0.0, 1.0, 1.0), "Wood": (0.6, 0.4, 0.2, 1.0),
    "FlatBlack": (0.1, 0.1, 0.1, 1.0),
}  # fmt: skip


def numbers(text: str | None, counts: tuple[int, ...]) -> list[float] | None:
    """Returns the numbers in an element's text, or None if they are not finite or not as many as one of ``counts``."""
    try:
        values = [float(word) for word in (text or "").split()]
    except ValueError:
        return None
    return values if len(values) in counts and all(map(math.isfinite, values)) else None


def primitive(element: Element) -> Shape | None:
    """Returns a box, sphere or cylinder, or None if the element is none or has no sizes above 0."""
    tags = PRIMITIVES.get(element.tag)
    if tags is None:
        return None
    values = numbers(" ".join(element.findtext(tag) or "" for tag in tags), (3,) if element.tag == "box" else (len(tags),))
    if values is None or min(values) <= 0:
        return None
    padded = [*values, 0.0, 0.0][:3]
    size: Vec3 = (padded[0], padded[1], padded[2])
    kinds: dict[str, ShapeKind] = {"box": "box", "sphere": "sphere", "cylinder": "cylinder"}
    return Shape(kinds[element.tag], size)


def plane_box(element: Element, matrix: F64) -> tuple[Shape, F64]:
    """Returns a thin box whose upper face is the plane, and T_world_box."""
    x, y = (numbers(element.findtext("size"), (2,)) or [1.0, 1.0])[:2]
    normal = np.array(numbers(element.findtext("normal"), (3,)) or [0.0, 0.0, 1.0])
    turned = matrix @ _turn_z_to(normal)
    down = np.eye(4)
    down[2, 3] = -PLANE_THICKNESS / 2
    return Shape("box", (max(x, 1e-3), max(y, 1e-3), PLANE_THICKNESS)), turned @ down


def _turn_z_to(normal: F64) -> F64:
    """Returns a (4, 4) rotation that takes z to ``normal``."""
    matrix = np.eye(4)
    length = np.linalg.norm(normal)
    if length == 0:
        return matrix
    z = normal / length
    if z[2] < 1 - 1e-9:
        x = np.cross([0.0, 1.0, 0.0], z) if abs(z[1]) < 0.9 else np.cross([1.0, 0.0, 0.0], z)
        x /= np.linalg.norm(x)
        matrix[:3, :3] = np.stack([x, np.cross(z, x), z], axis=1)
    return matrix


def visual_color(element: Element) -> tuple[Rgba | None, bool]:
    """Returns the colour that a <visual> gives its shape, None = the mesh's own, and whether it can be seen at all."""
    transparency = numbers(element.findtext("transparency"), (1,)) or [0.0]
    alpha = 1.0 - min(max(transparency[0], 0.0), 1.0)
    if alpha < 0.01:
        return None, False
    material = element.find("material")
    if material is None:
        return None, True
    script = (material.findtext("script/name") or "").strip().removeprefix("Gazebo/")
    base = _SCRIPT_COLORS.get(script)
    values = numbers(material.findtext("diffuse"), (3, 4))
    if values is not None and material.find("pbr") is None:
        r, g, b, a = (min(max(v, 0.0), 1.0) for v in ([*values, 1.0][:4]))
        base = (r, g, b, a or 1.0)
    if base is None or (base[:3] == (1.0, 1.0, 1.0) and element.find("geometry/mesh") is not None and not script):
        return None, True
    return (*base[:3], base[3] * alpha), True


def unread_material(element: Element, textured: bool) -> str:
    """Returns what of the material of a <visual> is not drawn, in words; empty = nothing.

    Args:
        element: the <visual>.
        textured: whether its mesh has textures of its own, as the images of a <pbr> mostly are.
    """
    material = element.find("material")
    if material is None:
        return ""
    name = (material.findtext("script/name") or "").strip()
    if name and name.removeprefix("Gazebo/") not in _SCRIPT_COLORS and material.find("diffuse") is None:
        return f"material script {clipped(name, 80)} is not read: its texture and colours are not drawn"
    image = (material.findtext(".//albedo_map") or "").strip()
    return f"texture {clipped(image, 120)} of its <pbr> material is not drawn" if image and not textured else ""
