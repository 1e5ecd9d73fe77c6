"""The files that a scene, a model or a mesh may name: those of its own folders, also in an installation by links."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from gibson_sim.description.urdf import read_urdf
from gibson_sim.errors import MeshError
from gibson_sim.formats.file_roots import is_inside, package_roots
from gibson_sim.formats.load_mesh import MeshLoader, load_shape, mesh_folders
from gibson_sim.resources import find_scene, known_scenes
from gibson_sim.robots.load import load_robot
from gibson_sim.scenes.load import load_scene
from gibson_sim.scenes.scene_meshes import scene_roots
from support.gltf import png


def install_with_links(source: Path, target: Path) -> Path:
    """Mirrors a folder as ``colcon build --symlink-install`` does: real folders with a link for each file."""
    for path in sorted(source.rglob("*")):
        there = target / path.relative_to(source)
        if path.is_dir():
            there.mkdir(parents=True, exist_ok=True)
        else:
            there.parent.mkdir(parents=True, exist_ok=True)
            there.symlink_to(path)
    return target


@pytest.mark.shipped
def test_every_scene_loads_from_an_installation_made_of_links(tmp_path: Path) -> None:
    scenes = known_scenes()
    assert {"linden_flat", "orchard_house", "corner_shop"} <= set(scenes)
    for name, folder in scenes.items():
        assert load_scene(install_with_links(folder, tmp_path / "share" / name)).visuals, name
    # Bags and caches identify a scene by its hash, which is that of the copy.
    assert load_scene(tmp_path / "share" / "flat").content_hash == load_scene(scenes["flat"]).content_hash


def test_scene_loads_from_links_into_a_store_of_files_without_names(root: Path, tmp_path: Path) -> None:
    scene = root / "scenes" / "flat"
    (tmp_path / "blobs").mkdir()
    for number, file in enumerate(sorted(path for path in scene.rglob("*") if path.is_file())):
        blob, link = tmp_path / "blobs" / f"{number:064d}", tmp_path / "flat" / file.relative_to(scene)
        blob.write_bytes(file.read_bytes())
        link.parent.mkdir(parents=True, exist_ok=True)
        link.symlink_to(blob)
    found = load_scene(tmp_path / "flat")
    loader = MeshLoader(scene_roots(found))
    assert {len(loader.shape(visual.shape).merged()[1]) > 0 for visual in found.visuals} == {True}
    mesh = next(path for path in (tmp_path / "flat").rglob("*.glb"))
    assert load_scene(find_scene(mesh)).visuals, "a mesh alone is found by its name, too"


def test_objects_and_robots_made_of_links_are_drawn_and_collide(root: Path, tmp_path: Path) -> None:
    for name in ("scenes/objects", "scenes/linden_flat", "config/robots/arm_bot"):
        install_with_links(root / name, tmp_path / name)
    bodies = [body.model for body in load_scene(tmp_path / "scenes" / "linden_flat").bodies]
    models = [*bodies, read_urdf(load_robot(tmp_path / "config" / "robots" / "arm_bot").urdf)]
    links = [link for model in models for link in model.links]
    shapes = {shape for link in links for shape in (*(v.shape for v in link.visuals), *(c.shape for c in link.collisions))}
    meshes = {shape for shape in shapes if shape.kind == "mesh"}
    assert any(Path(shape.mesh).is_symlink() for shape in meshes)
    loader = MeshLoader(mesh_folders(meshes), textures=False)
    for shape in meshes:
        assert len(loader.shape(shape).merged()[1]), shape.mesh
        assert len(load_shape(shape).merged()[1]), shape.mesh


@pytest.mark.parametrize("uri", ["/etc/passwd", "../secret.bin", "../../secret.bin", "file:///etc/passwd", "link.bin"])
def test_a_mesh_names_no_buffer_outside_of_its_folder(tmp_path: Path, uri: str) -> None:
    folder = tmp_path / "models" / "mine"
    folder.mkdir(parents=True)
    for secret in (tmp_path / "secret.bin", tmp_path / "models" / "secret.bin"):
        secret.write_bytes(b"canary" * 10)
    (folder / "link.bin").symlink_to(tmp_path / "secret.bin")
    mesh = folder / "a.gltf"
    attributes = {"attributes": {"POSITION": 0}}
    mesh.write_text(
        json.dumps(
            {
                "asset": {"version": "2.0"},
                "buffers": [{"uri": uri, "byteLength": 36}],
                "bufferViews": [{"buffer": 0, "byteLength": 36}],
                "accessors": [{"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"}],
                "meshes": [{"primitives": [attributes]}],
                "nodes": [{"mesh": 0}],
                "scenes": [{"nodes": [0]}],
            }
        )
    )
    with pytest.raises(MeshError, match="outside the folder of the mesh") as caught:
        MeshLoader(None).mesh(mesh)
    assert "canary" not in str(caught.value)


def test_a_model_in_gazebos_layout_names_files_of_the_whole_model(tmp_path: Path) -> None:
    model = tmp_path / "chair"
    for folder in ("meshes", "materials/textures"):
        (model / folder).mkdir(parents=True)
    texture = model / "materials/textures/wood.png"
    texture.write_bytes(png((5, 6, 7)))
    mesh = model / "meshes/chair.dae"
    mesh.write_text("")
    assert is_inside(texture, package_roots(mesh))
    assert not is_inside(tmp_path / "other.png", package_roots(mesh))
    deep = model / "meshes/high/chair.dae"
    assert not is_inside(texture, package_roots(deep))
    (model / "model.config").write_text("<model/>")
    assert is_inside(texture, package_roots(deep))


@pytest.mark.parametrize("text", ["a\0b", "x" * 5000])
def test_an_invalid_path_is_inside_no_root(tmp_path: Path, text: str) -> None:
    assert not is_inside(Path(text), (tmp_path,))
