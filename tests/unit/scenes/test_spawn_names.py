"""Names of the catalogue that are mistyped."""

from __future__ import annotations

import json

import pytest

from gibson_sim.cli.command_line import run
from gibson_sim.scenes.spawning import SpawnError, load_spawnable
from gibson_sim.types import Pose


def test_a_mistyped_name_gets_the_nearest_one_and_the_command_that_lists_all_in_a_message_that_is_never_cut() -> None:
    with pytest.raises(SpawnError) as error:
        load_spawnable("bottle_watr", "", name="x", pose=Pose())
    text = "is neither a file nor a built-in model; did you mean 'bottle_water'? `gibson-sim spawn --list` lists all of them"
    assert error.value.public == text
    assert str(error.value) == f"bottle_watr: {text}"


def test_spawn_gets_only_its_own_arguments(monkeypatch: pytest.MonkeyPatch) -> None:
    given: list[str] = []
    monkeypatch.setattr("gibson_sim.cli.commands.ros_tools.require_nodes", lambda: None)
    monkeypatch.setattr("gibson_sim.cli.commands.ros_tools.become", lambda module, words, environment: given.extend(words))
    with pytest.raises(TypeError):  # the real one does not return
        run(["spawn", "person", "--at", "4,5"])
    assert json.loads(given[0]) == {"command": "spawn", "uri": "person", "at": [4.0, 5.0, 0.0], "name": ""}


def test_spawn_lists_all_built_in_models(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        run(["spawn", "--list"])
    assert ended.value.code == 0
    listed = capsys.readouterr().out.split("\n")
    assert {"person", "bottle_water", "gibson_bot"} <= set(listed)
