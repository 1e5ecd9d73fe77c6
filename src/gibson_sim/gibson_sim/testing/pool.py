"""Simulations of a test session: one runs at a time and is reset and reused by the next test with the same settings."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

from gibson_sim.errors import GibsonSimError
from gibson_sim.testing.headless_simulation import HeadlessSimulation
from gibson_sim.testing.settings import SimulationSettings


class SimulationPool:
    """Starts simulations on request of tests, and ends them."""

    def __init__(self, domains: str, folder: Path) -> None:
        """Creates a pool; starts no simulation.

        Args:
            domains: range of ROS domains.
            folder: folder to which relative paths in settings refer.
        """
        self._domains, self._folder = domains, folder
        self._kept: HeadlessSimulation | None = None
        self._others: list[HeadlessSimulation] = []
        self._started = 0

    def acquire(self, given: dict[str, Any], bag: Path) -> HeadlessSimulation:
        """Returns a simulation in its initial state: the kept one, reset, if its settings are equal to the given ones.

        Args:
            given: settings of the simulation by name.
            bag: folder of the recording, used if the settings request one.

        Raises:
            GibsonSimError: the simulation cannot start.
        """
        settings = SimulationSettings.of(given)
        kept, self._kept = self._kept, None
        if kept is not None:
            if kept.is_usable and kept.settings == settings and not settings.fresh and not settings.record:
                try:
                    kept.restart()
                except GibsonSimError:  # a test may have left the simulation in a state that cannot be reset
                    kept.close()
                else:
                    self._kept = kept
                    return kept
            else:
                kept.close()
        simulation = self.start(given, bag)
        self._others.remove(simulation)
        self._kept = simulation
        return simulation

    def start(self, given: dict[str, Any], bag: Path | None = None) -> HeadlessSimulation:
        """Returns a new simulation, which ends at the latest with the session."""
        self._started += 1  # use a new domain: other participants take seconds to drop an ended one
        simulation = HeadlessSimulation(
            domains=self._domains, folder=self._folder, bag=bag, first_domain=os.getpid() + self._started, **given
        )
        self._others.append(simulation)
        return simulation

    def release(self, simulation: HeadlessSimulation) -> None:
        """Ends the programs that a test started; keeps the simulation for the next test unless it serves one test only."""
        if simulation.settings.fresh or simulation.settings.record or not simulation.is_usable:
            simulation.close()
        else:
            simulation.stop_programs()

    def close(self) -> None:
        """Ends all simulations."""
        for simulation in (*self._others, *([self._kept] if self._kept is not None else [])):
            simulation.close()
        self._kept, self._others = None, []
