"""Models a chair, a stool, a small table."""

from __future__ import annotations

import math

from gibson_sim_tools.making.blender.objects.paints import BEECH, OAK, WALNUT
from gibson_sim_tools.making.blender.objects.workshop import LinkModel, ShaderMaterial, mm


def _leg(
    part: LinkModel, foot: tuple[float, float, float], top: tuple[float, float, float], thick: float, paint: ShaderMaterial
) -> None:
    """Adds a round leg that tapers towards its foot."""
    # The end of an inclined bar is inclined, too: its lower edge touches the floor.
    slant = math.hypot(top[0] - foot[0], top[1] - foot[1]) / math.dist(foot, top)
    part.rod((foot[0], foot[1], foot[2] + 0.62 * thick * slant), top, 0.62 * thick, paint, 14, 0.002, top=thick)


def _chair_wooden(part: LinkModel) -> None:
    wood = ShaderMaterial(OAK.color, roughness=0.5)
    part.prism(mm("240 -190, 240 190, 215 220, -190 205, -220 180, -220 -180, -190 -205, 215 -220"), 0.427, 0.455, OAK, 0.007)
    for y in (-1.0, 1.0):
        _leg(part, (0.222, 0.200 * y, 0.0), (0.190, 0.175 * y, 0.43), 0.019, wood)
        _leg(part, (-0.222, 0.190 * y, 0.0), (-0.180, 0.170 * y, 0.43), 0.019, wood)
        part.tube(
            [(-0.190, 0.178 * y, 0.44), (-0.215, 0.180 * y, 0.58), (-0.238, 0.182 * y, 0.72), (-0.249, 0.184 * y, 0.845)],
            0.0145,
            wood,
            3,
            6,
            (1.15, 1.0, 0.95, 0.8),
        )
        part.rod((0.208, 0.188 * y, 0.20), (-0.204, 0.181 * y, 0.20), 0.009, wood, 10)
    part.rod((0.0, -0.185, 0.20), (0.0, 0.185, 0.20), 0.009, wood, 10)
    for k in range(5):
        y = -0.115 + 0.0575 * k
        part.tube([(-0.193, 0.92 * y, 0.45), (-0.222, y, 0.60), (-0.238, 1.03 * y, 0.82)], 0.0075, wood, 2, 5)
    # The top rail is curved.
    front, back = [], []
    for k in range(13):
        y = -0.215 + 0.43 * k / 12
        bend = -0.232 - 0.010 * math.cos(y / 0.22 * 1.5)
        front.append((bend + 0.011, y))
        back.append((bend - 0.008, y))
    part.prism([*front, *back[::-1]], 0.80, 0.88, OAK, 0.006)


def _stool(part: LinkModel) -> None:
    seat = mm("0 430, 165 430, 176 434, 180 443, 178 455, 170 460, 130 458.5, 0 456.5")
    part.lathe(seat, ShaderMaterial((0.82, 0.68, 0.50), roughness=0.55, picture="wood_beech"), 40)
    wood = ShaderMaterial((0.80, 0.66, 0.48), roughness=0.55)
    feet = [(0.152 * x, 0.152 * y) for x, y in ((1, 1), (-1, 1), (-1, -1), (1, -1))]
    for x, y in feet:
        _leg(part, (x, y, 0.0), (0.72 * x, 0.72 * y, 0.432), 0.019, wood)
    for (x0, y0), (x1, y1) in zip(feet, feet[1:] + feet[:1], strict=True):
        part.rod((0.91 * x0, 0.91 * y0, 0.14), (0.91 * x1, 0.91 * y1, 0.14), 0.010, wood, 10)


def _table_side(part: LinkModel) -> None:
    part.box((-0.225, -0.225, 0.476), (0.225, 0.225, 0.5), WALNUT, 0.005, 2)
    for x in (-1, 1):
        for y in (-1, 1):
            _leg(
                part,
                (0.200 * x, 0.200 * y, 0.0),
                (0.178 * x, 0.178 * y, 0.478),
                0.0195,
                ShaderMaterial(WALNUT.color, roughness=0.5),
            )
    for k in (-1, 1):
        part.box((-0.175, 0.178 * k - 0.009, 0.425), (0.175, 0.178 * k + 0.009, 0.477), WALNUT, 0.002, 1)
        part.box((0.178 * k - 0.009, -0.175, 0.425), (0.178 * k + 0.009, 0.175, 0.477), WALNUT, 0.002, 1)
    part.box((-0.185, -0.185, 0.14), (0.185, 0.185, 0.156), BEECH, 0.003, 2)


MAKERS = {function.__name__[1:]: function for function in (_chair_wooden, _stool, _table_side)}
"""Modelling function of the only link, by object name."""
