"""Models books, boxes, fruit, balls, electronics, a clock, a chair, a stool, a small table."""

from __future__ import annotations

import math

from mathutils import Matrix

from gibson_sim_tools.making.blender.objects.workshop import (
    BEECH,
    BLACK,
    BRASS,
    GREY_PLASTIC,
    OAK,
    PAPER,
    RUBBER,
    WALNUT,
    LinkModel,
    ShaderMaterial,
    label,
    mm,
)

_WALNUT_ROUND = ShaderMaterial((0.36, 0.23, 0.14), roughness=0.45)
_SPINE, _FRONT = (0.0, 0.0, 0.125, 1.0), (0.13, 0.0, 1.0, 1.0)


def _book(
    part: LinkModel,
    x: float,
    y: float,
    low: float,
    size: tuple[float, float, float],
    cover: str,
    color: tuple[float, float, float],
    yaw: float,
) -> None:
    """Adds a lying book centred at (x, y); before the rotation, its spine faces -x and the top of its cover +y."""
    dx, dy, dz = size
    board = 0.0022
    paint, plain = label(cover, 0.6), ShaderMaterial(color, roughness=0.6)
    first = len(part.pieces)
    part.box((-dx / 2 + 0.001, -dy / 2, dz - board), (dx / 2, dy / 2, dz), plain, 0.0007, 1)
    part.box((-dx / 2 + 0.001, -dy / 2, 0.0), (dx / 2, dy / 2, board), plain, 0.0007, 1)
    part.box((-dx / 2 + 0.004, -dy / 2 + 0.004, board), (dx / 2 - 0.004, dy / 2 - 0.004, dz - board), PAPER, 0.0005, 1)
    part.box((-dx / 2, -dy / 2, 0.0), (-dx / 2 + 0.004, dy / 2, dz), plain, 0.0018, 2)
    top = dz + 0.0003
    left, right, far = -dx / 2 + 0.006, dx / 2 - 0.001, dy / 2 - 0.001
    part.plate([(left, far, top), (left, -far, top), (right, -far, top), (right, far, top)], paint)
    _crop(part, _FRONT)
    back = -dx / 2 - 0.0003
    part.plate([(back, far, 0.002), (back, -far, 0.002), (back, -far, dz - 0.002), (back, far, dz - 0.002)], paint)
    _crop(part, _SPINE)
    move = Matrix.Translation((x, y, low)) @ Matrix.Rotation(yaw, 4, "Z")
    for piece in part.pieces[first:]:
        piece.matrix_world = move @ piece.matrix_world


def _crop(part: LinkModel, window: tuple[float, float, float, float]) -> None:
    """Crops the picture of the last plate to a window."""
    left, top, right, bottom = window
    for loop in part.pieces[-1].data.uv_layers[0].data:
        u, v = loop.uv
        loop.uv = (left + u * (right - left), 1 - bottom + v * (bottom - top))


def _book_a(part: LinkModel) -> None:
    _book(part, 0.0, 0.0, 0.0, (0.155, 0.225, 0.0297), "cover_blue", (0.14, 0.24, 0.41), 0.0)


def _book_b(part: LinkModel) -> None:
    _book(part, 0.0, 0.0, 0.0, (0.130, 0.195, 0.0217), "cover_red", (0.59, 0.16, 0.16), 0.0)


def _book_stack(part: LinkModel) -> None:
    _book(part, 0.0, 0.0, 0.0, (0.170, 0.240, 0.038), "cover_green", (0.20, 0.38, 0.27), 0.02)
    _book(part, 0.002, -0.004, 0.0383, (0.156, 0.224, 0.030), "cover_cream", (0.88, 0.83, 0.71), -0.05)
    _book(part, -0.003, 0.004, 0.0686, (0.138, 0.205, 0.029), "cover_red", (0.59, 0.16, 0.16), 0.07)


def _box_cereal(part: LinkModel) -> None:
    front, side = (0.0, 0.0, 0.625, 1.0), (0.625, 0.0, 1.0, 1.0)
    plain = (0.02, 0.02, 0.06, 0.06)
    atlas = {"+x": front, "-x": front, "+y": side, "-y": side, "+z": plain, "-z": plain}
    part.box((-0.035, -0.095, 0.0), (0.035, 0.095, 0.29), label("box_cereal", 0.45), 0.0012, 1, atlas)


def _box_small(part: LinkModel) -> None:
    whole, plain = (0.0, 0.0, 1.0, 1.0), (0.0, 0.1, 1.0, 0.22)
    atlas = {"+z": whole, "+x": plain, "-x": plain, "+y": plain, "-y": plain, "-z": plain}
    part.box((-0.06, -0.09, 0.0), (0.06, 0.09, 0.09), label("box_tea", 0.4), 0.0012, 1, atlas)
    part.box((-0.0604, -0.0904, 0.0645), (0.0604, 0.0904, 0.0655), ShaderMaterial((0.10, 0.27, 0.23), roughness=0.5), 0.0, 1)


def _box_cardboard(part: LinkModel) -> None:
    card = label("cardboard", 0.9)
    side, plain = (0.0, 0.0, 1.0, 1.0), (0.0, 0.0, 1.0, 0.65)
    part.box(
        (-0.15, -0.2, 0.0),
        (0.15, 0.2, 0.278),
        card,
        0.003,
        1,
        {"+x": side, "-x": side, "+y": side, "-y": side, "+z": plain, "-z": plain},
    )
    for x0, x1 in ((-0.149, -0.0008), (0.0008, 0.149)):
        part.box(
            (x0, -0.199, 0.276), (x1, 0.199, 0.2795), card, 0.001, 1, {k: plain for k in ("+x", "-x", "+y", "-y", "+z", "-z")}
        )
    tape = ShaderMaterial((0.78, 0.64, 0.40), roughness=0.25)
    part.box((-0.025, -0.2006, 0.2793), (0.025, 0.2006, 0.28), tape, 0.0, 1)
    for y in (-0.2004, 0.2004):
        part.box((-0.025, min(y, y * 0.9995), 0.225), (0.025, max(y, y * 0.9995), 0.28), tape, 0.0, 1)


def _laptop(part: LinkModel) -> None:
    shell = ShaderMaterial((0.66, 0.665, 0.68), metallic=0.35, roughness=0.4)
    part.box((-0.115, -0.165, 0.004), (0.12, 0.165, 0.017), shell, 0.003, 2)
    for x in (-0.1, 0.1):
        part.box((x - 0.006, -0.14, 0.0), (x + 0.006, 0.14, 0.004), RUBBER, 0.001, 1)
    keys = label("keys_laptop", 0.55)
    part.plate(mm("-105 -155 17.3, 112 -155 17.3, 112 155 17.3, -105 155 17.3"), keys)
    part.rod((-0.116, -0.13, 0.016), (-0.116, 0.13, 0.016), 0.006, RUBBER, 10)
    # The lid is tilted back about its hinge.
    lean, high = 0.33, 0.206
    foot, s, c = (-0.118, 0.016), math.sin(lean), math.cos(lean)

    def at(along: float, out: float) -> tuple[float, float]:
        return foot[0] - along * s + out * c, foot[1] + along * c + out * s

    x, z = at(high / 2, -0.003)
    part.box((x - 0.003, -0.165, z - high / 2), (x + 0.003, 0.165, z + high / 2), shell, 0.0025, 2, turn=(0.0, -lean, 0.0))
    for margin, out, paint in (
        (0.004, 0.0002, BLACK),
        (0.012, 0.0005, ShaderMaterial(picture="screen", roughness=0.25, glow=0.8)),
    ):
        (x0, z0), (x1, z1) = at(margin + 0.006, out), at(high - margin, out)
        y = 0.165 - margin
        part.plate([(x1, -y, z1), (x0, -y, z0), (x0, y, z0), (x1, y, z1)], paint)


def _keyboard(part: LinkModel) -> None:
    part.box(
        (-0.07, -0.22, 0.005),
        (0.07, 0.22, 0.016),
        ShaderMaterial((0.17, 0.18, 0.20), roughness=0.5),
        0.004,
        2,
        turn=(0.0, 0.06, 0.0),
    )
    for y in (-0.17, 0.17):
        part.box((-0.062, y - 0.02, 0.0), (-0.05, y + 0.02, 0.012), RUBBER, 0.001, 1)
    key = ShaderMaterial((0.30, 0.31, 0.33), roughness=0.5)
    accent = ShaderMaterial((0.86, 0.42, 0.20), roughness=0.5)
    for row in range(5):
        x, y = -0.048 + 0.0225 * row, -0.206
        z = 0.0172 - math.tan(0.06) * x
        while y < 0.19:
            width = 0.0205
            if row == 4 and -0.10 < y < -0.08:
                width = 0.14
            elif row and y < -0.2:
                width = 0.0205 * (1 + 0.25 * row)
            width = 0.206 - y if y + 1.6 * width > 0.206 else width
            paint = accent if (row, y < -0.2) == (0, True) or (row == 2 and y + width > 0.2) else key
            part.box(
                (x - 0.0095, y + 0.001, z - 0.004),
                (x + 0.0095, y + width - 0.001, z + 0.0045),
                paint,
                0.0,
                1,
                turn=(0.0, 0.06, 0.0),
            )
            y += width


def _remote_control(part: LinkModel) -> None:
    part.box((-0.085, -0.023, 0.0), (0.085, 0.023, 0.019), ShaderMaterial((0.12, 0.12, 0.13), roughness=0.55), 0.006, 3)
    red, grey, pale = (
        ShaderMaterial((0.80, 0.14, 0.12), roughness=0.4),
        GREY_PLASTIC,
        ShaderMaterial((0.82, 0.82, 0.82), roughness=0.4),
    )
    part.rod((-0.070, -0.012, 0.0185), (-0.070, -0.012, 0.0215), 0.0045, red, 12, 0.0008)
    part.lathe(mm("0 0, 15 0, 15.5 1, 14.5 2.2, 8.5 2.2, 0 1.5"), grey, 20, at=(-0.022, 0.0, 0.0188))
    part.rod((-0.022, 0.0, 0.0195), (-0.022, 0.0, 0.022), 0.006, pale, 12, 0.0008)
    for row in range(4):
        for column in (-1, 0, 1):
            x, y = 0.012 + 0.0165 * row, 0.013 * column
            part.box((x - 0.004, y - 0.0045, 0.018), (x + 0.004, y + 0.0045, 0.0208), pale, 0.001, 1)
    for y in (0.006, 0.015):
        part.box((-0.052, y - 0.0035, 0.018), (-0.044, y + 0.0035, 0.0208), grey, 0.001, 1)


def _fruit_apple(part: LinkModel) -> None:
    outline = mm("0 7.5, 8 3, 13.5 0, 21 3.2, 30 14, 35.5 28, 37 40, 34.5 52, 27 62.5, 18 66.8, 10 65.5, 3.5 60, 0 57.5")
    part.lathe(outline, label("skin_apple", 0.3), 28, shape=lambda a, s: 1.0 + 0.012 * math.cos(5 * a) * (0.3 + abs(s - 0.5)))
    stem = ShaderMaterial((0.32, 0.22, 0.12), roughness=0.8)
    part.tube(mm("0 0 57, 0.5 0 64, 3 1 70, 6 2 74.2"), 0.0014, stem, 1, 3)


def _ball_outline(radius: float, steps: int) -> list[tuple[float, float]]:
    return [(radius * math.sin(math.pi * k / steps), radius - radius * math.cos(math.pi * k / steps)) for k in range(steps + 1)]


def _fruit_orange(part: LinkModel) -> None:
    part.lathe(_ball_outline(0.038, 14), label("skin_orange", 0.45), 28)
    part.lathe(mm("0 0, 3 0.3, 3.5 0.8, 0 1"), ShaderMaterial((0.30, 0.38, 0.16), roughness=0.8), 8, at=(0, 0, 0.0750))


def _toy_ball(part: LinkModel) -> None:
    part.lathe(_ball_outline(0.06, 18), label("beach_ball", 0.3), 36)


def _ball(part: LinkModel) -> None:
    part.lathe(_ball_outline(0.11, 22), label("football", 0.4), 44)


def _clock(part: LinkModel) -> None:
    turn = (0.0, math.pi / 2, 0.0)  # the axis of revolution points forward
    part.lathe(
        mm("0 -20, 60 -20, 68 -15, 68 16, 65.5 22.5, 62.5 22.5, 60.5 18, 0 18"), _WALNUT_ROUND, 44, at=(0, 0, 0.077), turn=turn
    )
    part.lathe(mm("66 21.5, 64.5 25, 61.5 23.5, 60.5 19.5"), BRASS, 44, at=(0, 0, 0.077), turn=turn)
    part.disc(0.0605, label("clock_face", 0.3), at=(0.0186, 0.0, 0.077), turn=turn)
    for y in (-0.032, 0.032):
        part.box((-0.022, y - 0.012, 0.0), (0.022, y + 0.012, 0.024), WALNUT, 0.004, 2)
    part.rod((0.0, 0.0, 0.140), (0.0, 0.0, 0.145), 0.007, BRASS, 14, 0.001)


def _bin_waste(part: LinkModel) -> None:
    paint = ShaderMaterial((0.42, 0.47, 0.50), roughness=0.55)
    inner = ShaderMaterial((0.26, 0.29, 0.31), roughness=0.7)
    part.lathe(mm("0 0, 100 0, 104 4, 118 160, 133.5 312, 138 314, 140 320, 139 328, 136 330"), paint, 40)
    part.lathe(mm("136 330, 132 328, 130 310, 100 8, 0 7"), inner, 40)
    for z, r in ((0.09, 0.1125), (0.20, 0.1225)):
        part.lathe([(r, z - 0.006), (r + 0.002, z - 0.003), (r + 0.002, z + 0.003), (r + 0.0005, z + 0.006)], paint, 40)


def _basket(part: LinkModel) -> None:
    weave = ShaderMaterial((0.68, 0.52, 0.32), roughness=0.85, picture="wicker", tile=0.12)
    x, y, z, w = 0.148, 0.198, 0.215, 0.012
    part.box((-x, -y, 0.0), (x, y, w), weave, 0.003, 1)
    for side in (-1, 1):
        part.box((min(side * x, side * (x - w)), -y, 0.004), (max(side * x, side * (x - w)), y, z), weave, 0.003, 1)
        part.box((-x, min(side * y, side * (y - w)), 0.004), (x, max(side * y, side * (y - w)), z), weave, 0.003, 1)
    dark = ShaderMaterial((0.52, 0.36, 0.20), roughness=0.8)
    r = 0.008
    corners = [(x - 0.006, y - 0.006), (-x + 0.006, y - 0.006), (-x + 0.006, -y + 0.006), (x - 0.006, -y + 0.006)]
    for (x0, y0), (x1, y1) in zip(corners, corners[1:] + corners[:1], strict=True):
        part.rod((x0, y0, z), (x1, y1, z), r, dark, 10)
        part.lathe(_ball_outline(r, 6), dark, 10, at=(x0, y0, z - r))
    for side in (-1, 1):
        ear = [
            (-0.06, side * 0.192, 0.205),
            (-0.055, side * 0.196, 0.228),
            (0.0, side * 0.197, 0.2285),
            (0.055, side * 0.196, 0.228),
            (0.06, side * 0.192, 0.205),
        ]
        part.tube(ear, 0.0055, dark, 2, 4)


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


MAKERS = {
    function.__name__[1:]: function
    for function in (
        _chair_wooden,
        _stool,
        _table_side,
        _book_a,
        _book_b,
        _book_stack,
        _box_cereal,
        _box_small,
        _box_cardboard,
        _laptop,
        _keyboard,
        _remote_control,
        _fruit_apple,
        _fruit_orange,
        _toy_ball,
        _ball,
        _clock,
        _bin_waste,
        _basket,
    )
}
"""Modelling function of the only link, by object name."""
