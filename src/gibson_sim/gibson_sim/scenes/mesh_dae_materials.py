"""Reads the materials of COLLADA files: the diffuse colour or texture, and a transparency that can be believed."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree

from gibson_sim.quoting import quoted
from gibson_sim.scenes.mesh_types import LIGHT_GREY, AlphaMode, Material, TextureSource
from gibson_sim.scenes.textures import TextureStore, Warn
from gibson_sim.types import Rgba

Element = ElementTree.Element
_SHADERS = ("phong", "blinn", "lambert", "constant")
_BELIEVABLE_ALPHA = 0.02


class DaeMaterials:
    """All materials of one file, read when they are first asked for."""

    def __init__(self, path: Path, root: Element, textures: TextureStore, files: list[Path], warn: Warn) -> None:
        self.path = path
        self.textures = textures
        self.files = files
        self.warn = warn
        self._materials = {m.get("id", ""): m for m in root.iterfind("library_materials/material")}
        self._effects = {e.get("id", ""): e for e in root.iterfind("library_effects/effect")}
        self._images = {i.get("id", ""): i for i in root.iterfind("library_images/image")}
        self._known: dict[str, Material] = {}

    def bound(self, instance: Element | None) -> dict[str, str]:
        """Returns the material of each symbol that an <instance_geometry> binds."""
        if instance is None:
            return {}
        return {m.get("symbol", ""): m.get("target", "").lstrip("#") for m in instance.iter("instance_material")}

    def get(self, name: str) -> Material:
        """Returns a material by id; light grey, with a warning, if there is none."""
        if name not in self._known:
            self._known[name] = self._read(name)
        return self._known[name]

    def _read(self, name: str) -> Material:
        source = self._materials.get(name)
        instance = None if source is None else source.find("instance_effect")
        effect = None if instance is None else self._effects.get(instance.get("url", "").lstrip("#"))
        if effect is None:
            self.warn(f"{self.path}: material {quoted(name)} is not in the file; the surface is light grey")
            return Material(name)
        shader = next((found for tag in _SHADERS if (found := effect.find(f".//{tag}")) is not None), None)
        if shader is None:
            return Material(name)
        color: Rgba = LIGHT_GREY
        texture = None
        # A <constant> shader has no diffuse: what it shows is its emission.
        for slot in ("diffuse", "emission") if shader.tag == "constant" else ("diffuse",):
            diffuse = shader.find(slot)
            if diffuse is None:
                continue
            image = diffuse.find("texture")
            if image is not None:
                texture = self._texture(effect, image.get("texture", ""))
                color = (1.0, 1.0, 1.0, 1.0) if texture is not None else LIGHT_GREY
            else:
                color = _color(diffuse.findtext("color")) or LIGHT_GREY
            break
        alpha = _alpha(shader)
        transparent = shader.find("transparent/texture")
        mode: AlphaMode = "opaque"
        if alpha < 1.0:
            mode = "blend"
        elif transparent is not None and texture is not None and texture.pixels.shape[2] == 4:
            mode = "mask"
        return Material(name, (*color[:3], alpha), texture, alpha_mode=mode)

    def _texture(self, effect: Element, name: str) -> TextureSource | None:
        """Returns the image behind a sampler: sampler -> surface -> image, or the image's own id as some exporters write."""
        for _ in range(3):
            if name in self._images:
                break
            parameter = next((p for p in effect.iter("newparam") if p.get("sid") == name), None)
            if parameter is None:
                break
            image = parameter.find(".//instance_image")
            found = parameter.findtext("sampler2D/source") or parameter.findtext("surface/init_from")
            name = (image.get("url", "").lstrip("#") if image is not None else found or "").strip()
        if name not in self._images:
            self.warn(f"{self.path}: image {quoted(name)} is not in the file; the surface is drawn without it")
            return None
        init = self._images[name].find("init_from")
        uri = "" if init is None else (init.text or init.findtext("ref") or "").strip()
        if not uri:
            self.warn(f"{self.path}: image {quoted(name)} names no file; the surface is drawn without it")
            return None
        return self.textures.from_uri(uri, self.path, self.files, self.warn)


def _color(text: str | None) -> Rgba | None:
    values = [min(max(float(word), 0.0), 1.0) for word in (text or "").split()]
    if len(values) < 3:
        return None
    return (values[0], values[1], values[2], values[3] if len(values) > 3 else 1.0)


def _alpha(shader: Element) -> float:
    """Returns the opacity, COLLADA 1.4.1 "Determining Transparency"; what would be invisible is taken as opaque.

    Exporters write both "0 = opaque" and "1 = opaque", with and without the attribute that tells; nobody exports a surface
    that cannot be seen.
    """
    transparent, factor = shader.find("transparent"), shader.findtext("transparency/float")
    if transparent is None and factor is None:
        return 1.0
    strength = 1.0 if factor is None else float(factor)
    color = _color(None if transparent is None else transparent.findtext("color")) or (1.0, 1.0, 1.0, 1.0)
    mode = "A_ONE" if transparent is None else transparent.get("opaque", "A_ONE")
    luminance = 0.2126 * color[0] + 0.7152 * color[1] + 0.0722 * color[2]
    alpha = {
        "A_ONE": color[3] * strength,
        "A_ZERO": 1.0 - color[3] * strength,
        "RGB_ZERO": 1.0 - luminance * strength,
        "RGB_ONE": luminance * strength,
    }.get(mode, 1.0)
    return alpha if _BELIEVABLE_ALPHA < alpha < 1.0 - _BELIEVABLE_ALPHA else 1.0
