"""Reads Wavefront OBJ with its MTL files. The format has no units and no up axis: metres and z up are assumed.

trimesh (5.2) is not used: it cuts concave polygons into fans, finds no faces where tabs separate words, loses the vertices of faces whose corners
differ in form, and ignores options of textures.
"""

from __future__ import annotations

import math
import os
import re
from collections import defaultdict
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gibson_sim.description.omissions import Omission, OmissionKind
from gibson_sim.errors import MeshError
from gibson_sim.formats.file_roots import is_inside
from gibson_sim.formats.mesh import (
    F64,
    I64,
    LIGHT_GREY,
    MAX_FRACTION,
    Material,
    MeshPart,
    Sampling,
    area_normals,
    build_part,
    index_corners,
)
from gibson_sim.formats.polygons import triangulate
from gibson_sim.formats.textures import TextureStore, Warn, local_path
from gibson_sim.quoting import quoted
from gibson_sim.reading import is_file, read_file
from gibson_sim.types import Rgba, Vec3

_NUMBER = re.compile(r"-?\d+")
_USED = ("v", "vt", "vn", "f", "usemtl", "mtllib")
_NUMBERS = ("v", "vt", "vn", "f")
_WITHOUT_EFFECT = ("g", "o", "s", "mg", "lod", "bevel", "c_interp", "d_interp")
"""Names, groups and rendering hints: normals of the file, else smooth ones, are used."""
_LEFT_OUT = {
    "l": "are left out: lines have no surface",
    "p": "are left out: points have no surface",
    "maplib": "are left out: the surfaces keep the textures of their materials",
    "usemap": "are left out: the surfaces keep the textures of their materials",
}
"""Key of a line -> what changes."""
_UNKNOWN = "are left out: free-form curves and surfaces, and lines of other programs, are not drawn; export polygons"
_OPTION_VALUES = {
    "-blendu": 1, "-blendv": 1, "-bm": 1, "-boost": 1, "-cc": 1, "-clamp": 1, "-imfchan": 1, "-mm": 2, "-o": 3, "-s": 3,
    "-t": 3, "-texres": 1, "-type": 1,
}  # fmt: skip
"""Option of a texture -> number of its values; of -o, -s and -t the last two may be missing."""
_OPTIONS_LEFT_OUT = {
    "-bm": "bumps have another height", "-boost": "the image is less sharp far away", "-cc": "its colours are not corrected",
    "-imfchan": "its colour channels are used", "-mm": "its contrast is unchanged", "-t": "it has no turbulence",
    "-type": "it is mapped by texture coordinates",
}  # fmt: skip
_MTL_USED = ("kd", "d", "tr", "ke", "map_kd", "map_d", "pm", "pr")
_MTL_WITHOUT_EFFECT = ("ka", "ks", "ns", "ni", "illum", "tf", "sharpness", "map_ka", "map_aat", "aniso", "anisor")
"""Terms of the Phong model and of refraction, which almost every exporter writes and a matte surface lacks."""
_MTL_LEFT_OUT = {
    "map_ks": "highlights are even", "map_ns": "highlights are even", "map_ke": "the surface emits evenly", "map_bump": "the surface is smooth",
    "bump": "the surface is smooth", "norm": "the surface is smooth", "disp": "the surface is smooth", "decal": "it is not drawn",
    "refl": "nothing is reflected", "map_pr": "the roughness is even", "map_pm": "the metalness is even", "pc": "there is no clear coat",
    "pcr": "there is no clear coat", "ps": "there is no sheen",
}  # fmt: skip
"""Key of a material, lower case -> what changes without it."""


@dataclass(frozen=True, slots=True)
class _Mapping:
    """Options of a texture that change texture coordinates (v upwards): ``uv * scale + offset``."""

    scale: tuple[float, float] = (1.0, 1.0)
    offset: tuple[float, float] = (0.0, 0.0)


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
    rows: dict[str, tuple[list[int], list[str]]] = defaultdict(lambda: ([], []))
    left_out: dict[str, int] = defaultdict(int)
    for number, line in enumerate(_lines(data)):
        key, rest = _split_key(line)
        if key in _USED:
            rows[key][0].append(number)
            rows[key][1].append(rest.partition("#")[0] if "#" in rest and key in _NUMBERS else rest)
        elif key and not key.startswith("#") and key not in _WITHOUT_EFFECT:
            left_out[key] += 1
    for key, count in left_out.items():
        warn(f"{path}: {count} line(s) {quoted(key)} {_LEFT_OUT.get(key, _UNKNOWN)}")
    if not rows["v"][0]:
        raise MeshError(f"{path}: has no vertices; is it an OBJ file?")
    counts = [len(line.split()) for line in rows["v"][1]]
    positions = _table(path, rows["v"][1], 3, counts)
    texcoords, normals = _table(path, rows["vt"][1], 2), _table(path, rows["vn"][1], 3)
    known = _materials(path, [name for line in rows["mtllib"][1] for name in _names(line, path)], textures, files, warn)
    faces = _faces_by_material(path, rows, positions, (len(positions), len(texcoords), len(normals)), warn)
    smooth = _smooth_normals(path, positions, faces)
    colors = _colors(path, rows["v"][1], counts, warn)
    parts = []
    for text, face in faces.items():
        name = text if text in known else _without_comment(text)
        if name and name not in known:
            warn(f"{path}: material {quoted(name)} is not defined in its .mtl; the surface is light grey")
        plain = Material(name) if colors is None else Material(name, (1.0, 1.0, 1.0, 1.0), unlit=True)
        part = _part(path, face, positions, texcoords, normals, smooth, *known.get(name, (plain, _Mapping())), colors)
        if part is not None:
            parts.append(part)
    return parts


def _lines(data: bytes) -> list[str]:
    """Returns the lines of an OBJ or MTL file, without a byte order mark; a backslash at the end of a line continues it."""
    return data.decode("utf-8-sig", errors="replace").replace("\\\r\n", " ").replace("\\\n", " ").splitlines()


def _without_comment(text: str) -> str:
    """Returns a text up to a ``#`` after white space. Names may have one (3ds Max: ``Material #25``), so that they are searched as a whole first."""
    return re.split(r"(?:^|\s)#", text, maxsplit=1)[0].strip()


def _split_key(line: str) -> tuple[str, str]:
    """Returns the first word of a line, and the rest without the white space around it; both may be empty."""
    key, *rest = line.split(None, 1) or [""]
    return key, rest[0].strip() if rest else ""


def _table(path: Path, lines: list[str], width: int, word_counts: list[int] | None = None) -> F64:
    """Returns the first ``width`` numbers of every line, (N, width); missing numbers are 0, since vt may have only one."""
    if not lines:
        return np.zeros((0, width))
    counts = set(word_counts or (len(line.split()) for line in lines))
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


def _colors(path: Path, lines: list[str], counts: list[int], warn: Warn) -> NDArray[np.uint8] | None:
    """Returns the vertex colours, (V, 3) uint8 sRGB, if lines have three further numbers, as in scans; else None. Others are white.

    Args:
        path: the file, for messages.
        lines: the vertices.
        counts: number of words of each line.
        warn: called with one line if some vertices have no colours, or colours that cannot be read.
    """
    has_color = np.isin(counts, (6, 7))
    if not has_color.any():
        return None
    try:
        texts = lines if has_color.all() else [line for line, has in zip(lines, has_color, strict=True) if has]
        if len(set(counts)) == 1:
            values = np.array(" ".join(texts).split(), dtype=np.float64).reshape(len(texts), -1)[:, 3:6]
        else:
            values = np.array([line.split()[3:6] for line in texts], dtype=np.float64)
    except ValueError:
        warn(f"{path}: the colours of its vertices are left out, since one is not a number")
        return None
    if not has_color.all():
        warn(f"{path}: {int((~has_color).sum())} of {len(lines)} vertices have no colour; they are white")
    values = np.nan_to_num(values)
    colors = np.full((len(lines), 3), 255, dtype=np.uint8)
    # Some programs write 0 to 1, others 0 to 255.
    colors[has_color] = np.rint(np.clip(values * (1.0 if values.max() > MAX_FRACTION else 255.0), 0.0, 255.0))
    return colors


def _faces_by_material(
    path: Path, rows: dict[str, tuple[list[int], list[str]]], positions: F64, totals: tuple[int, int, int], warn: Warn
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
        words = text.split()
        pattern = _NUMBER.sub("", " ".join(words)).strip()
        groups[(uses[1][usemtl_row[k]] if usemtl_row[k] >= 0 else "", pattern + f" {len(words)}")].append(k)
    # A negative index counts back from the last vertex before the line of the face.
    defined = [
        np.searchsorted(np.array(rows[key][0], dtype=np.int64), np.array(numbers, dtype=np.int64)) for key in ("v", "vt", "vn")
    ]
    faces: dict[str, list[_Faces]] = defaultdict(list)
    too_small = 0
    for (material, _), members in groups.items():
        columns = _columns(path, [texts[k] for k in members])
        n_corners = columns.shape[1]
        if n_corners < 3:
            too_small += len(members)
            continue
        index = []
        for column in range(3):
            values = columns[:, :, column]
            defined_before = defined[column][members][:, None]
            absolute = np.where(values > 0, values - 1, np.where(values < 0, values + defined_before, -1))
            is_wrong = (values != 0) & ((absolute < 0) | (absolute >= totals[column])) | ((values == 0) if column == 0 else False)
            if is_wrong.any():
                kind = ("vertex", "texture coordinate", "normal")[column]
                named = int(values[is_wrong][0])
                raise MeshError(f"{path}: a face names {kind} {named}, but there are {totals[column]}, from 1; the OBJ is broken")
            index.append(absolute.ravel())
        corners = triangulate(positions, index[0], np.full(len(members), n_corners))[0]
        faces[material].append(_Faces(*(column[corners] for column in index)))
    if too_small:
        text = f"{path}: {too_small} face(s) of fewer than 3 corners are left out: they have no surface"
        warn(text)
    return {
        name: _Faces(*(np.concatenate([getattr(f, field) for f in groups_of_faces]) for field in ("positions", "uvs", "normals")))
        for name, groups_of_faces in faces.items()
    }


def _columns(path: Path, texts: list[str]) -> I64:
    """Returns the v, vt and vn indices of faces of one pattern, (faces, corners, 3) int64, 0 = not given."""
    # Which of v, vt and vn each corner gives: corners of one face may differ, as in ``f 1/1 2 3``.
    given = [[bool(index) for index in word.split("/")] for word in texts[0].split()]
    if any(len(corner) > 3 or not corner[0] for corner in given):
        raise MeshError(
            f"{path}: face {quoted(texts[0].strip())} has a corner that is not v, v/vt, v//vn or v/vt/vn; the OBJ is broken"
        )
    slots = [3 * k + column for k, corner in enumerate(given) for column, present in enumerate(corner) if present]
    out = np.zeros((len(texts), 3 * len(given)), dtype=np.int64)
    try:
        out[:, slots] = np.array(" ".join(texts).replace("/", " ").split(), dtype=np.int64).reshape(len(texts), len(slots))
    except (ValueError, OverflowError) as e:
        raise MeshError(f"{path}: face {quoted(texts[0].strip())} cannot be read; the OBJ is broken") from e
    return out.reshape(len(texts), len(given), 3)


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
    mapping: _Mapping,
    colors: NDArray[np.uint8] | None,
) -> MeshPart | None:
    p, t, n = face.positions.ravel(), face.uvs.ravel(), face.normals.ravel()
    if not len(p):
        return None
    first, corner = index_corners(p, t, n)
    p, t, n = p[first], t[first], n[first]
    uvs = None
    if len(texcoords) and (t >= 0).any():
        u, v = (texcoords[t] * mapping.scale + mapping.offset).T
        uvs = np.where((t >= 0)[:, None], np.stack([u, 1.0 - v], axis=1), 0.0)
    corner_normals = normals[n] if len(normals) else None
    if smooth is not None:
        corner_normals = smooth[p] if corner_normals is None else np.where((n >= 0)[:, None], corner_normals, smooth[p])
    tints = None if colors is None else colors[p]
    return build_part(str(path), positions[p], corner.reshape(-1, 3), corner_normals, uvs, material, None, tints)


# Materials


def _names(line: str, path: Path) -> list[str]:
    """Returns the .mtl file names of an mtllib line: one name with spaces if that file exists, else several names."""
    for name in (line, _without_comment(line)):
        if is_file(local_path(name, path.parent)):
            return [name]
    return _without_comment(line).split()


def _materials(
    path: Path, names: list[str], textures: TextureStore, files: list[Path], warn: Warn
) -> dict[str, tuple[Material, _Mapping]]:
    materials: dict[str, tuple[Material, _Mapping]] = {}
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
        for line in _lines(read_file(file)):
            key, rest = _split_key(line)
            if key == "newmtl":
                current = blocks.setdefault(rest, {})
            elif key and not key.startswith("#"):
                current[key.lower()] = rest if key.lower().startswith("map_") else _without_comment(rest)
        materials.update({key: _material(key, block, file, path, textures, files, warn) for key, block in blocks.items()})
    return {_without_comment(name): material for name, material in materials.items()} | materials


def _material(
    name: str, block: dict[str, str], mtl: Path, obj: Path, textures: TextureStore, files: list[Path], warn: Warn
) -> tuple[Material, _Mapping]:
    said = f"{mtl}: material {quoted(name)}"
    for key in block:
        if key in _MTL_LEFT_OUT:
            warn(f"{said}: {key} is left out; {_MTL_LEFT_OUT[key]}")
        elif key not in _MTL_USED and key not in _MTL_WITHOUT_EFFECT:
            warn(f"{said}: {quoted(key)} is unknown and has no effect")
    uri, mapping, clamp = _texture(said, block.get("map_kd", ""), warn)
    uri = uri if is_file(local_path(uri, mtl.parent)) else _without_comment(uri)
    # Paths are relative to the .mtl, but warnings and the search for missing textures use the mesh.
    texture = textures.from_uri(uri, mtl.parent / obj.name, files, warn) if uri else None
    if texture is not None and clamp:
        texture = textures.with_sampling(texture, Sampling(wrap_u="clamp", wrap_v="clamp"))
    if "-halo" in block.get("d", ""):
        warn(Omission(f"{said}: -halo of d is left out; the opacity is the same from all directions"))
    alpha = _fraction(said, block, "d", 1.0, warn)
    if "tr" in block and "d" not in block and _fraction(said, block, "tr", 0.0, warn) not in (0.0, 1.0):
        # Tr is opacity for some exporters, and transparency for others; only d is unambiguous.
        warn(Omission(f"{said}: Tr without d is left out, since programs disagree on its meaning; the surface is opaque"))
    color: Rgba = (1.0, 1.0, 1.0, alpha)
    if texture is None:
        color = (*_color(said, block, "kd", LIGHT_GREY[:3], warn), alpha)
    has_cut_out = "map_d" in block and texture is not None and texture.pixels.shape[2] == 4
    if "map_d" in block and not has_cut_out:
        warn(Omission(f"{said}: map_d is left out: only the alpha channel of map_Kd is used; the surface has no holes"))
    material = Material(
        name,
        color,
        texture,
        alpha_mode="blend" if alpha < 0.999 else "mask" if has_cut_out else "opaque",
        metallic=_fraction(said, block, "pm", 0.0, warn),
        roughness=_fraction(said, block, "pr", 1.0, warn),
        emissive=_color(said, block, "ke", (0.0, 0.0, 0.0), warn, largest=math.inf),
    )
    return material, mapping


def _color(said: str, block: dict[str, str], key: str, default: Vec3, warn: Warn, largest: float = 1.0) -> Vec3:
    """Returns the colour of a line ``r [g b]``, 0 to ``largest``; g and b are r if they are missing.

    The default if there is no line or, with a warning, if it is of another form, such as ``xyz x y z`` and ``spectral file.rfl``.
    """
    words = block.get(key, "").split()
    if not words:
        return default
    if len(words) not in (1, 3) or not all(map(_is_number, words)):
        warn(f"{said}: {key} {quoted(' '.join(words))} is left out, must be r g b")
        return default
    r, g, b = (min(max(float(word), 0.0), largest) for word in (words * 3 if len(words) == 1 else words))
    return r, g, b


def _fraction(said: str, block: dict[str, str], key: str, default: float, warn: Warn) -> float:
    """Returns the number of a line, clamped to 0 to 1; the default if there is no line or, with a warning, if it has no number."""
    words = block.get(key, "").split()
    if not words:
        return default
    if not _is_number(words[-1]):
        warn(f"{said}: {key} {quoted(' '.join(words))} is not a number; ignored")
        return default
    return min(max(float(words[-1]), 0.0), 1.0)


def _texture(said: str, text: str, warn: Warn) -> tuple[str, _Mapping, bool]:
    """Returns file name, mapping and ``-clamp on`` of a texture line such as ``-s 2 2 1 wood.png``; options that have no effect are named."""
    scale, offset, clamp = [1.0, 1.0], [0.0, 0.0], False
    while True:
        option, rest = _split_key(text)
        option = option.lower()
        if option not in _OPTION_VALUES:
            break
        values: list[str] = []
        while rest and len(values) < _OPTION_VALUES[option]:
            word, after = _split_key(rest)
            if option in ("-o", "-s", "-t") and not _is_number(word):
                break
            values.append(word)
            rest = after
        text = rest
        if option in ("-o", "-s"):
            target = scale if option == "-s" else offset
            target[: min(len(values), 2)] = [float(value) for value in values[:2]]
        elif option == "-clamp":
            clamp = values == ["on"]
        elif option in _OPTIONS_LEFT_OUT:
            warn(f"{said}: option {option} of map_Kd is left out; {_OPTIONS_LEFT_OUT[option]}")
    return text.strip(), _Mapping((scale[0], scale[1]), (offset[0], offset[1])), clamp


def _is_number(word: str) -> bool:
    try:
        return math.isfinite(float(word))
    except ValueError:
        return False
