"""Reading the files with several layers that Blender writes."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest

from gibson_sim.errors import GibsonSimError
from gibson_sim_tools.making.blender.exr import read_exr


def _attribute(name: str, kind: str, value: bytes) -> bytes:
    return f"{name}\0{kind}\0".encode() + struct.pack("<i", len(value)) + value


def _exr(channels: dict[str, np.ndarray], *, compression: int = 0, version: int = 2) -> bytes:
    """Returns a file; the first row of its data window is 5."""
    kinds = {np.dtype("<u4"): 0, np.dtype("<f2"): 1, np.dtype("<f4"): 2}
    names = sorted(channels)
    listed = b"".join(n.encode() + b"\0" + struct.pack("<iB3xii", kinds[channels[n].dtype], 0, 1, 1) for n in names) + b"\0"
    height, width = channels[names[0]].shape
    header = struct.pack("<ii", 20000630, version) + _attribute("channels", "chlist", listed)
    header += _attribute("compression", "compression", bytes([compression]))
    header += _attribute("dataWindow", "box2i", struct.pack("<4i", 0, 5, width - 1, 5 + height - 1)) + b"\0"
    rows = [b"".join(channels[n][k].tobytes() for n in names) for k in range(height)]
    blocks = [struct.pack("<ii", 5 + k, len(row)) + row for k, row in enumerate(rows)]
    first = len(header) + 8 * height
    offsets = [first + k * len(blocks[0]) for k in range(height)]
    return header + struct.pack(f"<{height}Q", *offsets) + b"".join(blocks)


def test_channels_of_all_types_have_their_rows(tmp_path: Path) -> None:
    wide = np.arange(6, dtype="<f4").reshape(2, 3) + 0.25
    path = tmp_path / "picture.exr"
    path.write_bytes(_exr({"View.Combined.R": wide, "View.Depth.Z": wide.astype("<f2"), "View.Index.X": wide.astype("<u4")}))
    read = read_exr(path)
    assert set(read) == {"View.Combined.R", "View.Depth.Z", "View.Index.X"}
    assert read["View.Combined.R"].tolist() == [[0.25, 1.25, 2.25], [3.25, 4.25, 5.25]]
    assert read["View.Depth.Z"].tolist() == read["View.Combined.R"].tolist()
    assert read["View.Index.X"].tolist() == [[0, 1, 2], [3, 4, 5]]


@pytest.mark.parametrize(
    ("data", "error"),
    [
        (b"", "has 0 bytes"),
        (b"\x89PNG\r\n\x1a\n", "is no OpenEXR file of one part"),
        (_exr({"R": np.zeros((1, 1), dtype="<f4")}, version=0x1002), "is no OpenEXR file of one part"),
        (_exr({"R": np.zeros((1, 1), dtype="<f4")}, compression=3), "is compressed, must not be"),
    ],
)
def test_other_layouts_are_refused(tmp_path: Path, data: bytes, error: str) -> None:
    path = tmp_path / "picture.exr"
    path.write_bytes(data)
    with pytest.raises(GibsonSimError, match=error):
        read_exr(path)
