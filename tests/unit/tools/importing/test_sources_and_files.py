"""What kind a source is, and the files that an import writes: GLBs with textures inside, and maps of Nav2."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml

from gibson_sim.errors import SceneError, SceneNotFoundError
from gibson_sim.formats.load_mesh import load_mesh
from gibson_sim.formats.mesh import LightMapSource, Material, Mesh, MeshPart, TextureSource
from gibson_sim_tools.importing.document import FloorPicture, file_name, rpy_deg, write_nav2_map
from gibson_sim_tools.importing.glb import encoded, write_glb
from gibson_sim_tools.importing.sources import SourceKind, identify
from support.gltf import png


def _touch(folder: Path, *names: str) -> None:
    for name in names:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(b"x")


@pytest.mark.parametrize(
    ("names", "kind", "file", "semantics"),
    [
        (("mesh_z_up.obj", "semantic.obj"), SourceKind.GIBSON, "mesh_z_up.obj", 1),
        (("mesh_z_up.obj",), SourceKind.GIBSON, "mesh_z_up.obj", 0),
        (("mesh.ply", "textures/a.jpg"), SourceKind.REPLICA, "mesh.ply", 0),
        (("mesh.ply", "habitat/mesh_semantic.ply", "habitat/info_semantic.json"), SourceKind.REPLICA, "mesh.ply", 2),
        (("a.glb", "a.semantic.glb", "a.semantic.txt"), SourceKind.HABITAT, "a.glb", 2),
        (("a.glb", "a_semantic.ply", "a.house"), SourceKind.HABITAT, "a.glb", 2),
        (("a.usda", "b.png"), SourceKind.USD, "a.usda", 0),
        (("scene.yaml", "mesh_z_up.obj"), SourceKind.GIBSON_SIM, "scene.yaml", 0),
    ],
)
def test_layouts_of_folders_are_recognised_by_their_content(
    tmp_path: Path, names: tuple[str, ...], kind: SourceKind, file: str, semantics: int
) -> None:
    _touch(tmp_path, *names)
    source = identify(tmp_path)
    assert (source.kind, source.file.name, len(source.semantics)) == (kind, file, semantics)


@pytest.mark.parametrize(
    ("name", "kind"),
    [
        ("a.obj", SourceKind.MESH),
        ("a.tar.gz", SourceKind.ARCHIVE),
        ("a.usdz", SourceKind.USD),
        ("a.dmd.yaml", SourceKind.WORLD),
        ("a.yaml", SourceKind.GIBSON_SIM),
    ],
)
def test_formats_of_files_are_recognised_by_their_names(tmp_path: Path, name: str, kind: SourceKind) -> None:
    _touch(tmp_path, name)
    assert identify(tmp_path / name).kind is kind


def test_two_usd_files_must_be_chosen_between(tmp_path: Path) -> None:
    _touch(tmp_path, "a.usd", "b.usd")
    with pytest.raises(SceneError, match=r"holds 2 USD files, name one of them: a\.usd, b\.usd"):
        identify(tmp_path)
    with pytest.raises(SceneNotFoundError, match="does not exist"):
        identify(tmp_path / "c.usd")


def test_names_of_files_and_angles() -> None:
    assert file_name("Sofa (left)/2") == "Sofa_left_2"
    # A quarter turn about z, then what a camera looks like that is rolled by 30 degrees.
    assert rpy_deg(np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])) == [0.0, 0.0, 90.0]
    c, s = np.cos(np.pi / 6), np.sin(np.pi / 6)
    assert rpy_deg(np.array([[1.0, 0, 0], [0, c, -s], [0, s, c]])) == pytest.approx([30.0, 0.0, 0.0])


def test_a_map_of_gibson_is_turned_over_and_its_origin_is_its_corner(tmp_path: Path) -> None:
    image = np.zeros((2, 4), dtype=np.uint8)
    image[0, 1] = 255
    cv2.imwrite(str(tmp_path / "floor_trav_0.png"), image)
    write_nav2_map(FloorPicture(tmp_path / "floor_trav_0.png", 0.01, 1), 2.5, tmp_path)
    written = cv2.imread(str(tmp_path / "floor_1.pgm"), cv2.IMREAD_GRAYSCALE)
    assert written.tolist() == [[0, 0, 0, 0], [0, 254, 0, 0]]
    text = (tmp_path / "floor_1.yaml").read_text()
    assert yaml.safe_load(text)["origin"] == pytest.approx([-0.02, -0.01, 0.0]) and "z = 2.5 m" in text


def test_a_map_that_is_no_image_is_refused(tmp_path: Path) -> None:
    _touch(tmp_path, "floor_trav_0.png")
    with pytest.raises(SceneError, match="is not an image"):
        write_nav2_map(FloorPicture(tmp_path / "floor_trav_0.png", 0.01, 0), 0.0, tmp_path)


def _mesh(*materials: Material, colors: bool = False) -> Mesh:
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0, 2, 3]], dtype=np.float32)
    normal = np.tile(np.float32([0, -0.8320503, 0.5547002]), (3, 1))
    painted = np.array([[255, 0, 0], [0, 128, 0], [0, 0, 1]], dtype=np.uint8) if colors else None
    uvs = np.array([[0, 0], [1, 0], [0, 1]], dtype=np.float32)
    triangles = np.array([[0, 1, 2]], dtype=np.uint32)
    return Mesh(tuple(MeshPart(vertices, normal, uvs, triangles, m, painted) for m in materials))


def _texture(alpha: int = 255) -> TextureSource:
    pixels = np.full((4, 4, 4), (200, 100, 50, alpha), dtype=np.uint8)
    return TextureSource("t", pixels)


def test_images_with_alpha_become_png_and_others_jpeg() -> None:
    assert encoded(_texture(alpha=100).pixels).startswith(b"\x89PNG")
    assert encoded(_texture().pixels).startswith(b"\xff\xd8\xff")


def test_a_mesh_is_read_back_as_it_was_written(tmp_path: Path) -> None:
    wood = Material("wood", (0.5, 0.25, 1.0, 0.75), texture=_texture(), alpha_mode="mask", alpha_cutoff=0.3, double_sided=False,
                    metallic=0.4, roughness=0.6, emissive=(0.1, 0.2, 0.3))  # fmt: skip
    source = _mesh(wood, Material("light", unlit=True))
    write_glb(tmp_path / "a.glb", source)
    first, second = load_mesh(tmp_path / "a.glb", [tmp_path]).parts
    assert first.vertices == pytest.approx(source.parts[0].vertices) and first.normals == pytest.approx(
        source.parts[0].normals, abs=1e-6
    )
    assert first.uvs == pytest.approx(source.parts[0].uvs) and first.triangles.tolist() == [[0, 1, 2]]
    read = first.material
    assert read.base_color == pytest.approx(wood.base_color, abs=1e-6)
    assert (read.alpha_mode, read.alpha_cutoff, read.double_sided, read.metallic, read.roughness) == (
        "mask",
        0.3,
        False,
        0.4,
        0.6,
    )
    assert read.emissive == pytest.approx(wood.emissive) and read.texture is not None
    assert read.texture.pixels[0, 0, :3] == pytest.approx([200, 100, 50], abs=3)
    assert second.material.unlit and not read.unlit


def test_a_light_map_is_read_back_as_it_was_written(tmp_path: Path) -> None:
    pixels = np.arange(24, dtype=np.uint16).reshape(2, 4, 3) * np.uint16(2000)
    lit = Material("lit", unlit=True, light_map=LightMapSource("light", pixels), light_intensity=2.5)
    (part,) = _mesh(lit).parts
    light_uvs = np.array([[0, 0], [1, 0], [0.2, 1]], dtype=np.float32)
    write_glb(tmp_path / "a.glb", Mesh((replace(part, light_uvs=light_uvs),)))
    (found,) = load_mesh(tmp_path / "a.glb", [tmp_path]).parts
    assert found.light_uvs == pytest.approx(light_uvs, abs=1e-6) and found.material.light_intensity == 2.5
    assert found.material.light_map is not None and np.array_equal(found.material.light_map.pixels, pixels)


def test_parts_of_one_material_and_one_image_share_them(tmp_path: Path) -> None:
    texture = _texture()
    wood, other = Material("wood", texture=texture), Material("other", texture=texture)
    write_glb(tmp_path / "a.glb", _mesh(wood, wood, other), {id(texture): png((1, 2, 3))})
    data = (tmp_path / "a.glb").read_bytes()
    assert data.count(b"\x89PNG") == 1 and data.count(b'"name":"wood"') == 1
    a, b, c = load_mesh(tmp_path / "a.glb", [tmp_path]).parts
    assert a.material == b.material != c.material and a.material.texture is c.material.texture


def test_vertex_colours_come_back(tmp_path: Path) -> None:
    source = _mesh(Material("paint", colored=True), colors=True)
    write_glb(tmp_path / "a.glb", source)
    (part,) = load_mesh(tmp_path / "a.glb", [tmp_path]).parts
    assert part.colors is not None and part.colors.tolist() == source.parts[0].colors.tolist()  # type: ignore[union-attr]
