"""Furnishes the flat. Each piece is modelled at the origin with its front along -y, and placed at (x, y, yaw)."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from gibson_sim_tools.generator import textures
from gibson_sim_tools.generator.gltf import MeshBuilder, MeshMaterial

SaveTexture = Callable[[str, textures.Image], str]
MakeRng = Callable[[str], np.random.Generator]
Box = tuple[float, float, float, float]


@dataclass(frozen=True)
class FlatPiece:
    """A piece of furniture and its pose."""

    name: str
    semantic_class: str
    solid: MeshBuilder | None
    """None = the mesh of another piece, see ``mesh``."""
    xy: tuple[float, float] = (0.0, 0.0)
    yaw_deg: float = 0.0
    collision: str = "same"
    mesh: str = ""
    footprint: Box | None = None
    """Footprint, (x0, y0, x1, y1), m, for its shadow on the floor."""


@dataclass(frozen=True)
class _Materials:
    oak: MeshMaterial
    walnut: MeshMaterial
    white: MeshMaterial
    sofa: MeshMaterial
    pillow: MeshMaterial
    linen: MeshMaterial
    rug: MeshMaterial
    runner: MeshMaterial
    books: MeshMaterial
    ceramic: MeshMaterial
    steel: MeshMaterial
    dark: MeshMaterial
    leaf: MeshMaterial
    pot: MeshMaterial
    shade: MeshMaterial
    stone: MeshMaterial
    mirror: MeshMaterial


def _materials(save: SaveTexture, rng: MakeRng) -> _Materials:
    def texture(name: str, image: textures.Image, metres: float = 1.0) -> MeshMaterial:
        return MeshMaterial(name, save(name, image), metres=metres)

    return _Materials(
        oak=texture("oak", textures.wood(rng("oak"), (0.72, 0.54, 0.34)), 0.8),
        walnut=texture("walnut", textures.wood(rng("walnut"), (0.44, 0.29, 0.19)), 0.8),
        white=texture("lacquer", textures.plain(rng("lacquer"), (0.91, 0.9, 0.88), 64, 0.012), 0.5),
        sofa=texture("sofa_cloth", textures.fabric(rng("sofa"), (0.33, 0.43, 0.50)), 0.5),
        pillow=texture("pillow_cloth", textures.fabric(rng("pillow"), (0.82, 0.55, 0.24)), 0.4),
        linen=texture("linen", textures.fabric(rng("linen"), (0.90, 0.89, 0.86)), 0.6),
        rug=texture("rug", textures.fabric(rng("rug"), (0.62, 0.26, 0.22)), 0.6),
        runner=texture("runner", textures.fabric(rng("runner"), (0.35, 0.38, 0.46)), 0.6),
        books=texture("books", textures.book_spines(rng("books")), 0.9),
        ceramic=MeshMaterial("ceramic", color=(0.88, 0.88, 0.87)),
        steel=MeshMaterial("steel", color=(0.45, 0.46, 0.47)),
        dark=MeshMaterial("dark", color=(0.02, 0.02, 0.024)),
        leaf=MeshMaterial("leaf", color=(0.06, 0.20, 0.05)),
        pot=MeshMaterial("pot", color=(0.55, 0.20, 0.10)),
        shade=MeshMaterial("lampshade", color=(1.0, 0.88, 0.66), unlit=True),
        stone=texture("worktop", textures.plain(rng("worktop"), (0.26, 0.26, 0.28), 128, 0.2), 0.6),
        mirror=MeshMaterial("mirror", color=(0.62, 0.70, 0.74), unlit=True),
    )


def furnish(save: SaveTexture, rng: MakeRng) -> list[FlatPiece]:
    """Returns the furniture of the flat; writes textures through ``save``."""
    p = _materials(save, rng)
    pieces = [
        _piece("sofa", "sofa", _sofa(p), (1.35, 2.4), 90.0, (1.8, 0.9)),
        _piece("coffee_table", "table", _table(p.walnut, 1.0, 0.55, 0.42), (2.75, 2.4), 90.0, (1.0, 0.55)),
        _piece("tv_board", "cabinet", _tv(p), (4.88, 3.15), -90.0, (1.3, 0.4)),
        _piece("bookshelf", "shelf", _bookshelf(p), (2.7, 3.76), 0.0, (1.0, 0.3)),
        _piece("armchair", "chair", _armchair(p), (3.7, 0.75), 160.0, (0.8, 0.8)),
        _piece("plant", "plant", _plant(p, rng("plant")), (0.5, 0.5), 0.0, (0.35, 0.35)),
        _piece("floor_lamp", "lamp", _lamp(p), (0.45, 3.6), 0.0, (0.3, 0.3)),
        _piece("rug", "rug", _rug(p.rug, 2.2, 1.5), (2.75, 2.4), 90.0, None, "none"),
        _piece("kitchen_counter", "counter", _counter(p), (7.58, 0.36), 180.0, (2.7, 0.6)),
        _piece("fridge", "fridge", _fridge(p), (5.72, 0.38), 180.0, (0.62, 0.62)),
        _piece("dining_table", "table", _table(p.oak, 1.5, 0.85, 0.74), (7.6, 2.5), 0.0, (1.5, 0.85)),
        _piece("chair", "chair", _chair(p), (7.2, 3.1), 0.0, (0.42, 0.42)),
        _piece("bed", "bed", _bed(p), (4.24, 7.3), 90.0, (1.64, 2.1)),
        _piece("nightstand", "nightstand", _nightstand(p), (5.08, 6.2), 90.0, (0.42, 0.42)),
        _piece("wardrobe", "wardrobe", _wardrobe(p), (0.4, 8.05), -90.0, (0.95, 0.6)),
        _piece("desk", "table", _table(p.oak, 1.2, 0.6, 0.74), (0.4, 6.9), 90.0, (1.2, 0.6)),
        _piece("bedroom_rug", "rug", _rug(p.runner, 1.4, 2.0), (2.5, 7.4), 0.0, None, "none"),
        _piece("bath", "bath", _bath(p), (8.02, 8.17), 0.0, (1.7, 0.72)),
        _piece("basin", "basin", _basin(p), (5.72, 7.0), 90.0, (0.8, 0.46)),
        _piece("toilet", "toilet", _toilet(p), (8.6, 6.4), -90.0, (0.4, 0.66)),
        _piece("shoe_cabinet", "cabinet", _nightstand(p, 1.0, 0.24, 0.8), (5.2, 5.2), 0.0, (1.0, 0.24)),
        _piece("hall_runner", "rug", _rug(p.runner, 2.4, 0.8), (6.4, 4.6), 0.0, None, "none"),
    ]
    for name, xy, yaw in (
        ("chair_2", (8.0, 3.1), 0.0),
        ("chair_3", (7.2, 1.9), 180.0),
        ("chair_4", (8.0, 1.9), 180.0),
        ("desk_chair", (0.95, 6.9), -90.0),
    ):
        pieces.append(FlatPiece(name, "chair", None, xy, yaw, mesh="chair", footprint=_footprint(xy, yaw, (0.42, 0.42))))
    pieces.append(
        FlatPiece(
            "nightstand_2",
            "nightstand",
            None,
            (5.08, 8.36),
            90.0,
            mesh="nightstand",
            footprint=_footprint((5.08, 8.36), 90.0, (0.42, 0.42)),
        )
    )
    return pieces + _pictures(save, rng, p)


def _piece(
    name: str,
    semantic_class: str,
    solid: MeshBuilder,
    xy: tuple[float, float],
    yaw_deg: float,
    size: tuple[float, float] | None,
    collision: str = "same",
) -> FlatPiece:
    return FlatPiece(
        name, semantic_class, solid, xy, yaw_deg, collision, footprint=_footprint(xy, yaw_deg, size) if size else None
    )


def _footprint(xy: tuple[float, float], yaw_deg: float, size: tuple[float, float]) -> Box:
    """Returns the bounding rectangle of a rotated rectangle. ``size``: width, depth, m."""
    c, s = abs(math.cos(math.radians(yaw_deg))), abs(math.sin(math.radians(yaw_deg)))
    w, h = (size[0] * c + size[1] * s) / 2, (size[0] * s + size[1] * c) / 2
    return (xy[0] - w, xy[1] - h, xy[0] + w, xy[1] + h)


def _pictures(save: SaveTexture, rng: MakeRng, p: _Materials) -> list[FlatPiece]:
    """Returns framed paintings; (x, y) is on the wall, and -y of a piece points into the room."""
    poses = (
        (0.075, 3.35, 90.0),
        (3.15, 5.325, 0.0),
        (1.0, 5.325, 0.0),
        (8.3, 3.925, 0.0),
        (4.2, 5.475, 180.0),
        (5.5, 4.075, 180.0),
    )
    pieces = []
    for number, (x, y, yaw) in enumerate(poses, start=1):
        name = f"painting_{number}"
        solid = MeshBuilder()
        art = MeshMaterial(name, save(name, textures.painting(rng(name))))
        solid.box((-0.43, -0.025, 1.15), (0.43, 0.0, 1.8), p.walnut)
        front = [(-0.38, -0.027, 1.2), (0.38, -0.027, 1.2), (0.38, -0.027, 1.75), (-0.38, -0.027, 1.75)]
        solid.quad(art, front, [(0, 1), (1, 1), (1, 0), (0, 0)])
        pieces.append(FlatPiece(name, "painting", solid, (x, y), yaw, "none"))
    return pieces


def _legs(solid: MeshBuilder, material: MeshMaterial, half: tuple[float, float], height: float, thickness: float = 0.05) -> None:
    for sx in (-1, 1):
        for sy in (-1, 1):
            x, y = sx * (half[0] - thickness), sy * (half[1] - thickness)
            solid.box((x - thickness / 2, y - thickness / 2, 0.0), (x + thickness / 2, y + thickness / 2, height), material)


def _table(material: MeshMaterial, width: float, depth: float, height: float) -> MeshBuilder:
    solid = MeshBuilder()
    solid.cushion((-width / 2, -depth / 2, height - 0.035), (width / 2, depth / 2, height), material, 0.012, 1)
    _legs(solid, material, (width / 2, depth / 2), height - 0.035)
    return solid


def _chair(p: _Materials) -> MeshBuilder:
    solid = MeshBuilder()
    _legs(solid, p.oak, (0.22, 0.22), 0.43, 0.04)
    solid.cushion((-0.21, -0.21, 0.43), (0.21, 0.21, 0.48), p.sofa, 0.02)
    for x in (-0.19, 0.16):
        solid.box((x, 0.17, 0.43), (x + 0.03, 0.2, 0.9), p.oak)
    solid.cushion((-0.2, 0.165, 0.68), (0.2, 0.2, 0.9), p.oak, 0.012, 1)
    return solid


def _sofa(p: _Materials) -> MeshBuilder:
    solid = MeshBuilder()
    solid.box((-0.85, -0.38, 0.0), (0.85, 0.42, 0.1), p.dark)
    solid.cushion((-0.9, -0.42, 0.09), (0.9, 0.45, 0.3), p.sofa, 0.04)
    solid.cushion((-0.9, 0.2, 0.25), (0.9, 0.45, 0.82), p.sofa, 0.08)
    for x in (-0.9, 0.7):
        solid.cushion((x, -0.43, 0.1), (x + 0.2, 0.4, 0.6), p.sofa, 0.07)
    for x in (-0.7, 0.0):
        solid.cushion((x + 0.01, -0.42, 0.28), (x + 0.69, 0.24, 0.46), p.sofa, 0.06)
    for x in (-0.62, 0.24):
        solid.cushion((x, 0.08, 0.45), (x + 0.4, 0.24, 0.8), p.pillow, 0.07)
    return solid


def _armchair(p: _Materials) -> MeshBuilder:
    solid = MeshBuilder()
    _legs(solid, p.walnut, (0.36, 0.36), 0.14, 0.05)
    solid.cushion((-0.38, -0.38, 0.13), (0.38, 0.38, 0.42), p.pillow, 0.06)
    solid.cushion((-0.38, 0.2, 0.35), (0.38, 0.4, 0.9), p.pillow, 0.08)
    for x in (-0.4, 0.26):
        solid.cushion((x, -0.36, 0.2), (x + 0.14, 0.36, 0.6), p.pillow, 0.05)
    return solid


def _tv(p: _Materials) -> MeshBuilder:
    solid = MeshBuilder()
    solid.box((-0.65, -0.2, 0.08), (0.65, 0.2, 0.45), p.walnut)
    solid.box((-0.6, -0.16, 0.0), (0.6, 0.16, 0.08), p.dark)
    for x in (-0.64, 0.005):
        solid.box((x, -0.215, 0.1), (x + 0.635, -0.2, 0.43), p.white)
    solid.box((-0.2, -0.1, 0.45), (0.2, 0.1, 0.465), p.dark)
    solid.box((-0.03, 0.02, 0.46), (0.03, 0.05, 0.6), p.dark)
    solid.box((-0.58, 0.0, 0.55), (0.58, 0.04, 1.22), p.dark)
    return solid


def _bookshelf(p: _Materials) -> MeshBuilder:
    solid = MeshBuilder()
    for x in (-0.5, 0.47):
        solid.box((x, -0.15, 0.0), (x + 0.03, 0.15, 1.9), p.oak)
    solid.box((-0.47, 0.13, 0.0), (0.47, 0.15, 1.9), p.oak)
    for number, z in enumerate((0.06, 0.43, 0.8, 1.17, 1.54, 1.87)):
        solid.box((-0.47, -0.15, z), (0.47, 0.13, z + 0.03), p.oak)
        if number < 5 and number != 2:
            left, right = (-0.45, 0.4) if number % 2 else (-0.3, 0.45)
            shift = 0.17 * number
            front = [(left, -0.08, z + 0.03), (right, -0.08, z + 0.03), (right, -0.08, z + 0.31), (left, -0.08, z + 0.31)]
            u = (right - left) / 0.9
            solid.quad(p.books, front, [(shift, 1), (shift + u, 1), (shift + u, 0), (shift, 0)])
            solid.box((left, -0.078, z + 0.03), (right, 0.12, z + 0.26), p.linen, omit=("-y",))
    solid.cylinder((0.1, -0.02, 0.83), 0.07, 0.2, p.pot, top=0.04)
    return solid


def _plant(p: _Materials, rng: np.random.Generator) -> MeshBuilder:
    solid = MeshBuilder()
    solid.cylinder((0, 0, 0), 0.13, 0.3, p.pot, top=0.17)
    solid.cylinder((0, 0, 0.3), 0.02, 0.5, p.walnut, top=0.012, sides=8)
    for number in range(26):
        angle, lift = number * 2.4, 0.35 + 0.03 * number
        reach, droop = rng.uniform(0.22, 0.36), rng.uniform(-0.05, 0.22)
        out = np.array([math.cos(angle), math.sin(angle), 0.0])
        across = np.array([-out[1], out[0], 0.0]) * 0.055
        base, tip = np.array([0, 0, lift]), np.array([0, 0, lift + droop]) + out * reach
        middle = (base + tip) / 2 + np.array([0, 0, 0.05])
        solid.quad(p.leaf, [base - across * 0.3, middle - across, tip, middle + across])
    return solid


def _lamp(p: _Materials) -> MeshBuilder:
    solid = MeshBuilder()
    solid.cylinder((0, 0, 0), 0.15, 0.025, p.dark)
    solid.cylinder((0, 0, 0.025), 0.014, 1.35, p.steel, sides=10)
    solid.cylinder((0, 0, 1.35), 0.2, 0.28, p.shade, top=0.13)
    return solid


def _rug(material: MeshMaterial, width: float, depth: float) -> MeshBuilder:
    solid = MeshBuilder()
    solid.box((-width / 2, -depth / 2, 0.0), (width / 2, depth / 2, 0.006), material)
    return solid


def _counter(p: _Materials) -> MeshBuilder:
    solid = MeshBuilder()
    solid.box((-1.35, -0.24, 0.0), (1.35, 0.3, 0.1), p.dark)
    solid.box((-1.35, -0.28, 0.1), (1.35, 0.3, 0.87), p.white)
    for number in range(4):
        x = -1.34 + number * 0.67
        solid.cushion((x, -0.3, 0.12), (x + 0.65, -0.28, 0.85), p.white, 0.008, 1)
        solid.box((x + 0.2, -0.325, 0.77), (x + 0.45, -0.31, 0.785), p.steel)
    solid.box((-1.36, -0.31, 0.87), (1.36, 0.31, 0.91), p.stone)
    solid.box((0.2, -0.2, 0.9), (0.75, 0.2, 0.914), p.steel)
    solid.cylinder((0.47, 0.23, 0.91), 0.016, 0.28, p.steel, sides=10)
    solid.box((0.455, 0.05, 1.17), (0.485, 0.24, 1.19), p.steel)
    solid.box((-0.85, -0.24, 0.91), (-0.25, 0.24, 0.918), p.dark)
    for x, y in ((-0.7, -0.11), (-0.4, -0.11), (-0.7, 0.12), (-0.4, 0.12)):
        solid.cylinder((x, y, 0.918), 0.09, 0.004, p.steel)
    solid.cylinder((-1.15, 0.05, 0.91), 0.06, 0.22, p.ceramic, top=0.045)
    return solid


def _fridge(p: _Materials) -> MeshBuilder:
    solid = MeshBuilder()
    solid.cushion((-0.31, -0.28, 0.03), (0.31, 0.31, 1.85), p.steel, 0.02)
    for low, high in ((0.06, 0.62), (0.65, 1.82)):
        solid.cushion((-0.3, -0.31, low), (0.3, -0.27, high), p.white, 0.012, 1)
        solid.box((0.2, -0.345, high - 0.35), (0.225, -0.31, high - 0.05), p.steel)
    solid.box((-0.29, -0.25, 0.0), (0.29, 0.29, 0.03), p.dark)
    return solid


def _bed(p: _Materials) -> MeshBuilder:
    """Returns a bed with its head at -y."""
    solid = MeshBuilder()
    _legs(solid, p.walnut, (0.8, 1.0), 0.16, 0.08)
    solid.box((-0.82, -1.05, 0.16), (0.82, 1.03, 0.3), p.walnut)
    solid.cushion((-0.82, -1.08, 0.16), (0.82, -1.0, 1.0), p.walnut, 0.03)
    solid.cushion((-0.79, -0.99, 0.28), (0.79, 1.0, 0.5), p.linen, 0.07)
    solid.cushion((-0.83, -0.35, 0.34), (0.83, 1.02, 0.54), p.sofa, 0.06)
    for x in (-0.72, 0.06):
        solid.cushion((x, -0.93, 0.47), (x + 0.66, -0.5, 0.62), p.linen, 0.07)
    return solid


def _nightstand(p: _Materials, width: float = 0.42, depth: float = 0.4, height: float = 0.5) -> MeshBuilder:
    solid = MeshBuilder()
    solid.box((-width / 2, -depth / 2, 0.08), (width / 2, depth / 2, height), p.oak)
    _legs(solid, p.oak, (width / 2, depth / 2), 0.08, 0.04)
    drawer = (height - 0.12) / 2
    for number in range(2):
        z = 0.1 + number * (drawer + 0.01)
        solid.cushion(
            (-width / 2 + 0.015, -depth / 2 - 0.015, z), (width / 2 - 0.015, -depth / 2, z + drawer - 0.01), p.white, 0.006, 1
        )
        solid.box((-0.05, -depth / 2 - 0.03, z + drawer * 0.6), (0.05, -depth / 2 - 0.015, z + drawer * 0.6 + 0.012), p.steel)
    return solid


def _wardrobe(p: _Materials) -> MeshBuilder:
    solid = MeshBuilder()
    solid.box((-0.475, -0.28, 0.0), (0.475, 0.3, 2.1), p.oak)
    for x in (-0.47, 0.003):
        solid.cushion((x, -0.3, 0.06), (x + 0.467, -0.28, 2.08), p.white, 0.01, 1)
    for x in (-0.05, 0.035):
        solid.box((x, -0.33, 0.95), (x + 0.015, -0.3, 1.2), p.steel)
    return solid


def _bath(p: _Materials) -> MeshBuilder:
    solid = MeshBuilder()
    solid.box((-0.85, -0.36, 0.0), (0.85, -0.3, 0.52), p.ceramic)
    solid.box((-0.85, 0.3, 0.0), (0.85, 0.36, 0.52), p.ceramic)
    for x in (-0.85, 0.77):
        solid.box((x, -0.3, 0.0), (x + 0.08, 0.3, 0.52), p.ceramic)
    solid.box((-0.77, -0.3, 0.0), (0.77, 0.3, 0.14), p.ceramic)
    solid.cushion((-0.86, -0.37, 0.51), (0.86, -0.28, 0.55), p.ceramic, 0.018)
    solid.cushion((-0.86, 0.28, 0.51), (0.86, 0.37, 0.55), p.ceramic, 0.018)
    solid.cylinder((0.7, 0.0, 0.54), 0.018, 0.18, p.steel, sides=10)
    return solid


def _basin(p: _Materials) -> MeshBuilder:
    solid = MeshBuilder()
    solid.box((-0.38, -0.2, 0.15), (0.38, 0.22, 0.75), p.walnut)
    for x in (-0.375, 0.005):
        solid.cushion((x, -0.215, 0.17), (x + 0.37, -0.2, 0.73), p.white, 0.008, 1)
    solid.cushion((-0.4, -0.23, 0.75), (0.4, 0.23, 0.87), p.ceramic, 0.04)
    solid.cylinder((0.0, 0.15, 0.86), 0.015, 0.16, p.steel, sides=10)
    solid.box((-0.35, 0.2, 1.15), (0.35, 0.225, 1.85), p.steel)
    solid.quad(p.mirror, [(-0.33, 0.198, 1.17), (0.33, 0.198, 1.17), (0.33, 0.198, 1.83), (-0.33, 0.198, 1.83)])
    return solid


def _toilet(p: _Materials) -> MeshBuilder:
    solid = MeshBuilder()
    solid.cushion((-0.12, -0.2, 0.0), (0.12, 0.3, 0.36), p.ceramic, 0.05)
    solid.cushion((-0.19, -0.33, 0.3), (0.19, 0.2, 0.42), p.ceramic, 0.06)
    solid.cushion((-0.19, 0.14, 0.38), (0.19, 0.32, 0.8), p.ceramic, 0.03)
    return solid
