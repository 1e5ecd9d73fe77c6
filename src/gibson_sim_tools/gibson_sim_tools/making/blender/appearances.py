"""Maps material names to a pattern and a colour. NumPy only; ``tiles`` draws the patterns."""

from __future__ import annotations

import colorsys

import numpy as np

from gibson_sim_tools.making.blender.shapes import Surface, Tint

APPEARANCES: dict[str, tuple[str, Tint]] = {
    "plaster_white": ("plaster", (0.90, 0.89, 0.87)),
    "plaster_warm": ("plaster", (0.90, 0.87, 0.81)),
    "plaster_sage": ("plaster", (0.66, 0.72, 0.62)),
    "plaster_blue": ("plaster", (0.58, 0.68, 0.76)),
    "plaster_grey": ("plaster", (0.74, 0.74, 0.73)),
    "brick_red": ("brick", (0.60, 0.30, 0.22)),
    "brick_white": ("brick", (0.86, 0.84, 0.80)),
    "concrete": ("concrete", (0.62, 0.61, 0.59)),
    "wallpaper_stripes": ("stripes", (0.80, 0.79, 0.72)),
    "oak_planks": ("planks", (0.72, 0.54, 0.36)),
    "walnut_planks": ("planks", (0.44, 0.29, 0.19)),
    "pine_planks": ("planks", (0.84, 0.68, 0.46)),
    "parquet": ("parquet", (0.66, 0.46, 0.28)),
    "tile_white": ("tile_30", (0.90, 0.90, 0.89)),
    "tile_grey": ("tile_60", (0.60, 0.60, 0.59)),
    "tile_terracotta": ("tile_30", (0.66, 0.46, 0.36)),
    "tile_checker": ("checker", (0.88, 0.87, 0.84)),
    "tile_metro": ("metro", (0.91, 0.92, 0.90)),
    "carpet_grey": ("carpet", (0.52, 0.52, 0.53)),
    "carpet_beige": ("carpet", (0.72, 0.65, 0.55)),
    "carpet_blue": ("carpet", (0.30, 0.38, 0.50)),
    "vinyl_grey": ("concrete", (0.68, 0.68, 0.67)),
    "marble": ("marble", (0.90, 0.89, 0.87)),
    "terrazzo": ("terrazzo", (0.82, 0.80, 0.76)),
    "wood_oak": ("wood", (0.74, 0.56, 0.38)),
    "wood_walnut": ("wood", (0.42, 0.28, 0.18)),
    "wood_pine": ("wood", (0.84, 0.68, 0.46)),
    "wood_white": ("plain", (0.90, 0.90, 0.88)),
    "wood_black": ("wood", (0.12, 0.11, 0.10)),
    "fabric_grey": ("fabric", (0.52, 0.53, 0.54)),
    "fabric_beige": ("fabric", (0.78, 0.71, 0.60)),
    "fabric_blue": ("fabric", (0.24, 0.34, 0.50)),
    "fabric_green": ("fabric", (0.32, 0.42, 0.32)),
    "fabric_red": ("fabric", (0.60, 0.22, 0.18)),
    "fabric_striped": ("cloth_stripes", (0.80, 0.76, 0.68)),
    "leather_brown": ("leather", (0.42, 0.25, 0.16)),
    "leather_black": ("leather", (0.11, 0.10, 0.10)),
    "metal_steel": ("plain", (0.66, 0.67, 0.68)),
    "metal_black": ("plain", (0.12, 0.12, 0.13)),
    "metal_brass": ("plain", (0.72, 0.56, 0.30)),
    "plastic_white": ("plain", (0.90, 0.90, 0.89)),
    "plastic_black": ("plain", (0.10, 0.10, 0.11)),
    "plastic_red": ("plain", (0.70, 0.14, 0.11)),
    "ceramic_white": ("plain", (0.93, 0.93, 0.92)),
    "glass": ("glass", (0.80, 0.90, 0.88)),
    "mirror": ("mirror", (0.78, 0.81, 0.82)),
    "stone_dark": ("terrazzo", (0.22, 0.22, 0.22)),
    "paper": ("plain", (0.92, 0.91, 0.88)),
    "leaves": ("leaves", (0.24, 0.40, 0.16)),
    "soil": ("concrete", (0.16, 0.11, 0.08)),
    "screen": ("screen", (0.05, 0.052, 0.058)),
    "cardboard": ("cardboard", (0.70, 0.55, 0.38)),
    # Only for furniture
    "rug": ("rug", (0.70, 0.62, 0.52)),
    "art": ("art", (0.80, 0.72, 0.60)),
    "linen": ("fabric", (0.90, 0.89, 0.86)),
    "glow": ("glow", (1.0, 0.95, 0.86)),
    "outside": ("outside", (0.84, 0.82, 0.78)),
}
_PRINTED_HUES = (0.0, 0.02, 0.05, 0.08, 0.11, 0.13, 0.3, 0.42, 0.52, 0.57, 0.6, 0.62)
UNLIT = ("glass", "glow", "mirror", "outside")
"""Patterns without a light map, of a single colour; a mirror has a picture of its own."""


def surface_of(name: str, tint: Tint | None = None, importance: float = 1.0) -> Surface:
    """Returns the surface of a named material, in its default colour or in ``tint``, sRGB."""
    pattern, color = APPEARANCES[name]
    return Surface(pattern, tint or color, importance)


def vary_color(color: Tint, rng: np.random.Generator, amount: float = 0.06) -> Tint:
    """Returns a random variation of a colour, sRGB."""
    hue, saturation, value = colorsys.rgb_to_hsv(*color)
    shifts = rng.uniform(-amount, amount, 3)
    return colorsys.hsv_to_rgb((hue + 0.3 * shifts[0]) % 1.0, _clamped(saturation + shifts[1]), _clamped(value + shifts[2]))


def sample_vivid_color(
    rng: np.random.Generator, saturation: tuple[float, float] = (0.25, 0.7), value: tuple[float, float] = (0.25, 0.85)
) -> Tint:
    """Samples a saturated colour, as of printed products, sRGB, within limits of HSV saturation and value."""
    hue = _PRINTED_HUES[int(rng.integers(len(_PRINTED_HUES)))] + rng.uniform(-0.02, 0.02)
    return colorsys.hsv_to_rgb(hue % 1.0, rng.uniform(*saturation), rng.uniform(*value))


def _clamped(value: float) -> float:
    return float(min(max(value, 0.0), 1.0))
