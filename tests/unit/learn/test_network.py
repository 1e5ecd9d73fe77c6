"""Network, training and export. They need PyTorch, which ``make setup`` does not install."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gibson_path_following.localisation.pose_filter import OffsetCalibration
from gibson_path_following.obstacles.floor_plane import FloorPlane
from gibson_path_following.policies.path_model import PathModel
from gibson_sim_learn.path_following.data import DIRECTIONS, FREE_EDGES, PAIR, Shard
from gibson_sim_learn.path_following.drawing import CAMERA_HEIGHT, HFOV
from gibson_sim_learn.path_following.sampling import Sampler
from gibson_sim_learn.path_following.settings import DistanceSettings, TrainingSettings

torch = pytest.importorskip("torch")  # "could not import 'torch'"
SETTINGS = TrainingSettings(iterations=3, later=4, evaluate_every=2, bfloat16=False)


def sampler() -> Sampler:
    rng = np.random.default_rng(0)
    pairs = np.array([(k, k - 1, 0.5, 0.1, 0.0, True) for k in range(1, 6)], dtype=PAIR)
    images = rng.integers(0, 256, (6, 64, 96, 3)).astype(np.uint8)
    earlier = {"earlier": images[::-1].copy(), "earlier_pose": np.tile(np.float32([-0.2, 0.0, 0.1]), (6, 1))}
    return Sampler([Shard(images, np.full((6, DIRECTIONS), 1.5, np.float32), pairs, **earlier)])


def test_interrupted_training_goes_on_as_if_it_had_not_been(tmp_path: Path) -> None:
    from gibson_sim_learn.path_following.training import PathTraining

    data = sampler()
    whole = PathTraining(tmp_path / "whole", SETTINGS)
    whole.run(data, data, 4)

    class Interrupted(Exception):
        pass

    def interrupt(text: str) -> None:
        if text.startswith("iteration 2:"):
            raise Interrupted

    with pytest.raises(Interrupted):
        PathTraining(tmp_path / "parts", SETTINGS).run(data, data, 4, interrupt)
    second = PathTraining(tmp_path / "parts", SETTINGS)
    assert second.iteration == 2
    second.run(data, data, 4)
    for one, other in zip(whole.network.state_dict().values(), second.network.state_dict().values(), strict=True):
        torch.testing.assert_close(one, other)
    assert [point.iteration for point in second.curve] == [2, 4]


def test_exported_network_gives_what_the_network_gives(tmp_path: Path) -> None:
    pytest.importorskip("onnx", reason="could not import 'torch' with its exporter onnx")
    from gibson_sim_learn.path_following.export import export_network
    from gibson_sim_learn.path_following.network import PathNetwork

    torch.manual_seed(0)
    network = PathNetwork().eval()
    size = export_network(network, tmp_path / "model.onnx", OffsetCalibration(0.25, 0.4))
    assert size < 10e6
    model = PathModel(tmp_path / "model.onnx")
    rng = np.random.default_rng(0)
    present, recorded = (rng.integers(0, 256, (n, 64, 96, 3)).astype(np.uint8) for n in (1, 3))
    found = model.estimate(present[0], recorded)
    with torch.no_grad():
        here, there = network.encode(torch.from_numpy(present)), network.encode(torch.from_numpy(recorded))
        expected = network.compare(here.expand(3, -1, -1, -1), there)
        hit = torch.softmax(network.free(here)[0], dim=1)
    np.testing.assert_allclose(found.pose, expected.pose.numpy(), atol=1e-4)
    np.testing.assert_allclose(found.match, torch.sigmoid(expected.match).numpy(), atol=1e-4)
    np.testing.assert_allclose(found.hit, hit.numpy(), atol=1e-5)
    assert found.hit.shape == (DIRECTIONS, len(FREE_EDGES))
    np.testing.assert_allclose(model.edges, FREE_EDGES)
    assert model.offsets == OffsetCalibration(0.25, 0.4)


def test_free_distances_go_on_as_if_they_had_not_been_interrupted(tmp_path: Path) -> None:
    from gibson_sim_learn.path_following.distances.training import DistanceTraining

    data = sampler()
    settings = replace(SETTINGS, distances=DistanceSettings(iterations=4, images=4))
    whole = DistanceTraining(tmp_path / "whole", settings)
    whole.run(data, data, (data, data))
    first = DistanceTraining(tmp_path / "parts", settings)
    first.run(data, data, (data, data), until=2)
    second = DistanceTraining(tmp_path / "parts", settings)
    assert second.iteration == 2
    second.run(data, data, (data, data))
    for one, other in zip(whole.network.state_dict().values(), second.network.state_dict().values(), strict=True):
        torch.testing.assert_close(one, other)
    assert [point.iteration for point in second.curve] == [2, 4]


def test_near_obstacles_predicted_as_far_and_far_ones_as_near_are_counted() -> None:
    from gibson_sim_learn.path_following.distances.training import miss_rates

    free = np.array([[0.5, 0.8, 2.0, 3.0, 1.5]], np.float32)
    # 0.5 m is told as twice as far; of the three that are free for 1 m, one is told as 0.7 m.
    assert miss_rates(np.array([[1.0, 0.9, 0.7, 3.0, 0.8]]), free) == pytest.approx((0.5, 1.0 / 3.0))


def test_exported_free_distances_are_those_of_their_own_network(tmp_path: Path) -> None:
    pytest.importorskip("onnx", reason="could not import 'torch' with its exporter onnx")
    from gibson_sim_learn.path_following.distances.network import DistanceNetwork
    from gibson_sim_learn.path_following.export import export_network
    from gibson_sim_learn.path_following.network import PathNetwork

    torch.manual_seed(0)
    network, distances = PathNetwork(), DistanceNetwork().eval()
    assert export_network(network, tmp_path / "model.onnx", OffsetCalibration(0.25, 0.4), distances) < 10e6
    assert network.training and not distances.training
    model = PathModel(tmp_path / "model.onnx")
    present, before = np.random.default_rng(0).integers(0, 256, (2, 64, 96, 3)).astype(np.uint8)
    pose = np.array([-0.3, 0.02, 0.1])
    floor = FloorPlane(96, 64, HFOV, CAMERA_HEIGHT)
    for earlier, warped in ((None, np.zeros_like(before)), ((before, pose), floor.warp(before, pose))):
        found = model.estimate(present, present[None], earlier)
        with torch.no_grad():
            hit = torch.softmax(distances(torch.from_numpy(present[None]), torch.from_numpy(warped[None]))[0], dim=1)
        np.testing.assert_allclose(found.hit, hit.numpy(), atol=1e-5)


def test_underestimated_offsets_are_measured() -> None:
    from gibson_sim_learn.path_following.training import calibrate_offsets

    rng = np.random.default_rng(0)
    true = rng.normal(0.0, 0.2, 20_000)
    found = calibrate_offsets(0.25 * true + rng.normal(0.0, 0.1, true.shape), true)
    assert (found.ratio, found.deviation) == pytest.approx((0.25, 0.4), rel=0.05)
