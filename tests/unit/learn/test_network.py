"""Network, training and export. They need PyTorch, which ``make setup`` does not install."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from gibson_path_following.learned import PathModel
from gibson_sim_learn.path_following.data import DIRECTIONS, FREE_EDGES, PAIR, Shard
from gibson_sim_learn.path_following.sampling import Sampler
from gibson_sim_learn.path_following.settings import TrainingSettings

torch = pytest.importorskip("torch")  # "could not import 'torch'"
SETTINGS = TrainingSettings(iterations=3, later=4, evaluate_every=2, bfloat16=False)


def sampler() -> Sampler:
    rng = np.random.default_rng(0)
    pairs = np.array([(k, k - 1, 0.5, 0.1, 0.0, True) for k in range(1, 6)], dtype=PAIR)
    images = rng.integers(0, 256, (6, 64, 96, 3)).astype(np.uint8)
    return Sampler([Shard(images, np.full((6, DIRECTIONS), 1.5, np.float32), pairs)])


def test_interrupted_training_goes_on_as_if_it_had_not_been(tmp_path: Path) -> None:
    from gibson_sim_learn.path_following.training import Training

    data = sampler()
    whole = Training(tmp_path / "whole", SETTINGS)
    whole.run(data, data, 4)
    first = Training(tmp_path / "parts", SETTINGS)
    first._rate = lambda done, total: whole._rate(done, 4)  # type: ignore[method-assign]
    first.run(data, data, 2)
    second = Training(tmp_path / "parts", SETTINGS)
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
    size = export_network(network, tmp_path / "model.onnx")
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
