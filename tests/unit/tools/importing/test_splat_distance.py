"""Splats made from the surfaces of a scene lie on them, and the check measures by how much others are off."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gibson_sim.errors import SceneError
from gibson_sim.formats.glb import GlbBuilder
from gibson_sim.formats.light_maps import light_map_png
from gibson_sim.formats.splats import SH_DC, Splats, splats_ply
from gibson_sim.scenes.load import load_scene
from gibson_sim.scenes.scene_meshes import collision_triangles
from gibson_sim.scenes.spec import SplatsSpec
from gibson_sim_tools.importing.checks.check import check_path
from gibson_sim_tools.importing.checks.fix import FixOptions, fix_scene
from gibson_sim_tools.importing.checks.splats import splat_distance
from gibson_sim_tools.making.pixels import tone_map
from gibson_sim_tools.making.splats import splats_of_scene

FLOOR = "objects: [{name: floor, box: [4, 4, 0.2], pose: {xyz: [0, 0, -0.1]}, color: [0.2, 0.4, 0.6]}]\n"


def _splats(folder: Path, text: str = FLOOR) -> Splats:
    (folder / "scene.yaml").write_text(text)
    return splats_of_scene(load_scene(folder), 3000, np.random.default_rng(1))


def test_splats_lie_flat_on_the_surfaces_with_their_colours(tmp_path: Path) -> None:
    splats = _splats(tmp_path)
    assert 0.6 * 3000 < len(splats) < 1.5 * 3000
    np.testing.assert_allclose(splats.sh[:, 0] * SH_DC + 0.5, np.tile([0.2, 0.4, 0.6], (len(splats), 1)), atol=1e-6)
    top = (np.abs(splats.positions[:, 2]) < 1e-6) & (np.abs(splats.positions[:, :2]) < 1.9).all(axis=1)
    assert top.sum() > 1000
    # The third axis of a splat, along which it is thin, is the normal of the floor.
    x, y = splats.quats_xyzw[top, :2].T
    np.testing.assert_allclose(np.abs(1 - 2 * (x * x + y * y)), 1.0, atol=1e-6)
    assert (splats.scales[:, 2] < 0.2 * splats.scales[:, 0]).all()


def test_splats_of_a_light_mapped_surface_have_its_colours_in_the_light(tmp_path: Path) -> None:
    builder = GlbBuilder()
    light = builder.texture_data(light_map_png(np.full((2, 2, 3), 0.5), 2.0))
    material = builder.light_mapped_material({"pbrMetallicRoughness": {"baseColorFactor": [0.4, 0.8, 1.0, 1.0]}}, light, 2.0)
    attributes = {
        "POSITION": builder.attribute([[-2, 0, -2], [-2, 0, 2], [2, 0, 2]], bounds=True),
        "TEXCOORD_1": builder.attribute([[0, 0], [0, 65535], [65535, 65535]], "u2", normalized=True),
    }
    builder.primitive(attributes, builder.indices([[0, 1, 2]]), material)
    (tmp_path / "floor.glb").write_bytes(builder.to_bytes("floor"))
    splats = _splats(tmp_path, "objects: [{name: floor, mesh: floor.glb}]\n")
    expected = tone_map([0.2, 0.4, 0.5]) / 255.0
    np.testing.assert_allclose(splats.sh[:, 0] * SH_DC + 0.5, np.tile(expected, (len(splats), 1)), atol=1.5 / 255.0)


def test_a_scene_without_an_opaque_surface_gives_no_splats(tmp_path: Path) -> None:
    with pytest.raises(SceneError, match="no opaque surface"):
        _splats(tmp_path, "objects: [{box: [1, 1, 1], color: [1, 1, 1, 0.5]}]\n")


@pytest.mark.parametrize("off", [0.0, 0.01, 0.2])
def test_the_distance_is_that_by_which_splats_are_off(tmp_path: Path, off: float) -> None:
    splats = _splats(tmp_path)
    top = np.abs(splats.positions[:, 2]) < 1e-6
    parts = {name: getattr(splats, name)[top] for name in ("positions", "scales", "quats_xyzw", "opacities", "sh")}
    parts["positions"] = parts["positions"] + np.array([0.0, 0.0, off], dtype=np.float32)
    (tmp_path / "s.ply").write_bytes(splats_ply(Splats(**parts)))
    vertices, triangles = collision_triangles(load_scene(tmp_path))
    found = splat_distance(SplatsSpec(str(tmp_path / "s.ply")), vertices[triangles], np.random.default_rng(0))
    assert found.median == pytest.approx(off, abs=1e-3) and found.p90 >= found.median - 1e-6
    lifted = SplatsSpec(str(tmp_path / "s.ply"), scale=2.0)
    twice = splat_distance(lifted, vertices[triangles], np.random.default_rng(0))
    assert twice.median >= 2.0 * off - 1e-3


def test_faint_splats_do_not_count_and_without_solid_ones_nothing_is_near(tmp_path: Path) -> None:
    splats = _splats(tmp_path)
    haze = replace(splats, opacities=np.full(len(splats), 0.3, dtype=np.float32))
    (tmp_path / "s.ply").write_bytes(splats_ply(haze))
    found = splat_distance(SplatsSpec(str(tmp_path / "s.ply")), np.zeros((0, 3, 3)), np.random.default_rng(0))
    assert found.median == np.inf


def test_check_reports_an_error_above_three_centimetres(tmp_path: Path) -> None:
    (tmp_path / "s.ply").write_bytes(splats_ply(_splats(tmp_path)))
    (tmp_path / "scene.yaml").write_text(f"{FLOOR}visual: {{splats: s.ply, pose: {{xyz: [0, 0, 0.3]}}}}\n")
    (finding,) = [f for f in check_path(tmp_path).findings if f.what.startswith("splats")]
    assert (finding.what, finding.level, finding.fixable) == ("splats-apart", "error", True)
    assert "splats of degree 0: half of the solid ones are within" in finding.text and "at most 3 cm are allowed" in finding.text


@pytest.mark.parametrize(("visual", "before"), [("", "splats"), (", pose: {xyz: [0, 0, 0.3]}, scale: 2", "splats-apart")])
def test_a_mended_copy_has_the_splats_where_its_mesh_is(tmp_path: Path, visual: str, before: str) -> None:
    (tmp_path / "s.ply").write_bytes(splats_ply(_splats(tmp_path)))
    (tmp_path / "scene.yaml").write_text(f"{FLOOR}visual: {{splats: s.ply{visual}}}\n")
    report = check_path(tmp_path)
    assert before in {f.what for f in report.findings}
    file, mended = fix_scene(report, tmp_path / "mended", FixOptions(unit_m=0.5))
    spec = load_scene(file).splats
    assert spec is not None and Path(spec.file) == (tmp_path / "mended" / "assets" / "s.ply").resolve()
    assert spec.scale == pytest.approx(0.5, abs=1e-3) and spec.pose.position == pytest.approx((0.0, 0.0, 0.0), abs=1e-3)
    assert "splats" in {f.what for f in mended.findings}


def test_large_splats_and_splats_without_rotation_are_notes(tmp_path: Path) -> None:
    splats = _splats(tmp_path)
    scales, quats = splats.scales.copy(), splats.quats_xyzw.copy()
    scales[:2], quats[:3] = 148.0, 0.0
    (tmp_path / "s.ply").write_bytes(splats_ply(replace(splats, scales=scales, quats_xyzw=quats)))
    (tmp_path / "scene.yaml").write_text(f"{FLOOR}visual: {{splats: s.ply}}\n")
    found = {f.what: f for f in check_path(tmp_path).findings}
    assert "2 of" in found["splats-large"].text and "the largest 148 m" in found["splats-large"].text
    assert found["splats-unrotated"].text.startswith("3 of ") and found["splats-unrotated"].level == "note"
