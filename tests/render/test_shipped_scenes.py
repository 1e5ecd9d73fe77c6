"""Every shipped scene loads, can be driven in, and is drawn."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gibson_sim.maps.placement import populate
from gibson_sim.physics.world import PhysicsWorld
from gibson_sim.render.culling.closed_surfaces import NearPlaneTest
from gibson_sim.render.renderer import Renderer, RenderOptions
from gibson_sim.scenes.spec import drawn_scene
from gibson_sim.types import VelocityCommand
from gibson_sim_tools.making.planning.shipped import SHIPPED

pytestmark = [pytest.mark.egl, pytest.mark.usefixtures("egl")]
FOLDER = Path(__file__).resolve().parents[2] / "scenes"
SCENES = sorted(path.parent.name for path in FOLDER.glob("*/scene.yaml"))
STRUCTURE = {"floor", "wall"}


def test_all_designs_are_shipped() -> None:
    assert {design.name for design in SHIPPED} <= set(SCENES)


@pytest.mark.parametrize("name", SCENES)
def test_a_scene_loads_drives_and_is_drawn(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    scene = populate(str(FOLDER / name), "gibson_bot", "")
    assert not scene.warnings
    with PhysicsWorld(scene, step_hz=240) as world:
        robot = scene.robots[0].name
        yaws = []
        for _ in range(120):
            world.command(robot, VelocityCommand((0.0, 0.0, 0.0), (0.0, 0.0, 1.0), world.stamp_ns))
            world.step()
            yaws.append(world.odometry(robot).yaw)
        assert yaws[-1] - yaws[0] > 0.2, "it turns on the spot"
        state = world.state()
        drawn = drawn_scene(world.scene, world.links)
    camera = replace(drawn.cameras[0], width=160, height=120, outputs=("rgb", "depth", "semantic"))
    # Without levels of detail, which take long to make.
    with Renderer(drawn, options=RenderOptions(detail_px=0)) as renderer:
        frame = renderer.render(state, [camera])[0]
        monkeypatch.setattr(NearPlaneTest, "touches", lambda *_: True)  # closed surfaces are drawn with their back faces
        with_all_sides = renderer.render(state, [camera])[0]
    assert frame.rgb is not None and frame.depth is not None and frame.semantic is not None
    assert frame.rgb.std() > 15
    classes = {drawn.semantic_classes[k] for k in np.unique(frame.semantic).tolist() if k}
    assert classes & STRUCTURE
    near = frame.depth[np.isfinite(frame.depth)]
    assert 0.05 < np.median(near) < 20.0
    assert len(near) > 0.5 * frame.depth.size
    np.testing.assert_allclose(frame.depth, with_all_sides.depth, rtol=0.01)
    assert (frame.rgb == with_all_sides.rgb).mean() > 0.99, "edges at most"
