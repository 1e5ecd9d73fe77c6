"""Meshes: GLB, glTF, OBJ, PLY, STL and COLLADA, spawned and as part of a scene."""

from __future__ import annotations

import json
from pathlib import Path

from fuzz import seeds
from fuzz.grammar import SECRET, Mutator
from fuzz.live import live, simulator
from fuzz.trial import Trial
from gibson_sim.errors import MeshError
from gibson_sim.formats.load_mesh import MeshLoader
from gibson_sim.standard.population import SpawnRequest
from gibson_sim.standard.requests import LoadRequest


def make(mutator: Mutator, folder: Path) -> None:
    """Writes a mesh of some format with one or several changes."""
    seeds.mesh_files(folder)
    name = mutator.rng.choice(seeds.MESHES)
    change(mutator, folder / name)
    (folder / "case.json").write_text(json.dumps({"file": name, "spawn": mutator.chance(0.6)}))
    (folder / "scene.yaml").write_text(f"ground_z: 0\nobjects: [{{mesh: {name}, name: thing}}]\n")


def change(mutator: Mutator, path: Path) -> None:
    """Changes a mesh of the seeds, or what it names."""
    kind, times = path.suffix, mutator.times()
    if times and mutator.chance(0.08):
        image = path.parent / "wood.png"
        image.write_bytes(mutator.data(image.read_bytes()))
    if kind in (".glb", ".gltf"):
        _change_gltf(mutator, path, times)
    elif kind == ".dae":
        text = path.read_text()
        for _ in range(times):
            text = mutator.xml(text)
        path.write_bytes(mutator.file_text(text))
    elif kind == ".obj":
        other = path.with_suffix(".mtl")
        for _ in range(times):
            one = other if mutator.chance(0.2) else path
            one.write_bytes(mutator.lines(one.read_text(errors="surrogateescape")).encode(errors="surrogatepass"))
    elif kind == ".stl":
        data = seeds.stl_bytes(text=mutator.chance(0.4))
        for _ in range(times):
            text = data.startswith(b"solid") and mutator.chance(0.8)
            data = (
                mutator.lines(data.decode(errors="replace")).encode(errors="surrogatepass")
                if text
                else _changed_floats(mutator, data, 84)
            )
        path.write_bytes(data)
    else:
        _change_ply(mutator, path, times)


def _change_gltf(mutator: Mutator, path: Path, times: int) -> None:
    made = seeds.gltf_document()
    document = json.loads(made.text())
    chunk = made.chunk
    if path.suffix == ".glb":
        document["buffers"] = [{"byteLength": len(chunk)}]
    if times and mutator.harsh and mutator.chance(0.05):
        count = mutator.rng.choice((50, 2000, 20000))
        document["nodes"] = [{"children": [k + 1]} for k in range(count)] + [{"mesh": 0}]
    for _ in range(times):
        if mutator.chance(0.25):
            chunk = _changed_floats(mutator, chunk, 0)
        else:
            document = mutator.tree(document)
    if path.suffix == ".gltf":
        path.write_bytes(mutator.file_text(json.dumps(document)))
        return
    data = seeds.glb_of(document, chunk) if isinstance(document, dict) else json.dumps(document).encode()
    path.write_bytes(mutator.data(data) if mutator.harsh and mutator.chance(0.15) else data)


def _changed_floats(mutator: Mutator, data: bytes, start: int) -> bytes:
    """Returns bytes with one 4-byte number changed, or, where harsh, with any change."""
    import struct

    if (mutator.harsh and mutator.chance(0.5)) or len(data) < start + 8:
        return mutator.data(data)
    at = start + 4 * mutator.rng.randrange((len(data) - start) // 4)
    (old,) = struct.unpack_from("<f", data, at)
    try:
        new = struct.pack("<f", mutator.number(float(old)))
    except (OverflowError, struct.error):
        new = struct.pack("<f", float("inf"))
    return data[:at] + new + data[at + 4 :]


def _change_ply(mutator: Mutator, path: Path, times: int) -> None:
    from support.plys import ply

    order = mutator.rng.choice(("", "<", ">"))
    colors = None if mutator.chance(0.3) else [[10, 20, 30]] * len(seeds.CORNERS)
    data = ply(seeds.CORNERS, seeds.FACES, colors, order=order, objects=[1] * len(seeds.FACES) if mutator.chance(0.2) else None)
    head, mark, body = data.partition(b"end_header\n")
    for _ in range(times):
        if order == "" and mutator.chance(0.6):
            body = mutator.lines(body.decode(errors="replace")).encode(errors="surrogatepass")
        elif mutator.harsh and mutator.chance(0.4):
            head = mutator.lines(head.decode(errors="replace")).encode(errors="surrogatepass")
        else:
            body = _changed_floats(mutator, body, 0)
    path.write_bytes(head + mark + body)


def run(folder: Path, trial: Trial) -> None:
    """Spawns the mesh, or loads the scene that has it, lives with it, and looks which files it read."""
    case = json.loads((folder / "case.json").read_text())
    path = folder / case["file"]
    with simulator() as made:
        if case["spawn"]:
            trial.call(
                "spawn", made.population.spawn, SpawnRequest(name="thing", uri=str(path), position=(0.5, 0.0, 0.5)), secret=True
            )
        else:
            trial.call("load_world", made.load_world, LoadRequest(str(folder / "scene.yaml")), secret=True)
        trial.reach("loaded")
        only_own_files(trial, folder, path)
        live(trial, made)


def only_own_files(trial: Trial, folder: Path, path: Path) -> None:
    """Faults a mesh that takes files from elsewhere."""
    try:
        mesh = MeshLoader(None).mesh(path)
    except MeshError:
        return
    for file in mesh.files:
        if not file.resolve().is_relative_to(folder.resolve()):
            trial.fault(f"{path.name} has read {file.name} of another folder")
    for part in mesh.parts:
        texture = part.material.texture
        if texture is not None and SECRET in str(texture):
            trial.fault(f"{path.name} names {texture} as its texture")
