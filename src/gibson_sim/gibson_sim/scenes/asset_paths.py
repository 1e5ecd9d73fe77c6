"""Maps the paths in a ``DrawnScene`` that was loaded on another machine, the physics node's, to files on this one.

A path that exists is kept. Otherwise it is mapped by the user's table of folders or, if that has no match, by a part ``scenes/<name>/``,
``robots/<name>/`` or ``objects/<name>/`` whose name is known here (``resources``).
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path, PurePosixPath

from gibson_sim.description.shapes import VisualSpec
from gibson_sim.errors import GibsonSimError, SceneNotFoundError
from gibson_sim.quoting import quoted
from gibson_sim.reading import exists, is_folder
from gibson_sim.resources import find_robot, find_scene, share_folders
from gibson_sim.scenes.load import load_scene
from gibson_sim.scenes.spec import DrawnScene

_KINDS = ("scenes", "robots", "objects")


def with_local_files(scene: DrawnScene, folders: Sequence[tuple[str, str]] = ()) -> tuple[DrawnScene, tuple[str, ...]]:
    """Returns the scene with paths of this machine, and warnings, one line each.

    Args:
        scene: the scene as it was received.
        folders: pairs of a folder on the other machine and the same folder on this one.

    Raises:
        SceneNotFoundError: a file is not found on this machine.
    """
    found: dict[str, str] = {}

    def local(path: str) -> str:
        if path and path not in found:
            found[path] = path if exists(Path(path)) else str(_located(path, folders))
        return found[path] if path else path

    visuals = tuple(_with_files(visual, local(visual.shape.mesh), local(_pattern_image(visual))) for visual in scene.visuals)
    light = replace(scene.light, environment=local(scene.light.environment), backdrop=local(scene.light.backdrop))
    splats = None if scene.splats is None else replace(scene.splats, file=local(scene.splats.file))
    cameras = tuple(replace(c, fill=local(c.fill)) if c.fill.endswith(".onnx") else c for c in scene.cameras)
    if all(there == here for there, here in found.items()):
        return scene, ()
    moved = replace(scene, visuals=visuals, light=light, splats=splats, cameras=cameras)
    return moved, _difference(scene, found)


def _pattern_image(visual: VisualSpec) -> str:
    """Returns the path of the image in a visual's pattern, "" if it has none."""
    return visual.appearance.pattern.image if visual.appearance is not None and visual.appearance.pattern is not None else ""


def _with_files(visual: VisualSpec, mesh: str, image: str) -> VisualSpec:
    appearance = visual.appearance
    if appearance is not None and appearance.pattern is not None and image:
        appearance = replace(appearance, pattern=replace(appearance.pattern, image=image))
    return replace(visual, shape=replace(visual.shape, mesh=mesh), appearance=appearance)


def _located(path: str, folders: Sequence[tuple[str, str]]) -> Path:
    """Returns the path on this machine of a file of the other machine."""
    for there, here in folders:
        if PurePosixPath(path).is_relative_to(there):
            candidate = Path(os.path.expanduser(here)) / PurePosixPath(path).relative_to(there)
            if exists(candidate):
                return candidate
    for kind, name, tail in _named(path):
        try:
            folder = _folder(kind, name)
        except GibsonSimError:
            continue
        if exists(folder / tail):
            return folder / tail
    raise SceneNotFoundError(
        f"{path} is a file of the physics node's machine and is not found on this one: map its folder with the setting 'asset_roots' "
        "(from=to), or put the scene into a folder of $GIBSON_SIM_PATH"
    )


def _named(path: str) -> list[tuple[str, str, PurePosixPath]]:
    """Returns kind, name and the rest after them for each part of a path that names a scene, a robot or an object; the last part first."""
    parts = PurePosixPath(path).parts
    return [
        (parts[k], parts[k + 1], PurePosixPath(*parts[k + 2 :])) for k in reversed(range(len(parts) - 2)) if parts[k] in _KINDS
    ]


def _folder(kind: str, name: str) -> Path:
    if kind == "objects":
        return next((share / kind / name for share in share_folders() if exists(share / kind / name)), Path(name))
    found = find_scene(name) if kind == "scenes" else find_robot(name)
    return found if is_folder(found) else found.parent


def _difference(scene: DrawnScene, found: dict[str, str]) -> tuple[str, ...]:
    """Returns a warning if the scene on this machine has another digest than that of the physics node."""
    # A randomised scene has a digest of its own, which cannot be computed here.
    if not scene.content_hash or any(visual.appearance is not None for visual in scene.visuals):
        return ()
    for there, here in found.items():
        name = next((name for kind, name, _ in _named(there) if kind == "scenes"), "")
        if there == here or not name:
            continue
        try:
            same = load_scene(name).content_hash == scene.content_hash
        except GibsonSimError as error:
            return (f"{here} stands for {there}, but scene {quoted(name)} cannot be compared: {error}",)
        return (
            ()
            if same
            else (f"{here} stands for {there}, but scene {quoted(name)} differs between the two machines: pictures may be wrong",)
        )
    return ()
