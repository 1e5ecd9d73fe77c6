"""The folder of a training: its lock and its settings."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from gibson_sim.errors import ConfigError
from gibson_sim_learn.path_following.data import DataSettings
from gibson_sim_learn.path_following.settings import TrainingSettings, as_dict
from gibson_sim_learn.training_folder import SETTINGS, locked, training_folder


def test_settings_are_stored_before_the_training_begins(tmp_path: Path) -> None:
    with training_folder(tmp_path / "new", as_dict(TrainingSettings(seed=3)), ()):
        assert json.loads((tmp_path / "new" / SETTINGS).read_text())["seed"] == 3


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        (TrainingSettings(seed=1), r"holds a training with another seed \(0\); choose another --folder"),
        (
            TrainingSettings(data=DataSettings(paths=2)),
            r"holds a training with another data.paths \(8\); choose another --folder",
        ),
    ],
)
def test_another_training_is_refused_before_it_makes_data(tmp_path: Path, settings: TrainingSettings, message: str) -> None:
    with training_folder(tmp_path, as_dict(TrainingSettings()), ()):
        pass
    with pytest.raises(ConfigError, match=message), training_folder(tmp_path, as_dict(settings), ("iterations",)):
        pytest.fail("the block was entered")
    assert json.loads((tmp_path / SETTINGS).read_text())["seed"] == 0


def test_the_same_training_resumes_and_may_be_extended(tmp_path: Path) -> None:
    for iterations in (10, 10, 20):
        with training_folder(tmp_path, as_dict(TrainingSettings(iterations=iterations)), ("iterations",)):
            pass
    assert json.loads((tmp_path / SETTINGS).read_text())["iterations"] == 20


def test_a_folder_in_use_is_refused_in_one_line(tmp_path: Path) -> None:
    with (
        locked(tmp_path),
        pytest.raises(
            ConfigError, match="another `gibson-sim learn` works in this folder; wait for it, or choose another"
        ) as error,
        training_folder(tmp_path, {}, ()),
    ):
        pytest.fail("the block was entered")
    assert "\n" not in str(error.value)
    assert not (tmp_path / SETTINGS).exists()


def test_unreadable_settings_say_what_to_do(tmp_path: Path) -> None:
    (tmp_path / SETTINGS).write_text("{")
    with pytest.raises(ConfigError, match=r"cannot be read: .*; choose another --folder"), training_folder(tmp_path, {}, ()):
        pytest.fail("the block was entered")
