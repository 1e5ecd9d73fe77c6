"""Our objects: correct physics, correct files, small enough."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from gibson_sim.description.body import BodySpec
from gibson_sim.description.rigid_groups import rigid_groups
from gibson_sim.description.urdf import UrdfModel, parse_urdf
from gibson_sim.errors import GibsonSimError
from gibson_sim.formats.load_mesh import MeshLoader
from gibson_sim.scenes.spawning import built_in_spawnables, load_spawnable
from gibson_sim.types import Pose
from gibson_sim_tools.making.objects import program
from gibson_sim_tools.making.objects.catalogue import OBJECTS, door_names, objects_table
from gibson_sim_tools.making.objects.model import (
    ObjectLink,
    ObjectModel,
    Primitive,
    box,
    cylinder,
    mass_properties,
    resting_sphere,
    ring_wall,
    rotation,
)
from gibson_sim_tools.making.objects.pictures import PICTURES, noise
from gibson_sim_tools.making.objects.program import make_objects, select_objects
from gibson_sim_tools.making.objects.urdf import mesh_name, object_urdf

MOST_TRIANGLES = 3000
MOST_BYTES = 8_000_000


@pytest.fixture(scope="module")
def folder() -> Path:
    return Path(__file__).resolve().parents[4] / "scenes" / "objects"


@pytest.fixture(scope="module")
def loader(folder: Path) -> MeshLoader:
    return MeshLoader((folder,), textures=False)


def model_of(one: ObjectModel, folder: Path) -> UrdfModel:
    return parse_urdf(object_urdf(one), folder / one.name / f"{one.name}.urdf")


def test_a_box_has_the_inertia_of_the_textbook() -> None:
    mass = mass_properties(ObjectLink("a", 12.0, (box((0.0, 0.0, 0.0), (1.0, 2.0, 3.0)),)))
    assert mass.center == pytest.approx([0.5, 1.0, 1.5])
    np.testing.assert_allclose(mass.inertia, np.diag([13.0, 10.0, 5.0]), atol=1e-12)


def test_a_cylinder_and_a_ball_have_the_inertia_of_the_textbook() -> None:
    mass = mass_properties(ObjectLink("a", 2.0, (cylinder(0.5, 0.0, 3.0),)))
    np.testing.assert_allclose(mass.inertia, np.diag([1.625, 1.625, 0.25]), atol=1e-12)
    np.testing.assert_allclose(mass_properties(ObjectLink("a", 5.0, (resting_sphere(0.5),))).inertia, np.eye(3) * 0.5, atol=1e-12)


def test_two_solids_share_the_mass_by_their_volume_about_a_common_centre() -> None:
    one, other = Primitive("sphere", (0.1, 0.0, 0.0), (0.0, 0.0, 0.0)), Primitive("sphere", (0.1, 0.0, 0.0), (2.0, 0.0, 0.0))
    mass = mass_properties(ObjectLink("a", 2.0, (one, other)))
    assert mass.center == pytest.approx([1.0, 0.0, 0.0])
    # Two balls of 1 kg: 2/5 r^2 each, and 1 m away from the centre.
    np.testing.assert_allclose(mass.inertia, np.diag([0.008, 2.008, 2.008]), atol=1e-12)


def test_a_turned_box_has_a_turned_inertia() -> None:
    lying = mass_properties(ObjectLink("a", 12.0, (Primitive("box", (1.0, 2.0, 3.0), (0.0, 0.0, 0.0), (math.pi / 2, 0.0, 0.0)),)))
    np.testing.assert_allclose(lying.inertia, np.diag([13.0, 5.0, 10.0]), atol=1e-12)


def test_a_wall_of_boxes_stays_within_its_radius() -> None:
    for primitive in ring_wall(0.1, 0.1, 0.0, 0.2, 0.01):
        corners = [np.array([x, y, z]) * primitive.size / 2 for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]
        radii = [np.hypot(*(rotation(primitive.rpy) @ corner + primitive.middle)[:2]) for corner in corners]
        assert max(radii) == pytest.approx(0.1, abs=0.006)


def test_at_least_thirty_objects_exist_including_all_required_ones() -> None:
    assert len(OBJECTS) >= 30
    assert {"mug", "chair_wooden", "cabinet_drawers", "fridge_body", "oven_body", "window_casement", *door_names()} <= set(
        OBJECTS
    )


def test_every_object_is_found_by_its_name_and_has_its_class(folder: Path) -> None:
    ours = built_in_spawnables()
    for name in OBJECTS:
        assert ours[name].samefile(folder / name), name
    body = load_spawnable("door_80_left", "", name="d", pose=Pose())
    assert isinstance(body, BodySpec)
    assert (body.static, body.semantic_class, body.links) == (True, "door", ("world", "leaf", "handle"))
    assert {one.semantic_class for one in OBJECTS.values()} >= {
        "bottle",
        "can",
        "cup",
        "book",
        "box",
        "chair",
        "table",
        "ball",
        "bin",
    }


@pytest.mark.parametrize("name", OBJECTS)
def test_the_files_are_those_that_the_command_writes(name: str, folder: Path, loader: MeshLoader) -> None:
    """The URDF is up to date, the meshes are as large as was said and not too fine, the numbers of physics can be used."""
    one = OBJECTS[name]
    assert (folder / name / f"{name}.urdf").read_text() == object_urdf(one), "run: gibson-sim scene objects"
    model = model_of(one, folder)
    assert not model.warnings
    assert not rigid_groups(model, fixed_root=one.built_in)[1], "no mass or inertia had to be replaced"
    at, corners = model.transforms(), []
    for link in model.links:
        for visual in link.visuals:
            vertices, triangles = loader.shape(visual.shape).merged()
            assert len(triangles) <= MOST_TRIANGLES
            corners.append(vertices + at[link.name][:3, 3])
    every = np.concatenate(corners)
    assert np.ptp(every, axis=0) == pytest.approx(one.size, abs=0.004)
    wanted = {mesh_name(one, link) for link in one.links if link.visual} | {f"{name}.urdf"}
    assert {path.name for path in (folder / name).iterdir()} == wanted


@pytest.mark.parametrize("name", [name for name, one in OBJECTS.items() if not one.built_in])
def test_standing_objects_have_their_origin_at_the_centre_of_the_underside(name: str, folder: Path, loader: MeshLoader) -> None:
    model = model_of(OBJECTS[name], folder)
    vertices = np.concatenate([loader.shape(v.shape).merged()[0] for v in model.links[0].visuals])
    assert vertices[:, 2].min() == pytest.approx(0.0, abs=5e-4)
    lowest = min(_lowest(primitive) for primitive in OBJECTS[name].links[0].primitives)
    assert lowest == pytest.approx(0.0, abs=1.5e-3), "what is drawn stands on what collides"


def _lowest(primitive: Primitive) -> float:
    if primitive.kind == "sphere":
        return primitive.middle[2] - primitive.size[0]
    if primitive.kind == "cylinder":
        upright_ = abs(primitive.rpy[1]) < 0.1
        return primitive.middle[2] - (primitive.size[1] / 2 if upright_ else primitive.size[0])
    return primitive.middle[2] - (
        primitive.size[2] / 2 * math.cos(primitive.rpy[1]) + primitive.size[0] / 2 * abs(math.sin(primitive.rpy[1]))
    )


def test_all_objects_together_are_small_and_free(folder: Path) -> None:
    assert sum(path.stat().st_size for path in folder.rglob("*") if path.is_file()) <= MOST_BYTES
    assert "CC0" in (folder / "LICENSE").read_text()


def test_pictures_are_small_and_the_same_every_time() -> None:
    for name in ("label_soda", "clock_face", "skin_apple"):
        first = PICTURES[name]()
        assert first.dtype == np.uint8 and max(first.shape[:2]) <= 512
        np.testing.assert_array_equal(first, PICTURES[name]())


def test_noise_repeats_at_its_borders() -> None:
    field = noise(64, 64, (2.0, 2.0), 1)
    steps = np.abs(np.diff(field, axis=1)).max()
    assert np.abs(field[:, 0] - field[:, -1]).max() <= 1.5 * steps


def test_the_table_in_the_docs_is_the_one_that_the_command_prints(root: Path) -> None:
    assert objects_table(list(OBJECTS.values())) in (root / "docs/objects.md").read_text(), "see gibson-sim scene objects --table"


def test_an_unknown_name_lists_the_known_ones() -> None:
    with pytest.raises(GibsonSimError, match=r"object 'mugg' is unknown; known: bottle_water, "):
        select_objects(["mugg"])
    assert [one.name for one in select_objects(["mug", "cup"])] == ["cup", "mug"]


def test_a_missing_python_or_blender_is_reported_in_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(program, "write_pictures", lambda folder, names: None)
    with pytest.raises(GibsonSimError, match=r"/nowhere/python cannot be run.*--blender-python"):
        make_objects(["cup"], tmp_path, "/nowhere/python", print)
    script = tmp_path / "python"
    script.write_text("#!/bin/sh\necho \"ModuleNotFoundError: No module named 'bpy'\"\nexit 1\n")
    script.chmod(0o755)
    with pytest.raises(GibsonSimError, match=r"has no Blender; give a Python"):
        make_objects(["cup"], tmp_path, str(script), print)
