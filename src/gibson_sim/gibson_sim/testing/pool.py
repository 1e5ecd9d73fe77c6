"""Simulations of a test session: one runs at a time, and the next test gets it, reset, if it asks for the same settings."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

from gibson_sim.errors import GibsonSimError
from gibson_sim.testing.headless_simulation import HeadlessSimulation
from gibson_sim.testing.settings import SimulationSettings


class SimulationPool:
    """Starts simulations when tests ask for them, and ends them."""

    def __init__(self, domains: str, folder: Path) -> None:
        """Starts nothing yet.

        Args:
            domains: range of ROS domains.
            folder: from which relative paths in settings count.
        """
        self._domains, self._folder = domains, folder
        self._kept: HeadlessSimulation | None = None
        self._others: list[HeadlessSimulation] = []
        self._started = 0

    def take(self, given: dict[str, Any], bag: Path) -> HeadlessSimulation:
        """Returns a simulation at its start: the kept one, reset, if its settings are these.

        Args:
            given: settings of the simulation by name.
            bag: folder of the recording, if one is asked for.

        Raises:
            GibsonSimError: it cannot start.
        """
        settings = SimulationSettings.of(given)
        kept, self._kept = self._kept, None
        if kept is not None:
            if kept.is_usable and kept.settings == settings and not settings.fresh and not settings.record:
                try:
                    kept.begin_again()
                except GibsonSimError:  # a test may have left it in a state from which there is no way back
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
        """Returns a new simulation, which ends with the session at the latest."""
        self._started += 1  # another domain than before: what is left of an ended participant takes others seconds to forget
        simulation = HeadlessSimulation(
            domains=self._domains, folder=self._folder, bag=bag, first_domain=os.getpid() + self._started, **given
        )
        self._others.append(simulation)
        return simulation

    def give_back(self, simulation: HeadlessSimulation) -> None:
        """Ends what a test started in its simulation; the simulation itself is kept for the next test, unless it is for one test alone."""
        if simulation.settings.fresh or simulation.settings.record or not simulation.is_usable:
            simulation.close()
        else:
            simulation.stop_programs()

    def close(self) -> None:
        """Ends all simulations."""
        for simulation in (*self._others, *([self._kept] if self._kept is not None else [])):
            simulation.close()
        self._kept, self._others = None, []
