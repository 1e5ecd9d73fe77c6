"""Materials of COLLADA: the common profile of the effects, with its parameters, samplers and images."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from gibson_sim.errors import MeshError
from gibson_sim.formats.dae_document import DaeDocument, Element, children, reference
from gibson_sim.formats.mesh import LIGHT_GREY, AlphaMode, Filter, Material, Sampling, TextureSource, Wrap
from gibson_sim.formats.textures import TextureStore
from gibson_sim.geometry.colours import linear_from_srgb
from gibson_sim.quoting import quoted
from gibson_sim.types import Rgba, Vec3

_SHADERS = ("phong", "blinn", "lambert", "constant")
_HIGHLIGHTS = ("specular", "reflective")
_LEAST_ALPHA = 0.02
"""Opacity below which a surface counts as opaque, since no exporter writes invisible surfaces, as does an opacity above 1 minus this."""
_WHITE: Rgba = (1.0, 1.0, 1.0, 1.0)
_WRAPS: dict[str, Wrap] = {"WRAP": "repeat", "MIRROR": "mirror", "CLAMP": "clamp"}
_LONGEST_CHAIN = 8
"""Maximum number of parameters between a texture and its image."""


@dataclass(frozen=True, slots=True)
class Binding:
    """How one instance of a geometry binds the symbol of a material."""

    material: str
    """Id of the material."""
    uv_sets: Mapping[str, int | None]
    """Name of texture coordinates, as in <texture texcoord>, -> set of the geometry; None = any."""


@dataclass(frozen=True, slots=True)
class _Texture:
    """One <texture>."""

    image: TextureSource | None
    texcoord: str


class DaeMaterials:
    """Materials of one file, each read at its first use.

    Args:
        document: the file.
        textures: finds and decodes the images that it names.
        files: list to which the paths of these are appended.
    """

    def __init__(self, document: DaeDocument, textures: TextureStore, files: list[Path]) -> None:
        self._document = document
        self._textures = textures
        self._files = files
        self._materials = document.by_id("library_materials/material")
        self._effects = document.by_id("library_effects/effect")
        self._images = document.by_id("library_images/image")
        self._known: dict[str, tuple[Material, str]] = {}

    def bindings(self, instance: Element | None) -> dict[str, Binding]:
        """Returns symbol -> binding of an <instance_geometry> or <instance_controller>."""
        found = {}
        for item in () if instance is None else instance.iter("instance_material"):
            uv_sets: dict[str, int | None] = {}
            for bind in item.iterfind("bind_vertex_input"):
                if bind.get("input_semantic") == "TEXCOORD":
                    number = self._document.whole(bind, "input_set", -1)
                    uv_sets[bind.get("semantic", "")] = None if number < 0 else number
                else:
                    text = f"{quoted(bind.get('semantic'))} to {quoted(bind.get('input_semantic'))}"
                    self._document.warn(f"<bind_vertex_input> of {text} is left out; only texture coordinates can be bound")
            found[item.get("symbol", "")] = Binding(reference(item, "target"), uv_sets)
        return found

    def get(self, name: str) -> tuple[Material, str]:
        """Returns a material by id, and the name of its texture coordinates; light grey, with a warning, if it does not exist."""
        if name not in self._known:
            self._known[name] = self._read(name)
        return self._known[name]

    def _read(self, name: str) -> tuple[Material, str]:
        source = self._materials.get(name)
        instance = None if source is None else source.find("instance_effect")
        effect = None if instance is None else self._effects.get(reference(instance))
        if instance is None or effect is None:
            self._document.warn(f"material {quoted(name)} is not in the file; the surface is light grey")
            return Material(name), ""
        shader = next((found for tag in _SHADERS if (found := effect.find(f".//{tag}")) is not None), None)
        if shader is None:
            self._document.warn(f"effect of material {quoted(name)} has no shader of <profile_COMMON>; the surface is light grey")
            return Material(name), ""
        return _EffectReader(self._document, self._textures, self._image, name, instance, effect, shader).read()

    def _image(self, name: str) -> TextureSource | None:
        """Returns an image by id, or None with a warning."""
        image = self._images.get(name)
        if image is None:
            self._document.warn(f"image {quoted(name)} is not in the file; the surface is drawn without it")
            return None
        hexes = next((e.text for e in image.iter() if e.tag in ("data", "hex") and e.text), None)
        if hexes is not None:
            return self._embedded(name, hexes)
        # 1.4: the URI itself; 1.5: in <ref>, and for some kinds of textures in <create_2d>.
        init = next(image.iter("init_from"), None)
        uri = "" if init is None else (init.findtext("ref") or init.text or "").strip()
        if not uri:
            self._document.warn(f"image {quoted(name)} names no file; the surface is drawn without it")
            return None
        return self._textures.from_uri(uri, self._document.path, self._files, self._document.warn_of_file)

    def _embedded(self, name: str, hexes: str) -> TextureSource | None:
        title = f"{self._document.path}: image {quoted(name)}"
        try:
            data = bytes.fromhex(hexes)
        except ValueError:
            self._document.warn(f"image {quoted(name)} is not in hexadecimal digits; the surface is drawn without it")
            return None
        return self._textures.from_bytes(title, data, self._document.warn_of_file)


class _EffectReader:
    """Reader of one effect for one material."""

    def __init__(
        self,
        document: DaeDocument,
        textures: TextureStore,
        image: Callable[[str], TextureSource | None],
        name: str,
        instance: Element,
        effect: Element,
        shader: Element,
    ) -> None:
        self.document = document
        self.textures = textures
        self.image = image
        self.name = name
        self.effect = effect
        self.shader = shader
        self.parameters = {p.get("sid", ""): p for p in effect.iter("newparam")}
        # A material may set parameters of its effect.
        self.parameters.update({p.get("ref", ""): p for p in instance.iterfind("setparam")})

    def read(self) -> tuple[Material, str]:
        shader = self.shader
        unlit = shader.tag == "constant"
        texture: _Texture | None = None
        color: Rgba = LIGHT_GREY
        # A <constant> shader has no diffuse colour; it shows its emission.
        for slot in ("diffuse", "emission") if unlit else ("diffuse",):
            if shader.find(slot) is None:
                continue
            texture = self._texture(slot)
            if texture is None:
                color = self._color(slot) or LIGHT_GREY
            elif texture.image is not None:
                color = _WHITE
            break
        emissive, emissive_texture = ((0.0, 0.0, 0.0), None) if unlit else self._emission(texture)
        alpha = self._alpha()
        diffuse = None if texture is None else texture.image
        material = Material(
            self.name, (*color[:3], alpha), diffuse, unlit=unlit, alpha_mode=self._alpha_mode(alpha, diffuse),
            emissive=emissive, emissive_texture=emissive_texture,
        )  # fmt: skip
        self._warn_of_rest()
        return material, "" if texture is None else texture.texcoord

    def _emission(self, diffuse: _Texture | None) -> tuple[Vec3, TextureSource | None]:
        """Returns the emitted light, linear, and its texture."""
        texture = self._texture("emission")
        if texture is not None and texture.image is not None:
            if diffuse is not None and texture.texcoord != diffuse.texcoord:
                self._warn(
                    f"reads its emission at {quoted(texture.texcoord)}; it is drawn with the texture coordinates of its colour"
                )
            return (1.0, 1.0, 1.0), texture.image
        color = self._color("emission", largest=math.inf) or (0.0, 0.0, 0.0, 1.0)
        # Above 1 there is no sRGB curve: the colour is that of its brightest component at 1, times its strength.
        strength = max(1.0, *color[:3])
        red, green, blue = (linear_from_srgb([value / strength for value in color[:3]]) * strength).tolist()
        return (red, green, blue), None

    def _alpha_mode(self, alpha: float, texture: TextureSource | None) -> AlphaMode:
        if self.shader.find("transparent/texture") is not None:
            if texture is None or texture.pixels.shape[2] < 4:
                self._warn("has a texture of its opacity apart from its colour, which is left out; the surface is opaque there")
            elif alpha == 1.0:
                return "mask"
        return "blend" if alpha < 1.0 else "opaque"

    def _alpha(self) -> float:
        """Returns the opacity, 0 to 1, by COLLADA 1.4.1, "Determining Transparency"; invisible surfaces count as opaque.

        Exporters use both "0 = opaque" and "1 = opaque", with or without the attribute that specifies it, but write no invisible surfaces.
        """
        transparent, factor = self.shader.find("transparent"), self._float("transparency")
        if transparent is None and factor is None:
            return 1.0
        strength = 1.0 if factor is None else factor
        color = self._color("transparent") or _WHITE
        mode = "A_ONE" if transparent is None else transparent.get("opaque", "A_ONE")
        luminance = 0.2126 * color[0] + 0.7152 * color[1] + 0.0722 * color[2]
        alphas = {
            "A_ONE": color[3] * strength,
            "A_ZERO": 1.0 - color[3] * strength,
            "RGB_ZERO": 1.0 - luminance * strength,
            "RGB_ONE": luminance * strength,
        }
        if mode not in alphas:
            self._warn(f"has opaque={quoted(mode)}, must be one of {', '.join(alphas)}; it is drawn opaque")
        alpha = alphas.get(mode, 1.0)
        if alpha <= _LEAST_ALPHA:
            self._warn(
                "is invisible by its <transparent> and <transparency>, as exporters write it by mistake; it is drawn opaque"
            )
        elif alpha < 1.0 - _LEAST_ALPHA and mode.startswith("RGB") and max(color[:3]) - min(color[:3]) > _LEAST_ALPHA:
            self._warn("lets colours through unequally; it is drawn with their mean opacity")
        return alpha if _LEAST_ALPHA < alpha < 1.0 - _LEAST_ALPHA else 1.0

    def _warn_of_rest(self) -> None:
        """Warns of what is left out of the effect."""
        slots = [slot for slot in _HIGHLIGHTS if self._shines(slot)]
        if slots:
            self.document.warn(f"{' and '.join(slots)} light of its materials is left out; they are matte")
        if self.shader.find("ambient/texture") is not None:
            self._warn("has a texture of its ambient light, which is left out")
        for extra in self.effect.iter("extra"):
            for tag in ("bump", "normal"):
                if extra.find(f".//{tag}/texture") is not None:
                    self._warn(f"has a {tag} map, which is left out; the surface is smooth")
            for sided in extra.iter("double_sided"):
                if (sided.text or "").strip() in ("0", "false"):
                    self.document.warn("has materials with <double_sided>0; their back faces are drawn too")

    def _shines(self, slot: str) -> bool:
        """Returns whether a slot of the shader reflects light."""
        if self.shader.find(slot) is None or (slot == "reflective" and self._float("reflectivity") == 0.0):
            return False
        color = self._color(slot)
        return self.shader.find(f"{slot}/texture") is not None or (color is not None and any(color[:3]))

    def _value(self, slot: str, *tags: str) -> str | None:
        """Returns the text of a slot's value, followed through <param ref>; None if it has none."""
        element = self.shader.find(slot)
        for _ in range(_LONGEST_CHAIN):
            if element is None:
                return None
            value = next(children(element, *tags), None)
            if value is not None:
                return value.text
            param = element.find("param")
            if param is None:
                return None
            sid = param.get("ref", "")
            element = self.parameters.get(sid)
            if element is None:
                self._warn(f"refers to parameter {quoted(sid)} in <{slot}>, which the effect does not define; ignored")
        return None

    def _color(self, slot: str, largest: float = 1.0) -> Rgba | None:
        """Returns the colour of a slot, each 0 to ``largest``; None if it has none or, with a warning, if it cannot be read."""
        text = self._value(slot, "color", "float4", "float3", "half4", "half3")
        try:
            values = self.document.numbers(text).clip(0.0, largest).tolist()
        except MeshError:
            values = []
        if len(values) < 3:
            if text is not None:
                self._warn(
                    f"has the colour {quoted(text.strip())} in <{slot}>, must be 3 or 4 numbers between spaces; it is left out"
                )
            return None
        return (values[0], values[1], values[2], values[3] if len(values) > 3 else 1.0)

    def _float(self, slot: str) -> float | None:
        text = self._value(slot, "float", "half")
        values = self.document.numbers(text)
        if text is not None and len(values) != 1:
            raise self.document.error(f"material {quoted(self.name)}: <{slot}> has {len(values)} numbers, must have 1")
        return float(values[0]) if len(values) else None

    def _texture(self, slot: str) -> _Texture | None:
        """Returns the texture of a slot, None if it has none; its image is found by sampler -> surface -> image, or directly."""
        element = self.shader.find(f"{slot}/texture")
        if element is None:
            return None
        name = element.get("texture", "")
        sampling = Sampling()
        for _ in range(_LONGEST_CHAIN):
            parameter = self.parameters.get(name)
            if parameter is None:
                break
            sampler = parameter.find("sampler2D")
            sampling = sampling if sampler is None else self._sampling(sampler)
            image = parameter.find(".//instance_image")
            source = parameter.findtext("sampler2D/source") or parameter.findtext("surface/init_from")
            following = reference(image) if image is not None else (source or "").strip()
            if following == name:
                break
            name = following
        self._warn_of_placement(element)
        found = self.image(name)
        return _Texture(None if found is None else self.textures.with_sampling(found, sampling), element.get("texcoord", ""))

    def _sampling(self, sampler: Element) -> Sampling:
        """Returns how a <sampler2D> reads its image."""
        wraps: list[Wrap] = []
        for tag in ("wrap_s", "wrap_t"):
            text = (sampler.findtext(tag) or "WRAP").strip()
            wraps.append(_WRAPS.get(text, "mirror" if text.startswith("MIRROR") else "clamp"))
            if text not in _WRAPS:
                self._warn(f"has <{tag}>{text[:20]}, which is left out; its texture is drawn with {wraps[-1].upper()}")
        # 1.4 has the filter between mip levels in the name of the other (LINEAR_MIPMAP_NEAREST), 1.5 by itself.
        minified, _, between = (sampler.findtext("minfilter") or "").strip().partition("_MIPMAP_")
        between = (
            sampler.findtext("mipfilter") or between or ("NONE" if minified in ("LINEAR", "NEAREST") else "LINEAR")
        ).strip()
        magnified = (sampler.findtext("magfilter") or "").strip()
        return Sampling(
            wraps[0], wraps[1], _filter(magnified), _filter(minified), None if between == "NONE" else _filter(between)
        )

    def _warn_of_placement(self, texture: Element) -> None:
        """Warns of the vendors' extras that scale, move or turn a texture."""
        usual = {"repeatU": 1.0, "repeatV": 1.0, "offsetU": 0.0, "offsetV": 0.0, "rotateUV": 0.0, "rotateFrame": 0.0}
        usual |= {"mirrorU": 0.0, "mirrorV": 0.0, "translateFrameU": 0.0, "translateFrameV": 0.0}
        for element in texture.iterfind("extra/technique/*"):
            text = (element.text or "").strip().lower()
            if element.tag not in usual or text in ("", "false"):
                continue
            if text == "true" or self.document.numbers(text).tolist() != [usual[element.tag]]:
                self._warn(
                    f"has <{element.tag}>{text[:20]} of a texture, which is left out; the texture lies as its coordinates say"
                )

    def _warn(self, text: str) -> None:
        self.document.warn(f"material {quoted(self.name)} {text}")


def _filter(text: str) -> Filter:
    return "nearest" if text == "NEAREST" else "linear"
