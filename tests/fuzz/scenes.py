"""Scenes: scene.yaml, SDF worlds and Drake directives with the models that they name."""

from __future__ import annotations

import json
from pathlib import Path

from fuzz import seeds
from fuzz.grammar import Mutator
from fuzz.live import live, simulator
from fuzz.meshes import change
from fuzz.trial import Trial
from gibson_sim.standard.catalogue import available_worlds, spawnables
from gibson_sim.standard.filters import TagsFilter
from gibson_sim.standard.requests import LoadRequest


def make(mutator: Mutator, folder: Path) -> None:
    """Writes a scene.yaml with its meshes."""
    seeds.mesh_files(folder)
    document, thing = seeds.scene_document(), seeds.THING
    if mutator.chance(0.7):
        document["light"].pop("environment")
    if mutator.chance(0.5):
        document["light"].pop("points")
    for _ in range(mutator.times()):
        document = mutator.tree(document)
    if mutator.chance(0.15):
        for _ in range(mutator.times()):
            thing = mutator.xml(thing)
    if mutator.chance(0.1):
        change(mutator, folder / mutator.rng.choice(("a.glb", "a.obj", "a.ply", "a.stl")))
    (folder / "thing.urdf").write_bytes(mutator.file_text(thing))
    (folder / "scene.yaml").write_bytes(mutator.file_text(seeds.yaml_text(document)))
    (folder / "case.json").write_text(json.dumps({"file": "scene.yaml"}))


def make_world(mutator: Mutator, folder: Path) -> None:
    """Writes an SDF world, or Drake directives, with models."""
    seeds.mesh_files(folder)
    chair, world, directives = seeds.SDF_CHAIR, seeds.SDF_WORLD, seeds.DIRECTIVES
    drake = mutator.chance(0.25)
    for _ in range(mutator.times()):
        if mutator.chance(0.2):
            chair = mutator.xml(chair)
        elif drake:
            directives = mutator.tree(directives)
        else:
            world = mutator.xml(world)
    (folder / "models" / "chair").mkdir(parents=True)
    (folder / "models" / "chair" / "model.sdf").write_bytes(mutator.file_text(chair))
    (folder / "models" / "chair" / "model.config").write_text(
        "<model><name>chair</name><sdf version='1.6'>model.sdf</sdf></model>"
    )
    (folder / "package.xml").write_text("<package><name>drake_models</name></package>")
    (folder / "chair.sdf").write_bytes(mutator.file_text(chair))
    name = "a.dmd.yaml" if drake else "a.world"
    (folder / name).write_bytes(mutator.file_text(seeds.yaml_text(directives) if drake else world))
    flags = {"ignore_missing": mutator.chance(0.7), "fail_on_unsupported": mutator.chance(0.2)}
    (folder / "case.json").write_text(json.dumps({"file": name, **flags}))


def run(folder: Path, trial: Trial) -> None:
    """Loads the world, lives in it, and lists what lies in its folder."""
    case = json.loads((folder / "case.json").read_text())
    flags = {"fail_on_unsupported": case.get("fail_on_unsupported", False), "ignore_missing": case.get("ignore_missing", False)}
    request = LoadRequest(str(folder / case["file"]), **flags)
    listed = TagsFilter()
    for name, function in (
        ("get_available_worlds", lambda: available_worlds((str(folder),), listed, continue_on_error=False)),
        ("get_spawnables", lambda: spawnables((str(folder),))),
    ):
        trial.call(name, function, go_on=True, secret=True)
    with simulator(None) as made:
        trial.call("load_world", made.load_world, request, secret=True)
        trial.reach("loaded")
        live(trial, made)
