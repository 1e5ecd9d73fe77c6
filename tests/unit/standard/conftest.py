"""Simulators of a small world."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import pytest

from gibson_sim.config import PhysicsConfig
from gibson_sim.scenes.spec import SceneSpec
from gibson_sim.standard.simulator import Simulator
from support.yard import SCENE


@pytest.fixture
def make() -> Iterator[Callable[..., Simulator]]:
    """Makes simulators of ``SCENE`` with these settings, and closes them."""
    made: list[Simulator] = []

    def simulator(scene: SceneSpec | None = SCENE, **settings: object) -> Simulator:
        made.append(Simulator(scene, PhysicsConfig.of(**settings)))  # type: ignore[arg-type]
        return made[-1]

    yield simulator
    for one in made:
        one.close()
