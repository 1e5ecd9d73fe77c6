"""What generated scenes are made of: meshes, textures, an atlas, furniture."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from gibson_sim.errors import ConfigError
from gibson_sim.formats.load_mesh import load_mesh
from gibson_sim_tools.generator import rooms_furniture, textures
from gibson_sim_tools.generator.gltf import MeshBuilder, MeshMaterial, write_glb
from gibson_sim_tools.generator.rooms_atlas import AtlasFace, pack, paint
from support.gltf import png

GREY = MeshMaterial("grey", color=(0.5, 0.5, 0.5))


def volume(mesh: MeshBuilder) -> float:
    """Returns the volume that all triangles enclose, cubic metres; positive if they face outwards."""
    total = 0.0
    for material, blocks in mesh.points.items():
        points = np.concatenate(blocks)[:, :3].astype(float)
        a, b, c = (points[np.concatenate(mesh.faces[material])[:, k].astype(int)] for k in range(3))
        total += float(np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6.0)
    return total


def test_a_box_encloses_its_volume_and_stands_without_an_underside() -> None:
    hanging, standing, open_ = MeshBuilder(), MeshBuilder(), MeshBuilder()
    hanging.box((0, 0, 1), (1, 2, 4), GREY)
    standing.box((0, 0, 0), (1, 2, 3), GREY)
    open_.box((0, 0, 1), (1, 2, 4), GREY, omit=("+x", "-y"))
    assert volume(hanging) == pytest.approx(6.0)
    assert (hanging.triangle_count, standing.triangle_count, open_.triangle_count) == (12, 10, 8)


def test_cylinders_cones_and_cushions_enclose_their_volume() -> None:
    cylinder, cone, cushion = MeshBuilder(), MeshBuilder(), MeshBuilder()
    cylinder.cylinder((0, 0, 1), 0.5, 2.0, GREY, sides=200)
    cone.cylinder((0, 0, 1), 0.5, 3.0, GREY, top=0.0, sides=200)
    cushion.cushion((0, 0, 0), (1, 2, 3), GREY, round_by=1e-4)
    assert volume(cylinder) == pytest.approx(math.pi * 0.25 * 2.0, rel=1e-3)
    assert volume(cone) == pytest.approx(math.pi * 0.25, rel=1e-3)
    assert volume(cushion) == pytest.approx(6.0, rel=1e-2)


def test_a_texture_repeats_by_its_size_upright_along_the_first_edge() -> None:
    mesh = MeshBuilder()
    mesh.quad(MeshMaterial("wood", "wood.jpg", metres=0.5), [(0, 0, 0), (2, 0, 0), (2, 0, 1), (0, 0, 1)])
    ((rows,),) = mesh.points.values()
    assert rows[:, 3:6].tolist() == [[0, -1, 0]] * 4
    assert rows[:, 6:].tolist() == [[0, 0], [4, 0], [4, -2], [0, -2]]


def test_a_mesh_is_read_back_z_up_with_its_textures(tmp_path: Path) -> None:
    mesh = MeshBuilder()
    mesh.box((0, 0, 1), (1, 2, 3), MeshMaterial("wood", "t.png"))
    mesh.box((5, 0, 1), (6, 1, 2), MeshMaterial("lamp", color=(1.0, 0.25, 0.0), unlit=True))
    (tmp_path / "t.png").write_bytes(png((10, 20, 30)))
    write_glb(tmp_path / "a.glb", mesh)
    wood, lamp = load_mesh(tmp_path / "a.glb", [tmp_path]).parts
    assert wood.vertices.min(axis=0).tolist() == [0, 0, 1] and wood.vertices.max(axis=0).tolist() == [1, 2, 3]
    assert wood.material.texture is not None and not wood.material.unlit
    assert lamp.material.unlit and lamp.material.texture is None
    assert lamp.material.base_color[1] == pytest.approx(0.5371, abs=1e-3), "linear 0.25 in sRGB"


@pytest.mark.parametrize("atlas", [256, 1024])
def test_surfaces_lie_apart_in_their_atlas(atlas: int) -> None:
    sizes = [(2.0, 1.0), (0.5, 0.5), (3.0, 2.6), (1.0, 2.0), (0.2, 0.1)]
    layout = pack(sizes, atlas)
    taken = np.zeros((atlas, atlas), dtype=int)
    for (x, y, w, h), size in zip(layout.rects, sizes, strict=True):
        assert (w, h) == (max(1, round(size[0] * layout.px_per_m)), max(1, round(size[1] * layout.px_per_m)))
        taken[y - 3 : y + h + 3, x - 3 : x + w + 3] += 1
    assert taken.max() == 1
    # At one pixel per metre more they do not fit, so a good part is taken.
    assert taken.mean() > 0.4


def test_an_atlas_that_is_too_small_is_refused() -> None:
    with pytest.raises(ConfigError, match="too small for 100 surfaces"):
        pack([(1.0, 1.0)] * 100, 32)


def test_a_plain_surface_has_its_colour_and_continues_into_its_border() -> None:
    layout = pack([(1.0, 1.0), (1.0, 1.0)], 128)
    faces = [AtlasFace("a", "wall", (1.0, 1.0), "plaster", color) for color in ((0.9, 0.1, 0.1), (0.1, 0.9, 0.1))]
    picture = paint(faces, layout, 0)
    (x, y, w, h), (x2, y2, _, _) = layout.rects
    red, green = picture[y + h // 2, x + w // 2].astype(int), picture[y2 + h // 2, x2 + w // 2].astype(int)
    assert red[0] > 2 * red[1] and green[1] > 2 * green[0]
    assert (picture[y - 3 : y, x + 5] == picture[y, x + 5]).all()


@pytest.mark.parametrize(
    ("make", "shape"),
    [
        (lambda rng: textures.plain(rng, (0.5, 0.4, 0.3), 64), (64, 64, 3)),
        (lambda rng: textures.wall(rng, (0.5, 0.4, 0.3), 64), (64, 64, 3)),
        (lambda rng: textures.wood(rng, (0.5, 0.4, 0.3), 48, 64), (48, 64, 3)),
        (lambda rng: textures.fabric(rng, (0.5, 0.4, 0.3), 64), (64, 64, 3)),
        (lambda rng: textures.view_outside(rng, 64, 96), (64, 96, 3)),
        (lambda rng: textures.painting(rng, 96, 128), (96, 128, 3)),
        (lambda rng: textures.book_spines(rng, 96, 128), (96, 128, 3)),
    ],
)
def test_textures_are_rgb_images_that_their_generator_decides(make, shape) -> None:
    first, again, other = (make(np.random.default_rng(seed)) for seed in (0, 0, 1))
    assert first.dtype == np.uint8 and first.shape == shape
    assert (first == again).all() and (first != other).any()


def test_plaster_keeps_its_colour_and_walls_are_darker_at_both_ends() -> None:
    plain = textures.plain(np.random.default_rng(0), (0.8, 0.4, 0.2))
    assert plain.mean(axis=(0, 1)) == pytest.approx([204, 102, 51], rel=0.03)
    rows = textures.wall(np.random.default_rng(0), (0.8, 0.8, 0.8)).mean(axis=(1, 2))
    assert rows[0] < rows[64] > rows[-1]


def test_tiles_have_joints_every_side_and_floors_are_darker_under_furniture() -> None:
    floor = textures.tiles(np.random.default_rng(0), (1.2, 0.6), 100, (0.2, 0.3, 0.4), tile_size=0.3)
    assert floor.shape == (60, 120, 3)
    joints = np.flatnonzero((floor == 0.72).all(axis=(0, 2)))
    assert joints.tolist() == [0, 30, 60, 90]
    shaded = textures.shaded_floor(np.full((100, 100, 3), 0.8), 50, [(0.5, 0.1, 1.0, 0.6)])
    # Row 0 is the far wall: furniture at y = 0.1 to 0.6 m is in rows 70 to 95.
    assert shaded[82, 37].mean() < shaded[20, 37].mean() and shaded[0, 50].mean() < shaded[50, 80].mean()


def test_furniture_keeps_clear_of_the_camera_and_has_names_of_its_own() -> None:
    way = np.array([[x, 2.0] for x in np.linspace(0.0, 6.0, 40)])
    pieces = list(rooms_furniture.furnish([(0.0, 0.0, 6.0, 4.0)], [(1, 0.0, 3.0)], way, np.random.default_rng(1)))
    assert len({p.name for p in pieces}) == len(pieces) > 4
    for piece in pieces:
        assert piece.name.rsplit("_", 1)[0] == piece.semantic_class
        if piece.semantic_class in ("ceiling_lamp", "plant"):
            continue  # above the camera; leaves reach beyond the pot
        for box in piece.boxes:
            corners = box.to_world(np.array([[x, y, 0.0] for x in (-1, 1) for y in (-1, 1)]) * box.half)
            assert np.abs(corners[:, 1] - 2.0).min() > 0.35
            assert corners[:, :2].min() > -0.05 and (corners[:, :2].max(axis=0) < (6.05, 4.05)).all()
