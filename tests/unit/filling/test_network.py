"""Networks that fill holes: the inputs of each kind, and the one-line errors for other files."""

from __future__ import annotations

import hashlib
import sys
from pathlib import Path

import numpy as np
import pytest

from gibson_sim.errors import ConfigError
from gibson_sim.filling import fillers, onnx_files
from gibson_sim.filling.fillers import LEARNED, PushPull, network_digests, open_filler
from gibson_sim.filling.holes import Filled
from gibson_sim.filling.network import FADE_PX
from support import onnx_bytes as ox
from support.filler_networks import generator, our_network, pipeline

COLOUR = np.random.default_rng(0).integers(0, 256, (20, 36, 3), dtype=np.uint8)
HOLE = np.zeros((20, 36), dtype=np.uint8)
HOLE[4:8, 10:20], HOLE[8:10, 10:20], HOLE[0, 0] = 1, 2, 3
DEPTH = np.where(HOLE == 1, np.inf, 4.0).astype(np.float32)
NORMALS = np.zeros((20, 36, 3), dtype=np.float32)
IS_HOLE = (HOLE == 1) | (HOLE == 2)


def fill(tmp_path: Path, content: bytes, *, with_depth: bool = False) -> Filled:
    file = tmp_path / "network.onnx"
    file.write_bytes(content)
    return open_filler(str(file)).fill(COLOUR, DEPTH, NORMALS, HOLE, with_depth=with_depth)


def test_our_network_gets_the_picture_after_push_pull_at_any_size(tmp_path: Path) -> None:
    expected = PushPull().fill(COLOUR, DEPTH, NORMALS, HOLE, with_depth=True)
    found = fill(tmp_path, our_network(), with_depth=True)
    assert np.array_equal(found.colour, expected.colour)
    assert np.array_equal(found.depth, expected.depth), "without depth of its own, push-pull fills depth"


def test_corrections_of_our_network_fade_with_the_distance_from_holes(tmp_path: Path) -> None:
    file = tmp_path / "network.onnx"
    file.write_bytes(our_network(gain=0.0))
    grey, depth, normals = (
        np.full((16, 200, 3), 200, np.uint8),
        np.ones((16, 200), np.float32),
        np.zeros((16, 200, 3), np.float32),
    )
    hole = np.zeros((16, 200), dtype=np.uint8)
    unchanged = open_filler(str(file)).fill(grey, depth, normals, hole, with_depth=True)
    assert np.array_equal(unchanged.colour, grey) and np.array_equal(unchanged.depth, depth), (
        "without a hole nothing is corrected"
    )
    hole[:, 0] = 1
    row = open_filler(str(file)).fill(grey, depth, normals, hole, with_depth=False).colour[8, :, 0].astype(float)
    distances = np.arange(200)
    assert np.abs(row - 200.0 * (1.0 - np.exp(-distances / FADE_PX))).max() <= 1.0
    assert row[0] == 0.0 and (row[120:] == 200.0).all()


def test_depth_of_our_network_is_used_in_holes_alone(tmp_path: Path) -> None:
    found = fill(tmp_path, our_network(depth=True), with_depth=True)
    # 1 / (0 + 0.5) where nothing is drawn, 1 / (1 / 4 + 0.5) at a back face.
    assert np.allclose(found.depth[HOLE == 1], 2.0) and np.allclose(found.depth[HOLE == 2], 4.0 / 3.0)
    assert (found.depth[~IS_HOLE] == 4.0).all()
    assert fill(tmp_path, our_network(depth=True)).depth is None


def test_negative_inverse_depth_of_a_network_is_not_used(tmp_path: Path) -> None:
    found = fill(tmp_path, our_network(depth=True, offset=-0.1), with_depth=True)
    # 0 - 0.1 where nothing is drawn, 1 / 4 - 0.1 at a back face.
    assert np.allclose(found.depth[HOLE == 1], 4.0) and np.allclose(found.depth[HOLE == 2], 1.0 / 0.15)


@pytest.mark.parametrize(("content", "painted"), [(pipeline(), 7), (generator(), 0)])
def test_third_party_networks_change_only_holes(tmp_path: Path, content: bytes, painted: int) -> None:
    found = fill(tmp_path, content, with_depth=True)
    assert np.array_equal(found.colour[~IS_HOLE], COLOUR[~IS_HOLE])
    assert (found.colour[5:7, 13:17] == painted).all()
    assert np.allclose(found.depth[IS_HOLE], 4.0)


def test_the_same_picture_gives_the_same_bits(tmp_path: Path) -> None:
    one, other = (fill(tmp_path, our_network(), with_depth=True) for _ in range(2))
    assert one.colour.tobytes() == other.colour.tobytes()


def _external() -> bytes:
    value = ox.value("input", "float32", [1, 9, 4, 4])
    return ox.model(
        [ox.node("Add", ["input", "w"], "image")], [value], [value], [ox.external_tensor("w", [1], "/etc/hostname")]
    )  # fmt: skip


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", r"network\.onnx is empty, or holds only zeros; export it again"),
        (b"GIF89a and so on", r"network\.onnx is not an ONNX file, or is truncated"),
        (our_network()[:-60], r"network\.onnx is not an ONNX file, or is truncated"),
        (_external(), r"network\.onnx has its weights in other files, which are not read"),
        (our_network(channels=5), r"has input input float \[1, 5, .* and output image .*must be one of: ours, float input \(1, 9, H, W\)"),
        (our_network(size=32), r"network\.onnx takes only images of 32x32 pixels, must take any size; export it with dynamic axes"),
        (our_network(version="2"), r"network\.onnx is for version '2' of the input format \(metadata gibson_filler\), must be for 1"),
        (our_network(nan=True), r"network\.onnx: its output holds a NaN or an infinity"),
    ],
)  # fmt: skip
def test_files_without_a_network_are_refused_in_one_line(tmp_path: Path, content: bytes, message: str) -> None:
    with pytest.raises(ConfigError, match=message) as caught:
        fill(tmp_path, content)
    assert "\n" not in str(caught.value)


def test_a_file_that_is_too_large_is_not_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(onnx_files, "MAX_BYTES", 100)
    with pytest.raises(ConfigError, match=r"cannot read '.*network\.onnx': .*give an ONNX file"):
        fill(tmp_path, our_network())


def test_without_onnxruntime_one_line_says_what_to_install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "onnxruntime", None)
    with pytest.raises(ConfigError, match=r"needs onnxruntime, which is not installed: pip install 'gibson_sim\[filler\]'"):
        fill(tmp_path, our_network())


def test_learned_is_the_file_in_the_package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fillers, "LEARNED", tmp_path / "filler.onnx")
    with pytest.raises(
        ConfigError, match="this installation has no learned network; give push_pull, or the path of an ONNX file"
    ):
        open_filler("learned")
    (tmp_path / "filler.onnx").write_bytes(our_network())
    assert open_filler("learned").fill(COLOUR, DEPTH, NORMALS, HOLE, with_depth=False).colour.shape == COLOUR.shape


def test_a_changed_file_of_a_network_has_another_digest(tmp_path: Path) -> None:
    file = tmp_path / "network.onnx"
    file.write_bytes(b"one")
    fills = ("", "push_pull", "learned", str(file))
    expected = {"learned": hashlib.sha256(LEARNED.read_bytes()).hexdigest(), str(file): hashlib.sha256(b"one").hexdigest()}
    assert network_digests(fills) == expected
    file.write_bytes(b"two")
    assert network_digests(fills)[str(file)] == hashlib.sha256(b"two").hexdigest()
    file.unlink()
    assert network_digests(fills)[str(file)] == ""
