"""The configuration of a training, and what the command says where PyTorch is missing."""

from __future__ import annotations

import argparse
from pathlib import Path

import pytest

from gibson_sim.errors import ConfigError
from gibson_sim_learn.cli import learn
from gibson_sim_learn.path_following.data import DataSettings
from gibson_sim_learn.path_following.settings import DistanceSettings, TrainingSettings, load_settings
from gibson_sim_learn.remaining import Remaining

_DOCS = Path(__file__).resolve().parents[3] / "docs"


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


def test_trial_configuration_of_the_docs_is_read_and_keeps_the_other_defaults() -> None:
    settings = load_settings(_DOCS / "examples" / "path_following_trial.yaml")
    assert (settings.iterations, settings.dagger_rounds, settings.distances.iterations) == (60, 1, 60)
    assert settings.learning_rate == TrainingSettings().learning_rate


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
    with pytest.raises(ConfigError, match="needs torch, which is not installed; in the checkout: pip install -c constraints"):
        learn.run(argparse.Namespace(config=None, folder=tmp_path, seed=None))
    assert not list(tmp_path.iterdir())


def test_an_interrupt_says_that_the_same_command_resumes(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("gibson_sim_learn.filler.pipeline.make_all_pairs", interrupt)
    monkeypatch.setattr("importlib.util.find_spec", lambda name: name)
    args = argparse.Namespace(folder=tmp_path, scenes=None)
    with pytest.raises(KeyboardInterrupt):
        learn.run_filler_pairs(args)
    assert capsys.readouterr().err == "interrupted; the same command resumes\n"


def test_remaining_time_is_never_zero_and_has_a_unit_that_fits() -> None:
    now_s = 0.0
    remaining = Remaining(10, lambda: now_s)
    assert remaining.text(10, 100) == ""
    now_s = 20.0  # 10 of the remaining 90 steps
    assert remaining.text(20, 100) == ", 3 min left"
    assert remaining.text(80, 100) == ", 6 s left"
    assert remaining.text(99, 100) == ", 1 s left"
    assert remaining.text(100, 100) == ""
    assert remaining.text(20, 20010) == ", 11.1 h left"


@pytest.mark.parametrize("page", ["path_following_training.md", "goggles.md"])
def test_docs_and_message_have_the_same_command_that_installs_pytorch(page: str) -> None:
    assert learn.INSTALL in (_DOCS / page).read_text(encoding="utf-8")
