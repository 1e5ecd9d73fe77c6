"""The report on tensors says where they were, and holds what a reader must know."""

from __future__ import annotations

import json

from gibson_sim.types import OUTPUTS
from gibson_sim_bench.tensors import TensorCase, TensorReport, _cameras, table

REPORT = TensorReport(
    "2026-01-02T03:04:05+00:00", "x86_64, 2 x CPU", "a GPU", "4.6", "cuda:0", "2.13.0", 1_000_000, 20, 50,
    (TensorCase("tensors", 128, 64, OUTPUTS, 20500.0, 20000.0, 21000.0),),
)  # fmt: skip


def test_the_table_names_machine_driver_date_and_where_the_tensors_are() -> None:
    text = table(REPORT)
    assert all(part in text for part in ("a GPU", "4.6", "2 x CPU", "2026-01-02", "1,000,000 triangles", "on the GPU (cuda:0)"))
    assert f"| tensors | 128 | 64 | {len(OUTPUTS)} | 20,500 | 20,000 | 21,000 |" in text.splitlines()


def test_tensors_on_the_cpu_are_called_so() -> None:
    cpu = TensorReport(**{**{name: getattr(REPORT, name) for name in TensorReport.__slots__}, "tensors_on": "cpu"})
    assert "on the CPU: there is no CUDA here" in table(cpu)


def test_the_report_becomes_json_with_every_case() -> None:
    read = json.loads(json.dumps(REPORT.as_json()))
    assert (read["tensors_on"], read["cases"][0]["median"], read["cases"][0]["outputs"]) == ("cuda:0", 20500.0, list(OUTPUTS))


def test_views_are_apart_and_move_from_call_to_call() -> None:
    cameras = _cameras(128, 4, ("rgb",), 3)
    assert [len(call) for call in cameras] == [4, 4, 4]
    poses = {camera.pose for call in cameras for camera in call}
    assert len(poses) >= 4
    assert len({camera.pose for camera in cameras[0]}) == 4
    assert cameras[0][0].pose != cameras[1][0].pose
