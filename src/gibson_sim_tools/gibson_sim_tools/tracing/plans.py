"""Finds the plan that a scene was made from, by the command in the first line of its ``scene.yaml``."""

from __future__ import annotations

import itertools
import shlex
from pathlib import Path

import numpy as np

from gibson_sim.errors import GibsonSimError, SceneError
from gibson_sim.formats.load_mesh import MeshLoader
from gibson_sim.reading import is_file, read_file
from gibson_sim.scenes.scene_yaml import DESCRIPTION
from gibson_sim.scenes.spec import DrawnScene
from gibson_sim_tools.making.blender.assembly import objects_of
from gibson_sim_tools.making.building import Building
from gibson_sim_tools.making.planning.planner import KINDS, plan_building

_COMMAND = "# Made by: gibson-sim scene generate "
_MAX_BYTES = 16_000_000
_TOLERANCE_M = 0.005
"""Largest difference between the bounds of an object in the plan and in the scene, m."""


def plan_of_scene(scene: DrawnScene) -> Building | None:
    """Returns the plan of a scene; None for one that ``gibson-sim scene generate`` did not make.

    Raises:
        SceneError: the command in the first line of its ``scene.yaml`` is incomplete or no command.
    """
    folders = dict.fromkeys(Path(v.shape.mesh).parent.parent for v in scene.visuals if v.shape.mesh and not v.link)
    path = next((folder / DESCRIPTION for folder in folders if is_file(folder / DESCRIPTION)), None)
    if path is None:
        return None
    lines = read_file(path, _MAX_BYTES).decode("utf-8", errors="replace").splitlines()
    command = next((line.removeprefix(_COMMAND) for line in lines[:3] if line.startswith(_COMMAND)), None)
    if command is None:
        return None
    try:
        words = shlex.split(command)
    except ValueError as error:
        raise SceneError(f"{path}: its first line is no command: {error}; generate the scene again") from error
    values = {name.removeprefix("--"): value for name, value in itertools.pairwise(words) if name.startswith("--")}
    kind = next((kind for kind in KINDS if kind == values.get("kind")), None)
    if kind is None or not values.get("seed", "").isdigit():
        raise SceneError(f"{path}: its first line names no --kind and --seed of a plan; generate the scene again")
    return plan_building(kind, int(values["seed"]), values.get("name", scene.name))


def check_plan(building: Building, scene: DrawnScene) -> frozenset[str]:
    """Returns the names of the static visuals that are objects of the plan.

    Raises:
        SceneError: an object of the plan is not in the scene, or elsewhere; the scene was then made with another version.
    """
    visuals = {visual.name: visual for visual in scene.visuals if not visual.link}
    loader = MeshLoader(None, textures=False)
    names = set()
    for item in (item for item in objects_of(building) if item.exported):
        points = np.concatenate([part.vertices[part.triangles].reshape(-1, 3) for part in item.solid.parts])
        visual = visuals.get(item.name)
        try:
            bounds = None if visual is None else loader.shape(visual.shape).bounds
        except GibsonSimError:
            bounds = None
        planned = np.array([points.min(axis=0), points.max(axis=0)])
        if bounds is None or np.abs(bounds - planned).max() > _TOLERANCE_M:
            raise SceneError(
                f"scene {scene.name}: {item.name} is not where its plan has it: the scene was made with another version; generate it again"
            )
        names.add(item.name)
    return frozenset(names)
