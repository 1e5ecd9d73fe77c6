"""The loop that the benchmarks time is physics, sensors and the velocities of its protocol, put together by hand."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from gibson_sim.maps.placement import populate
from gibson_sim.physics.world import PhysicsWorld
from gibson_sim.types import VelocityCommand
from gibson_sim_bench.loop import Loop
from gibson_sim_bench.protocol import SETTLE_S, STEP_HZ, RandomCommands, write_robot


def test_a_frame_of_the_loop_is_its_substeps_with_the_velocities_of_the_protocol(tmp_path: Path) -> None:
    robot = write_robot(tmp_path, (64, 48))
    loop, commands = Loop("arena", robot, 4), RandomCommands(4)
    loop.settle()
    with PhysicsWorld(populate("arena", str(robot))) as world:
        world.step(round(SETTLE_S * STEP_HZ))
        for _ in range(12):
            loop.step()
            state = loop.read()
            linear, angular = commands.next()
            world.command("robot", VelocityCommand((linear, 0.0, 0.0), (0.0, 0.0, angular), world.stamp_ns))
            world.step(4)
        wanted = world.state()
    assert state.step == wanted.step == SETTLE_S * STEP_HZ + 48
    assert np.array_equal(state.positions, wanted.positions) and np.array_equal(state.twists, wanted.twists)
    loop.close()
    loop.close()
