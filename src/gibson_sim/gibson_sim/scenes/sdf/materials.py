"""Reads the <material> of SDF: one colour per visual, and warnings about the rest."""

from __future__ import annotations

from dataclasses import dataclass

from gibson_sim.description.omissions import OmissionKind
from gibson_sim.description.shapes import Appearance
from gibson_sim.formats.mesh import LIGHT_GREY
from gibson_sim.quoting import clipped, quoted
from gibson_sim.scenes.sdf.elements import Element, Warn, numbers, text_of
from gibson_sim.types import Rgba

_SCRIPT_COLORS: dict[str, Rgba] = {
    "White": (1.0, 1.0, 1.0, 1.0), "Grey": (0.7, 0.7, 0.7, 1.0), "DarkGrey": (0.18, 0.18, 0.18, 1.0),
    "Black": (0.0, 0.0, 0.0, 1.0), "Red": (1.0, 0.0, 0.0, 1.0), "Green": (0.0, 1.0, 0.0, 1.0), "Blue": (0.0, 0.0, 1.0, 1.0),
    "Yellow": (1.0, 1.0, 0.0, 1.0), "Orange": (1.0, 0.5, 0.0, 1.0), "Purple": (1.0, 0.0, 1.0, 1.0), "Wood": (0.6, 0.4, 0.2, 1.0),
    "FlatBlack": (0.1, 0.1, 0.1, 1.0),
}  # fmt: skip
"""Name of a Gazebo material script -> colour, sRGB and alpha, 0 to 1."""
_INVISIBLE = 0.01
"""Opacity below which a visual is not drawn."""


@dataclass(frozen=True, slots=True)
class DrawnMaterial:
    """How a visual is drawn."""

    color: Rgba | None
    """Colour, sRGB and alpha; None = that of the mesh."""
    appearance: Appearance | None = None
    """Metalness and roughness; None = those of the mesh."""


def is_visible(element: Element) -> bool:
    """Returns whether a <visual> is drawn: it is not fully transparent."""
    return _opacity(element) >= _INVISIBLE


def material_of(element: Element, textured: bool, where: str, warn: Warn) -> DrawnMaterial:
    """Returns how a <visual> is drawn, and warns about the parts of its material that are not.

    Args:
        element: the <visual>.
        textured: whether its mesh has textures, which usually are those of its <pbr>.
        where: link or model, for warnings.
        warn: receives the warnings.
    """
    alpha = _opacity(element)
    material = element.find("material")
    if material is None:
        return DrawnMaterial(_with_opacity(element, None, alpha, where, warn))
    script = text_of(material, "script/name")
    colors = {tag: _color(material, tag, where, warn) for tag in ("ambient", "diffuse", "emissive")}
    if script.removeprefix("Gazebo/") not in _SCRIPT_COLORS and script and colors["diffuse"] is None:
        text = (
            f"material script {clipped(script, 80)} is not read: its texture and colours are not drawn; Gazebo Classic's .material files are "
            "not read, use <pbr> or <diffuse>"
        )
        warn(f"{where}: {text}", OmissionKind.UNSUPPORTED_ASSET)
    _name_textures(material, textured, where, warn)
    base = _base_color(element, colors, textured, where, warn)
    return DrawnMaterial(_with_opacity(element, base, alpha, where, warn), _appearance(material, where, warn))


def _with_opacity(element: Element, base: Rgba | None, alpha: float, where: str, warn: Warn) -> Rgba | None:
    """Returns a colour with the opacity of the <visual>; a mesh with the colours of its file stays opaque, with a warning."""
    if base is None and alpha < 1.0:
        if element.find("geometry/mesh") is not None:
            warn(f"{where}: <transparency> of a mesh with its own colours is not drawn; it is opaque", OmissionKind.OTHER)
            return None
        base = (*LIGHT_GREY[:3], 1.0)
    return None if base is None else (*base[:3], base[3] * alpha)


def _base_color(element: Element, colors: dict[str, Rgba | None], textured: bool, where: str, warn: Warn) -> Rgba | None:
    """Returns the colour of a <material>, sRGB and alpha; None = that of the mesh."""
    material_script = text_of(element, "material/script/name").removeprefix("Gazebo/")
    diffuse, emissive = colors["diffuse"], colors["emissive"]
    if diffuse is not None and textured and text_of(element, "material/pbr//albedo_map"):
        return None
    base = diffuse or _SCRIPT_COLORS.get(material_script)
    if emissive is not None and any(emissive[:3]):
        # Without a diffuse colour the material is black, apart from its own light.
        r, g, b = (min(own + light, 1.0) for own, light in zip((base or (0.0, 0.0, 0.0))[:3], emissive[:3], strict=True))
        warn(f"{where}: <emissive> is drawn as a colour that light falls on, so that it does not glow", OmissionKind.OTHER)
        return r, g, b, base[3] if base else 1.0
    if base is None and material_script == "" and colors["ambient"] is not None and element.find("geometry/mesh") is None:
        base = colors["ambient"]
    if base is not None and base[:3] == (1.0, 1.0, 1.0) and element.find("geometry/mesh") is not None and not material_script:
        return None
    return base


def _color(material: Element, tag: str, where: str, warn: Warn) -> Rgba | None:
    """Returns a colour of a <material>, None if it is not given or, with a warning, invalid."""
    text = text_of(material, tag)
    if not text:
        return None
    values = numbers(text, (3, 4))
    if values is None:
        warn(f"{where}: <{tag}> is {quoted(text)}, must be three or four numbers; left out", OmissionKind.OTHER)
        return None
    if not all(0.0 <= value <= 1.0 for value in values):
        warn(f"{where}: <{tag}> is {quoted(text)}, must be 0 to 1; it is clipped", OmissionKind.OTHER)
    r, g, b, a = (min(max(v, 0.0), 1.0) for v in ([*values, 1.0][:4]))
    return r, g, b, a or 1.0


def _appearance(material: Element, where: str, warn: Warn) -> Appearance | None:
    """Returns the metalness and roughness of a <pbr> that gives them as numbers."""
    values: dict[str, float] = {}
    for tag in ("metalness", "roughness"):
        text = text_of(material, f"pbr/metal/{tag}")
        if not text:
            continue
        value = numbers(text, (1,))
        if value is None or not 0.0 <= value[0] <= 1.0:
            warn(f"{where}: <{tag}> is {quoted(text)}, must be 0 to 1; left out", OmissionKind.OTHER)
        else:
            values[tag] = value[0]
    return Appearance(metallic=values.get("metalness"), roughness=values.get("roughness")) if values else None


def _name_textures(material: Element, textured: bool, where: str, warn: Warn) -> None:
    """Warns about the textures of a <pbr>, unless those of the mesh are drawn."""
    images = [] if textured else [(e.text or "").strip() for e in material.iterfind("pbr/*/*") if e.tag.endswith("_map")]
    images = [clipped(image, 120) for image in dict.fromkeys(images) if image]
    if images:
        rest = f" and {len(images) - 1} more" if len(images) > 1 else ""
        text = f"texture {images[0]}{rest} of its <pbr> material {'are' if rest else 'is'} not drawn"
        warn(f"{where}: {text}", OmissionKind.UNSUPPORTED_ASSET)


def _opacity(element: Element) -> float:
    transparency = numbers(element.findtext("transparency"), (1,)) or [0.0]
    return 1.0 - min(max(transparency[0], 0.0), 1.0)
