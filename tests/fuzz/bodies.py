"""What can be spawned: URDF and SDF models, by file and as text, and robots with their sensors."""

from __future__ import annotations

import json
from pathlib import Path

from fuzz import seeds
from fuzz.grammar import SECRET_NUMBER, Mutator
from fuzz.live import live, simulator
from fuzz.trial import Trial
from gibson_sim.standard.population import SpawnRequest


def make(mutator: Mutator, folder: Path) -> None:
    """Writes a URDF or an SDF model."""
    seeds.mesh_files(folder)
    kind = mutator.rng.choice(("thing", "object", "sdf"))
    text = (
        seeds.THING
        if kind == "thing"
        else seeds.object_urdf(mutator.rng.choice(seeds.OBJECTS))
        if kind == "object"
        else f'<sdf version="1.7">{seeds.SDF_MODEL}</sdf>'
    )
    for _ in range(mutator.times()):
        text = mutator.xml(text)
    name = "body.sdf" if kind == "sdf" else "body.urdf"
    (folder / name).write_bytes(mutator.file_text(text))
    position = [0.5, 0.0, 0.5]
    quat = [0.0, 0.0, 0.0, 1.0]
    if mutator.times() > 2:
        position = [float(mutator.number(x)) for x in position]
        quat = [float(mutator.number(x)) for x in quat]
        length = sum(x * x for x in quat) ** 0.5
        # What the client itself wrote is no secret.
        position, quat = ([1.0 if x == SECRET_NUMBER else x for x in values] for values in (position, quat))
        quat = quat if mutator.harsh or not length else [x / length for x in quat]
    case = {
        "file": name,
        "text": mutator.chance(0.25),
        "position": position,
        "quat": quat,
        "name": mutator.rng.choice(("", "x", "x")),
    }
    (folder / "case.json").write_text(json.dumps(case))


def run(folder: Path, trial: Trial) -> None:
    """Spawns it and lives with it."""
    case = json.loads((folder / "case.json").read_text())
    path = folder / case["file"]
    text = path.read_text(errors="replace") if case["text"] else ""
    request = SpawnRequest(
        name=case["name"],
        uri="" if case["text"] else str(path),
        text=text,
        position=tuple(case["position"]),
        quat_xyzw=tuple(case["quat"]),
    )
    with simulator() as made:
        trial.call("spawn", made.population.spawn, request, secret=not case["text"])
        trial.reach("loaded")
        live(trial, made)


def make_robot(mutator: Mutator, folder: Path) -> None:
    """Writes a robot.yaml and its URDF."""
    name = mutator.rng.choice(seeds.ROBOTS)
    document, text = seeds.robot_document(name), seeds.robot_urdf(name)
    for _ in range(mutator.times()):
        if mutator.chance(0.65):
            document = mutator.tree(document)
        else:
            text = mutator.xml(text)
    (folder / "robot.yaml").write_bytes(mutator.file_text(seeds.yaml_text(document)))
    (folder / "robot.urdf").write_bytes(mutator.file_text(text))


def run_robot(folder: Path, trial: Trial) -> None:
    """Spawns the robot, drives it and lets its sensors measure."""
    request = SpawnRequest(name="robot", uri=str(folder / "robot.yaml"), position=(0.0, 0.0, 0.0))
    with simulator() as made:
        trial.call("spawn", made.population.spawn, request, secret=True)
        trial.reach("loaded")
        live(trial, made)
