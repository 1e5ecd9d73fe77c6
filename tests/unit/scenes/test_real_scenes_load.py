"""Third-party worlds load with the right size, axes, materials and warnings."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml
from numpy.typing import NDArray

from gibson_sim.description.omissions import OmissionKind, kind_of
from gibson_sim.formats.load_mesh import MeshLoader, load_mesh
from gibson_sim.geometry.transforms import matrix_from_pose, transform_points
from gibson_sim.maps.floor_map import FloorMap, scene_floor_map
from gibson_sim.scenes.load import load_scene
from gibson_sim.scenes.scene_meshes import scene_roots
from gibson_sim.scenes.spec import SceneSpec

TURTLEBOT_HEIGHT = 0.19
"""Size of the robot that recorded the SLAM map of the house, metres."""


@pytest.fixture(scope="module")
def house(data_dir: Path) -> SceneSpec:
    """A house of several rooms, an SDF world with DAE meshes in centimetres."""
    return load_scene(data_dir / "aws_small_house")


@pytest.fixture(scope="module")
def living_room(data_dir: Path) -> SceneSpec:
    """A furnished room, Drake model directives with glTF meshes, y up."""
    return load_scene(data_dir / "drake_living_room")


def _bounds(scene: SceneSpec) -> NDArray[np.float64]:
    """Returns the lowest and highest corner of all visuals, (2, 3), metres."""
    loader = MeshLoader(scene_roots(scene), textures=False)
    points = np.concatenate(
        [transform_points(matrix_from_pose(v.pose), loader.shape(v.shape).merged()[0]) for v in scene.visuals]
    )
    return np.array([points.min(axis=0), points.max(axis=0)])


def test_house_is_19_by_11_4_by_3_metres_with_z_up(house: SceneSpec) -> None:
    low, high = _bounds(house)
    np.testing.assert_allclose(high - low, [19.0, 11.4, 3.0], atol=0.05)
    assert low[2] == pytest.approx(0.0, abs=0.02)


def test_floor_of_the_house_is_at_0(house: SceneSpec) -> None:
    assert house.floor_z == pytest.approx(0.0, abs=0.02)


def test_bed_stands_where_the_world_file_says(house: SceneSpec) -> None:
    (bed,) = [v for v in house.visuals if v.name.startswith("Bed_01")]
    assert bed.pose.position[:2] == pytest.approx((-6.165, 2.03), abs=0.01)
    assert bed.semantic_class == "bed"
    assert any(c.name.startswith("Bed_01") for c in house.collisions)


def test_missing_assets_of_the_house_are_named(house: SceneSpec) -> None:
    assert any("aws_Carpet_01.png" in w for w in house.warnings)
    assert any("PortraitA_01" in w and "left out" in w for w in house.warnings)


def test_furniture_of_the_house_is_opaque(house: SceneSpec) -> None:
    loader = MeshLoader(scene_roots(house), textures=False)
    modes = {part.material.alpha_mode for v in house.visuals if "Bed" in v.name for part in loader.shape(v.shape).parts}
    assert modes == {"opaque"}


@pytest.fixture(scope="module")
def house_map(house: SceneSpec) -> FloorMap:
    """The floor of the house for the robot that recorded the SLAM map."""
    return scene_floor_map(house, robot_height=TURTLEBOT_HEIGHT)


@pytest.fixture(scope="module")
def slam_free(data_dir: Path) -> NDArray[np.float64]:
    """World x, y, (N, 2), of the free cells in the SLAM map of the house, whose frame is that of the world file."""
    folder = data_dir / "aws_small_house" / "maps" / "turtlebot3_waffle_pi"
    meta = yaml.safe_load((folder / "map.yaml").read_text())
    image = cv2.imread(str(folder / meta["image"]), cv2.IMREAD_GRAYSCALE)
    assert image is not None
    # Row 0 of the image is at the highest y.
    free = (255 - image[::-1].astype(float)) / 255 < meta["free_thresh"]
    return (np.argwhere(free)[:, ::-1] + 0.5) * meta["resolution"] + np.array(meta["origin"][:2])


def _agreement(floor_map: FloorMap, points: NDArray[np.float64]) -> tuple[float, int]:
    """Returns the share of the points inside the map that are not occupied in it, and how many lie inside."""
    cells = floor_map.cells(points)
    cells = cells[((cells >= 0) & (cells < np.array(floor_map.shape))).all(axis=1)]
    return float((~floor_map.occupied[tuple(cells.T)]).mean()), len(cells)


def test_floor_that_a_real_robot_drove_over_is_not_occupied(house_map: FloorMap, slam_free: NDArray[np.float64]) -> None:
    share, count = _agreement(house_map, slam_free)
    assert count > 60_000
    assert share > 0.97


@pytest.mark.parametrize("offset", [(0.2, 0.0), (-0.2, 0.0), (0.0, 0.2), (0.0, -0.2)])
def test_maps_agree_best_without_an_offset(
    house_map: FloorMap, slam_free: NDArray[np.float64], offset: tuple[float, float]
) -> None:
    assert _agreement(house_map, slam_free)[0] > _agreement(house_map, slam_free + offset)[0] + 0.01


@pytest.mark.parametrize("mirror", [(-1.0, 1.0), (1.0, -1.0), (-1.0, -1.0)])
def test_maps_do_not_agree_mirrored(house_map: FloorMap, slam_free: NDArray[np.float64], mirror: tuple[float, float]) -> None:
    assert _agreement(house_map, slam_free)[0] > _agreement(house_map, slam_free * mirror)[0] + 0.03


def test_living_room_has_7_models_and_its_size(living_room: SceneSpec) -> None:
    assert {v.name for v in living_room.visuals} == {
        "living_room", "bookshelves", "cabinet", "curtains", "sofa", "stool", "tall_cabinet",
    }  # fmt: skip
    low, high = _bounds(living_room)
    np.testing.assert_allclose(high - low, [6.05, 6.19, 3.22], atol=0.05)
    # The data lack the normal map of the table.
    gaps = [w for w in living_room.warnings if kind_of(w) is not OmissionKind.OTHER]
    assert [w for w in gaps if "texture wood_table_worn_nor_gl_1k.png is missing" not in w] == []
    assert living_room.floor_z == pytest.approx(0.0, abs=0.02)


def test_sofa_of_the_living_room_stands_upright_on_the_floor(living_room: SceneSpec) -> None:
    (sofa,) = [v for v in living_room.visuals if v.name == "sofa"]
    points, _ = MeshLoader(scene_roots(living_room), textures=False).shape(sofa.shape).merged()
    z = transform_points(matrix_from_pose(sofa.pose), points)[:, 2]
    assert z.min() == pytest.approx(0.0, abs=0.05)
    assert 0.5 < z.max() < 1.3


def test_gallery_is_unlit_and_has_1930_triangles(data_dir: Path) -> None:
    path = next((data_dir / "playcanvas_vr_gallery").rglob("*.glb"))
    mesh = load_mesh(path, [path.parent])
    assert mesh.triangle_count == 1930
    assert all(part.material.unlit for part in mesh.parts)
    assert any(part.material.texture is not None for part in mesh.parts)
    scene = load_scene(path)
    low, high = _bounds(scene)
    np.testing.assert_allclose(high - low, [10.1, 10.1, 5.05], atol=0.05)
    assert scene.floor_z == pytest.approx(0.0, abs=0.02)


@pytest.mark.parametrize("name", ["010_potted_meat_can", "011_banana", "061_foam_brick"])
def test_scanned_object_has_its_texture(data_dir: Path, name: str) -> None:
    path = next((data_dir / "isaacgym_ycb").rglob(f"{name}/textured.obj"))
    mesh = load_mesh(path, [path.parent])
    textures = [part.material.texture for part in mesh.parts]
    assert all(t is not None and min(t.pixels.shape[:2]) >= 256 for t in textures)
    assert all(part.uvs is not None for part in mesh.parts)
    # Centimetres in the file: nothing on this list is larger than 25 cm.
    size = mesh.bounds[1] - mesh.bounds[0]
    assert 3.0 < size.max() < 25.0
