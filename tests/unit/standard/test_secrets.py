"""The contents of a file that a client names never appear in a response, whatever is wrong with it; the log has them."""

from __future__ import annotations

import logging
import struct
from collections.abc import Iterator
from pathlib import Path

import pytest

from gibson_sim.config import PhysicsConfig
from gibson_sim.standard.codes import SimulationError
from gibson_sim.standard.population import SpawnRequest
from gibson_sim.standard.requests import LoadRequest
from gibson_sim.standard.simulator import Simulator

SECRET = "hunter2"
_GLB = struct.pack("<4sII", SECRET[:4].encode(), 2, 12)
FILES: dict[str, bytes] = {
    "robot.yaml": f"{SECRET}: 1\n".encode(),
    "value.yaml": f"urdf: [{SECRET}]\n".encode(),
    "none.yaml": f"urdf: {SECRET}.urdf\n".encode(),
    "broken.yaml": f"a: [{SECRET}\n".encode(),
    "tag.yaml": f"a: !{SECRET} 1\n".encode(),
    "tag.urdf": f"<{SECRET}/>".encode(),
    "link.urdf": f'<robot name="r"><link name="{SECRET}"/><link name="b"/></robot>'.encode(),
    "number.urdf": f'<robot name="r"><link name="a"><inertial><mass value="{SECRET}"/></inertial></link></robot>'.encode(),
    "mesh.urdf": f'<robot name="r"><link name="a"><visual><geometry><mesh filename="{SECRET}.obj"/></geometry></visual></link></robot>'.encode(),
    "broken.urdf": f"<robot><{SECRET}></robot>".encode(),
    "name.urdf": f'<robot name="{SECRET} x"><link name="a"/></robot>'.encode(),
    "text.urdf": f"{SECRET}:x:0".encode(),
    "broken.sdf": f"<sdf><model name='m'><link name='{SECRET}'><pose>{SECRET}</pose></link></model></sdf>".encode(),
    "include.sdf": f"<sdf version='1.7'><model name='m'><include><uri>model://{SECRET}</uri></include></model></sdf>".encode(),
    "mesh.glb": _GLB,
    "mesh.gltf": f'{{"asset": {{"version": "2.0"}}, "buffers": [{{"uri": "{SECRET}.bin"}}], "{SECRET}"'.encode(),
    "version.gltf": f'{{"asset": {{"version": "{SECRET}"}}}}'.encode(),
    "mesh.obj": f"v {SECRET} 0 0\nf 1 1 1\n".encode(),
    "mesh.ply": f"{SECRET}\n".encode(),
    "mesh.stl": f"solid x\nvertex {SECRET} 0 0\n".encode(),
    "mesh.dae": f"<{SECRET}/>".encode(),
}
WORLDS: dict[str, bytes] = {
    "scene.yaml": f"gravity: [{SECRET}, 0]\n".encode(),
    "key.yaml": f"{SECRET}: 1\n".encode(),
    "broken.yaml": f"a: [{SECRET}\n".encode(),
    "missing.yaml": f"objects: [{{mesh: {SECRET}.obj}}]\n".encode(),
    "shape.yaml": f"objects: [{{name: {SECRET}, box: [1, 1]}}]\n".encode(),
    "a.dmd.yaml": f"directives: [{SECRET}]\n".encode(),
    "a.world": f"<sdf><world name='{SECRET}'><model name='{SECRET}'><pose>{SECRET}</pose></model></world></sdf>".encode(),
    "b.world": f"<{SECRET}/>".encode(),
    "mesh.glb": _GLB,
}


@pytest.fixture
def simulator() -> Iterator[Simulator]:
    made = Simulator(None, PhysicsConfig())
    yield made
    made.close()


@pytest.mark.parametrize("name", FILES)
def test_refused_spawn_reveals_nothing_of_the_file(
    simulator: Simulator, tmp_path: Path, name: str, caplog: pytest.LogCaptureFixture
) -> None:
    (tmp_path / "empty.yaml").write_text("ground_z: 0\n")
    simulator.load_world(LoadRequest(str(tmp_path / "empty.yaml")))
    (tmp_path / name).write_bytes(FILES[name])
    caplog.set_level(logging.WARNING)
    with pytest.raises(SimulationError) as error:
        simulator.population.spawn(SpawnRequest(name="" if name == "name.urdf" else "x", uri=str(tmp_path / name)))
    assert SECRET not in str(error.value)
    assert SECRET[:4] not in str(error.value)


@pytest.mark.parametrize("name", WORLDS)
def test_refused_world_reveals_nothing_of_the_file(simulator: Simulator, tmp_path: Path, name: str) -> None:
    (tmp_path / name).write_bytes(WORLDS[name])
    with pytest.raises(SimulationError) as error:
        simulator.load_world(LoadRequest(str(tmp_path / name)))
    assert SECRET[:4] not in str(error.value)


def test_reply_states_the_allowed_values_and_the_log_the_value_in_the_file(
    simulator: Simulator, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    (tmp_path / "scene.yaml").write_bytes(WORLDS["scene.yaml"])
    with pytest.raises(SimulationError, match="gravity must be a list of 3 numbers"):
        simulator.load_world(LoadRequest(str(tmp_path / "scene.yaml")))
    assert SECRET in caplog.text
