"""Materials and appearances of a scene as rows of the arrays that shaders read. No OpenGL here.

``MaterialTable`` collects the rows. An appearance changes a material in two ways: ``apply_appearance`` replaces numbers of the material;
the renderer draws tints of textures (``tint_matrix``) and patterns, whose pictures ``pattern_pictures`` makes.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from gibson_sim.description.shapes import Appearance, Pattern
from gibson_sim.formats.image_header import MAX_IMAGE_BYTES
from gibson_sim.formats.mesh import F64, Material
from gibson_sim.formats.textures import Warn, decode_image
from gibson_sim.geometry.colours import LUMINANCE, linear_from_srgb, srgb8_from_linear, srgb_from_linear
from gibson_sim.reading import read_file
from gibson_sim.render.batching.scene_geometry import APPEARANCE, MATERIAL, PLAIN_APPEARANCE

OPAQUE_ALPHA = 0.9
"""Alpha from which a blended material is drawn as opaque, so that it also has a depth."""
PATTERN_PX = 256
"""Side of the picture of a pattern, pixels."""
_CELLS = 8
"""Cells of a checker, and stripes, along one side: even, so that it repeats without a seam."""


class MaterialTable:
    """Rows of ``MATERIAL``, and of ``APPEARANCE`` beside them."""

    def __init__(self, appearances: Sequence[Appearance], warn: Callable[[str], None]) -> None:
        self.rows: dict[tuple[tuple[float, ...], tuple[float, ...]], int] = {}
        patterns = list(dict.fromkeys(appearance.pattern for appearance in appearances if appearance.pattern is not None))
        self._layers, self.patterns = pattern_pictures(patterns, warn)

    def row(self, material: Material, appearance: Appearance | None) -> int:
        """Returns the row of a material under an appearance."""
        worn = material if appearance is None else apply_appearance(material, appearance)
        linear = linear_from_srgb(worn.base_color[:3]).tolist()
        # A roughness of an appearance is that of the surface, not a factor on a map.
        from_map = [
            float(appearance is None or value is None)
            for value in (appearance and appearance.metallic, appearance and appearance.roughness)
        ]
        values = (
            *linear, worn.base_color[3],
            worn.metallic, worn.roughness, min(max(opaque_alpha(worn), 0.0), 1.0), float(worn.unlit),
            *worn.emissive, 0.0,
            0.0 if worn.normal_texture is None else worn.normal_scale, worn.occlusion_strength, *from_map,
        )  # fmt: skip
        return self.rows.setdefault((values, self._appearance(material, appearance)), len(self.rows))

    def _appearance(self, material: Material, appearance: Appearance | None) -> tuple[float, ...]:
        if appearance is None or not is_drawn(material, appearance):
            return ()
        layer, size = -1, 1.0
        colors: tuple[tuple[float, ...], tuple[float, ...]] = ((0.0,) * 3, (1.0,) * 3)
        if appearance.pattern is not None:
            layer, size, colors = self._layers[appearance.pattern], appearance.pattern.size, pattern_colors(appearance.pattern)
        first, second = linear_from_srgb(colors).tolist()
        tint = np.hstack([tint_matrix(appearance), np.zeros((3, 1))])
        return (*tint.ravel().tolist(), *first, float(layer), *second, 1.0 / size)

    def materials(self) -> NDArray[np.void]:
        """Returns (M,) of ``MATERIAL``."""
        return np.array([v for v, _ in self.rows], dtype=np.float32).reshape(-1, 16).view(MATERIAL)[:, 0]

    def appearances(self) -> NDArray[np.void]:
        """Returns (M,) of ``APPEARANCE``, or (0,) if there are none."""
        worn = [appearance for _, appearance in self.rows]
        if not any(worn):
            return np.zeros(0, dtype=APPEARANCE)
        return np.array([appearance or PLAIN_APPEARANCE for appearance in worn], dtype=np.float32).view(APPEARANCE)[:, 0]


def opaque_alpha(material: Material) -> float:
    """Returns the alpha from which a material is drawn as opaque."""
    return material.alpha_cutoff if material.alpha_mode == "mask" else OPAQUE_ALPHA


def apply_appearance(material: Material, appearance: Appearance) -> Material:
    """Returns a material under an appearance, without tints of textures and patterns, which the renderer draws."""
    changes: dict[str, object] = {}
    if appearance.is_tint and material.texture is None and not material.colored and appearance.pattern is None:
        changes["base_color"] = (*_tinted(material.base_color[:3], appearance), material.base_color[3])
    if appearance.metallic is not None:
        changes["metallic"] = appearance.metallic
    if appearance.roughness is not None:
        changes["roughness"] = appearance.roughness
    return replace(material, **changes)  # type: ignore[arg-type]


def is_drawn(material: Material, appearance: Appearance | None) -> bool:
    """Returns whether the renderer has to tint a texture or to draw a pattern: an appearance does more than ``apply_appearance``."""
    return appearance is not None and (
        appearance.pattern is not None or (appearance.is_tint and (material.texture is not None or material.colored))
    )


def tint_matrix(appearance: Appearance) -> F64:
    """Returns the (3, 3) matrix of a tint, linear light: hue turns about grey, saturation scales away from it, then value scales all."""
    angle = 2.0 * np.pi * appearance.hue
    c, s = np.cos(angle), np.sin(angle) / np.sqrt(3.0)
    third = (1.0 - c) / 3.0
    turn = np.array([[c + third, third - s, third + s], [third + s, c + third, third - s], [third - s, third + s, c + third]])
    grey = np.tile(LUMINANCE, (3, 1))
    matrix: F64 = appearance.value * (grey + appearance.saturation * (np.eye(3) - grey)) @ turn
    return matrix


def _tinted(srgb: tuple[float, ...], appearance: Appearance) -> tuple[float, ...]:
    return tuple(srgb_from_linear(tint_matrix(appearance) @ linear_from_srgb(srgb)).tolist())


def pattern_pictures(patterns: Sequence[Pattern], warn: Warn) -> tuple[dict[Pattern, int], NDArray[np.uint8]]:
    """Makes the pictures of patterns: patterns that differ in colours and size alone share one.

    Returns:
        The layer of each pattern, and the layers, (L, 256, 256, 3) uint8, sRGB. A pattern mixes its two colours by the picture's,
        channel by channel, in linear light. An image that cannot be read has layer -1, after a warning.
    """
    layers: dict[tuple[str, int, str], int] = {}
    pictures: list[NDArray[np.uint8]] = []
    found: dict[Pattern, int] = {}
    for pattern in patterns:
        key = (pattern.kind, pattern.seed if pattern.kind == "noise" else 0, pattern.image)
        if key not in layers:
            picture = _picture(pattern, warn)
            layers[key] = -1 if picture is None else len(pictures)
            if picture is not None:
                pictures.append(picture)
        found[pattern] = layers[key]
    return found, np.stack(pictures) if pictures else np.zeros((0, PATTERN_PX, PATTERN_PX, 3), dtype=np.uint8)


def pattern_colors(pattern: Pattern) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Returns the colours where the picture is black and where it is white, sRGB; an image keeps its own."""
    return ((0.0,) * 3, (1.0,) * 3) if pattern.kind == "image" else pattern.colors


def _picture(pattern: Pattern, warn: Warn) -> NDArray[np.uint8] | None:
    size = (PATTERN_PX, PATTERN_PX)
    if pattern.kind == "image":
        try:
            pixels = decode_image(read_file(Path(pattern.image), MAX_IMAGE_BYTES))
        except OSError:
            pixels = None
        if pixels is None:
            warn(f"{pattern.image}: is no image that can be read; the surface keeps its own texture")
            return None
        return np.asarray(cv2.resize(np.ascontiguousarray(pixels[:, :, :3]), size, interpolation=cv2.INTER_AREA), dtype=np.uint8)
    cell = np.arange(PATTERN_PX) * _CELLS // PATTERN_PX
    if pattern.kind == "stripes":
        share = np.broadcast_to((cell % 2).astype(np.float64), size)
    elif pattern.kind == "checker":
        share = ((cell[:, None] + cell[None, :]) % 2).astype(np.float64)
    else:
        share = _noise(np.random.Generator(np.random.PCG64(pattern.seed)))
    return np.repeat(srgb8_from_linear(share)[:, :, None], 3, axis=2)


def _noise(rng: np.random.Generator) -> F64:
    """Returns value noise of four octaves that repeats without a seam, (256, 256), 0 to 1."""
    total = np.zeros((PATTERN_PX, PATTERN_PX))
    for cells, weight in ((4, 0.5), (8, 0.27), (16, 0.14), (64, 0.09)):
        knots = rng.random((cells, cells))
        at = np.arange(PATTERN_PX) * cells / PATTERN_PX
        low = at.astype(np.int64)
        t = at - low
        t = t * t * (3.0 - 2.0 * t)
        high = (low + 1) % cells
        rows = knots[low] + t[:, None] * (knots[high] - knots[low])
        total += weight * (rows[:, low] + t[None, :] * (rows[:, high] - rows[:, low]))
    return np.clip((total - 0.5) * 2.2 + 0.5, 0.0, 1.0)
