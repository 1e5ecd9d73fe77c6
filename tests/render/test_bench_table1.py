"""The paper's table in process, with few frames: the results are plausible."""

from __future__ import annotations

from pathlib import Path

import pytest

from gibson_sim_bench.protocol import Table1Plan, write_robot
from gibson_sim_bench.reports.paper import FILLED, MODES, SENSOR_ONLY
from gibson_sim_bench.rows import BULLET, COPY, HOST, OPENGL, TENSOR
from gibson_sim_bench.table1 import measure

pytestmark = pytest.mark.egl


@pytest.mark.usefixtures("egl")
def test_every_mode_is_measured_to_the_host_and_with_images_to_tensors(tmp_path: Path) -> None:
    plan = Table1Plan(scene="arena", substeps=(2,), frames=2, sensor_frames=2, parts=("in process",))
    report = measure(plan, write_robot(tmp_path, (256, 256)))
    assert sorted(row.mode for row in report.rows if row.to == HOST) == sorted(mode.name for mode in MODES)
    assert sorted(row.mode for row in report.rows if row.to == TENSOR) == sorted(mode.name for mode in MODES if mode.outputs)
    for row in report.rows:
        assert (row.substeps, row.width, row.triangles > 0) == (2, 256, True)
        parts = {BULLET} if row.mode == SENSOR_ONLY else {BULLET, OPENGL, COPY}
        assert set(row.bounds) == parts
        assert all(value > 0.0 for value in row.bounds.values())
        assert row.fps > 0.0
    with_images = [row for row in report.rows if row.to == HOST and row.mode != SENSOR_ONLY]
    assert all(
        row.stages["draw"] + row.stages.get("fill", 0.0) >= row.bounds[OPENGL] and row.stages["step"] >= row.bounds[BULLET]
        for row in with_images
    )
    assert [row.mode for row in report.rows if row.stages.get("fill", 0.0) > 0.0] == [FILLED]
    assert report.facts.gpu
