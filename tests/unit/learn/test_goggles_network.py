"""Network, training and export of Goggles. They need PyTorch, which ``make setup`` does not install."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from gibson_path_following.images.goggles import LearnedGoggles
from gibson_sim.errors import ConfigError
from gibson_sim_learn.goggles.pairs import Pairs
from gibson_sim_learn.goggles.settings import GogglesSettings

torch = pytest.importorskip("torch")  # "could not import 'torch'"
SETTINGS = GogglesSettings(iterations=3, batch=2, evaluate_every=2)


def pairs() -> list[Pairs]:
    rng = np.random.default_rng(0)
    clean = rng.integers(0, 256, (4, 64, 96, 3)).astype(np.uint8)
    return [Pairs(clean, (clean // 2)[:, None])]


def test_an_interrupted_training_goes_on_as_if_it_had_not_been(tmp_path: Path) -> None:
    from gibson_sim_learn.goggles.training import GogglesTraining

    data = pairs()
    whole = GogglesTraining(tmp_path / "whole", SETTINGS)
    whole.run(data, data)

    class Interrupted(Exception):
        pass

    def interrupt(text: str) -> None:
        if text.startswith("iteration 2:"):
            raise Interrupted

    with pytest.raises(Interrupted):
        GogglesTraining(tmp_path / "parts", SETTINGS).run(data, data, interrupt)
    again = GogglesTraining(tmp_path / "parts", SETTINGS)
    assert again.iteration == 2
    again.run(data, data)
    for name, weights in whole.network.state_dict().items():
        assert torch.equal(weights, again.network.state_dict()[name]), name
    assert [point.iteration for point in again.curve] == [2, 3]
    with pytest.raises(ConfigError, match="another batch"):
        GogglesTraining(tmp_path / "parts", GogglesSettings(iterations=3, batch=3, evaluate_every=2))


def test_an_untrained_network_leaves_images_of_any_size_as_they_are_in_its_file_too(tmp_path: Path) -> None:
    from gibson_sim_learn.goggles.export import export_network
    from gibson_sim_learn.goggles.network import GogglesNetwork

    assert export_network(GogglesNetwork(), tmp_path / "goggles.onnx") < 2_000_000
    adapt = LearnedGoggles(tmp_path / "goggles.onnx")
    for size in ((64, 96), (31, 57)):
        image = np.random.default_rng(1).integers(0, 256, (*size, 3)).astype(np.uint8)
        assert np.array_equal(adapt(image), image)


def test_a_checkpoint_of_another_version_is_refused_with_what_to_do(tmp_path: Path) -> None:
    from gibson_sim_learn.goggles.training import GogglesTraining

    GogglesTraining(tmp_path, SETTINGS).run(pairs(), pairs())
    file = tmp_path / "checkpoint.pt"
    content = torch.load(file, weights_only=False)
    del content["torch_rng"]
    torch.save(content, file)
    with pytest.raises(ConfigError, match=r"is from another version \('torch_rng'\); delete it to start anew"):
        GogglesTraining(tmp_path, SETTINGS)
