"""Reads Gaussian splats: PLY of 3D Gaussian Splatting, compressed PLY (PlayCanvas, SuperSplat) and SPZ; writes the first.

Kerbl et al., "3D Gaussian Splatting for Real-Time Radiance Field Rendering", 2023. The formats are defined by the training code of that paper,
https://github.com/playcanvas/splat-transform and https://github.com/nianticlabs/spz.
"""

from __future__ import annotations

import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import zstandard
from numpy.typing import NDArray

from gibson_sim.errors import MeshError
from gibson_sim.formats.mesh import UpAxis
from gibson_sim.formats.ply import read_ply_tables
from gibson_sim.reading import read_file, read_head

F32 = NDArray[np.float32]
Table = Mapping[str, NDArray[Any]]

SH_DC = 0.28209479177387814
"""Value of the spherical harmonic of degree 0."""
MAX_SPLATS = 8_000_000
MAX_BYTES = 2 * 2**30
"""Maximum size of a file, and of its decompressed content, bytes."""
FARTHEST = 1e5
"""Maximum absolute value of coordinates and standard deviations, units of the file."""
ADVICE = "known are the PLY of 3D Gaussian Splatting, compressed PLY and SPZ; SuperSplat (https://superspl.at) and splat-transform convert others"

_CHUNK = 256
"""Number of splats in a chunk of a compressed PLY."""
_SH_COUNTS = (0, 9, 24, 45)
"""Number of coefficients above degree 0, for three colours, by degree."""
_SPZ_MAGIC = b"NGSP"
_GZIP_MAGIC = b"\x1f\x8b"
_SPZ_SH_COUNTS = (0, 9, 24, 45, 72)
_SPZ_COLOR = 0.15


@dataclass(frozen=True, slots=True, eq=False)
class Splats:
    """Gaussian splats, in the frame and the units of their file."""

    positions: F32
    """Centres, (N, 3)."""
    scales: F32
    """Standard deviations along the axes of each splat, (N, 3), 0 or more."""
    quats_xyzw: F32
    """Unit quaternions from the axes of each splat to the frame of the file, (N, 4)."""
    opacities: F32
    """Opacities at the centre, (N,), 0 to 1."""
    sh: F32
    """Coefficients of K = 1, 4, 9 or 16 spherical harmonics, (N, K, 3), for red, green and blue (sRGB) minus 0.5, as a function of the direction
    from the eye to the splat in the frame of the file."""
    up_axis: UpAxis = "z"
    """Up axis of the format; z for PLY, which does not define it."""
    without_rotation: int = 0
    """Number of splats whose quaternion in the file has length 0; they have the identity."""

    def __len__(self) -> int:
        return len(self.positions)

    @property
    def degree(self) -> int:
        """Degree of the spherical harmonics, 0 to 3."""
        return (1, 4, 9, 16).index(self.sh.shape[1])


def load_splats(path: Path) -> Splats:
    """Returns the splats in a file.

    Raises:
        MeshError: the file cannot be read, or is of another format, truncated or corrupt.
    """
    try:
        data = read_file(path, MAX_BYTES)
    except OSError as e:
        raise MeshError(f"{path}: cannot be read: {e.strerror or e}") from e
    return read_splats(path, data)


def up_axis_of(path: Path) -> UpAxis:
    """Returns the up axis of the format of a splat file; reads only its beginning.

    Raises:
        MeshError: the file cannot be read, or is of another format.
    """
    try:
        head = read_head(path, 4)
    except OSError as e:
        raise MeshError(f"{path}: cannot be read: {e.strerror or e}") from e
    if head.startswith(b"ply"):
        return "z"
    if head.startswith((_GZIP_MAGIC, _SPZ_MAGIC)):
        return "y"
    raise MeshError(f"{path}: is not a file of splats; {ADVICE}")


def read_splats(path: Path, data: bytes) -> Splats:
    """Returns the splats in the bytes of a file.

    Args:
        path: the file, for messages.
        data: its content, from which the format is detected.

    Raises:
        MeshError: the content is of another format, truncated or corrupt.
    """
    if data.startswith(b"ply"):
        return _checked(path, _from_ply(path, data))
    if data.startswith((_GZIP_MAGIC, _SPZ_MAGIC)):
        return _checked(path, _from_spz(path, data))
    raise MeshError(f"{path}: is not a file of splats; {ADVICE}")


def splats_ply(splats: Splats) -> bytes:
    """Returns the splats as a PLY of 3D Gaussian Splatting, binary, little-endian."""
    rest = (
        splats.sh[:, 1:].transpose(0, 2, 1).reshape(len(splats), -1)
    )  # file order: all coefficients of red, then green, then blue
    names = ["x", "y", "z", "f_dc_0", "f_dc_1", "f_dc_2", *(f"f_rest_{k}" for k in range(rest.shape[1])), "opacity"]
    names += ["scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"]
    with np.errstate(divide="ignore"):
        opacities = np.log(splats.opacities / (1.0 - splats.opacities))
        scales = np.log(splats.scales)
    columns = (splats.positions, splats.sh[:, 0], rest, opacities[:, None], scales, splats.quats_xyzw[:, [3, 0, 1, 2]])
    header = [
        "ply", "format binary_little_endian 1.0", f"element vertex {len(splats)}", *(f"property float {name}" for name in names), "end_header",
    ]  # fmt: skip
    return ("\n".join(header) + "\n").encode() + np.concatenate(columns, axis=1).astype("<f4").tobytes()


def _checked(path: Path, splats: Splats) -> Splats:
    """Returns the splats with unit quaternions.

    Raises:
        MeshError: a value is NaN or too large.
    """
    limits = ((splats.positions, "position"), (splats.scales, "scale"), (splats.quats_xyzw, "rotation"), (splats.sh, "colour"))
    for values, what in (*limits, (splats.opacities, "opacity")):
        invalid = ~(np.abs(values) <= FARTHEST).reshape(len(splats), -1).all(axis=1)
        if invalid.any():
            row = int(invalid.argmax())
            values_text = " ".join(f"{number:g}" for number in np.atleast_1d(values[row]).ravel()[:4])
            raise MeshError(
                f"{path}: the {what} of {np.count_nonzero(invalid)} of {len(splats)} splats is NaN or beyond {FARTHEST:g} (splat {row}: "
                f"{values_text}); the file is broken: clean it in SuperSplat"
            )
    lengths = np.linalg.norm(splats.quats_xyzw, axis=1, keepdims=True)
    # A quaternion of length 0 is replaced by the identity; the splats of such files are spheres.
    identity = np.array([0.0, 0.0, 0.0, 1.0], dtype=np.float32)
    quats = np.where(lengths > 1e-12, splats.quats_xyzw / np.maximum(lengths, 1e-12), identity).astype(np.float32)
    return Splats(
        splats.positions, splats.scales, quats, splats.opacities, splats.sh, splats.up_axis, int((lengths <= 1e-12).sum())
    )


def _check_count(path: Path, count: int) -> None:
    """Raises MeshError if there are no splats, or too many."""
    if not count:
        raise MeshError(f"{path}: holds no splats")
    if count > MAX_SPLATS:
        raise MeshError(f"{path}: has {count} splats, must have at most {MAX_SPLATS}; prune it, for example with SuperSplat")


def _from_ply(path: Path, data: bytes) -> Splats:
    tables = read_ply_tables(path, data)
    vertex: Table = tables.get("vertex", {})
    if "chunk" in tables and "packed_position" in vertex:
        return _from_compressed(path, tables["chunk"], vertex, tables.get("sh", {}))
    required = ("x", "y", "z", "f_dc_0", "opacity", "scale_0", "rot_0")
    missing = [name for name in required if name not in vertex]
    if missing:
        what = "is a mesh" if "face" in tables else "is a point cloud" if "x" in vertex else "is another PLY"
        raise MeshError(f"{path}: {what}, not splats: its vertices have no {', '.join(missing)}; {ADVICE}")
    _check_count(path, len(vertex["x"]))
    dc, scales, quats = (
        _columns(path, vertex, names)
        for names in (["f_dc_0", "f_dc_1", "f_dc_2"], [f"scale_{k}" for k in range(3)], [f"rot_{k}" for k in (1, 2, 3, 0)])
    )
    rest = _rest(path, vertex)
    sh = np.concatenate([dc[:, None], rest], axis=1)
    opacities = _columns(path, vertex, ["opacity"])[:, 0]
    return Splats(_columns(path, vertex, list("xyz")), _exp(scales), quats, _sigmoid(opacities), sh)


def _columns(path: Path, table: Table, names: list[str]) -> F32:
    """Returns columns of a table as an array (N, len(names))."""
    missing = [name for name in names if name not in table]
    if missing:
        raise MeshError(f"{path}: the splats have no {', '.join(missing)}; the PLY is broken")
    with np.errstate(over="ignore"):
        return np.stack([np.asarray(table[name], dtype=np.float32) for name in names], axis=1)


def _rest(path: Path, table: Table) -> F32:
    """Returns the coefficients above degree 0, (N, 0, 3), (N, 3, 3), (N, 8, 3) or (N, 15, 3); files store them colour by colour."""
    count = sum(name.startswith("f_rest_") for name in table)
    if count not in _SH_COUNTS:
        raise MeshError(f"{path}: has {count} columns f_rest_, must have {', '.join(map(str, _SH_COUNTS))}")
    rows = len(next(iter(table.values()))) if table else 0
    if not count:
        return np.zeros((rows, 0, 3), dtype=np.float32)
    columns = _columns(path, table, [f"f_rest_{k}" for k in range(count)])
    return np.ascontiguousarray(columns.reshape(rows, 3, count // 3).transpose(0, 2, 1))


def _exp(values: F32) -> F32:
    with np.errstate(over="ignore", invalid="ignore"):
        return np.exp(values)


def _sigmoid(values: F32) -> F32:
    with np.errstate(over="ignore", invalid="ignore"):
        return np.asarray(1.0 / (1.0 + np.exp(-values)), dtype=np.float32)


def _from_compressed(path: Path, chunk: Table, vertex: Table, rest: Table) -> Splats:
    """Returns the splats of a compressed PLY: each chunk of 256 has a value range, in which the values of its splats are quantised."""
    count = len(vertex["packed_position"])
    _check_count(path, count)
    chunks = -(-count // _CHUNK)
    if any(len(values) != chunks for values in chunk.values()):
        raise MeshError(
            f"{path}: {count} splats are in {chunks} chunks, the file has {len(next(iter(chunk.values())))}; it is broken"
        )
    packed: list[NDArray[np.uint32]] = []
    for name in ("packed_position", "packed_rotation", "packed_scale", "packed_color"):
        column = vertex.get(name)
        if column is None or column.dtype.kind != "u" or column.dtype.itemsize != 4:
            raise MeshError(f"{path}: the splats have no {name} of type uint; the compressed PLY is broken")
        packed.append(np.asarray(column, dtype=np.uint32))
    row = np.arange(count) // _CHUNK

    def interpolated(fractions: F32, names: list[str]) -> F32:
        low, high = (_columns(path, chunk, [f"{end}_{name}" for name in names])[row] for end in ("min", "max"))
        with np.errstate(over="ignore", invalid="ignore"):
            return np.asarray(low * (1.0 - fractions) + high * fractions, dtype=np.float32)

    position, rotation, scale, color = packed
    colors = np.stack([_bits(color, shift, 8) for shift in (24, 16, 8, 0)], axis=1)
    rgb = interpolated(colors[:, :3], ["r", "g", "b"]) if "min_r" in chunk else colors[:, :3]
    higher = _rest(path, rest) if rest else np.zeros((count, 0, 3), dtype=np.float32)
    if len(higher) != count:
        raise MeshError(f"{path}: {count} splats have {len(higher)} rows of spherical harmonics; the compressed PLY is broken")
    if rest:
        # Bytes in 256 steps from -4 to 4; the first and the last value are the exact ends.
        fractions = np.where(higher == 0.0, 0.0, np.where(higher == 255.0, 1.0, (higher + 0.5) / 256.0))
        higher = np.asarray((fractions - 0.5) * 8.0, dtype=np.float32)
    with np.errstate(over="ignore", invalid="ignore"):  # infinite values are rejected by _checked
        sh = np.concatenate([((rgb - 0.5) / SH_DC)[:, None], higher], axis=1).astype(np.float32)
    return Splats(
        interpolated(_bits_11_10_11(position), list("xyz")),
        _exp(interpolated(_bits_11_10_11(scale), ["scale_x", "scale_y", "scale_z"])),
        _smallest_three(
            rotation >> np.uint32(30),
            np.stack([_bits(rotation, shift, 10) - 0.5 for shift in (20, 10, 0)], axis=1) * 2.0**0.5,
            "wxyz",
        ),
        np.ascontiguousarray(colors[:, 3]),
        sh,
    )


def _bits(packed: NDArray[np.uint32], shift: int, bits: int) -> F32:
    """Returns a bit field of each number, normalised to 0 to 1."""
    mask = (1 << bits) - 1
    return np.asarray(((packed >> np.uint32(shift)) & np.uint32(mask)) / np.float32(mask), dtype=np.float32)


def _bits_11_10_11(packed: NDArray[np.uint32]) -> F32:
    return np.stack([_bits(packed, 21, 11), _bits(packed, 11, 10), _bits(packed, 0, 11)], axis=1)


def _smallest_three(largest: NDArray[np.uint32], others: NDArray[Any], order: str) -> F32:
    """Returns quaternions (x, y, z, w), (N, 4), from the "smallest three" encoding.

    Args:
        largest: index of the largest component, which is omitted, (N,).
        others: the other three components, (N, 3).
        order: order of the components in the file, ``xyzw`` or ``wxyz``.
    """
    count = len(largest)
    quats = np.zeros((count, 4), dtype=np.float32)
    index = np.arange(4)[None, :] != largest[:, None]
    quats[index] = others.ravel()
    quats[np.arange(count), largest] = np.sqrt(np.maximum(1.0 - np.square(others).sum(axis=1), 0.0))
    return np.ascontiguousarray(quats[:, [order.index(axis) for axis in "xyzw"]])


def _from_spz(path: Path, data: bytes) -> Splats:
    """Returns the splats of an SPZ file, whose axes are right, up, back."""
    if data.startswith(_SPZ_MAGIC):
        version, count, bits, sections = _spz_streams(path, data)
    else:
        version, count, bits, sections = _spz_gzip(path, data)
    positions, alphas, colors, scales, rotations, rest = sections
    if version == 1:
        xyz = positions.view("<f2").reshape(count, 3).astype(np.float32)
    else:
        p = positions.reshape(count, 3, 3).astype(np.int32)
        fixed = p[..., 0] | p[..., 1] << 8 | p[..., 2] << 16
        fixed -= (fixed & 0x800000) << 1
        xyz = np.asarray(fixed / float(1 << bits), dtype=np.float32)
    dc = (colors.reshape(count, 1, 3) / 255.0 - 0.5) / _SPZ_COLOR
    higher = (rest.reshape(count, -1, 3)[:, :15] - 128.0) / 128.0
    return Splats(
        xyz,
        _exp(np.asarray(scales.reshape(count, 3) / 16.0 - 10.0, dtype=np.float32)),
        _spz_rotations(version, count, rotations),
        np.asarray(alphas / 255.0, dtype=np.float32),
        np.concatenate([dc, higher], axis=1).astype(np.float32),
        "y",
    )


def _spz_rotations(version: int, count: int, data: NDArray[np.uint8]) -> F32:
    """Returns the quaternions (x, y, z, w), (N, 4)."""
    if version < 3:
        xyz = data.reshape(count, 3) / 127.5 - 1.0
        w = np.sqrt(np.maximum(1.0 - np.square(xyz).sum(axis=1, keepdims=True), 0.0))
        return np.concatenate([xyz, w], axis=1).astype(np.float32)
    packed: NDArray[np.uint32] = data.view("<u4")
    parts = [(packed >> np.uint32(shift)) & np.uint32(1023) for shift in (20, 10, 0)]
    signed = [np.where(part & 512, -1.0, 1.0) * (part & 511) / 511.0 for part in parts]
    return _smallest_three(packed >> np.uint32(30), np.stack(signed, axis=1) * 0.5**0.5, "xyzw")


def _spz_sizes(path: Path, version: int, count: int, degree: int) -> list[int]:
    """Returns the sizes of the sections, bytes.

    Raises:
        MeshError: the header has an invalid value.
    """
    if version not in (1, 2, 3, 4):
        raise MeshError(f"{path}: is SPZ of version {version}; known: 1 to 4")
    if degree >= len(_SPZ_SH_COUNTS):
        raise MeshError(f"{path}: has spherical harmonics of degree {degree}, must be 0 to {len(_SPZ_SH_COUNTS) - 1}")
    _check_count(path, count)
    each = (6 if version == 1 else 9, 1, 3, 3, 3 if version < 3 else 4, _SPZ_SH_COUNTS[degree])
    return [size * count for size in each]


def _spz_gzip(path: Path, data: bytes) -> tuple[int, int, int, list[NDArray[np.uint8]]]:
    """Returns version, number of splats, fractional bits and the sections of an SPZ of versions 1 to 3."""
    unpacker = zlib.decompressobj(16 + zlib.MAX_WBITS)
    try:
        head = unpacker.decompress(data, 16)
        if len(head) < 16 or not head.startswith(_SPZ_MAGIC):
            raise MeshError(f"{path}: is a gzip file, but not SPZ; {ADVICE}")
        version, count, degree, bits = (
            int.from_bytes(head[4:8], "little"),
            int.from_bytes(head[8:12], "little"),
            head[12],
            head[13],
        )
        sizes = _spz_sizes(path, version, count, degree)
        total = sum(sizes)
        # Limited to the size in the header: a file of a few bytes may decompress to any size.
        body = unpacker.decompress(unpacker.unconsumed_tail, total) if total else b""
    except zlib.error as e:
        raise MeshError(f"{path}: the SPZ cannot be unpacked ({e}); it is broken") from e
    if len(body) < total:
        raise MeshError(f"{path}: {count} splats need {total} bytes, the SPZ holds {len(body)}; it is cut")
    everything = np.frombuffer(body, dtype=np.uint8)
    return version, count, min(bits, 24), np.split(everything, np.cumsum(sizes)[:-1])


def _spz_streams(path: Path, data: bytes) -> tuple[int, int, int, list[NDArray[np.uint8]]]:
    """Same as ``_spz_gzip``, for version 4: a table of contents, and a Zstandard stream for each non-empty section."""
    if len(data) < 32:
        raise MeshError(f"{path}: the SPZ has {len(data)} bytes, its header 32; it is cut")
    version, count = int.from_bytes(data[4:8], "little"), int.from_bytes(data[8:12], "little")
    if version < 4:
        raise MeshError(
            f"{path}: is an SPZ of version {version} that is not compressed, as such a file must be: compress it with gzip"
        )
    degree, bits, streams, table = data[12], data[13], data[15], int.from_bytes(data[16:20], "little")
    sizes = _spz_sizes(path, version, count, degree)
    at = table + 16 * streams
    filled = [size for size in sizes if size]
    if len(filled) != streams or at > len(data):
        raise MeshError(f"{path}: the SPZ has {streams} streams, must have {len(filled)}, or it is cut")
    sections: list[NDArray[np.uint8]] = []
    entry = table
    for size in sizes:
        if not size:
            sections.append(np.zeros(0, dtype=np.uint8))
            continue
        packed = int.from_bytes(data[entry : entry + 8], "little")
        try:
            content = (
                zstandard.ZstdDecompressor().decompressobj().decompress(data[at : at + packed])
                if _frame_size(data, at) == size
                else b""
            )
        except zstandard.ZstdError as e:
            raise MeshError(f"{path}: the SPZ cannot be unpacked ({e}); it is broken") from e
        if len(content) != size:
            raise MeshError(f"{path}: a section of the SPZ has {len(content)} bytes, must have {size}; it is cut or broken")
        sections.append(np.frombuffer(content, dtype=np.uint8))
        entry, at = entry + 16, at + packed
    return version, count, min(bits, 24), sections


def _frame_size(data: bytes, at: int) -> int:
    """Returns the decompressed size in the header of a Zstandard frame, so that a small file cannot fill the memory."""
    return zstandard.frame_content_size(data[at : at + 18])
