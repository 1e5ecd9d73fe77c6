"""Models bottles, cans, cups and bowls."""

from __future__ import annotations

import math

from gibson_sim_tools.making.blender.objects.workshop import (
    BLACK,
    GLASS,
    PORCELAIN,
    TIN,
    WHITE,
    LinkModel,
    ShaderMaterial,
    label,
    mm,
)

_FRONT = (0.0, 0.0, -math.pi / 2)
"""Rotates a label so that its first quarter, with the name, faces +x."""


def _bottle_water(part: LinkModel) -> None:
    clear = ShaderMaterial((0.70, 0.85, 0.93), roughness=0.08, alpha=0.42)
    grip = [(0.0330 - 0.0016 * (k % 2), 0.012 + 0.008 * k) for k in range(5)]
    part.lathe(
        [
            (0.0, 0.004),
            (0.022, 0.0),
            (0.031, 0.004),
            *grip,
            (0.0325, 0.056),
            (0.0325, 0.135),
            (0.033, 0.142),
            (0.033, 0.156),
            (0.029, 0.180),
            (0.020, 0.200),
            (0.0135, 0.208),
            (0.0135, 0.222),
            (0.0, 0.222),
        ],
        clear,
        24,
    )
    part.lathe([(0.0329, 0.064), (0.0329, 0.130)], label("label_water"), 24, turn=_FRONT)
    blue = ShaderMaterial((0.10, 0.32, 0.62), roughness=0.5)
    part.lathe(mm("0 213, 15 213, 15.4 216, 14.8 233, 13.5 235, 0 235"), blue, 20)
    part.lathe(mm("0 204.5, 15.5 204.5, 16.2 206, 15.5 207.5, 0 207.5"), clear, 16)


def _bottle_wine(part: LinkModel) -> None:
    glass = ShaderMaterial((0.07, 0.13, 0.07), roughness=0.08)
    part.lathe(
        mm("0 12, 20 4, 30 0, 36 3, 38 10, 38 185, 35.5 205, 28 222, 18.5 236, 14.8 250, 13.8 270"),
        glass,
        28,
    )
    foil = ShaderMaterial((0.42, 0.06, 0.10), metallic=0.3, roughness=0.4)
    part.lathe(mm("14.6 252, 14.1 262, 14.1 296, 15.2 298, 15.2 306, 13.8 310, 0 310"), foil, 20)
    part.lathe([(0.0383, 0.060), (0.0383, 0.150)], label("label_wine", 0.7), 28, turn=_FRONT)


def _can_soda(part: LinkModel) -> None:
    part.lathe(mm("0 8, 18 7, 23 0, 26 0.5, 32.5 9"), TIN, 28)
    part.lathe(mm("32.5 9, 33 12, 33 98, 32.5 100"), label("label_soda", 0.28, 0.25), 28, turn=_FRONT)
    part.lathe(mm("32.5 100, 27.8 111.5, 28.5 113.5, 27.8 116, 26.2 115.5, 25.5 111, 0 110.5"), TIN, 28)
    part.box((0.002, -0.006, 0.1108), (0.020, 0.006, 0.1122), TIN, 0.0005, 1)
    part.lathe(mm("0 0, 7 0, 7 0.6, 0 0.6"), BLACK, 14, at=(-0.012, 0, 0.1106))


def _can_food(part: LinkModel) -> None:
    for low in (0.0, 0.105):
        part.lathe(
            [
                (0.0345, low),
                (0.0370, low),
                (0.0375, low + 0.0012),
                (0.0375, low + 0.0038),
                (0.0370, low + 0.005),
                (0.0345, low + 0.005),
            ],
            TIN,
            28,
        )
    part.lathe([(0.0, 0.003), (0.035, 0.003)][::-1], TIN, 28)
    part.lathe(mm("35.8 4, 36.2 7, 36.2 103, 35.8 106"), label("label_food", 0.5), 28, turn=_FRONT)
    rings = mm("35 107, 30 107, 29 106.2, 26 106.2, 25 107, 0 107")
    part.lathe(rings, TIN, 28)
    part.box((-0.006, -0.010, 0.1072), (0.016, 0.010, 0.1088), TIN, 0.0006, 1)


def _handle(
    part: LinkModel, radius: float, low: float, high: float, out: float, thick: float, paint: ShaderMaterial, squash: float = 1.0
) -> None:
    """Adds a handle at the side +y."""
    middle, reach = (low + high) / 2, (high - low) / 2
    points = [
        (0.0, radius - 0.004, high),
        (0.0, radius + 0.4 * out, high + 0.10 * reach),
        (0.0, radius + out, middle + 0.75 * reach),
        (0.0, radius + out * squash, middle - 0.5 * reach),
        (0.0, radius + 0.3 * out, low - 0.02 * reach),
        (0.0, radius - 0.006, low),
    ]
    part.tube(points, thick, paint, 2, 5)


def _cup(part: LinkModel) -> None:
    part.lathe(
        mm("0 4, 17 3, 18 0, 21 0, 22 4, 30 14, 36.5 32, 39.5 52, 40 60, 39.2 62, 38 60, 37.2 52, 34 32, 28 17, 18 9, 0 8"),
        PORCELAIN,
        30,
    )
    part.lathe([(0.0, 0.0), (0.0366, 0.0)][::-1], ShaderMaterial((0.24, 0.13, 0.07), roughness=0.15), 30, at=(0, 0, 0.050))
    _handle(part, 0.036, 0.018, 0.050, 0.036, 0.0040, PORCELAIN, 0.75)


def _mug(part: LinkModel) -> None:
    outside = ShaderMaterial((0.16, 0.40, 0.44), roughness=0.25)
    part.lathe(mm("0 3, 33 3, 34 0, 38 0, 40.5 3, 41 8, 41 93, 40.5 95.2"), outside, 30)
    part.lathe(mm("40.5 95.2, 39.2 96, 37.6 95, 36.8 90, 36.5 10, 33 6, 0 6"), PORCELAIN, 30)
    _handle(part, 0.040, 0.022, 0.076, 0.043, 0.0058, outside, 0.9)


def _bowl(part: LinkModel) -> None:
    outside = ShaderMaterial((0.86, 0.62, 0.36), roughness=0.3)
    outer = mm("0 4, 33 4, 34 0, 39 0, 40 5, 56 16, 69 34, 77.5 56, 80 66")
    part.lathe(outer, outside, 36)
    part.lathe(mm("80 66, 79.2 68, 77.8 67.2, 74.5 55, 66 36, 53 20, 34 10, 0 8"), PORCELAIN, 36)


def _plate(part: LinkModel) -> None:
    rim = ShaderMaterial((0.20, 0.30, 0.50), roughness=0.2)
    part.lathe(
        mm("0 3, 72 3, 74 0, 80 0, 84 4, 106 12, 128.5 21.5, 130 23.2, 128.5 24"),
        PORCELAIN,
        44,
    )
    part.lathe([(0.1285, 0.024), (0.1215, 0.0214)], rim, 44)
    part.lathe(mm("121.5 21.4, 102 14.5, 90 9, 80 6.6, 0 6"), PORCELAIN, 44)


def _glass_tumbler(part: LinkModel) -> None:
    part.lathe(
        mm("0 0, 29 0, 31 2, 33 20, 37 118, 36.2 120, 35 118, 31.8 18, 28 14, 0 13"),
        GLASS,
        30,
    )
    water = ShaderMaterial((0.76, 0.88, 0.94), roughness=0.05, alpha=0.3)
    part.lathe(mm("0 13.5, 27.5 14.5, 31.2 18, 33.2 75, 0 75"), water, 30)


def _vase(part: LinkModel) -> None:
    outline = mm(
        "0 4, 38 3, 40 0, 44 1, 50 20, 62 60, 69 100, 69.5 125, 64 160, 50 195, 36 220, 30 240, 31 258, 38 275, 41.5 280"
    )
    part.lathe(outline, label("glaze", 0.2), 40)
    inside = ShaderMaterial((0.16, 0.22, 0.25), roughness=0.5)
    part.lathe(mm("41.5 280, 39 279.5, 34 272, 27 255, 26 238, 34 210, 30 180, 0 170"), inside, 40)


def _teapot(part: LinkModel) -> None:
    glaze = ShaderMaterial((0.80, 0.72, 0.56), roughness=0.22)
    part.lathe(
        mm("0 3, 40 3, 42 0, 47 0, 50 6, 64 22, 73 45, 75 66, 70 90, 56 110, 44 118, 42 120"),
        glaze,
        40,
    )
    part.lathe(mm("46 117, 47 120, 41 126, 22 133, 8 135, 7 138, 10.5 143, 9.5 148, 0 150"), glaze, 32)
    spout = mm("0 -58 52, 0 -80 54, 0 -98 78, 0 -106 102, 0 -121 111")
    part.tube(spout, 0.0135, glaze, 3, 6, (1.5, 1.25, 0.85, 0.68, 0.6))
    ear = mm("0 58 104, 0 92 122, 0 128 104, 0 128 66, 0 100 40, 0 66 42")
    part.tube(ear, 0.0068, ShaderMaterial((0.42, 0.27, 0.16), roughness=0.6), 2, 6)


def _candle(part: LinkModel) -> None:
    wax = ShaderMaterial((0.95, 0.90, 0.78), roughness=0.55)
    part.lathe(mm("0 0, 33 0, 35 2, 35 84, 33.5 87.5, 31 88, 26 84.5, 12 82, 0 81.5"), wax, 32)
    part.tube(mm("0 0 80, 0.5 0 88, 2 1 94, 2.5 1 100"), 0.0013, BLACK, 1, 3)


def _pen_cup(part: LinkModel) -> None:
    felt = ShaderMaterial((0.25, 0.26, 0.29), roughness=0.7)
    part.lathe(mm("0 0, 40 0, 42.5 2, 42.5 103, 41.8 105, 39.5 104.5, 39 102, 39 6, 0 5"), felt, 30)
    pens = (
        ((0.84, 0.22, 0.18), 15, 0.185),
        ((0.13, 0.30, 0.68), 115, 0.176),
        ((0.95, 0.74, 0.16), 235, 0.189),
        ((0.16, 0.16, 0.17), 310, 0.168),
    )
    for color, degrees, high in pens:
        a = math.radians(degrees)
        foot, top = (
            (0.016 * math.cos(a + 2.6), 0.016 * math.sin(a + 2.6), 0.008),
            (0.031 * math.cos(a), 0.031 * math.sin(a), high),
        )
        paint = ShaderMaterial(color, roughness=0.35)
        part.rod(foot, top, 0.0042, paint, 8, 0.0012)
        part.rod((top[0], top[1], high - 0.002), (1.02 * top[0], 1.02 * top[1], min(high + 0.004, 0.19)), 0.0028, WHITE, 8)


MAKERS = {
    function.__name__[1:]: function
    for function in (
        _bottle_water,
        _bottle_wine,
        _can_soda,
        _can_food,
        _cup,
        _mug,
        _bowl,
        _plate,
        _glass_tumbler,
        _vase,
        _teapot,
        _candle,
        _pen_cup,
    )
}
"""Modelling function of the only link, by object name."""
