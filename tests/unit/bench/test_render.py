"""The benchmark of renderers: rounds, ratios, text and JSON, from numbers made by hand."""

from __future__ import annotations

import argparse
import json
import math
import sys
from pathlib import Path

import numpy as np
import pytest

from gibson_sim.errors import ConfigError
from gibson_sim_bench import render
from gibson_sim_bench.cli import bench as cli, peers as bench_peers
from gibson_sim_bench.render import RenderPlan, RenderReport, RenderRow, growth, peer_ratios, rounds
from gibson_sim_bench.reports.render import report_text, table
from gibson_sim_bench.scenes.bench_scenes import parse_count, path_along
from gibson_sim_bench.timing import FIVE
from gibson_sim_bench.workers import Worker, WorkerError

RGB_DEPTH = ("rgb", "depth")


def _row(scene: str, triangles: int, outputs: tuple[str, ...], contestant: str, fps: float) -> RenderRow:
    return RenderRow(
        scene, triangles, 256, 256, outputs, contestant, fps, fps / 2, fps * 2, 1234 if contestant == "Gibson Sim" else 0
    )


ROWS = (
    _row("rooms:100k", 100_000, FIVE, "Gibson Sim", 120.0),
    _row("rooms:100k", 100_000, ("rgb",), "MuJoCo", 200.0),
    _row("rooms:100k", 100_000, RGB_DEPTH, "MuJoCo", 40.0),
    _row("rooms:100k", 100_000, RGB_DEPTH, "pyrender", 30.0),
    _row("rooms:1m", 1_000_000, FIVE, "Gibson Sim", 80.0),
    _row("rooms:1m", 1_000_000, RGB_DEPTH, "MuJoCo", 8.0),
    _row("rooms:1m", 1_000_000, (*RGB_DEPTH, "semantic"), "PyBullet EGL", 10.0),
)
REPORT = RenderReport(
    "2026-01-02T03:04:05+00:00", "0.1.0 (abc)", "x86_64, 2 x CPU", 2, 0.25, {"Gibson Sim": {"renderer": "llvmpipe"}}, 60.0, 30, ROWS,
    ("MuJoCo: ModuleNotFoundError: No module named 'mujoco'",),
)  # fmt: skip


def test_five_outputs_are_compared_with_the_quickest_peer_that_gives_rgb_and_depth() -> None:
    found = [(a.scene, a.peer, a.ratio) for a in peer_ratios(ROWS)]
    assert found == [("rooms:100k", "MuJoCo", 3.0), ("rooms:1m", "PyBullet EGL", 8.0)]


def test_without_peers_there_are_no_ratios() -> None:
    assert peer_ratios([row for row in ROWS if row.contestant == "Gibson Sim"]) == []


def test_growth_is_time_of_the_largest_rooms_over_time_of_the_smallest() -> None:
    assert [(row.contestant, times) for row, times in growth(ROWS)] == [("Gibson Sim", 1.5), ("MuJoCo", 5.0)]


def test_every_image_has_its_turn_once_and_the_warm_up_comes_before() -> None:
    poses = [[float(k)] for k in range(13)]
    first, *others = rounds(poses)
    assert [pose for part in others for pose in part] == poses
    assert (len(others), first) == (6, others[-1])


def test_fewer_images_than_rounds_are_fewer_rounds() -> None:
    assert list(rounds([[0.0], [1.0]])) == [[[1.0]], [[0.0]], [[1.0]]]


def test_the_text_names_machine_driver_date_and_omitted_peers() -> None:
    text = report_text(REPORT, show_growth=True)
    parts = ("2 x CPU", "llvmpipe", "2026-01-02", "abc", "load 0.25", "Left out: MuJoCo: ModuleNotFoundError")
    assert [part for part in parts if part not in text] == []
    lines = [" ".join(line.split()) for line in text.splitlines()]
    assert "rooms:100k 100,000 256x256 Gibson Sim rgb+depth+sem+inst+normal 120.0 60.0 240.0 1,234" in lines


def test_markdown_has_one_row_for_each_case() -> None:
    lines = report_text(REPORT, markdown=True).splitlines()
    assert "| rooms:1m | 1,000,000 | 256x256 | MuJoCo | rgb+depth | 8.0 | 4.0 | 16.0 | - |" in lines


def test_columns_stand_below_each_other() -> None:
    assert table(("a", "bb"), [("xyz", "1")], markdown=False) == "a    bb\nxyz   1"


def test_json_holds_every_row_and_the_ratios() -> None:
    read = json.loads(json.dumps(REPORT.as_json()))
    assert set(read) == {
        "date", "version", "machine", "cores", "load", "contestants", "fov_y_deg", "frames", "rows", "left_out", "against_peers",
        "kind", "figures",
    }  # fmt: skip
    assert read["rows"][0] == {
        "scene": "rooms:100k", "triangles": 100_000, "width": 256, "height": 256, "outputs": list(FIVE),
        "contestant": "Gibson Sim", "fps": 120.0, "p5": 60.0, "p95": 240.0, "drawn": 1234,
    }  # fmt: skip
    assert read["against_peers"][1]["ratio"] == 8.0


@pytest.mark.parametrize(("text", "count"), [("100k", 100_000), ("1m", 1_000_000), ("1.5M", 1_500_000), ("20000", 20_000)])
def test_numbers_of_triangles(text: str, count: int) -> None:
    assert parse_count(text) == count


@pytest.mark.parametrize("text", ["", "k", "-5k", "lots", "30m"])
def test_other_numbers_of_triangles_are_refused(text: str) -> None:
    with pytest.raises(ConfigError, match="such as rooms:500k"):
        parse_count(text)


def test_the_camera_looks_along_its_way_with_its_top_up() -> None:
    first, *_, last = path_along(np.array([[0.0, 0.0], [0.0, 4.0]]), 1.2, 3)
    # Columns of the optical frame: right = +x, down = -z, forward = +y.
    np.testing.assert_allclose(first[:3, :3], [[1, 0, 0], [0, 0, 1], [0, -1, 0]], atol=1e-12)
    np.testing.assert_allclose(first[:3, 3], [0, 0, 1.2])
    np.testing.assert_allclose(last[:3, 3], [0, 3.5, 1.2])


def _plan(*words: str) -> RenderPlan:
    parser = argparse.ArgumentParser()
    cli.add_parser(parser.add_subparsers())
    plan = cli.plan_of(parser.parse_args(["bench", "render", *words]))
    assert isinstance(plan, RenderPlan)
    return plan


def test_the_command_line_alone_is_the_plan_alone() -> None:
    assert _plan() == RenderPlan()


def test_the_plan_follows_the_command_line() -> None:
    plan = _plan("--scenes", "rooms:100k,flat", "--sizes", "64x48", "--outputs", "rgb", "rgb,flow", "--frames", "6", "--detail-px",
                 "0.5,0", "--device", "1")  # fmt: skip
    assert (plan.scenes, plan.sizes, plan.outputs) == (("rooms:100k", "flat"), ((64, 48),), (("rgb",), ("rgb", "flow")))
    assert (plan.frames, plan.detail_px, plan.device, plan.peers) == (6, (0.5, 0.0), 1, False)


def test_peers_are_measured_on_scan_like_meshes_at_the_image_sizes_of_the_paper() -> None:
    parser = argparse.ArgumentParser()
    bench_peers.add_parser(parser.add_subparsers())
    plan = bench_peers.plan_of(parser.parse_args(["peers", "--peer-python", "python9", "--frames", "6"]))
    assert (plan.peers, plan.peer_pythons, plan.frames, plan.sizes) == (True, ("python9",), 6, ((256, 256), (640, 480)))
    assert all(scene.startswith("scan:") for scene in plan.scenes)


@pytest.mark.parametrize(
    "words", [("--sizes", "64"), ("--outputs", "colour"), ("--frames", "0"), ("--detail-px", "-1"), ("--detail-px", "x")]
)
def test_an_impossible_plan_is_refused(words: tuple[str, str]) -> None:
    with pytest.raises(ConfigError, match=words[0]):
        _plan(*words)


def test_a_worker_that_cannot_start_its_renderer_fails_in_one_line() -> None:
    with Worker("gibson_sim_bench.peers") as worker, pytest.raises(WorkerError, match="KeyError: 'none'"):
        worker.request("open", renderer="none")


def test_a_worker_whose_process_is_gone_is_an_error() -> None:
    with Worker("gibson_sim_bench.not_there") as worker, pytest.raises(WorkerError, match="ended with code 1"):
        worker.request("open", renderer="none")


def test_a_missing_interpreter_is_an_error_of_the_worker() -> None:
    with pytest.raises(WorkerError, match="no_such_python cannot be run"):
        Worker("gibson_sim_bench.peers", "/no_such_python")


def test_missing_peers_are_lines_and_not_errors(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    # An interpreter without any package but those of Python, so without NumPy too.
    python = tmp_path / "python"
    python.write_text(f'#!/bin/sh\nexec "{sys.executable}" -S "$@"\n', encoding="utf-8")
    python.chmod(0o755)
    found = _measure(monkeypatch, RenderPlan(scenes=("rooms:5k",), sizes=((64, 64),), peers=True, peer_pythons=(str(python),)))
    assert [line.split(":")[0] for line in found.left_out] == [peer.name for peer in render.PEERS]
    assert {row.contestant for row in found.rows} == {"Gibson Sim"}


def _measure(monkeypatch: pytest.MonkeyPatch, plan: RenderPlan) -> RenderReport:
    """Measures with workers that do not render, except for the peers."""

    class Still:
        def __init__(self, module: str, python: str = "") -> None:
            self._real = Worker(module, python) if module.endswith("peers") else None

        def request(self, command: str, **values: object) -> object:
            if self._real is not None:
                return self._real.request(command, **values)
            poses = values.get("poses")
            if isinstance(poses, list):
                return [0.01] * len(poses), [7] * len(poses)
            return {"renderer": "none", "triangles": "5000"}

        def close(self) -> None:
            if self._real is not None:
                self._real.close()

        def __enter__(self) -> Still:
            return self

        def __exit__(self, *_: object) -> None:
            self.close()

    scene = render.BenchScene("rooms:5k", Path("nowhere"), 5000)
    monkeypatch.setattr(render, "Worker", Still)
    monkeypatch.setattr(render, "bench_scene", lambda name: scene)
    monkeypatch.setattr(render, "export_for_peers", lambda scene: Path("nowhere"))
    return render.measure(plan)


def test_times_of_a_hundredth_of_a_second_are_a_hundred_images_a_second(monkeypatch: pytest.MonkeyPatch) -> None:
    found = _measure(monkeypatch, RenderPlan(scenes=("rooms:5k",), sizes=((64, 64),), outputs=(("rgb",),), frames=6))
    (row,) = found.rows
    assert (row.fps, row.p5, row.p95, row.drawn, row.triangles) == (100.0, 100.0, 100.0, 7, 5000)


def test_fields_of_view_are_vertical_and_in_radians() -> None:
    assert math.degrees(render.FOV_Y) == pytest.approx(60.0)
