"""MJCF (MuJoCo) is refused in one line."""

from __future__ import annotations

from pathlib import Path

import pytest

from conformance.rules import rule
from gibson_sim.description.urdf import read_urdf
from gibson_sim.errors import GibsonSimError


@rule("MJCF", "<mujoco>", "refused", "MJCF is not read; convert it to URDF or SDF")
def test_mjcf_is_refused_in_one_line(tmp_path: Path) -> None:
    (tmp_path / "robot.xml").write_text('<mujoco model="m"><worldbody><geom type="sphere" size="0.1"/></worldbody></mujoco>')
    with pytest.raises(GibsonSimError) as caught:
        read_urdf(tmp_path / "robot.xml")
    assert "\n" not in str(caught.value)
    assert "MJCF" in str(caught.value)
