"""Maps the paths in a ``DrawnScene`` that was loaded on the remote machine of the physics node to files on the local machine.

A path that exists locally is kept. Otherwise it is mapped by the user's table of folders or, if that has no match, by a part
``scenes/<name>/``, ``robots/<name>/`` or ``objects/<name>/`` whose name is a local resource (``resources``).
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
    """Returns the scene with local paths, and warnings, one line each.

    Args:
        scene: the received scene.
        folders: pairs of a remote folder and the corresponding local folder.

    Raises:
        SceneNotFoundError: a file does not exist locally.
    """
    local_paths: dict[str, str] = {}

    def local(path: str) -> str:
        if path and path not in local_paths:
            local_paths[path] = path if exists(Path(path)) else str(_find_local(path, folders))
        return local_paths[path] if path else path

    visuals = tuple(_with_files(visual, local(visual.shape.mesh), local(_pattern_image(visual))) for visual in scene.visuals)
    light = replace(scene.light, environment=local(scene.light.environment), backdrop=local(scene.light.backdrop))
    splats = None if scene.splats is None else replace(scene.splats, file=local(scene.splats.file))
    cameras = tuple(replace(c, fill=local(c.fill)) if c.fill.endswith(".onnx") else c for c in scene.cameras)
    if all(remote == local_path for remote, local_path in local_paths.items()):
        return scene, ()
    moved = replace(scene, visuals=visuals, light=light, splats=splats, cameras=cameras)
    return moved, _check_digest(scene, local_paths)


def _pattern_image(visual: VisualSpec) -> str:
    """Returns the path of the image in a visual's pattern, "" if it has none."""
    return visual.appearance.pattern.image if visual.appearance is not None and visual.appearance.pattern is not None else ""


def _with_files(visual: VisualSpec, mesh: str, image: str) -> VisualSpec:
    appearance = visual.appearance
    if appearance is not None and appearance.pattern is not None and image:
        appearance = replace(appearance, pattern=replace(appearance.pattern, image=image))
    return replace(visual, shape=replace(visual.shape, mesh=mesh), appearance=appearance)


def _find_local(path: str, folders: Sequence[tuple[str, str]]) -> Path:
    """Returns the local path of a remote file."""
    for remote, local_folder in folders:
        if PurePosixPath(path).is_relative_to(remote):
            candidate = Path(os.path.expanduser(local_folder)) / PurePosixPath(path).relative_to(remote)
            if exists(candidate):
                return candidate
    for kind, name, tail in _resource_parts(path):
        try:
            folder = _folder(kind, name)
        except GibsonSimError:
            continue
        if exists(folder / tail):
            return folder / tail
    raise SceneNotFoundError(
        f"{path} is a file on the physics node's machine and does not exist on this one: map its folder with the setting 'asset_roots' "
        "(from=to), or put the scene into a folder of $GIBSON_SIM_PATH"
    )


def _resource_parts(path: str) -> list[tuple[str, str, PurePosixPath]]:
    """Returns (kind, name, relative path) for each part of a path that names a scene, a robot or an object; the last part first."""
    parts = PurePosixPath(path).parts
    return [
        (parts[k], parts[k + 1], PurePosixPath(*parts[k + 2 :])) for k in reversed(range(len(parts) - 2)) if parts[k] in _KINDS
    ]


def _folder(kind: str, name: str) -> Path:
    if kind == "objects":
        return next((share / kind / name for share in share_folders() if exists(share / kind / name)), Path(name))
    path = find_scene(name) if kind == "scenes" else find_robot(name)
    return path if is_folder(path) else path.parent


def _check_digest(scene: DrawnScene, local_paths: dict[str, str]) -> tuple[str, ...]:
    """Returns a warning if the digest of the local scene differs from that of the physics node's scene."""
    # The digest of a randomised scene cannot be computed from its files.
    if not scene.content_hash or any(visual.appearance is not None for visual in scene.visuals):
        return ()
    for remote, local in local_paths.items():
        name = next((name for kind, name, _ in _resource_parts(remote) if kind == "scenes"), "")
        if remote == local or not name:
            continue
        try:
            same = load_scene(name).content_hash == scene.content_hash
        except GibsonSimError as error:
            return (f"{local} replaces {remote}, but scene {quoted(name)} cannot be compared: {error}",)
        return (
            ()
            if same
            else (f"{local} replaces {remote}, but scene {quoted(name)} differs between the two machines: images may be wrong",)
        )
    return ()
