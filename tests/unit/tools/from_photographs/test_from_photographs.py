"""Import of photographs: inputs in a folder, stages, and when completed stages are invalidated."""

from __future__ import annotations

import json
import shutil
from collections.abc import Sequence
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import yaml

from gibson_sim.cli.command_line import run
from gibson_sim.errors import ConfigError, SceneError
from gibson_sim.formats.load_mesh import load_mesh
from gibson_sim.scenes.load import load_scene
from gibson_sim_tools.from_photographs import importing
from gibson_sim_tools.from_photographs.closed_floor import closed_floor
from gibson_sim_tools.from_photographs.given_mesh import given_mesh
from gibson_sim_tools.from_photographs.image_checks import is_truncated
from gibson_sim_tools.from_photographs.importing import UNSEEN_FLOOR, PhotographImport
from gibson_sim_tools.from_photographs.inputs import find_inputs, is_photograph_archive, is_photograph_folder
from gibson_sim_tools.from_photographs.settings import PhotographSettings
from gibson_sim_tools.from_photographs.stages import RECORD, Stage, StagedJob
from gibson_sim_tools.photographs.layouts import open_photographs
from gibson_sim_tools.scanning.fusion import Fusion
from gibson_sim_tools.scanning.posed_images import Intrinsics, ScanError
from gibson_sim_tools.scanning.trajectories import write_trajectory_log
from gibson_sim_tools.scanning.triangle_mesh import transformed, write_ply
from gibson_sim_tools.texturing.conventions import resolve_convention
from gibson_sim_tools.texturing.evaluation import ImageSimilarity
from gibson_sim_tools.texturing.surface import surface_from_mesh
from support.photographed_room import (
    COUNT,
    T_ARKIT_WORLD,
    T_FIRST_WORLD,
    WIDTH,
    room_image,
    room_mesh,
    room_poses,
    write_colmap,
    write_mesh,
    write_nerfstudio,
    write_polycam,
    write_rgbd,
)

SETTINGS = PhotographSettings(hold_out=0, snap=0.0)
"""Without the held-out comparison, which renders with OpenGL."""


def opened(folder: Path, output: Path, mesh: Path | None = None, settings: PhotographSettings = SETTINGS) -> PhotographImport:
    inputs = find_inputs(folder, mesh, fuse=False, longest_side=0, excluded=output)
    return PhotographImport(inputs, output, settings, "room")


def made(job: PhotographImport) -> dict[str, bool]:
    """Runs an import; returns the stages, and whether each was reused."""
    stages = {}
    job.run(lambda number: nullcontext(lambda part: None), lambda stage: stages.update({stage.name: stage.reused}))
    return stages


def run_stage(job: PhotographImport, name: str) -> Sequence[str]:
    """Runs one stage of an import; returns its report."""
    (found,) = (each for each in job.stages() if each.name == name)
    return found.run(lambda part: None)


def record(job: PhotographImport, name: str) -> Any:
    return json.loads((job.output / f"import/{name}.json").read_text())


@pytest.fixture
def room(tmp_path):
    """The room as an app exports it: photographs with depth, and a mesh, in the frame of the first camera."""
    folder = write_rgbd(tmp_path / "phone")
    write_mesh(folder / "mesh.ply")
    return folder


def test_a_folder_becomes_a_level_scene_once_and_its_floor_is_closed(room, tmp_path):
    job = opened(room, tmp_path / "out")
    assert job.inputs.lines() == [
        f"{COUNT} photographs of 64x48 pixels, with poses, with depth (layout: open3d)", f"mesh: {room}/mesh.ply",
    ]  # fmt: skip
    stages = made(job)
    assert list(stages) == ["photographs", "mesh", "planes", "level", "texture", "scene", "collision", "floor map", "check"]
    assert not any(stages.values())
    scene = load_scene(tmp_path / "out")
    assert [visual.name for visual in scene.visuals] == ["room", UNSEEN_FLOOR]
    # The floor of the room is at y = 1.2 of the frame of the first camera, which looks along its y.
    np.testing.assert_allclose(
        json.loads((tmp_path / "out/import/level.json").read_text())["T_level_scan"][2], [0, -1, 0, 1.2], atol=1e-3
    )
    assert scene.floors == (0.0,) and not scene.floor_estimated
    area = yaml.safe_load((tmp_path / "out/maps/floor_0.yaml").read_text())
    assert area["resolution"] == 0.05 and (tmp_path / "out/free_poses.csv").is_file()
    report = json.loads((tmp_path / "out/import/check.json").read_text())
    # The whole floor, 4 x 3 m, less a rim of the robot's radius and half a cell's diagonal.
    assert report["free_floor_m2"] == pytest.approx(3.5 * 2.5, abs=0.7)
    assert all(made(opened(room, tmp_path / "out")).values())


@pytest.mark.parametrize(
    ("changes", "again"),
    [
        ({"close_floor": False}, "scene"),
        ({"longest_side": 64}, "texture"),
        ({"triangles": 500}, "planes"),
    ],
)
def test_an_option_invalidates_its_stage_and_all_later_ones(room, tmp_path, monkeypatch, changes, again):
    skip_stages(monkeypatch)
    made(opened(room, tmp_path / "out"))
    stages = made(opened(room, tmp_path / "out", settings=replace(SETTINGS, **changes)))
    names = list(stages)
    assert [name for name in names if not stages[name]] == names[names.index(again) :]


def test_another_photograph_or_mesh_invalidates_all_later_stages(room, tmp_path, monkeypatch):
    skip_stages(monkeypatch)
    made(opened(room, tmp_path / "out"))
    write_mesh(room / "other.ply")
    stages = made(opened(room, tmp_path / "out", room / "other.ply"))
    assert stages["photographs"] and not any(reused for name, reused in stages.items() if name != "photographs")
    (room / "color/000003.png").write_bytes((room / "color/000004.png").read_bytes())
    assert not any(made(opened(room, tmp_path / "out", room / "other.ply")).values())


def test_leaving_out_depth_fuses_again(tmp_path, monkeypatch):
    folder, hold_out = write_rgbd(tmp_path / "phone"), replace(SETTINGS, hold_out=5)
    skip_stages(monkeypatch)
    monkeypatch.setattr(importing, "open3d", lambda: None)
    made(opened(folder, tmp_path / "out", settings=hold_out))
    stages = made(opened(folder, tmp_path / "out", settings=replace(hold_out, hold_out_depth=True)))
    assert [name for name, reused in stages.items() if reused] == ["photographs"]


def test_another_filler_compares_again_and_a_missing_one_is_refused_before_any_stage(room, tmp_path, monkeypatch):
    hold_out = replace(SETTINGS, hold_out=5)
    with pytest.raises(ConfigError, match=r"nowhere\.onnx"):
        made(opened(room, tmp_path / "out", settings=replace(hold_out, fill=str(tmp_path / "nowhere.onnx"))))
    assert not (tmp_path / "out").exists()
    skip_stages(monkeypatch)
    made(opened(room, tmp_path / "out", settings=hold_out))
    stages = made(opened(room, tmp_path / "out", settings=replace(hold_out, fill="push_pull")))
    assert [name for name, reused in stages.items() if not reused] == ["compare"]


def test_filled_images_need_held_out_photographs():
    with pytest.raises(ConfigError, match=r"'fill' is 'push_pull'.*'hold_out' is 0"):
        PhotographSettings(fill="push_pull", hold_out=0)


def skip_stages(monkeypatch):
    """Replaces every stage by one that writes empty files."""
    stages = PhotographImport.stages

    def empty(job: PhotographImport) -> list[Stage]:
        def writing(stage: Stage):
            def run(_):
                for file in stage.files:
                    (job.output / file).parent.mkdir(parents=True, exist_ok=True)
                    (job.output / file).touch()
                return []

            return replace(stage, run=run)

        return [writing(stage) for stage in stages(job)]

    monkeypatch.setattr(PhotographImport, "stages", empty)


def test_an_interrupted_job_resumes_at_the_stage_that_was_not_completed(tmp_path):
    ran = []

    def stage(name, fails=False):
        def run(_):
            ran.append(name)
            if fails:
                raise KeyboardInterrupt
            (tmp_path / "out" / name).write_text("")
            return [f"{name} said"]

        return Stage(name, run, (name,))

    job = StagedJob(tmp_path / "out", "source")
    job.open()
    with pytest.raises(KeyboardInterrupt):
        job.run([stage("a"), stage("b", fails=True), stage("c")], lambda _: nullcontext(lambda part: None), lambda _: None)
    said = []
    again = StagedJob(tmp_path / "out", "source")
    again.open()
    again.run([stage("a"), stage("b"), stage("c")], lambda _: nullcontext(lambda part: None), said.append)
    assert ran == ["a", "b", "b", "c"]
    assert [(s.lines, s.reused) for s in said] == [(("a said",), True), (("b said",), False), (("c said",), False)]
    (tmp_path / "out/b").unlink()
    again.run([stage("a"), stage("b"), stage("c")], lambda _: nullcontext(lambda part: None), said.append)
    assert ran[4:] == ["b", "c"]


def test_a_stage_interrupted_with_new_options_is_not_reused_with_the_former_ones(tmp_path):
    ran = []

    def stage(option, fails=False):
        def run(_):
            ran.append(option)
            (tmp_path / "out/file").write_text(option)
            if fails:
                raise KeyboardInterrupt
            return []

        return [Stage("stage", run, ("file",), option)]

    for option, fails in (("old", False), ("new", True), ("old", False)):
        job = StagedJob(tmp_path / "out", "source")
        job.open()
        try:
            job.run(stage(option, fails), lambda _: nullcontext(lambda part: None), lambda _: None)
        except KeyboardInterrupt:
            assert fails
    assert ran == ["old", "new", "old"] and (tmp_path / "out/file").read_text() == "old"


@pytest.fixture
def fused(monkeypatch):
    """Arguments of the fusion, which is replaced: frames, settings, and frames of which only the depth is fused."""
    given = []

    def fuse_scan(rgbd, settings, progress, *, depth_only):
        given.append((rgbd, settings, list(depth_only)))
        return Fusion(transformed(room_mesh(), T_FIRST_WORLD), 0.02, None, None, None)

    monkeypatch.setattr(importing, "fuse_scan", fuse_scan)
    return given


def test_depth_is_fused_without_a_mesh(tmp_path, fused):
    job = opened(write_rgbd(tmp_path / "phone"), tmp_path / "out", settings=replace(SETTINGS, depth_max=3.0))
    assert job.inputs.lines()[1] == "no mesh: it will be fused from depth"
    assert [stage.name for stage in job.stages()][1] == "fuse"
    run_stage(job, "fuse")
    ((rgbd, settings, depth_only),) = fused
    assert depth_only == [] and (len(rgbd), settings.depth_max, settings.snap) == (COUNT, 3.0, 0.0)
    assert len(load_mesh(job.output / "import/fused.ply", [job.output]).merged()[1]) == len(room_mesh().triangles)


@pytest.mark.parametrize("write", [write_rgbd, write_polycam])
def test_the_depth_of_held_out_photographs_is_fused_without_their_colors(tmp_path, fused, write):
    job = opened(write(tmp_path / "phone"), tmp_path / "out", settings=replace(SETTINGS, hold_out=5))
    assert run_stage(job, "fuse")[0].endswith(f"from {COUNT} depth images, 3 of them without their colours")
    ((rgbd, _, depth_only),) = fused
    assert (len(rgbd), depth_only) == (COUNT, [0, 5, 10])


@pytest.mark.parametrize("write", [write_rgbd, write_polycam])
def test_held_out_photographs_are_not_fused_with_hold_out_depth(tmp_path, fused, write):
    settings = replace(SETTINGS, hold_out=5, hold_out_depth=True)
    job = opened(write(tmp_path / "phone"), tmp_path / "out", settings=settings)
    assert run_stage(job, "fuse")[0].endswith("from 9 depth images")
    ((rgbd, _, depth_only),) = fused
    assert depth_only == []
    others = [1, 2, 3, 4, 6, 7, 8, 9, 11]
    assert [int(item.file.stem) for item in rgbd.photographs.items] == others
    np.testing.assert_array_equal(rgbd[5].T_world_camera, job.inputs.photographs.poses[7])
    assert rgbd[5].depth.tolist() == job.inputs.rgbd[7].depth.tolist()


def test_the_share_of_held_out_photographs_stays_if_photographs_are_selected(room, tmp_path, monkeypatch):
    job = opened(room, tmp_path / "out", settings=replace(SETTINGS, hold_out=3))
    surface, photographs = surface_from_mesh(load_mesh(room / "mesh.ply", [room])), job.inputs.photographs
    numbers, held_out = job._select_photographs(surface, photographs, lambda part: None)
    assert (numbers.tolist(), held_out) == (list(range(COUNT)), [0, 3, 6, 9])
    monkeypatch.setattr(importing, "MOST_PHOTOGRAPHS", 7)
    numbers, held_out = job._select_photographs(surface, photographs, lambda part: None)
    # Two of 0, 3, 6 and 9, and five of the others.
    assert len(numbers) == 7 and numbers[held_out].tolist() == [0, 9] and not {3, 6} & set(numbers.tolist())


def test_depth_is_fused_in_the_pose_convention_in_which_depth_images_agree(tmp_path, fused):
    folder = write_rgbd(tmp_path / "phone")
    right = open_photographs(folder).poses
    write_trajectory_log(folder / "trajectory.log", right @ np.diag([1.0, -1.0, -1.0, 1.0]))
    job = opened(folder, tmp_path / "out")
    assert run_stage(job, "fuse")[0].startswith("poses are read as opengl: camera-to-world, cameras look along -z with y up")
    np.testing.assert_allclose(fused[0][0].poses, right, atol=1e-6)
    # Up is that of the cameras at these poses.
    run_stage(job, "planes")
    run_stage(job, "level")
    np.testing.assert_allclose(np.array(record(job, "level")["T_level_scan"])[2], [0, -1, 0, 1.2], atol=1e-3)


def test_raw_data_of_polycam_are_fused_at_the_size_of_their_depth(tmp_path):
    job = opened(write_polycam(tmp_path / "phone"), tmp_path / "out")
    assert job.inputs.lines()[0] == f"{COUNT} photographs of 64x48 pixels, with poses, with depth (layout: polycam)"
    rgbd = job.inputs.rgbd
    assert rgbd is not None and (len(rgbd), rgbd.intrinsics) == (COUNT, Intrinsics(32, 24, 20.0, 20.0, 15.5, 11.5))
    frame = rgbd[3]
    # A quarter turn to portrait: the camera's x is down.
    T_world_camera = np.linalg.inv(T_ARKIT_WORLD) @ frame.T_world_camera
    assert T_world_camera[2, 0] < -0.8
    color, depth = room_image(T_world_camera, 2)
    np.testing.assert_allclose(frame.depth, depth / 1000.0, atol=1e-6)
    assert np.abs(frame.rgb[:, :, ::-1].astype(int) - color).max() <= 3


def test_up_is_that_of_the_phone_however_it_was_held(tmp_path):
    job = opened(write_polycam(tmp_path / "phone"), tmp_path / "out", write_mesh(tmp_path / "room.ply", T_ARKIT_WORLD))
    (tmp_path / "out").mkdir()
    run_stage(job, "mesh")
    run_stage(job, "planes")
    assert run_stage(job, "level") == ["turned by 90.00 degrees: z is up and the floor is at z = 0"]
    np.testing.assert_allclose((np.array(record(job, "level")["T_level_scan"]) @ T_ARKIT_WORLD)[2], [0, 0, 1, 0], atol=1e-3)


def test_frames_of_different_cameras_are_remapped_to_common_intrinsics(tmp_path):
    folder = write_polycam(tmp_path / "phone")
    for k in range(3):
        camera = json.loads((folder / f"keyframes/cameras/{k}.json").read_text())
        (folder / f"keyframes/cameras/{k}.json").write_text(json.dumps({**camera, "cx": WIDTH / 2 + 4.0}))
    rgbd = opened(folder, tmp_path / "out").inputs.rgbd
    assert rgbd is not None and rgbd.intrinsics == Intrinsics(32, 24, 20.0, 20.0, 15.5, 11.5)
    # The image of the camera whose middle is 2 pixels of depth further right is moved to the left.
    depth = room_image(room_poses()[0], 2)[1]
    moved_depth = rgbd[0].depth
    assert np.isnan(moved_depth[:, -2:]).all() and depth.shape == moved_depth.shape
    own = open_photographs(folder).depth(0)
    assert own is not None
    np.testing.assert_allclose(moved_depth[:, :-2], own[::2, ::2][:, 2:], atol=1e-6)


@pytest.mark.parametrize(("write", "layout"), [(write_nerfstudio, "nerfstudio"), (write_colmap, "colmap")])
def test_photographs_without_depth_need_a_mesh(tmp_path, write, layout):
    folder = write(tmp_path / "photographs")
    assert is_photograph_folder(folder)
    with pytest.raises(
        ScanError, match=f"12 photographs with poses \\({layout}\\), but neither depth images that can be fused nor a mesh"
    ):
        opened(folder, tmp_path / "out")
    mesh = write_mesh(tmp_path / "room.ply", np.eye(4))
    assert opened(folder, tmp_path / "out", mesh).inputs.photographs.poses == pytest.approx(room_poses(), abs=1e-6)


def test_a_mesh_with_other_axes_than_the_poses_is_rotated(tmp_path):
    folder = write_nerfstudio(tmp_path / "photographs")
    to_y_up = np.array([[1.0, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]])
    write_mesh(folder / "mesh.ply", to_y_up)
    job = opened(folder, tmp_path / "out")
    (tmp_path / "out").mkdir()
    (text,) = run_stage(job, "mesh")
    assert "turned from y up to z up" in text
    vertices, _ = load_mesh(job.output / "import/fused.ply", [job.output]).merged()
    np.testing.assert_allclose(np.ptp(vertices, axis=0), [4.0, 3.0, 2.4], atol=1e-5)


@pytest.mark.parametrize("convention", ["auto", "opencv"])
def test_poses_in_another_convention_are_converted_beside_a_mesh(tmp_path, convention):
    folder = write_nerfstudio(tmp_path / "photographs")
    write_mesh(folder / "mesh.ply", np.eye(4))
    file = folder / "transforms.json"
    values = json.loads(file.read_text())
    for frame, T in zip(values["frames"], room_poses(), strict=True):
        frame["transform_matrix"] = T.tolist()
    file.write_text(json.dumps(values))
    job = replace(opened(folder, tmp_path / "out"), pose_convention=convention)
    (tmp_path / "out").mkdir()
    lines = run_stage(job, "mesh")
    np.testing.assert_allclose(record(job, "fused")["T_scan_camera"], room_poses(), atol=1e-9)
    assert (convention == "opencv") == (len(lines) == 1)
    assert convention == "opencv" or lines[1].startswith("poses are read as opencv: ")
    with pytest.raises(ScanError, match=r"agree if poses are read as opencv .* give --pose-convention opencv, or auto"):
        run_stage(replace(job, pose_convention="as-read"), "mesh")


def test_a_mesh_that_is_shown_in_another_convention_only_is_not_refused(tmp_path):
    folder = write_nerfstudio(tmp_path / "photographs")
    # Half of the room: cameras that look the other way see nothing of it.
    mesh = room_mesh()
    is_ahead = mesh.vertices[mesh.triangles].mean(axis=1)[:, 1] > 1.0
    write_ply(folder / "mesh.ply", replace(mesh, triangles=mesh.triangles[is_ahead]))
    photographs = open_photographs(folder)
    ahead = photographs.subset([k for k, T in enumerate(photographs.poses) if T[1, 2] > 0.5])
    turned = ahead.with_poses(ahead.poses @ np.diag([1.0, -1.0, -1.0, 1.0]))
    with pytest.raises(ScanError, match=r"mesh.ply: fills -?\d+ % of the photographs"):
        given_mesh(folder / "mesh.ply", turned, "as-read")
    assert given_mesh(folder / "mesh.ply", turned, "auto").convention == "opencv"
    assert given_mesh(folder / "mesh.ply", ahead, "auto").convention == "as-read"


def test_a_mesh_in_millimetres_is_refused_before_it_is_split(tmp_path):
    folder = write_nerfstudio(tmp_path / "photographs")
    write_mesh(folder / "mesh.ply", np.diag([1000.0, 1000.0, 1000.0, 1.0]))
    with pytest.raises(ScanError, match=r"the mesh is 4000 x 3000 x 2400 m; in mm it would be a room or a building"):
        opened(folder, tmp_path / "out")._load_mesh(lambda part: None)


def test_poses_of_another_scale_than_the_mesh_are_named(tmp_path):
    photographs = open_photographs(write_nerfstudio(tmp_path / "photographs"))
    poses = T_FIRST_WORLD @ photographs.poses
    surface = surface_from_mesh(load_mesh(write_mesh(tmp_path / "mesh.ply"), [tmp_path]))
    photographs = photographs.with_poses(poses)
    assert resolve_convention(surface, photographs, "auto")[1] == ""
    with pytest.raises(
        ScanError,
        match=r"if the positions of the cameras are multiplied by 10 .* scale the mesh or the poses; the mesh is 4 x 2.4 x 3 m$",
    ):
        resolve_convention(surface, photographs.scaled(0.1), "auto")


def test_a_scene_that_hardly_resembles_its_photographs_is_a_warning():
    assert ImageSimilarity(22.0, 0.8, 100).warning() == ""
    assert (
        ImageSimilarity(14.2, 0.58, 100)
        .warning()
        .startswith("warning: the scene hardly resembles the held-out photographs (PSNR 14.2 dB")
    )


def test_options_of_the_camera_reach_the_photographs(tmp_path):
    folder, output = write_rgbd(tmp_path / "phone"), tmp_path / "out"
    inputs = find_inputs(
        folder, None, fuse=False, longest_side=0, excluded=output, focal=(50.0, 51.0, 30.0, 20.0), depth_scale=500.0
    )
    assert inputs.rgbd is not None and inputs.rgbd.intrinsics == Intrinsics(64, 48, 50.0, 51.0, 30.0, 20.0)
    assert inputs.rgbd.depth_scale == inputs.photographs.items[0].depth_scale == 500.0
    polycam = write_polycam(tmp_path / "polycam")
    inputs = find_inputs(polycam, None, fuse=False, longest_side=0, excluded=output, depth_scale=500.0)
    assert inputs.rgbd is not None and inputs.rgbd.depth_scale == 500.0
    with pytest.raises(
        ScanError, match=r"its layout \(polycam\) holds the intrinsics of each photograph; leave out --intrinsics"
    ):
        find_inputs(polycam, None, fuse=False, longest_side=0, excluded=output, focal=(50.0, 51.0, 30.0, 20.0))


def test_a_mesh_that_no_photograph_shows_is_refused(tmp_path):
    folder = write_nerfstudio(tmp_path / "photographs")
    aside = np.eye(4)
    aside[:3, 3] = 50.0
    write_mesh(folder / "mesh.ply", aside)
    with pytest.raises(ScanError, match=r"mesh.ply: fills 0 % of the photographs from its front, at least 20 % is needed"):
        opened(folder, tmp_path / "out")._load_mesh(lambda part: None)


def test_the_floor_is_closed_within_the_outline_and_not_over_a_stairwell():
    mesh = room_mesh()
    vertices = mesh.vertices.astype(np.float64)
    boards = closed_floor(vertices, mesh.triangles, room_poses()[:, :3, 3])
    assert boards is not None and boards.area == pytest.approx(0.6 * 3.0, abs=0.2)
    low, high = boards.mesh.bounds
    assert high[2] == pytest.approx(-0.008) and (low[:2] >= -0.051).all() and (high[:2] <= [0.71, 3.051]).all()
    up = np.array([0.0, 0.0, 0.3])
    raised = closed_floor(vertices + up, mesh.triangles, room_poses()[:, :3, 3] + up, 0.3)
    assert raised is not None and raised.area == boards.area and raised.mesh.bounds[1, 2] == pytest.approx(0.292)
    # A landing 1.5 m below the part that is missing.
    steps = room_mesh().vertices[mesh.triangles].reshape(-1, 3)
    landing = np.array([[0, 0, -1.5], [0.6, 0, -1.5], [0.6, 3, -1.5], [0, 3, -1.5]])
    joined = np.concatenate([steps, landing]).astype(np.float64)
    triangles = np.concatenate([np.arange(len(steps)).reshape(-1, 3), len(steps) + np.array([[0, 1, 2], [0, 2, 3]])])
    stairs = closed_floor(joined, triangles, room_poses()[:, :3, 3])
    assert stairs is None or stairs.area < 0.1


def test_floor_is_filled_near_observed_floor_and_not_in_unobserved_rooms():
    # A ceiling of 8 x 2 m, and floor that was seen below its first metre.
    ceiling = np.array([[0, 0, 1.9], [0, 2, 1.9], [8, 2, 1.9], [8, 0, 1.9]])
    floor = np.array([[0, 0, 0], [1, 0, 0], [1, 2, 0], [0, 2, 0]])
    square = np.array([[0, 1, 2], [0, 2, 3]])
    boards = closed_floor(
        np.concatenate([ceiling, floor]).astype(float), np.concatenate([square, 4 + square]), np.array([[0.5, 1.0, 1.2]])
    )
    # One metre from the floor, and from the rim of the camera's place at x = 0.9.
    assert boards is not None and boards.area == pytest.approx(1.0 * 2.0, abs=0.15)
    assert boards.mesh.bounds[1, 0] == pytest.approx(2.0, abs=0.06)


def test_a_folder_with_a_mesh_and_its_textures_is_no_folder_of_photographs(tmp_path):
    write_mesh(tmp_path / "shop.ply")
    (tmp_path / "wood.png").write_bytes(b"")
    assert not is_photograph_folder(tmp_path)
    (tmp_path / "shop.ply").unlink()
    assert is_photograph_folder(tmp_path)
    (tmp_path / "scene.yaml").write_text("name: shop\n")
    assert not is_photograph_folder(tmp_path)


def exit_code(*words: object) -> int:
    return run(["scene", "import", *map(str, words)])


def test_bad_folders_are_one_line_each(room, tmp_path, capsys):
    def message(*words):
        assert exit_code(*words, "--output", tmp_path / "out") == 1
        text = capsys.readouterr().err
        assert text.count("\n") == 1
        return text

    for name in ("heic", "unposed"):
        (tmp_path / name).mkdir()
    (tmp_path / "heic/IMG_1.HEIC").write_bytes(b"x")
    assert "has no photograph that can be read (.jpg, .png), but IMG_1.HEIC: convert it to JPEG first" in message(
        tmp_path / "heic"
    )
    (tmp_path / "unposed/1.jpg").write_bytes(b"x")
    assert "has photographs but no poses; COLMAP finds them" in message(tmp_path / "unposed")
    assert "--mesh" in message(room, "--mesh", tmp_path / "none.ply")
    assert "must be 0, or 2 or more" in message(room, "--hold-out", 1)
    assert "but 'hold_out' is 0; give" in message(room, "--hold-out", 0, "--hold-out-depth")
    refused = message(room, "--hold-out-depth")
    assert "--hold-out-depth needs a mesh that is fused from depth, but the mesh is '" in refused
    assert refused.rstrip().endswith("leave it out, or give --fuse")
    assert "give one of them" in message(room, "--mesh", room / "mesh.ply", "--fuse")
    write_mesh(room / "dense.ply")
    (room / "mesh.ply").rename(room / "sparse.ply")
    assert "holds 2 meshes (dense.ply, sparse.ply); say with --mesh FILE which one, or --fuse" in message(room)
    assert not (tmp_path / "out").exists()


def test_the_zip_of_an_app_is_unpacked_once(tmp_path, monkeypatch, capsys):
    folder = write_polycam(tmp_path / "phone/room")
    write_mesh(folder / "raw.ply", T_ARKIT_WORLD)
    shutil.make_archive(str(tmp_path / "room"), "zip", tmp_path / "phone")
    skip_stages(monkeypatch)
    for _ in range(2):
        assert exit_code(tmp_path / "room.zip", "--output", tmp_path / "out", "--hold-out", 0) == 0
        lines = capsys.readouterr().out.splitlines()
        assert lines[0].endswith(f"{COUNT} photographs of 64x48 pixels, with poses, with depth (layout: polycam)")
    assert all("done before" in line for line in lines if "/9 " in line)
    assert (tmp_path / "out/import/photographs/room/keyframes").is_dir()
    assert not is_photograph_archive(Path(shutil.make_archive(str(tmp_path / "mesh"), "zip", tmp_path / "phone/room", "raw.ply")))


def test_truncated_images_are_named_before_any_stage(room, tmp_path, capsys):
    for name in ("color/000002.png", "depth/000005.png"):
        (room / name).write_bytes((room / name).read_bytes()[:-20])
    assert exit_code(room, "--output", tmp_path / "out") == 1
    error = capsys.readouterr().err.splitlines()[-1]
    assert "000002.png: is truncated, and 1 more of 24 images are broken; copy the photographs again" in error


def test_a_jpeg_without_end_marker_is_truncated_although_its_thumbnail_has_one():
    preview = b"\xff\xd8\xff\xd9"
    header = b"\xff\xd8\xff\xe1" + (2 + len(preview)).to_bytes(2, "big") + preview
    assert is_truncated(header + b"\xff\xda\x00\x02 data") and not is_truncated(header + b"\xff\xda\x00\x02 data\xff\xd9 trailer")


def test_an_output_that_holds_something_else_is_refused(room, tmp_path):
    (tmp_path / "out").mkdir()
    (tmp_path / "out/notes.txt").write_text("mine")
    with pytest.raises(SceneError, match="out: already exists and is not empty; give another folder with --output"):
        made(opened(room, tmp_path / "out"))
    (tmp_path / "out/notes.txt").unlink()
    StagedJob(tmp_path / "out", "/elsewhere").open()
    with pytest.raises(SceneError, match="out: holds an import of /elsewhere; give another folder"):
        made(opened(room, tmp_path / "out"))
    (tmp_path / "out" / RECORD).write_text("{")
    with pytest.raises(SceneError, match=f"{RECORD}: is not the record of an import from photographs"):
        made(opened(room, tmp_path / "out"))


def test_two_imports_into_one_folder_at_a_time_are_refused_and_the_first_goes_on(room, tmp_path, monkeypatch, capsys):
    skip_stages(monkeypatch)
    job = opened(room, tmp_path / "out")
    codes = []

    def second(_):
        codes.append(exit_code(room, "--output", tmp_path / "out", "--hold-out", 0))

    job.run(lambda number: nullcontext(lambda part: None), second)
    errors = set(capsys.readouterr().err.splitlines())
    assert set(codes) == {1} and errors == {
        f"gibson-sim: error: {tmp_path}/out: another import is being made in the folder; wait until it ends, or give another folder with --output"
    }
    assert all(made(job).values())


def test_options_of_photographs_are_refused_for_other_sources(tmp_path, capsys):
    write_mesh(tmp_path / "shop.ply")
    assert exit_code(tmp_path / "shop.ply", "--triangles", 9, "--output", tmp_path / "out") == 1
    assert "--triangles: is for a folder of photographs, which" in capsys.readouterr().err


def test_several_refused_options_are_a_plural(tmp_path, capsys):
    write_mesh(tmp_path / "shop.ply")
    assert exit_code(tmp_path / "shop.ply", "--triangles", 9, "--voxel", 0.1, "--output", tmp_path / "out") == 1
    assert "--voxel, --triangles: are for a folder of photographs, which" in (text := capsys.readouterr().err)
    assert text.rstrip().endswith("leave them out")


def test_photographs_without_poses_beside_a_mesh_are_named(tmp_path, capsys):
    folder = tmp_path / "phone"
    folder.mkdir()
    write_mesh(folder / "mesh.ply")
    for number in range(6):
        cv2.imwrite(str(folder / f"IMG_{number}.jpg"), room_image(room_poses()[number])[0])
    assert exit_code(folder, "--hold-out", 5, "--output", tmp_path / "out") == 1
    assert "--hold-out: is for photographs with poses, but the 6 photographs in " in capsys.readouterr().err
    assert exit_code(folder, "--output", tmp_path / "out") == 0
    assert f"warning: 6 photographs in {folder} have no poses and are not used; COLMAP finds them" in capsys.readouterr().err


def test_the_next_command_is_quoted(tmp_path, capsys):
    folder = tmp_path / "my room"
    folder.mkdir()
    write_mesh(folder / "mesh.ply")
    assert exit_code(folder / "mesh.ply", "--output", tmp_path / "the scene") == 0
    assert (
        f"next: gibson-sim scene check '{tmp_path}/the scene'; gibson-sim run --scene '{tmp_path}/the scene'"
        in capsys.readouterr().out
    )


def test_a_bag_is_refused_with_the_command_that_exports_photographs(tmp_path, capsys):
    (tmp_path / "metadata.yaml").write_text("rosbag2_bagfile_information:")
    assert exit_code(tmp_path, "--output", tmp_path / "out") == 1
    assert "is a bag; make photographs with poses of it first: gibson-sim export " in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("--hold-out", "-1"), "--hold-out -1: must be 0, or 2 or more"),
        (("--fill", "bogus"), "--fill is 'bogus', must be none, push_pull, learned or"),
        (("--fill", "push_pull,depth"), "--fill push_pull,depth: only colours are compared"),
        (("--depth-scale", "0"), "--depth-scale 0: must be a number above 0"),
        (("--unit", "0"), "--unit 0: must be one of m, cm, mm"),
    ],
)
def test_options_are_named_as_they_were_given(room, tmp_path, capsys, words, message):
    assert exit_code(room, *words, "--output", tmp_path / "out") == 1
    assert message in capsys.readouterr().err


def test_a_convention_of_worlds_needs_a_mesh(tmp_path, capsys):
    assert exit_code(write_rgbd(tmp_path / "scan"), "--pose-convention", "y-up", "--output", tmp_path / "out") == 1
    assert (
        "--pose-convention y-up: is for photographs with a mesh; without one, give as-read, auto, opencv"
        in capsys.readouterr().err
    )


@pytest.mark.parametrize(
    ("name", "image", "message"),
    [
        (
            "color/000003.png",
            np.zeros((24, 32, 3), np.uint8),
            "has 32x24 pixels, its camera 64x48; give photographs of the size that was posed",
        ),
        ("depth/000003.png", np.zeros((48, 64), np.uint8), "has 8 bits and 1 channel; depth must be 16 bit with one channel"),
        ("depth/000003.png", np.zeros((48, 64, 3), np.uint16), "has 16 bits and 3 channels; depth must be 16 bit"),
        ("depth/000003.png", np.zeros((24, 32), np.uint16), "has 32x24 pixels, the intrinsics are for 64x48"),
    ],
)
def test_images_of_another_size_or_depth_are_named_in_the_first_stage(tmp_path, name, image, message):
    folder = write_rgbd(tmp_path / "scan")
    cv2.imwrite(str(folder / name), image)
    with pytest.raises(ScanError, match=f"{name}: {message}"):
        opened(folder, tmp_path / "out")._check_images(lambda part: None)


def test_depth_of_lower_resolution_must_have_the_aspect_ratio_of_its_photograph(tmp_path):
    folder = write_polycam(tmp_path / "phone")
    assert opened(folder, tmp_path / "out")._check_images(lambda part: None)[0].startswith("24 images are whole")
    cv2.imwrite(str(folder / "keyframes/depth/3.png"), np.zeros((24, 24), np.uint16))
    with pytest.raises(ScanError, match=r"3.png: has 24x24 pixels, its photograph 64x48; both must show the same"):
        opened(folder, tmp_path / "out")._check_images(lambda part: None)


def test_an_interrupted_import_says_that_it_resumes(room, tmp_path, monkeypatch, capsys):
    def interrupted(self, progress):
        raise KeyboardInterrupt

    monkeypatch.setattr(PhotographImport, "_load_mesh", interrupted)
    assert exit_code(room, "--output", tmp_path / "out", "--hold-out", 0) == 130
    assert capsys.readouterr().err.splitlines()[-1] == "interrupted; the same command resumes"
