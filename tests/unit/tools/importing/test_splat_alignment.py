"""Splats of a room, moved, turned and scaled, are aligned with its mesh; splats that fit nowhere, or anywhere, are refused."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from gibson_sim.cli.main import main
from gibson_sim.errors import SceneError
from gibson_sim.formats.splats import Splats, splats_ply
from gibson_sim.geometry.transforms import matrix_from_pose, pose_from_xyz_rpy, transform_points
from gibson_sim.scenes.load import load_scene
from gibson_sim.scenes.scene_meshes import collision_triangles
from gibson_sim.scenes.spec import SplatsSpec
from gibson_sim_tools.importing.checks.splat_alignment import align_splats
from gibson_sim_tools.importing.checks.splats import write_visual
from gibson_sim_tools.making.splats import splats_of_scene

F64 = NDArray[np.float64]
BARE = """objects:
- {name: floor, box: [5, 4, 0.1], pose: {xyz: [0, 0, -0.05]}}
- {name: ceiling, box: [5, 4, 0.1], pose: {xyz: [0, 0, 2.55]}}
- {name: west, box: [0.1, 4, 2.5], pose: {xyz: [-2.55, 0, 1.25]}}
- {name: east, box: [0.1, 4, 2.5], pose: {xyz: [2.55, 0, 1.25]}}
- {name: south, box: [5, 0.1, 2.5], pose: {xyz: [0, -2.05, 1.25]}}
- {name: north, box: [5, 0.1, 2.5], pose: {xyz: [0, 2.05, 1.25]}}
"""
ROOM = f"""# A room with a cupboard, a table and a bench.
{BARE}- {{name: cupboard, box: [0.6, 1.6, 2.0], pose: {{xyz: [-2.2, 1.2, 1.0]}}}}
- {{name: table, box: [1.6, 0.9, 0.75], pose: {{xyz: [0.9, -1.0, 0.375], rpy_deg: [0, 0, 20]}}}}
- {{name: bench, box: [0.4, 2.2, 0.45], pose: {{xyz: [2.2, 0.6, 0.225]}}}}
"""
AWAY = matrix_from_pose(pose_from_xyz_rpy((2.0, 0.0, 0.0), (0.0, 0.0, math.radians(70.0))))
AWAY[:3, :3] *= 1.7


def _room(folder: Path, text: str = ROOM) -> tuple[Splats, F64]:
    """Returns splats on the surfaces of a room, and the corners of its triangles."""
    (folder / "scene.yaml").write_text(text)
    scene = load_scene(folder)
    vertices, triangles = collision_triangles(scene)
    return splats_of_scene(scene, 6000, np.random.default_rng(1)), vertices[triangles]


def _moved(folder: Path, splats: Splats, T: F64) -> SplatsSpec:
    """Writes splats after a transform."""
    moved = transform_points(T, splats.positions).astype(np.float32)
    (folder / "room.ply").write_bytes(splats_ply(replace(splats, positions=moved)))
    return SplatsSpec(str(folder / "room.ply"))


def _matrix(spec: SplatsSpec) -> F64:
    T = matrix_from_pose(spec.pose)
    T[:3, :3] *= spec.scale
    return T


def _check(*words: str) -> int | str | None:
    """Returns the exit code of ``gibson-sim scene check``."""
    with pytest.raises(SystemExit) as ended:
        main(["scene", "check", *words])
    return ended.value.code


def _farthest(found: SplatsSpec, T: F64, splats: Splats) -> float:
    """Returns by how much splats miss their places at most, metres."""
    there = transform_points(_matrix(found) @ T, splats.positions)
    return float(np.linalg.norm(there - splats.positions, axis=1).max())


def test_splats_that_were_scaled_turned_and_moved_are_brought_back(tmp_path: Path) -> None:
    splats, corners = _room(tmp_path)
    found = align_splats(_moved(tmp_path, splats, AWAY), corners, np.random.default_rng(0))
    assert _farthest(found.spec, AWAY, splats) < 0.01
    assert found.spec.scale == pytest.approx(1 / 1.7, rel=1e-3)
    assert found.before.median > 0.3 and found.after.median < 0.01


def test_half_a_room_with_y_down_and_rough_surfaces_is_brought_back(tmp_path: Path) -> None:
    splats, corners = _room(tmp_path)
    half = splats.positions[:, 1] < 0.3
    splats = replace(
        splats,
        positions=splats.positions[half],
        scales=splats.scales[half],
        quats_xyzw=splats.quats_xyzw[half],
        opacities=splats.opacities[half],
        sh=splats.sh[half],
    )
    down = matrix_from_pose(pose_from_xyz_rpy(rpy=(math.radians(-85.0), 0.1, 0.0))) @ AWAY
    noise = np.random.default_rng(2).normal(scale=0.01, size=splats.positions.shape).astype(np.float32)
    rough = replace(splats, positions=splats.positions + noise)
    found = align_splats(_moved(tmp_path, rough, down), corners, np.random.default_rng(0))
    assert _farthest(found.spec, down, splats) < 0.01
    assert found.after.median == pytest.approx(0.0067, abs=0.002)  # half of a normal distribution is within 0.67 of its deviation


def test_splats_of_something_else_are_refused_in_one_line(tmp_path: Path) -> None:
    splats, corners = _room(tmp_path)
    ball = np.random.default_rng(3).normal(size=splats.positions.shape)
    other = replace(splats, positions=(2.0 * ball / np.linalg.norm(ball, axis=1, keepdims=True)).astype(np.float32))
    with pytest.raises(SceneError, match=r"no pose and scale fit the splats to the mesh: at best \d+ %") as caught:
        align_splats(_moved(tmp_path, other, np.eye(4)), corners, np.random.default_rng(0))
    assert "\n" not in str(caught.value)


def test_a_room_that_looks_alike_from_two_sides_needs_a_rough_pose(tmp_path: Path) -> None:
    splats, corners = _room(tmp_path, BARE)
    with pytest.raises(SceneError, match=r"several poses fit equally well.*give an approximate pose"):
        align_splats(_moved(tmp_path, splats, AWAY), corners, np.random.default_rng(0))
    near = matrix_from_pose(pose_from_xyz_rpy((0.2, -0.1, 0.1), (0.0, 0.0, 0.1)))
    near[:3, :3] *= 1.03
    found = align_splats(_moved(tmp_path, splats, near), corners, np.random.default_rng(0))
    assert _farthest(found.spec, near, splats) < 0.01


def test_splats_that_lie_on_the_mesh_stay_there(tmp_path: Path) -> None:
    splats, corners = _room(tmp_path)
    with pytest.raises(
        SceneError,
        match=r"pose of the splats is unchanged: .*within 0\.0 cm of the mesh, which is not closer than the present pose",
    ):
        align_splats(_moved(tmp_path, splats, np.eye(4)), corners, np.random.default_rng(0))


def test_too_few_splats_those_at_one_place_and_no_mesh_are_refused(tmp_path: Path) -> None:
    splats, corners = _room(tmp_path)
    spec = _moved(tmp_path, replace(splats, opacities=np.full(len(splats), 0.3, dtype=np.float32)), np.eye(4))
    with pytest.raises(SceneError, match=r"has 0 splats with an opacity of at least 0\.5; 100 are needed"):
        align_splats(spec, corners, np.random.default_rng(0))
    spec = _moved(tmp_path, replace(splats, positions=np.ones_like(splats.positions)), np.eye(4))
    with pytest.raises(SceneError, match=r"all splats are at the same position, 1, 1, 1"):
        align_splats(spec, corners, np.random.default_rng(0))
    with pytest.raises(SceneError, match="has no visual mesh"):
        align_splats(_moved(tmp_path, splats, np.eye(4)), np.zeros((0, 3, 3)), np.random.default_rng(0))


def test_the_command_writes_pose_and_scale_into_the_scene_and_changes_nothing_else(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    splats, _ = _room(tmp_path)
    _moved(tmp_path, splats, AWAY)
    text = f"{ROOM}visual:\n  splats: room.ply  # half a million\n  scale: 1\n\n# The end.\nfloor_z: 0\n"
    (tmp_path / "scene.yaml").write_text(text)
    _check(str(tmp_path), "--align-splats")
    out = capsys.readouterr().out
    assert "before: " in out and "after: " in out and "   note  splats: " in out and "splats-apart" not in out
    written = (tmp_path / "scene.yaml").read_text()
    assert written.startswith(f"{ROOM}visual: {{splats: room.ply, up_axis: z, pose: ") and written.endswith(
        "}\n\n# The end.\nfloor_z: 0\n"
    )
    spec = load_scene(tmp_path).splats
    assert spec is not None and _farthest(spec, AWAY, splats) < 0.01


def test_options_that_do_not_go_together_and_a_scene_without_splats_are_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "scene.yaml").write_text(BARE)
    assert _check(str(tmp_path), "--align-splats", "--fix", "--output", str(tmp_path / "x")) != 0
    assert "give one of them" in capsys.readouterr().err
    assert _check(str(tmp_path), "--align-splats") != 0
    assert "has no splats to align" in capsys.readouterr().err


@pytest.mark.parametrize(
    "before",
    [
        "visual: {splats: r.ply}\n",
        "visual:\n  splats: r.ply\n  pose:\n    xyz:\n    - 1\n    - 2\n    - 3\n",
        '"visual": {splats: "r.ply"}',
    ],
)
def test_a_new_pose_replaces_the_old_one_in_any_layout(tmp_path: Path, before: str) -> None:
    file = tmp_path / "scene.yaml"
    file.write_text(f"name: a\n{before}")
    line = write_visual(file, SplatsSpec("/r.ply", pose_from_xyz_rpy((1.0, 2.0, -0.5), (0.0, 0.0, math.pi / 2)), 0.25))
    assert line == "visual: {splats: r.ply, up_axis: z, pose: {xyz: [1.0, 2.0, -0.5], rpy_deg: [0.0, 0.0, 90.0]}, scale: 0.25}"
    assert file.read_text().rstrip("\n") == f"name: a\n{line}"


def test_a_pose_that_others_refer_to_is_not_replaced(tmp_path: Path) -> None:
    file = tmp_path / "scene.yaml"
    file.write_text(text := "visual: {splats: r.ply, pose: &p {xyz: [1, 2, 3]}}\nother: *p\n")
    with pytest.raises(SceneError, match=r"cannot be edited automatically; replace it by: visual: \{splats: r\.ply"):
        write_visual(file, SplatsSpec("/r.ply"))
    assert file.read_text() == text
