"""USD, where usd-core is installed."""

from __future__ import annotations

import importlib.util
import warnings
from pathlib import Path

import cv2
import numpy as np
import pytest

from gibson_sim.errors import EnvironmentProblemError, SceneError
from gibson_sim.formats.load_mesh import MeshLoader
from gibson_sim.scenes.scene_meshes import collision_triangles, scene_roots
from gibson_sim_tools.importing import usd
from gibson_sim_tools.importing.importers import ImportOptions, import_scene

STAGE = """#usda 1.0
(
    defaultPrim = "World"
    metersPerUnit = {unit}
    upAxis = "{up}"
)
def Xform "World" {{
    def Material "Paint" {{
        token outputs:surface.connect = </World/Paint/Surface.outputs:surface>
        def Shader "Surface" {{
            uniform token info:id = "UsdPreviewSurface"
            color3f inputs:diffuseColor.connect = </World/Paint/Image.outputs:rgb>
            float inputs:roughness = 0.25
            token outputs:surface
        }}
        def Shader "Image" {{
            uniform token info:id = "UsdUVTexture"
            asset inputs:file = @{texture}@
            float3 outputs:rgb
        }}
    }}
    def Xform "Chair" {{
        double3 xformOp:translate = (0, 0, 3)
        uniform token[] xformOpOrder = ["xformOp:translate"]
        def Mesh "Seat" (
            prepend apiSchemas = ["MaterialBindingAPI"]
        ) {{
            int[] faceVertexCounts = [4]
            int[] faceVertexIndices = [0, 1, 2, 3]
            point3f[] points = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)]
            texCoord2f[] primvars:st = [(0, 0), (1, 0), (1, 1), (0, 1)] ( interpolation = "faceVarying" )
            rel material:binding = </World/Paint>
        }}
    }}
    def Mesh "Colored" {{
        int[] faceVertexCounts = [3, 3]
        int[] faceVertexIndices = [0, 1, 2, 0, 2, 3]
        point3f[] points = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)]
        color3f[] primvars:displayColor = [(1, 0, 0), (0, 0, 1)] ( interpolation = "uniform" )
    }}
    def Mesh "Hidden" {{
        token visibility = "invisible"
        int[] faceVertexCounts = [3]
        int[] faceVertexIndices = [0, 1, 2]
        point3f[] points = [(0, 0, 0), (9, 0, 0), (0, 9, 0)]
    }}
}}
"""


@pytest.fixture(scope="module")
def pxr() -> None:
    """Skips, and says so, where usd-core is not installed."""
    if importlib.util.find_spec("pxr") is None:
        message = "SKIPPED: usd-core is not installed (pip install usd-core)"
        warnings.warn(message, stacklevel=2)
        pytest.skip(message)


def _stage(folder: Path, up: str = "Z", unit: float = 1.0) -> Path:
    path = folder / "stage.usda"
    path.write_text(STAGE.format(up=up, unit=unit, texture="./paint.png"))
    cv2.imwrite(str(folder / "paint.png"), np.full((4, 4, 3), (30, 20, 10), dtype=np.uint8))
    return path


@pytest.mark.usefixtures("pxr")
def test_meshes_come_with_transforms_colours_and_textures(tmp_path: Path) -> None:
    scene = import_scene(_stage(tmp_path), tmp_path / "out").scene
    assert [v.name for v in scene.visuals] == ["Chair_Seat", "World_Colored"]
    loader = MeshLoader(scene_roots(scene))
    (seat,), (colored,) = (loader.shape(v.shape).parts for v in scene.visuals)
    np.testing.assert_allclose(seat.vertices[:, 2], 3.0)
    assert seat.material.texture is not None and seat.material.roughness == pytest.approx(0.25)
    np.testing.assert_allclose(seat.material.texture.pixels[0, 0], (10, 20, 30), atol=3)
    # v grows downwards here.
    np.testing.assert_allclose(seat.uvs[np.abs(seat.vertices[:, 1]) < 1e-6, 1], 1.0)
    assert colored.colors is not None
    assert {tuple(c) for c in colored.colors.tolist()} == {(255, 0, 0), (0, 0, 255)}


@pytest.mark.usefixtures("pxr")
@pytest.mark.parametrize(
    ("up", "unit", "choices", "size"),
    [
        ("Y", 0.01, ImportOptions(), (0.01, 0.03, 0.01)),
        ("Z", 0.01, ImportOptions(), (0.01, 0.01, 0.03)),
        ("Y", 0.01, ImportOptions(up_axis="z", unit_m=1.0), (1, 1, 3)),
    ],
)
def test_up_axis_and_unit_of_the_stage_are_obeyed_unless_the_user_says_otherwise(
    tmp_path: Path, up: str, unit: float, choices: ImportOptions, size: tuple[float, float, float]
) -> None:
    scene = import_scene(_stage(tmp_path, up, unit), tmp_path / "out", choices).scene
    vertices, _ = collision_triangles(scene)
    np.testing.assert_allclose(np.ptp(vertices, axis=0), size, atol=1e-6)


@pytest.mark.usefixtures("pxr")
@pytest.mark.parametrize("text", ["", "#usda 1.0\ndef Mesh {", '#usda 1.0\ndef Xform "a" {}\n'])
def test_a_stage_that_is_broken_or_empty_is_refused(tmp_path: Path, text: str) -> None:
    (tmp_path / "a.usda").write_text(text)
    with pytest.raises(SceneError):
        import_scene(tmp_path / "a.usda", tmp_path / "out")


@pytest.mark.usefixtures("pxr")
def test_a_reference_that_leaves_the_folder_is_refused(tmp_path: Path) -> None:
    _stage(tmp_path)
    (tmp_path / "in").mkdir()
    (tmp_path / "in" / "a.usda").write_text('#usda 1.0\ndef "a" (\n    references = @../stage.usda@\n) {}\n')
    with pytest.raises(SceneError, match="outside its folder"):
        import_scene(tmp_path / "in" / "a.usda", tmp_path / "out")


@pytest.mark.usefixtures("pxr")
def test_a_package_has_its_textures_inside(tmp_path: Path) -> None:
    from pxr import UsdUtils

    assert UsdUtils.CreateNewUsdzPackage(str(_stage(tmp_path)), str(tmp_path / "a.usdz"))
    scene = import_scene(tmp_path / "a.usdz", tmp_path / "out").scene
    (seat,) = MeshLoader(scene_roots(scene)).shape(scene.visuals[0].shape).parts
    assert seat.material.texture is not None


def test_without_usd_core_the_message_says_how_to_get_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(usd.importlib.util, "find_spec", lambda name: None)
    with pytest.raises(EnvironmentProblemError, match="pip install usd-core"):
        import_scene(_stage(tmp_path), tmp_path / "out")
