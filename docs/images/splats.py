"""Makes splats.jpg, a room as mesh and as Gaussian splats, with a robot and through a fisheye, and prints what pictures cost.

python docs/images/splats.py [FILE.jpg]

The splats are made from the scene's own surfaces: half a million on all that the flat has.
"""

from __future__ import annotations

import math
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np

from gibson_sim.formats.splats import splats_ply
from gibson_sim.geometry.transforms import camera_pose
from gibson_sim.maps.placement import populate
from gibson_sim.physics.world import PhysicsWorld
from gibson_sim.render.renderer import MeshFiles, Renderer
from gibson_sim.scenes.scene_meshes import scene_roots
from gibson_sim.scenes.spec import SplatsSpec, drawn_scene
from gibson_sim.types import CameraSpec, SceneState
from gibson_sim_tools.making.splats import splats_of_scene

SCENE, SPLATS, REPEATS = "courtyard_flat", 500_000, 5
VIEW = CameraSpec("view", "", camera_pose((3.7, 11.3, 1.2), (8.0, 10.4, 0.5)), 640, 480, math.radians(60.0))
FISHEYE = replace(VIEW, projection="fisheye", fov=math.radians(180.0), width=480)
CORRIDOR = replace(VIEW, pose=camera_pose((3.96, 5.9, 0.5), (3.96, 9.0, 0.5)))
STUDY = replace(VIEW, pose=camera_pose((2.1, 5.5, 1.2), (0.3, 3.8, 0.3)))


def main() -> None:
    """Writes the picture."""
    path = Path(sys.argv[1] if len(sys.argv) > 1 else Path(__file__).with_name("splats.jpg"))
    spec = populate(SCENE, "gibson_bot", start="living_room")
    world = PhysicsWorld(spec)
    state = world.state()
    world.close()
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "splats.ply"
        splats = splats_of_scene(spec, SPLATS, np.random.default_rng(0))
        file.write_bytes(splats_ply(splats))
        roots = (*scene_roots(spec), Path(folder))
        with Renderer(drawn_scene(spec, state.links), meshes=MeshFiles(allowed_roots=roots)) as renderer:
            rows = [[renderer.render(state, [camera])[0].rgb for camera in (VIEW, FISHEYE)]]
            _report("mesh", renderer, state)
        began = time.process_time()
        drawn = drawn_scene(replace(spec, splats=SplatsSpec(str(file))), state.links)
        with Renderer(drawn, meshes=MeshFiles(allowed_roots=roots)) as renderer:
            print(f"{len(splats)} splats loaded with the scene in {time.process_time() - began:.1f} s of processor time")
            rows.append([renderer.render(state, [camera])[0].rgb for camera in (VIEW, FISHEYE)])
            _report("splats", renderer, state)
    sheet = np.vstack([np.hstack([picture for picture in row if picture is not None]) for row in rows])
    cv2.imwrite(str(path), cv2.cvtColor(sheet, cv2.COLOR_RGB2BGR), [cv2.IMWRITE_JPEG_QUALITY, 85])


def _report(what: str, renderer: Renderer, state: SceneState) -> None:
    """Prints the least processor time and the least wall time of a picture of each view."""
    for name, camera in (("living room", VIEW), ("corridor", CORRIDOR), ("study", STUDY)):
        renderer.render(state, [camera])
        used, waited = [], []
        for _ in range(REPEATS):
            began = time.process_time(), time.perf_counter()
            renderer.render(state, [camera])
            used.append(time.process_time() - began[0])
            waited.append(time.perf_counter() - began[1])
        print(
            f"{what}, {name}: {1e3 * min(used):.0f} ms of processor time, {1e3 * min(waited):.0f} ms of wall time, "
            f"{renderer.drawn_splats} splats drawn"
        )


if __name__ == "__main__":
    main()
