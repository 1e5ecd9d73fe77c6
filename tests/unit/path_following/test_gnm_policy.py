"""Networks with the inputs and outputs of GNM, ViNT and NoMaD drive a path; other files are refused in one line."""

from __future__ import annotations

import math
import os
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gibson_path_following.errors import ModelError, SettingError, ViewError
from gibson_path_following.policies.backends import make_policy
from gibson_path_following.policies.gnm_policy import Diffusion, GnmPolicy, GnmSettings, open_network, velocity_to
from gibson_path_following.types import PathNode, Place, RecordedPath, Velocity
from support import onnx_bytes as ox
from support.path_views import fisheye_view, straight_path

STEP = 250_000_000
"""A quarter of a second, ns."""
HERE = Place(3.0, 1.0, False)


def flat_path(levels: list[int]) -> RecordedPath:
    """Returns a path whose nodes are grey images of some levels."""
    path = straight_path(len(levels))
    nodes = zip(path.nodes, levels, strict=True)
    return replace(path, nodes=tuple(replace(node, view=(np.full((64, 96, 3), level, np.uint8),)) for node, level in nodes))


def grey(level: int) -> tuple[np.ndarray, ...]:
    return (np.full((64, 96, 3), level, np.uint8),)


def goal_network(batch: int | str = "batch", frame: int = 5, waypoints: int = 5) -> bytes:
    """Returns a network with the signature of GNM and ViNT.

    The distance is 10 times the difference of the sub-goal and image ``frame`` (0 = the oldest). Waypoint k is (k + 1) steps ahead and, for
    a sub-goal brighter than the mean of ImageNet, to the left: by its mean value.
    """
    ahead, aside = np.zeros((2, 1, waypoints, 4), dtype=np.float32)
    ahead[0, :, 0], ahead[0, :, 2], aside[0, :, 1] = np.arange(waypoints) + 1.0, 1.0, 1.0
    first, end = np.array([3 * frame], dtype=np.int64), np.array([3 * frame + 3], dtype=np.int64)
    return ox.model(
        [
            ox.node("Slice", ["obs_img", "first", "end", "channels"], "image"),
            ox.node("Sub", ["image", "goal_img"], "difference"),
            ox.node("Abs", ["difference"], "absolute"),
            ox.node("ReduceMean", ["absolute"], "mean", axes=[1, 2, 3], keepdims=0),
            ox.node("Mul", ["mean", "ten"], "scaled"),
            ox.node("Reshape", ["scaled", "column"], "distance"),
            ox.node("ReduceMean", ["goal_img"], "level", axes=[1, 2, 3], keepdims=0),
            ox.node("Reshape", ["level", "cube"], "levels"),
            ox.node("Mul", ["levels", "aside"], "sideways"),
            ox.node("Add", ["sideways", "ahead"], "action"),
        ],
        [ox.value("obs_img", "float32", [batch, 18, 64, 85]), ox.value("goal_img", "float32", [batch, 3, 64, 85])],
        [ox.value("distance", "float32", [batch, 1]), ox.value("action", "float32", [batch, waypoints, 4])],
        {
            "first": first,
            "end": end,
            "channels": np.array([1], dtype=np.int64),
            "ten": np.float32(10.0),
            "column": np.array([-1, 1], dtype=np.int64),
            "cube": np.array([-1, 1, 1], dtype=np.int64),
            "ahead": ahead,
            "aside": aside,
        },
    )


def nomad_files(folder: Path) -> Path:
    """Writes networks with the signature of NoMaD; the noise that they predict leaves a trajectory of one step ahead each."""
    (folder / "encoder.onnx").write_bytes(
        ox.model(
            [
                ox.node("Slice", ["obs_img", "first", "end", "channels"], "image"),
                ox.node("Sub", ["image", "goal_img"], "difference"),
                ox.node("ReduceMean", ["difference"], "features", axes=[2, 3], keepdims=0),
            ],
            [
                ox.value("obs_img", "float32", [1, 12, 96, 96]),
                ox.value("goal_img", "float32", [1, 3, 96, 96]),
                ox.value("input_goal_mask", "int64", [1]),
            ],
            [ox.value("features", "float32", [1, 3])],
            {
                "first": np.array([9], dtype=np.int64),
                "end": np.array([12], dtype=np.int64),
                "channels": np.array([1], dtype=np.int64),
            },
        )
    )
    (folder / "distance.onnx").write_bytes(
        ox.model(
            [
                ox.node("Abs", ["features"], "absolute"),
                ox.node("ReduceMean", ["absolute"], "mean", axes=[1], keepdims=1),
                ox.node("Mul", ["mean", "ten"], "distance"),
            ],
            [ox.value("features", "float32", ["batch", 3])],
            [ox.value("distance", "float32", ["batch", 1])],
            {"ten": np.float32(10.0)},
        )
    )
    # The share of the signal after step t of 10: f((t + 1) / 10) / f(0), f(s) = cos((s + 0.008) / 1.008 pi / 2) squared, and at most 0.999
    # of it is lost at once. One step ahead is -1 + 2 (1 + 2.5) / 7.5 in the units of the actions.
    kept = np.cos((np.arange(11) / 10 + 0.008) / 1.008 * math.pi / 2) ** 2
    kept = kept[1:] / kept[0]
    kept[9] = kept[8] * 0.001
    clean = np.array([[[-1.0 + 2.0 * 3.5 / 7.5, 0.0]]], dtype=np.float32)
    (folder / "action.onnx").write_bytes(
        ox.model(
            [
                ox.node("Gather", ["signal", "timestep"], "kept"),
                ox.node("Gather", ["noise", "timestep"], "lost"),
                ox.node("Mul", ["kept", "clean"], "known"),
                ox.node("Sub", ["sample", "known"], "rest"),
                ox.node("Div", ["rest", "lost"], "predicted"),
            ],
            [
                ox.value("sample", "float32", ["samples", 8, 2]),
                ox.value("timestep", "int64", []),
                ox.value("global_cond", "float32", ["samples", 3]),
            ],
            [ox.value("predicted", "float32", ["samples", 8, 2])],
            {"signal": np.sqrt(kept).astype(np.float32), "noise": np.sqrt(1.0 - kept).astype(np.float32), "clean": clean},
        )
    )
    return folder


def write(tmp_path: Path, content: bytes) -> Path:
    file = tmp_path / "network.onnx"
    file.write_bytes(content)
    return file


@pytest.mark.parametrize("batch", ["batch", 1, 4])
def test_the_nearest_node_by_temporal_distance_is_the_sub_goal_or_the_one_after_it(tmp_path: Path, batch: int | str) -> None:
    path = flat_path([20, 60, 100, 140, 180, 220])
    policy = GnmPolicy(path, write(tmp_path, goal_network(batch)), GnmSettings(close_threshold=3.0))
    policy.act(grey(140), 0, HERE)
    assert policy.sub_goal == 4  # node 3 is at distance 0, which is close
    policy.reset()
    # Between nodes 2 and 3: 20 levels are 20 / 255 / 0.226 x 10 = 3.5 steps from both, of which the first is not close.
    policy.act(grey(120), 0, HERE)
    assert policy.sub_goal in (2, 3)
    near = GnmPolicy(path, policy.network, GnmSettings(search_radius=1))
    near.act(grey(20), 0, HERE)
    assert near.sub_goal == 2  # nodes 2 to 4 alone are looked at


def test_the_waypoint_becomes_an_arc(tmp_path: Path) -> None:
    # Waypoint 2 is 3 steps of 0.5 / 4 m ahead and m steps to the left, m the mean of the sub-goal's image; in 0.75 s.
    path = flat_path([115] * 6)
    found = GnmPolicy(path, write(tmp_path, goal_network())).act(grey(115), 0, HERE)
    mean = float(np.mean((115 / 255 - np.array([0.485, 0.456, 0.406])) / np.array([0.229, 0.224, 0.225])))
    assert found.linear == pytest.approx(0.125 * math.hypot(3.0, mean) / 0.75, abs=1e-4)
    assert found.angular == pytest.approx(2.0 * math.atan2(mean, 3.0) / 0.75, abs=1e-4)


@pytest.mark.parametrize(
    ("waypoint", "velocity"),
    [
        ((3.0, 0.0), Velocity(0.5, 0.0)),
        ((1.5, 0.0), Velocity(0.25, 0.0)),
        ((30.0, 0.0), Velocity(0.5, 0.0)),
        ((0.3, -0.3), Velocity(0.125 * 0.3 * math.sqrt(2.0) / 0.75, -1.0)),
        ((-1.0, 0.1), Velocity(0.0, 1.0)),
        ((0.0, 0.0), Velocity(0.0, 0.0)),
    ],
)
def test_velocities_to_waypoints(waypoint: tuple[float, float], velocity: Velocity) -> None:
    found = velocity_to(np.array(waypoint, dtype=np.float32), 3, GnmSettings(max_linear=0.5, max_angular=1.0, rate_hz=4.0))
    assert (found.linear, found.angular) == pytest.approx((velocity.linear, velocity.angular))


def test_earlier_images_are_a_quarter_of_a_second_apart(tmp_path: Path) -> None:
    # The network compares with the oldest of six images: 1.25 s ago. Images come every 0.125 s, each another node.
    path = flat_path([10, 30, 50, 70, 90, 110, 130, 150, 170, 190, 210, 230])
    policy = GnmPolicy(path, write(tmp_path, goal_network(frame=0)), GnmSettings(close_threshold=0.0, search_radius=20))
    for i in range(12):
        policy.act(grey(10 + 20 * i), i * STEP // 2, HERE)
        assert policy.sub_goal == max(0, i - 10)
    policy.reset()
    policy.act(grey(130), 0, HERE)
    assert policy.sub_goal == 6  # the first image stands for those before it


def test_nomad_draws_its_trajectory_by_diffusion(tmp_path: Path) -> None:
    path = flat_path([20, 60, 100, 140, 180, 220])
    policy = GnmPolicy(path, nomad_files(tmp_path))
    assert (policy.network.frames, policy.network.size) == (4, (96, 96))
    found = policy.act(grey(100), 0, HERE)
    assert policy.sub_goal == 3  # the one after node 2
    # Three steps ahead in three steps of time.
    assert (found.linear, found.angular) == pytest.approx((0.5, 0.0), abs=1e-3)


def test_the_schedule_of_the_diffusion() -> None:
    found = Diffusion(10)
    # cos(0.108 / 1.008 pi / 2)^2 / cos(0.008 / 1.008 pi / 2)^2 = 0.971939 / 0.999845
    assert found.alpha_bar[0] == pytest.approx(0.97209, abs=1e-4)
    assert found.beta[9] == 0.999
    clean = found.previous_sample(
        np.full((1, 1, 2), 0.5, np.float32), np.zeros((1, 1, 2), np.float32), 0, np.random.default_rng(0)
    )
    assert clean == pytest.approx(0.5 / math.sqrt(0.97209), abs=1e-4)  # step 0 leaves the clean sample


def _two_images() -> bytes:
    shape = ["batch", 3, 64, 85]
    inputs = [ox.value("a", "float32", shape), ox.value("b", "float32", shape)]
    return ox.model([ox.node("Add", ["a", "b"], "c")], inputs, [ox.value("c", "float32", shape)])


def _sum_of_images() -> bytes:
    inputs = [ox.value("a", "float32", ["b", 18, 64, 85]), ox.value("g", "float32", ["b", 3, 64, 85])]
    nodes = [ox.node("Identity", ["g"], "distance"), ox.node("Identity", ["a"], "action")]
    shape = ["b", "c", "h", "w"]
    return ox.model(nodes, inputs, [ox.value("distance", "float32", shape), ox.value("action", "float32", shape)])


def _with_external_data(file: str) -> bytes:
    inputs = [ox.value("a", "float32", [1])]
    tensors = [ox.external_tensor("w", [1], file)]
    return ox.model([ox.node("Add", ["a", "w"], "c")], inputs, [ox.value("c", "float32", [1])], tensors)


def _texts() -> bytes:
    inputs = [ox.value("images", "float32", ["batch", 18, 64, 85]), ox.value("goal", "float32", ["batch", 3, 64, 85])]
    return ox.model([ox.node("Cast", ["goal"], "texts", to=8)], inputs, [ox.value("texts", "string", ["batch", 3, 64, 85])])


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (_texts(), r"network\.onnx: an output holds texts, maps or sequences, must be an array of numbers; export it again"),
        (b"", r"network\.onnx is empty, or holds only zeros; export it again"),
        (b"GIF89a and so on", r"network\.onnx is not an ONNX file, or is truncated"),
        (goal_network()[:-200], r"network\.onnx is not an ONNX file, or is truncated"),
        (_with_external_data("/etc/hostname"), r"network\.onnx has its weights in other files, which are not read"),
        (_two_images(), r"its inputs are a \['batch', 3, 64, 85\], b .*; must be images \(batch, 3 frames, height, width\)"),
        (_sum_of_images(), r"its outputs have shapes .*, must be a distance \(batch, 1\) and waypoints"),
        (goal_network(batch=100_000), r"a batch of 100000, must be 1 to 256, or free"),
        (goal_network(waypoints=0), r"must be a distance \(batch, 1\) and waypoints"),
    ],
)
def test_a_file_without_a_gnm_network_is_refused_in_one_line(tmp_path: Path, content: bytes, words: str) -> None:
    with pytest.raises(ModelError, match=words) as caught:
        open_network(write(tmp_path, content))
    assert "\n" not in str(caught.value) and len(str(caught.value)) < 500


def test_a_place_without_a_network_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ModelError, match=r"cannot read .*none\.onnx: No such file or directory; give an ONNX file"):
        open_network(tmp_path / "none.onnx")
    with pytest.raises(ModelError, match=r"encoder\.onnx, distance\.onnx, action\.onnx missing; a folder of NoMaD has"):
        open_network(tmp_path)
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(ModelError, match=r"pipe is not a regular file"):
        open_network(tmp_path / "pipe")
    nomad_files(tmp_path)
    (tmp_path / "action.onnx").write_bytes((tmp_path / "distance.onnx").read_bytes())
    with pytest.raises(ModelError, match=r"action\.onnx: its inputs are .*; must be actions \(samples, length, 2\)"):
        open_network(tmp_path)


def test_without_onnxruntime_one_line_says_what_to_install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "onnxruntime", None)
    with pytest.raises(
        ModelError, match=r"needs onnxruntime, which is not installed: pip install 'gibson_path_following\[onnx\]'"
    ):
        open_network(write(tmp_path, goal_network()))


def test_a_path_of_two_fisheyes_and_impossible_settings_are_refused(tmp_path: Path) -> None:
    nodes = tuple(PathNode(fisheye_view(i), i, 0.2 * i, ()) for i in range(2))
    with pytest.raises(ViewError, match=r"need a pinhole camera, the path is of a fisheye_pair; use teach_repeat"):
        GnmPolicy(RecordedPath("fisheye_pair", math.pi, nodes), tmp_path / "any.onnx")
    with pytest.raises(SettingError, match=r"rate_hz is 0, must be 0\.1 to 100"):
        GnmSettings(rate_hz=0.0)


def test_a_network_is_chosen_by_the_name_of_its_file(tmp_path: Path) -> None:
    policy, localiser = make_policy(f"onnx:{write(tmp_path, goal_network())}", straight_path(), max_linear=0.3)
    assert isinstance(policy, GnmPolicy) and policy.settings.max_linear == 0.3
    assert localiser.indices[-1] == 11.0
