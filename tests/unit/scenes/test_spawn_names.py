"""Names of the catalogue that are mistyped."""

from __future__ import annotations

import pytest

from gibson_sim.scenes.spawning import SpawnError, load_spawnable
from gibson_sim.types import Pose


def test_the_nearest_name_comes_before_the_list_and_the_mistyped_one_only_once() -> None:
    with pytest.raises(SpawnError) as error:
        load_spawnable("bottle_watr", "", name="x", pose=Pose())
    begin = "is neither a file nor a built-in model; did you mean 'bottle_water'? there are: ackermann_bot, "
    assert error.value.public.startswith(begin)
    assert str(error.value).startswith(f"bottle_watr: {begin}")
