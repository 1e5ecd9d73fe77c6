"""Reads Wavefront OBJ with its MTL files. The format has no units and no up axis: metres and z up are assumed."""

from __future__ import annotations

import os
import re
import shlex
from collections import defaultdict
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gibson_sim.description.omissions import Omission, OmissionKind
from gibson_sim.errors import MeshError
from gibson_sim.formats.file_roots import is_inside
from gibson_sim.formats.mesh import F64, I64, LIGHT_GREY, Material, MeshPart, area_normals, build_part, fan, index_corners
from gibson_sim.formats.textures import TextureStore, Warn, local_path
from gibson_sim.quoting import quoted
from gibson_sim.reading import is_file, read_file
from gibson_sim.types import Rgba

_NUMBER = re.compile(r"-?\d+")
_TEXTURE_OPTIONS = {
    "-blendu": 1, "-blendv": 1, "-bm": 1, "-boost": 1, "-cc": 1, "-clamp": 1, "-imfchan": 1, "-mm": 2, "-o": 3, "-s": 3,
    "-t": 3, "-texres": 1, "-type": 1,
}  # fmt: skip


@dataclass
class _Faces:
    """Triangles of one material: zero-based indices (F, 3), -1 = not given."""

    positions: I64
    uvs: I64
    normals: I64


def load_obj(path: Path, data: bytes, textures: TextureStore, files: list[Path], warn: Warn) -> list[MeshPart]:
    """Returns the parts of an OBJ file, one for each material, metres, z up.

    Args:
        path: the file.
        data: its content.
        textures: finds and decodes the images that it names.
        files: list to which the paths of further files that are read are appended.
        warn: called with one line for each element that is left out or replaced.

    Raises:
        MeshError: the file is corrupt.
    """
    if b"\0" in data[:4096]:
        raise MeshError(f"{path}: is not an OBJ file: it is not text")
    lines = data.decode("utf-8", errors="replace").replace("\\\r\n", " ").replace("\\\n", " ").splitlines()
    rows: dict[str, tuple[list[int], list[str]]] = defaultdict(lambda: ([], []))
    for number, line in enumerate(lines):
        key, _, rest = line.strip().partition(" ")
        if key in ("v", "vt", "vn", "f"):
            rows[key][0].append(number)
            rows[key][1].append(rest)
        elif key in ("usemtl", "mtllib"):
            rows[key][0].append(number)
            rows[key][1].append(rest.strip())
    if not rows["v"][0]:
        raise MeshError(f"{path}: has no vertices; is it an OBJ file?")
    positions, texcoords, normals = _table(path, rows["v"][1], 3), _table(path, rows["vt"][1], 2), _table(path, rows["vn"][1], 3)
    texcoords[:, 1] = 1.0 - texcoords[:, 1]
    known = _materials(path, [name for line in rows["mtllib"][1] for name in _names(line, path)], textures, files, warn)
    faces = _faces_by_material(path, rows, (len(positions), len(texcoords), len(normals)))
    smooth = _smooth_normals(path, positions, faces)
    colors = _colors(rows["v"][1])
    parts = []
    for name, face in faces.items():
        if name and name not in known:
            warn(f"{path}: material {quoted(name)} is not defined in its .mtl; the surface is light grey")
        plain = Material(name) if colors is None else Material(name, (1.0, 1.0, 1.0, 1.0), unlit=True)
        part = _part(path, face, positions, texcoords, normals, smooth, known.get(name, plain), colors)
        if part is not None:
            parts.append(part)
    return parts


def _table(path: Path, lines: list[str], width: int) -> F64:
    """Returns the first ``width`` numbers of every line, (N, width); missing numbers are 0, since vt may have only one."""
    if not lines:
        return np.zeros((0, width))
    counts = {len(line.split()) for line in lines}
    try:
        if len(counts) == 1 and min(counts) >= width:
            return np.array(" ".join(lines).split(), dtype=np.float64).reshape(len(lines), -1)[:, :width].copy()
        table = np.zeros((len(lines), width))
        for row, line in enumerate(lines):
            words = line.split()[:width]
            if len(words) < width and width == 3:
                raise ValueError(f"{quoted(line)} has {len(words)} coordinates")
            table[row, : len(words)] = [float(word) for word in words]
    except ValueError as e:
        raise MeshError(f"{path}: a line of coordinates cannot be read: {e}; the OBJ is broken") from e
    return table


def _colors(lines: list[str]) -> NDArray[np.uint8] | None:
    """Returns the vertex colours, (V, 3) uint8 sRGB, if every line has three further numbers, as in scans; else None."""
    if len(lines[0].split()) < 6:
        return None
    try:
        table = np.array(" ".join(lines).split(), dtype=np.float64).reshape(len(lines), -1)
    except ValueError:
        return None
    if table.shape[1] not in (6, 7):
        return None
    values = np.nan_to_num(table[:, 3:6])
    # Some programs write 0 to 1, others 0 to 255.
    return np.asarray(np.rint(np.clip(values * (1.0 if values.max() > 1.0 else 255.0), 0.0, 255.0)), dtype=np.uint8)


def _faces_by_material(
    path: Path, rows: dict[str, tuple[list[int], list[str]]], totals: tuple[int, int, int]
) -> dict[str, _Faces]:
    """Returns material name -> triangles, with absolute indices.

    Faces are grouped by their pattern (``7/1/4 8/2/4 9/3/4`` has the pattern ``// // //``): a file has few patterns, and NumPy parses all
    faces of a pattern at once.
    """
    numbers, texts = rows["f"]
    groups: dict[tuple[str, str], list[int]] = defaultdict(list)
    uses = rows["usemtl"]
    usemtl_row = np.searchsorted(np.array(uses[0], dtype=np.int64), np.array(numbers, dtype=np.int64)) - 1
    for k, text in enumerate(texts):
        pattern = " ".join(_NUMBER.sub("", text.partition("#")[0]).split(" ")).strip()
        groups[
            (uses[1][usemtl_row[k]] if usemtl_row[k] >= 0 else "", pattern + f" {len(text.partition('#')[0].split())}")
        ].append(k)
    # A negative index counts back from the last vertex before the line of the face.
    defined = [
        np.searchsorted(np.array(rows[key][0], dtype=np.int64), np.array(numbers, dtype=np.int64)) for key in ("v", "vt", "vn")
    ]
    faces: dict[str, list[_Faces]] = defaultdict(list)
    for (material, _), members in groups.items():
        columns = _columns(path, [texts[k].partition("#")[0] for k in members])
        n_corners = columns.shape[1]
        if n_corners < 3:
            continue
        corners = fan(np.full(len(members), n_corners))
        index = []
        for column in range(3):
            values = columns[:, :, column]
            defined_before = defined[column][members][:, None]
            absolute = np.where(values > 0, values - 1, np.where(values < 0, values + defined_before, -1))
            used = absolute[values != 0]
            if len(used) and (used.min() < 0 or used.max() >= totals[column]):
                raise MeshError(
                    f"{path}: a face names {('vertex', 'texture coordinate', 'normal')[column]} {int(used.max()) + 1}, "
                    f"but there are {totals[column]}; the OBJ is broken"
                )
            index.append(absolute.ravel()[corners])
        faces[material].append(_Faces(*index))
    return {
        name: _Faces(*(np.concatenate([getattr(f, field) for f in groups_of_faces]) for field in ("positions", "uvs", "normals")))
        for name, groups_of_faces in faces.items()
    }


def _columns(path: Path, texts: list[str]) -> I64:
    """Returns the v, vt and vn indices of faces of one pattern, (faces, corners, 3) int64, 0 = not given."""
    words = texts[0].split()
    slashes = words[0].count("/")
    double = "//" in words[0]
    if any(w.count("/") != slashes or ("//" in w) != double for w in words):
        raise MeshError(f"{path}: face {quoted(texts[0].strip())} mixes corner formats; the OBJ is broken")
    width = 2 if double else len([p for p in words[0].split("/") if p])
    try:
        values = np.array(" ".join(texts).replace("/", " ").split(), dtype=np.int64).reshape(len(texts), len(words), width)
    except ValueError as e:
        raise MeshError(f"{path}: face {quoted(texts[0].strip())} cannot be read; the OBJ is broken") from e
    out = np.zeros((*values.shape[:2], 3), dtype=np.int64)
    targets = [0, 2] if double else [0, 1, 2][:width]
    out[:, :, targets] = values
    return out


def _smooth_normals(path: Path, positions: F64, faces: dict[str, _Faces]) -> F64 | None:
    """Returns vertex normals, (N, 3), that are smooth across texture seams, if a face lacks normals, else None."""
    if not any((face.normals < 0).any() for face in faces.values()):
        return None
    with np.errstate(invalid="ignore"):
        return area_normals(positions, np.concatenate([face.positions for face in faces.values()]))


def _part(
    path: Path,
    face: _Faces,
    positions: F64,
    texcoords: F64,
    normals: F64,
    smooth: F64 | None,
    material: Material,
    colors: NDArray[np.uint8] | None,
) -> MeshPart | None:
    p, t, n = face.positions.ravel(), face.uvs.ravel(), face.normals.ravel()
    if not len(p):
        return None
    first, corner = index_corners(p, t, n)
    p, t, n = p[first], t[first], n[first]
    uvs = None
    if len(texcoords) and (t >= 0).any():
        uvs = np.where((t >= 0)[:, None], texcoords[t], 0.0)
    corner_normals = normals[n] if len(normals) else None
    if smooth is not None:
        corner_normals = smooth[p] if corner_normals is None else np.where((n >= 0)[:, None], corner_normals, smooth[p])
    tints = None if colors is None else colors[p]
    return build_part(str(path), positions[p], corner.reshape(-1, 3), corner_normals, uvs, material, None, tints)


# Materials


def _names(line: str, path: Path) -> list[str]:
    """Returns the .mtl file names of an mtllib line: one name with spaces if that file exists, else several names."""
    return [line] if is_file(local_path(line, path.parent)) or " " not in line else line.split()


def _materials(path: Path, names: list[str], textures: TextureStore, files: list[Path], warn: Warn) -> dict[str, Material]:
    materials: dict[str, Material] = {}
    for name in names:
        file = local_path(name, path.parent)
        if not is_inside(file, textures.roots):
            text = f"{path}: material file {quoted(name)} lies outside the folder of the mesh and of its model; put it beside the mesh"
            warn(Omission(text, OmissionKind.UNSUPPORTED_ASSET))
            continue
        if not is_file(file):
            text = f"{path}: material file {name} is missing; the surfaces are light grey"
            warn(Omission(text, OmissionKind.MISSING_ASSET))
            continue
        files.append(Path(os.path.realpath(file)))
        blocks: dict[str, dict[str, str]] = {}
        current: dict[str, str] = {}
        for line in read_file(file).decode("utf-8", errors="replace").splitlines():
            key, _, rest = line.strip().partition(" ")
            if key == "newmtl":
                current = blocks.setdefault(rest.strip(), {})
            elif key and not key.startswith("#"):
                current[key.lower()] = rest.strip()
        materials.update({key: _material(key, block, file, path, textures, files, warn) for key, block in blocks.items()})
    return materials


def _material(
    name: str, block: dict[str, str], mtl: Path, obj: Path, textures: TextureStore, files: list[Path], warn: Warn
) -> Material:
    uri = _texture_name(block.get("map_kd", ""))
    # Paths are relative to the .mtl, but warnings and the search for missing textures use the mesh.
    texture = textures.from_uri(uri, mtl.parent / obj.name, files, warn) if uri else None
    alpha = _floats(block.get("d", ""), 1, (1.0,), mtl, warn)[0]
    # Tr is ignored: it is opacity for some exporters, and transparency for others.
    color: Rgba = (1.0, 1.0, 1.0, alpha)
    if texture is None:
        r, g, b = _floats(block.get("kd", ""), 3, LIGHT_GREY[:3], mtl, warn)
        color = (r, g, b, alpha)
    has_cut_out = "map_d" in block and texture is not None and texture.pixels.shape[2] == 4
    red, green, blue = _floats(block.get("ke", ""), 3, (0.0, 0.0, 0.0), mtl, warn)
    return Material(
        name,
        color,
        texture,
        alpha_mode="blend" if alpha < 0.999 else "mask" if has_cut_out else "opaque",
        metallic=_floats(block.get("pm", ""), 1, (0.0,), mtl, warn)[0],
        roughness=_floats(block.get("pr", ""), 1, (1.0,), mtl, warn)[0],
        emissive=(red, green, blue),
    )


def _floats(text: str, count: int, default: tuple[float, ...], mtl: Path, warn: Warn) -> tuple[float, ...]:
    """Returns the last ``count`` numbers of a line, clamped to 0 to 1; the default if it is empty or, with a warning, invalid."""
    if not text:
        return default
    try:
        values = tuple(min(max(float(word), 0.0), 1.0) for word in text.split()[-count:])
    except ValueError:
        values = ()
    if len(values) != count:
        warn(f"{mtl}: {quoted(text)} is not {count} number(s); ignored")
        return default
    return values


def _texture_name(text: str) -> str:
    """Returns the file name of a map_Kd line without options such as ``-s 1 1 1``."""
    if not text.startswith("-"):
        return text
    words = shlex.split(text.replace("\\", "/"))
    while words and words[0] in _TEXTURE_OPTIONS:
        words = words[1 + _TEXTURE_OPTIONS[words[0]] :]
    return " ".join(words)
