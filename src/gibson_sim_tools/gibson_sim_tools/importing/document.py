"""Defines the result of an importer, and writes a scene folder from it.

Maps in Gibson's layout are converted to Nav2's: 0.01 m per pixel, origin of the world in the middle, row 0 at the lowest y; 255 = free.
``left_out.yaml`` lists items of the source that an import could not use; ``check`` repeats them. Scans, with uneven floors and many triangles,
are distinguished from modelled meshes.
"""

from __future__ import annotations

import os
import re
import shutil
import tempfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import yaml

from gibson_sim.description.omissions import Omission, OmissionKind, kind_of
from gibson_sim.errors import SceneError, TextError
from gibson_sim.formats.image_header import MAX_PIXELS, image_size
from gibson_sim.formats.load_mesh import MeshLoader
from gibson_sim.formats.mesh import Mesh
from gibson_sim.geometry.transforms import matrix_from_pose
from gibson_sim.geometry.triangle_meshes import components, weld
from gibson_sim.picture_files import write_picture
from gibson_sim.quoting import clipped
from gibson_sim.reading import is_file, read_yaml_file
from gibson_sim.scenes.room_spec import RoomSpec
from gibson_sim.scenes.scene_yaml import DESCRIPTION, write_scene_yaml
from gibson_sim.types import Pose, Rgba, Vec3
from gibson_sim.writing import cannot_write, write_file
from gibson_sim_tools.importing.glb import write_glb

ASSETS = "assets"
"""Folder of meshes and textures in a written scene."""
BAKED_LIGHT: Mapping[str, Any] = {"sun": 0.0, "ambient": 1.0}
"""``light`` of a scan; its textures contain the light of the room."""
SIMPLIFIED = "simplified"
"""Collision of a scan: boxes for level floors, and a mesh with fewer triangles."""
GIBSON_RESOLUTION = 0.01
"""Resolution of Gibson's maps, metres per pixel."""
LEFT_OUT = "left_out.yaml"
"""File beside the scene.yaml."""
_MAX_LINE_LENGTH = 1000
"""Length limit of a line, characters."""
_LEFT_OUT_HEADER = (
    "# Items of the source that could not be used. `gibson-sim scene check` repeats them; delete those that you have fixed.\n"
)
MIN_SCAN_TRIANGLES = 20_000
"""Minimum number of triangles of a scan."""
MIN_SCAN_SHARE = 0.5
"""Minimum fraction of a scan's triangles in its largest connected component."""


@dataclass(frozen=True, slots=True, eq=False)
class ImportedObject:
    """One object of a scene.yaml."""

    name: str
    shape: Path | Mesh | Mapping[str, Any]
    """Mesh file; mesh to be written as GLB (z up, metres); or the keys of a primitive."""
    pose: Pose = field(default_factory=Pose)
    scale: Vec3 = (1.0, 1.0, 1.0)
    up_axis: str = ""
    """Up axis of the mesh file; empty = as its format says."""
    unit_m: float | None = None
    """Metres per unit of the mesh file; None = as its format says."""
    semantic_class: str = ""
    color: Rgba | None = None
    collision: Path | Mesh | str = "same"
    """``same``, ``none``, ``simplified``, or a mesh in the frame of the shape."""
    visible: bool = True
    """False = collision only."""
    metallic: float | None = None
    """Metalness, 0 to 1; None = as in the mesh file."""
    roughness: float | None = None
    """Roughness, 0 to 1; None = as in the mesh file."""
    friction: float = 1.0
    """Coulomb friction, 0 to 1."""


@dataclass(frozen=True, slots=True, eq=False)
class FloorPicture:
    """A map image that is part of the source; Gibson Sim computes its own maps from triangles."""

    file: Path
    resolution: float
    """Resolution, metres per pixel."""
    number: int
    """Index of its floor, from the lowest."""


@dataclass(slots=True, eq=False)
class ImportedScene:
    """Result of an importer."""

    name: str
    kind: str
    """Kind of the source in words, such as ``Gibson folder``."""
    root: Path
    """Folder that contains all files of the source."""
    objects: list[ImportedObject] = field(default_factory=list)
    description: str = ""
    light: Mapping[str, Any] = field(default_factory=dict)
    floors: tuple[float, ...] = ()
    """Floor heights, m, the lowest first; empty = estimated on loading."""
    ground_z: float | None = None
    ground_friction: float = 1.0
    gravity: Vec3 | None = None
    rooms: tuple[RoomSpec, ...] = ()
    starts: list[dict[str, Any]] = field(default_factory=list)
    maps: list[FloorPicture] = field(default_factory=list)
    licences: list[Path] = field(default_factory=list)
    """Licence and attribution files."""
    warnings: list[str] = field(default_factory=list)
    in_place_folder: Path | None = None
    """Folder for a scene.yaml beside the source; None = the folder of the source."""
    loader: MeshLoader | None = None
    """Loader whose cache contains the meshes; None = a new one."""


@contextmanager
def new_folder(output: Path) -> Iterator[Path]:
    """Yields a temporary folder beside ``output``; it is renamed to ``output`` if the block succeeds, else removed.

    Raises:
        SceneError: ``output`` exists and is not empty, or cannot be written.
    """
    if output.exists() and (not output.is_dir() or any(output.iterdir())):
        raise SceneError(f"{output}: already exists and is not empty; give another folder with --output, or delete it first")
    try:
        output.parent.mkdir(parents=True, exist_ok=True)
        temporary = Path(tempfile.mkdtemp(prefix=f".{output.name}.", dir=output.parent))
    except OSError as e:
        raise cannot_write(output, e) from e
    try:
        yield temporary
        temporary.chmod(0o755)
        if output.exists():
            output.rmdir()
        temporary.rename(output)
    except OSError as e:
        raise cannot_write(output, e) from e
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


def write_scene(scene: ImportedScene, output: Path) -> Path:
    """Writes a scene with all its files into a new folder and returns the path of its scene.yaml.

    Raises:
        SceneError: the folder is not empty, or a file cannot be read or written.
    """
    with new_folder(output) as folder:
        writer = _MeshCopier(scene.root, folder, scene.loader)
        _write_description(scene, writer, folder)
        writer.maps(scene.maps, scene.floors)
        for licence in scene.licences:
            shutil.copyfile(licence, folder / licence.name)
        _write_left_out(scene, folder)
    return output / DESCRIPTION


def _write_left_out(scene: ImportedScene, folder: Path) -> None:
    text = _left_out_text(scene.warnings)
    if text:
        write_file(folder / LEFT_OUT, text)


def _write_description(scene: ImportedScene, writer: MeshPlacer, folder: Path) -> None:
    """Writes the scene.yaml; ``writer`` places the mesh files and returns their paths."""
    names: dict[str, int] = {}
    document: dict[str, Any] = {"name": scene.name}
    document["description"] = scene.description or f"Imported from a {scene.kind}"
    if scene.gravity is not None:
        document["gravity"] = [_short(c) for c in scene.gravity]
    if scene.ground_z is not None:
        document["ground_z"] = _short(scene.ground_z)
    if scene.ground_friction != 1.0:
        document["ground_friction"] = _short(scene.ground_friction)
    if len(scene.floors) == 1:
        document["floor_z"] = _short(scene.floors[0])
    elif scene.floors:
        document["floors"] = [_short(z) for z in scene.floors]
    if scene.rooms:
        document["rooms"] = [
            {"name": r.name, "class": r.room_class, "floor": r.floor, "polygon": [[_short(x), _short(y)] for x, y in r.polygon]}
            for r in scene.rooms
        ]
    if scene.light:
        document["light"] = dict(scene.light)
    if scene.starts:
        document["starts"] = scene.starts
    document["objects"] = [_object(item, writer, names) for item in scene.objects]
    write_scene_yaml(folder, document, f"Written by: gibson-sim scene import (from a {scene.kind})")


def _object(item: ImportedObject, writer: MeshPlacer, names: dict[str, int]) -> dict[str, Any]:
    names[item.name] = names.get(item.name, 0) + 1
    name = item.name if names[item.name] == 1 else f"{item.name}_{names[item.name]}"
    out: dict[str, Any] = {"name": name}
    if isinstance(item.shape, Mapping):
        out.update(item.shape)
    else:
        out["mesh"] = writer.mesh(item.shape, name)
    if item.pose != Pose():
        matrix = matrix_from_pose(item.pose)
        out["pose"] = {"xyz": [_short(c) for c in item.pose.position], "rpy_deg": rpy_deg(matrix)}
    if item.scale != (1.0, 1.0, 1.0) and not isinstance(item.shape, Mapping):
        out["scale"] = [float(c) for c in item.scale]
    for key in ("up_axis", "unit_m", "semantic_class"):
        if getattr(item, key):
            out[key] = getattr(item, key)
    if not item.visible:
        out["visible"] = False
    if item.color is not None:
        out["color"] = [_short(c) for c in item.color]
    for key in ("metallic", "roughness"):
        if getattr(item, key) is not None:
            out[key] = _short(getattr(item, key))
    if item.friction != 1.0:
        out["friction"] = _short(item.friction)
    if isinstance(item.collision, str):
        if item.collision != "same":
            out["collision"] = item.collision
    else:
        out["collision"] = writer.mesh(item.collision, f"{name}_collision")
    return out


class MeshPlacer:
    """Returns the paths of meshes for a scene.yaml. Files stay in place; meshes in memory are written below ``folder``.

    Args:
        root: folder of the source files.
        folder: folder of the scene.yaml.
    """

    def __init__(self, root: Path, folder: Path) -> None:
        self._root = Path(os.path.realpath(root))
        self._folder = folder
        self._used_paths: set[str] = set()

    def mesh(self, shape: Path | Mesh, name: str) -> str:
        """Returns the path of a mesh, relative to the scene.yaml; writes it if it is in memory."""
        if isinstance(shape, Mesh):
            return self._written(shape, name)
        return self._file(Path(os.path.realpath(shape)), name)

    def _file(self, path: Path, name: str) -> str:
        return path.relative_to(self._root).as_posix()

    def _written(self, mesh: Mesh, name: str) -> str:
        base = file_name(name)
        relative = f"{ASSETS}/{base}.glb"
        suffix = 1
        while relative in self._used_paths:
            suffix += 1
            relative = f"{ASSETS}/{base}_{suffix}.glb"
        self._used_paths.add(relative)
        (self._folder / ASSETS).mkdir(exist_ok=True)
        write_glb(self._folder / relative, mesh)
        return relative


class _MeshCopier(MeshPlacer):
    """Copies all files of a mesh to ``assets``, at their paths relative to the root of the source."""

    def __init__(self, root: Path, folder: Path, loader: MeshLoader | None) -> None:
        super().__init__(root, folder)
        self._loader = loader or MeshLoader((self._root,), textures=False)

    def _file(self, path: Path, name: str) -> str:
        if not path.is_relative_to(self._root):
            return self._written(MeshLoader((path.parent.parent,)).mesh(path), name)
        files = self._loader.mesh(path).files
        if not all(file.is_relative_to(self._root) for file in files):
            return self._written(MeshLoader((self._root,)).mesh(path), name)
        for file in files:
            target = self._folder / ASSETS / file.relative_to(self._root)
            if not target.exists():
                target.parent.mkdir(parents=True, exist_ok=True)
                shutil.copyfile(file, target)
        relative = f"{ASSETS}/{path.relative_to(self._root).as_posix()}"
        self._used_paths.add(relative)
        return relative

    def maps(self, maps: Sequence[FloorPicture], floors: Sequence[float]) -> None:
        """Writes the maps of the source in Nav2's format: an image and a YAML file for each."""
        for picture in maps:
            height = floors[picture.number] if picture.number < len(floors) else 0.0
            write_nav2_map(picture, height, self._folder / "maps")


def write_in_place(scene: ImportedScene, folder: Path) -> Path:
    """Writes a scene.yaml into the folder of the source, whose files stay in place, and returns its path.

    Raises:
        SceneError: the scene.yaml exists, or a file of the scene is outside the folder.
    """
    path = folder / DESCRIPTION
    if path.exists():
        raise SceneError(f"{path}: already exists; give another folder with --output, or delete it first")
    real = Path(os.path.realpath(folder))
    outside = [
        o.shape for o in scene.objects if isinstance(o.shape, Path) and not Path(os.path.realpath(o.shape)).is_relative_to(real)
    ]
    if outside:
        raise SceneError(
            f"{outside[0]}: lies outside {folder}, where the scene.yaml would go; give --output FOLDER to copy all files"
        )
    _write_description(scene, MeshPlacer(folder, folder), folder)
    _write_left_out(scene, folder)
    return path


def rpy_deg(matrix: Any) -> list[float]:
    """Returns roll, pitch and yaw, degrees, of a rotation or transform: ``R = Rz(yaw) Ry(pitch) Rx(roll)``."""
    r = np.asarray(matrix, dtype=np.float64)
    pitch = -np.arcsin(np.clip(r[2, 0], -1.0, 1.0))
    if abs(r[2, 0]) > 1.0 - 1e-12:
        roll, yaw = 0.0, np.arctan2(-r[0, 1], r[1, 1])
    else:
        roll, yaw = np.arctan2(r[2, 1], r[2, 2]), np.arctan2(r[1, 0], r[0, 0])
    return [_short(float(np.degrees(angle))) for angle in (roll, pitch, yaw)]


def file_name(name: str) -> str:
    """Returns a name that is valid on every file system."""
    return re.sub(r"[^A-Za-z0-9_.-]+", "_", name).strip("._")[:80] or "object"


def _short(value: float) -> float:
    return round(float(value), 9) + 0.0


def write_nav2_map(picture: FloorPicture, floor_z: float, folder: Path) -> None:
    """Writes ``floor_N.pgm``, row 0 at the highest y, and ``floor_N.yaml``.

    Args:
        picture: the map.
        floor_z: height of its floor, metres; written as a comment.
        folder: created if missing.

    Raises:
        SceneError: the image cannot be read.
    """
    data = picture.file.read_bytes()
    size = image_size(data)
    if size is None or size.pixels > MAX_PIXELS:
        problem = "is not an image" if size is None else f"has {size.width} x {size.height} pixels"
        raise SceneError(f"{picture.file}: {problem}; a map must be an image of at most {MAX_PIXELS // 2**20} million pixels")
    image = cv2.imdecode(np.frombuffer(data, dtype=np.uint8), cv2.IMREAD_GRAYSCALE)
    if image is None:
        raise SceneError(
            f"{picture.file}: is truncated or damaged; copy it again, or delete it: Gibson Sim computes its own maps"
        )
    name = f"floor_{picture.number}"
    # Nav2: 254 = free, 0 = occupied.
    free = np.where(image[::-1] == 255, 254, 0).astype(np.uint8)
    write_picture(folder / f"{name}.pgm", free)
    rows, columns = image.shape
    values = {
        "image": f"{name}.pgm", "mode": "trinary", "resolution": picture.resolution,
        "origin": [-columns / 2 * picture.resolution, -rows / 2 * picture.resolution, 0.0],
        "negate": 0, "occupied_thresh": 0.65, "free_thresh": 0.25,
    }  # fmt: skip
    header = f"# From {picture.file.name}, part of the source; floor at z = {floor_z:g} m\n"
    write_file(folder / f"{name}.yaml", header + yaml.safe_dump(values, sort_keys=False))


def _left_out_text(lines: Iterable[str]) -> str:
    """Returns the text of the file for these lines; empty without lines."""
    entries = [{"kind": kind_of(line).name.lower(), "text": str(line)} for line in dict.fromkeys(lines)]
    return _LEFT_OUT_HEADER + yaml.safe_dump(entries, sort_keys=False, allow_unicode=True, width=10_000) if entries else ""


def read_left_out(folder: Path) -> Sequence[Omission]:
    """Returns the omissions that an import listed in the folder of a scene; empty without the file.

    Raises:
        SceneError: the file cannot be read.
    """
    path = folder / LEFT_OUT
    if not is_file(path):
        return ()
    try:
        entries = read_yaml_file(path)
    except (OSError, TextError) as error:
        raise SceneError(f"{path}: {error}") from error
    kinds = {kind.name.lower(): kind for kind in OmissionKind}
    lines = []
    for entry in entries if isinstance(entries, list) else [entries]:
        if not isinstance(entry, dict) or not isinstance(entry.get("text"), str) or entry.get("kind") not in kinds:
            raise SceneError(
                f"{path}: must be a list of {{kind: .., text: ..}}, kind one of {', '.join(kinds)}; correct it, or delete it"
            )
        lines.append(Omission(clipped(entry["text"], _MAX_LINE_LENGTH), kinds[entry["kind"]]))
    return tuple(lines)


def is_scan(mesh: Mesh) -> bool:
    """Returns whether a mesh is probably a scan: many triangles, most of them connected."""
    if mesh.triangle_count < MIN_SCAN_TRIANGLES:
        return False
    vertices, triangles = weld(*mesh.merged())
    sizes = np.bincount(components(triangles, len(vertices)), minlength=1)
    return bool(sizes.max() > MIN_SCAN_SHARE * mesh.triangle_count)
