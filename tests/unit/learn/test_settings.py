"""The configuration of a training, and what the command says where PyTorch is missing."""

from __future__ import annotations

import argparse
from pathlib import Path

import pytest

from gibson_sim.errors import ConfigError
from gibson_sim_learn.cli import learn
from gibson_sim_learn.path_following.data import DataSettings
from gibson_sim_learn.path_following.settings import DistanceSettings, load_settings


def test_file_sets_what_it_names_and_the_option_sets_the_seed(tmp_path: Path) -> None:
    file = tmp_path / "training.yaml"
    file.write_text(
        "seed: 3\niterations: 10\nlearning_rate: 0.001\nbfloat16: false\ndata: {paths: 2, length: [1.0, 5.0]}\ndistances: {images: 8}\n"
    )
    settings = load_settings(file, seed=7)
    assert (settings.seed, settings.iterations, settings.learning_rate, settings.bfloat16) == (7, 10, 0.001, False)
    assert settings.data == DataSettings(paths=2, length=(1.0, 5.0))
    assert settings.distances == DistanceSettings(images=8)


def test_configuration_of_the_package_is_read() -> None:
    assert load_settings(None).seed == 0


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("iteration: 5", "did you mean 'iterations'"),
        ("iterations: 2.5", "iterations is 2.5, must be a whole number"),
        ("iterations: 0", "iterations is 0, must be 1 to 1e"),
        ("data: {path: 3}", "did you mean 'paths'"),
        ("distances: {obstacle_share: 2}", "obstacle_share is 2, must be 0 to 1"),
    ],
)
def test_mistakes_are_one_line(tmp_path: Path, text: str, message: str) -> None:
    file = tmp_path / "training.yaml"
    file.write_text(text)
    with pytest.raises(ConfigError, match=message) as error:
        load_settings(file)
    assert "\n" not in str(error.value)


def test_missing_pytorch_names_the_extra(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(ConfigError, match=r"needs torch, which is not installed: pip install gibson_sim_learn\[learn\]"):
        learn.run(argparse.Namespace(config=None, folder=tmp_path, seed=None))
    assert not list(tmp_path.iterdir())
