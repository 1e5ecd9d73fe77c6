"""OBJ with MTL: materials, indices, texture coordinates, missing and broken files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from gibson_sim.errors import MeshError
from gibson_sim.formats.load_mesh import LIGHT_GREY, load_mesh
from support.gltf import png
from support.scenes import write_square_obj

SQUARE = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n"


def _write(folder: Path, text: str) -> Path:
    path = folder / "thing.obj"
    path.write_text(text)
    return path


def test_each_material_becomes_a_part_with_its_colour(tmp_path: Path) -> None:
    (tmp_path / "two.mtl").write_text("newmtl red\nKd 1 0 0\nnewmtl blue\nKd 0 0 1\nd 0.5\n")
    path = _write(tmp_path, f"mtllib two.mtl\n{SQUARE}usemtl red\nf 1 2 3\nusemtl blue\nf 1 3 4\nusemtl red\nf 4 3 2\n")
    parts = {p.material.name: p for p in load_mesh(path, [tmp_path]).parts}
    assert parts["red"].material.base_color == (1, 0, 0, 1)
    assert parts["blue"].material.base_color == (0, 0, 1, 0.5)
    assert parts["blue"].material.alpha_mode == "blend"
    assert (len(parts["red"].triangles), len(parts["blue"].triangles)) == (2, 1)


def test_axes_are_kept_and_a_quad_becomes_two_triangles(tmp_path: Path) -> None:
    (part,) = load_mesh(_write(tmp_path, SQUARE + "f 1 2 3 4\n"), [tmp_path]).parts
    assert part.vertices[part.triangles].tolist() == [
        [[0, 0, 0], [1, 0, 0], [1, 1, 0]],
        [[0, 0, 0], [1, 1, 0], [0, 1, 0]],
    ]
    assert part.normals.tolist() == [[0, 0, 1]] * 4


def test_negative_indices_count_back_from_the_line_of_the_face(tmp_path: Path) -> None:
    text = "v 0 0 0\nv 1 0 0\nv 0 1 0\nf -3 -2 -1\nv 5 0 0\nv 6 0 0\nv 5 1 0\nf -3 -2 -1\n"
    (part,) = load_mesh(_write(tmp_path, text), [tmp_path]).parts
    assert part.vertices[part.triangles][:, 0].tolist() == [[0, 0, 0], [5, 0, 0]]


def test_v_is_flipped_so_that_0_is_the_top_row(tmp_path: Path) -> None:
    (part,) = load_mesh(
        _write(tmp_path, "v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0.25\nvt 0 1\nf 1/1 2/2 3/3\n"), [tmp_path]
    ).parts
    assert part.uvs is not None
    assert part.uvs[part.triangles[0]].tolist() == [[0, 1], [1, 0.75], [0, 0]]


def test_normals_of_the_file_are_used(tmp_path: Path) -> None:
    (part,) = load_mesh(_write(tmp_path, "v 0 0 0\nv 1 0 0\nv 0 1 0\nvn 0 3 4\nf 1//1 2//1 3//1\n"), [tmp_path]).parts
    np.testing.assert_allclose(part.normals, [[0, 0.6, 0.8]] * 3, atol=1e-6)


def test_missing_mtl_is_a_warning_that_names_it(tmp_path: Path) -> None:
    mesh = load_mesh(_write(tmp_path, f"mtllib gone.mtl\n{SQUARE}usemtl a\nf 1 2 3\n"), [tmp_path])
    assert any("thing.obj" in w and "gone.mtl" in w for w in mesh.warnings)
    assert mesh.parts[0].material.base_color == LIGHT_GREY


def test_missing_texture_leaves_the_colour_of_the_material(tmp_path: Path) -> None:
    mesh = load_mesh(write_square_obj(tmp_path, "gone.png"), [tmp_path])
    assert mesh.parts[0].material.base_color == (0.9, 0.1, 0.1, 1.0)
    assert any("gone.png" in w for w in mesh.warnings)


def test_missing_texture_is_replaced_by_the_only_image_beside_the_mesh(tmp_path: Path) -> None:
    (tmp_path / "texture_map.png").write_bytes(png((5, 6, 7)))
    mesh = load_mesh(write_square_obj(tmp_path, "textured.png"), [tmp_path])
    assert mesh.parts[0].material.texture is not None
    assert mesh.parts[0].material.texture.pixels.tolist() == [[[5, 6, 7]]]
    (warning,) = mesh.warnings
    assert "textured.png" in warning
    assert "texture_map.png" in warning


def test_missing_texture_is_not_guessed_among_two_images(tmp_path: Path) -> None:
    for name in ("a.png", "b.png"):
        (tmp_path / name).write_bytes(png((5, 6, 7)))
    assert load_mesh(write_square_obj(tmp_path, "gone.png"), [tmp_path]).parts[0].material.texture is None


def test_name_of_a_texture_may_differ_in_case_and_folder(tmp_path: Path) -> None:
    (tmp_path / "textures").mkdir()
    (tmp_path / "textures" / "Wood.PNG").write_bytes(png((5, 6, 7)))
    mesh = load_mesh(write_square_obj(tmp_path, "C:\\art\\wood.png"), [tmp_path])
    assert mesh.parts[0].material.texture is not None


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (SQUARE + "f 1 2 9\n", "vertex 9"),
        (SQUARE + "f 1 2 -9\n", "broken"),
        ("v 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "coordinates"),
        ("v 0 0 nan\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "finite"),
        (SQUARE, "no triangles"),
        ("hello\n", "no vertices"),
    ],
)
def test_broken_file_is_refused_in_one_line(tmp_path: Path, text: str, said: str) -> None:
    with pytest.raises(MeshError, match=said) as caught:
        load_mesh(_write(tmp_path, text), [tmp_path])
    assert "thing.obj" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_metal_roughness_and_emission_of_the_material_are_read(tmp_path: Path) -> None:
    (tmp_path / "m.mtl").write_text("newmtl a\nKd 1 1 1\nPr 0.25\nPm 0.5\nKe 0.1 0.2 0.3\nnewmtl b\nKd 1 1 1\n")
    (tmp_path / "m.obj").write_text("mtllib m.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nusemtl a\nf 1 2 3\nusemtl b\nf 1 2 3\n")
    first, second = (part.material for part in load_mesh(tmp_path / "m.obj", [tmp_path]).parts)
    assert (first.roughness, first.metallic, first.emissive) == (0.25, 0.5, (0.1, 0.2, 0.3))
    assert (second.roughness, second.metallic, second.emissive) == (1.0, 0.0, (0.0, 0.0, 0.0))
