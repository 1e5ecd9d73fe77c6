"""Makes splats, and the bytes of compressed PLY and SPZ files, for tests."""

from __future__ import annotations

import gzip
import struct

import numpy as np
import zstandard
from numpy.typing import NDArray

from gibson_sim.formats.splats import SH_DC, Splats

F32 = NDArray[np.float32]


def random_splats(count: int, degree: int = 0, seed: int = 0, size: float = 1.0) -> Splats:
    """Returns splats in a cube of side ``size`` around the origin."""
    rng = np.random.default_rng(seed)
    quats = rng.normal(size=(count, 4))
    quats /= np.linalg.norm(quats, axis=1, keepdims=True)
    sh = rng.normal(scale=0.1, size=(count, (degree + 1) ** 2, 3))
    sh[:, 0] = rng.uniform(-1.5, 1.5, size=(count, 3))
    return Splats(
        rng.uniform(-size / 2, size / 2, size=(count, 3)).astype(np.float32),
        np.exp(rng.uniform(-4.5, -2.5, size=(count, 3))).astype(np.float32) * np.float32(size),
        quats.astype(np.float32),
        rng.uniform(0.1, 0.95, size=count).astype(np.float32),
        sh.astype(np.float32),
    )


def compressed_ply(splats: Splats, *, colors: bool = True) -> bytes:
    """Returns a compressed PLY; ``colors``: each chunk has limits of the colours, too."""
    count = len(splats)
    chunks = -(-count // 256)
    rgb = splats.sh[:, 0] * SH_DC + 0.5
    logs = np.log(splats.scales)
    limits, packed = [], np.zeros((count, 4), dtype="<u4")
    for k in range(chunks):
        rows = slice(256 * k, min(256 * (k + 1), count))
        ranges = [_range(values[rows]) for values in (splats.positions, logs)]
        ranges += [_range(rgb[rows])] if colors else []
        limits.append(np.concatenate([np.concatenate(pair) for pair in ranges]))
        packed[rows, 0] = _111011(splats.positions[rows], *ranges[0])
        packed[rows, 2] = _111011(logs[rows], *ranges[1])
        low, high = ranges[2] if colors else (np.zeros(3), np.ones(3))
        parts = np.column_stack([(rgb[rows] - low) / (high - low), splats.opacities[rows]])
        bytes_ = np.rint(parts.clip(0.0, 1.0) * 255).astype(np.uint32)
        packed[rows, 3] = bytes_[:, 0] << 24 | bytes_[:, 1] << 16 | bytes_[:, 2] << 8 | bytes_[:, 3]
    packed[:, 1] = [_packed_quat(q[[3, 0, 1, 2]], 0.5, 1023) for q in splats.quats_xyzw]
    rest = splats.sh[:, 1:].transpose(0, 2, 1).reshape(count, -1)
    header = ["ply", "format binary_little_endian 1.0", f"element chunk {chunks}"]
    for kind in ("", "scale_"):
        header += [f"property float {end}_{kind}{axis}" for end in ("min", "max") for axis in "xyz"]
    header += [f"property float {end}_{c}" for end in ("min", "max") for c in "rgb"] if colors else []
    header += [
        f"element vertex {count}",
        *(f"property uint packed_{name}" for name in ("position", "rotation", "scale", "color")),
    ]
    if rest.shape[1]:
        header += [f"element sh {count}", *(f"property uchar f_rest_{k}" for k in range(rest.shape[1]))]
    body: bytes = np.array(limits, dtype="<f4").tobytes() + packed.tobytes()
    body += np.floor((rest / 8.0 + 0.5) * 256.0).clip(0, 255).astype(np.uint8).tobytes()
    return ("\n".join([*header, "end_header"]) + "\n").encode() + body


def _range(values: F32) -> tuple[F32, F32]:
    return values.min(axis=0), values.max(axis=0)


def _111011(values: F32, low: F32, high: F32) -> NDArray[np.uint32]:
    most = np.array([2047, 1023, 2047])
    parts = np.rint((values - low) / np.maximum(high - low, 1e-9) * most).astype(np.uint32)
    return np.asarray(parts[:, 0] << 21 | parts[:, 1] << 11 | parts[:, 2])


def _packed_quat(quat: F32, middle: float, most: int) -> int:
    """Returns the number of the largest component, and the others as unsigned fractions of 10 bits."""
    largest = int(np.abs(quat).argmax())
    signed = quat * np.sign(quat[largest])
    result = largest
    for k in range(4):
        if k != largest:
            result = result << 10 | round((float(signed[k]) * 0.5**0.5 + middle) * most)
    return result


def _spz_quat(quat: F32) -> int:
    """Returns the number of the largest component, and the others with a sign and 9 bits."""
    largest = int(np.abs(quat).argmax())
    signed = quat * np.sign(quat[largest])
    result = largest
    for k in range(4):
        if k != largest:
            result = result << 10 | (signed[k] < 0) << 9 | round(abs(float(signed[k])) / 0.5**0.5 * 511)
    return result


def spz(splats: Splats, version: int = 2, degree: int | None = None) -> bytes:
    """Returns an SPZ file of version 1 to 4; a ``degree`` of 4 adds coefficients of value 0."""
    count, bits = len(splats), 12
    sh_count = {0: 0, 1: 9, 2: 24, 3: 45, 4: 72}[splats.degree if degree is None else degree]
    rest = np.zeros((count, sh_count))
    known = splats.sh[:, 1:].reshape(count, -1)
    rest[:, : known.shape[1]] = known
    if version == 1:
        positions = splats.positions.astype("<f2").tobytes()
    else:
        fixed = np.rint(splats.positions * 2.0**bits).astype("<i4")
        positions = fixed.view(np.uint8).reshape(count, 3, 4)[:, :, :3].tobytes()
    if version < 3:
        sign = np.where(splats.quats_xyzw[:, 3:] < 0, -1.0, 1.0)
        rotations = np.rint(splats.quats_xyzw[:, :3] * sign * 127.5 + 127.5).clip(0, 255).astype(np.uint8).tobytes()
    else:
        rotations = np.array([_spz_quat(q) for q in splats.quats_xyzw], dtype="<u4").tobytes()
    sections = [
        positions,
        np.rint(splats.opacities * 255.0).astype(np.uint8).tobytes(),
        np.rint(splats.sh[:, 0] * 0.15 * 255.0 + 127.5).clip(0, 255).astype(np.uint8).tobytes(),
        np.rint((np.log(splats.scales) + 10.0) * 16.0).clip(0, 255).astype(np.uint8).tobytes(),
        rotations,
        np.rint(rest * 128.0 + 128.0).clip(0, 255).astype(np.uint8).tobytes(),
    ]
    used = splats.degree if degree is None else degree
    if version < 4:
        return gzip.compress(b"NGSP" + struct.pack("<IIBBBB", version, count, used, bits, 0, 0) + b"".join(sections), mtime=0)
    filled = [section for section in sections if section]
    streams = [zstandard.compress(section) for section in filled]
    head = b"NGSP" + struct.pack("<IIBBBBI12x", version, count, used, bits, 0, len(streams), 32)
    table = b"".join(struct.pack("<QQ", len(packed), len(plain)) for packed, plain in zip(streams, filled, strict=True))
    return head + table + b"".join(streams)
