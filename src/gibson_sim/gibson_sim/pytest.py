"""The pytest plugin: the fixture ``sim`` provides a running headless simulation in its own ROS domain.

    import pytest

    @pytest.mark.simulation(scene="flat", start="2.6,7.2,-90")
    def test_robot_drives_to_the_kitchen(sim):
        sim.start(["python3", "my_navigation.py"])
        sim.send_goal(1.0, 4.7)
        sim.wait_until(lambda: sim.robot_pose().distance_to(1.0, 4.7) < 0.25, timeout=60)
        assert not sim.contacts

pytest loads this module in every session of an environment with Gibson Sim: the rest of the package is imported when a test uses the fixture.
The tutorial is docs/testing_your_robot.md.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterator
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from gibson_sim.testing.headless_simulation import HeadlessSimulation
    from gibson_sim.testing.pool import SimulationPool

_DOMAINS = "simulation_domains"
"""Name of the option in pytest's configuration."""
_SIMULATION: pytest.StashKey[HeadlessSimulation] = pytest.StashKey()
"""Key of the simulation of a test, for its report."""
_MARKER = (
    "simulation(**settings): settings of the fixture `sim`: scene='flat', robot='gibson_bot', start='x,y,yaw_deg', seed=0, lockstep=True, "
    "cameras=False, record=False, fresh=False, and every other one that `gibson-sim params` lists"
)


def pytest_addoption(parser: pytest.Parser) -> None:
    """Adds the option."""
    parser.addini(_DOMAINS, "Range of ROS domains, of which each simulation gets a free one", default="1-101")


def pytest_configure(config: pytest.Config) -> None:
    """Registers the marker."""
    config.addinivalue_line("markers", _MARKER)


@pytest.fixture(scope="session")
def _simulation_pool(pytestconfig: pytest.Config) -> Iterator[SimulationPool]:
    from gibson_sim.errors import missing_package

    reason = ""
    try:
        from gibson_sim.testing.pool import SimulationPool
    except ImportError as error:
        missing = missing_package(error)
        if missing is None:
            raise
        reason = str(missing)
    if reason:
        pytest.fail(reason, pytrace=False)
    pool = SimulationPool(str(pytestconfig.getini(_DOMAINS)), pytestconfig.rootpath)
    yield pool
    pool.close()


@pytest.fixture
def simulation_settings() -> dict[str, Any]:
    """Settings of all simulations; override it in a conftest.py. Settings of the marker take precedence."""
    return {}


@pytest.fixture
def sim(
    request: pytest.FixtureRequest,
    simulation_settings: dict[str, Any],
    _simulation_pool: SimulationPool,
    tmp_path_factory: pytest.TempPathFactory,
) -> Iterator[HeadlessSimulation]:
    """A simulation in its initial state, with the settings of ``@pytest.mark.simulation(...)``.

    Tests with the same settings share one process, which is reset between tests; a reset restores the whole initial state. During the test, the
    environment variables of this process select the simulation's domain, so that nodes created by the test discover it.
    """
    from gibson_sim.errors import GibsonSimError
    from gibson_sim.testing.processes import variables_set

    settings = dict(simulation_settings)
    for mark in reversed(list(request.node.iter_markers("simulation"))):
        if mark.args:
            pytest.fail("the marker `simulation` takes settings by name only, such as scene='flat'", pytrace=False)
        settings.update(mark.kwargs)
    bag = tmp_path_factory.mktemp("simulation") / "bag" if settings.get("record") else tmp_path_factory.getbasetemp() / "no_bag"
    simulation, reason = None, ""
    try:
        simulation = _simulation_pool.acquire(settings, bag)
    except GibsonSimError as error:
        reason = str(error)
    if simulation is None:
        pytest.fail(reason, pytrace=False)
    request.node.stash[_SIMULATION] = simulation
    try:
        with variables_set(simulation.environment):
            yield simulation
    finally:
        _simulation_pool.release(simulation)


@pytest.fixture(scope="session")
def simulation_factory(_simulation_pool: SimulationPool) -> Callable[..., HeadlessSimulation]:
    """Starts further simulations: ``simulation_factory(scene="arena")``. Each is a context manager, and is closed at the latest with the session."""

    def start(**settings: Any) -> HeadlessSimulation:
        from pathlib import Path

        bag = settings.pop("bag", None)
        return _simulation_pool.start(settings, Path(bag) if bag is not None else None)

    return start


@pytest.hookimpl(hookwrapper=True)
def pytest_runtest_makereport(item: pytest.Item) -> Generator[None, Any, None]:
    """Adds the output of the simulation and its programs to the report of a failed test."""
    outcome = yield
    report = outcome.get_result()
    simulation = item.stash.get(_SIMULATION, None)
    if report.failed and simulation is not None:
        sections = [(title, text) for title, text in simulation.report_sections() if text.strip()]
        if hasattr(report.longrepr, "addsection"):  # --junitxml has these
            for title, text in sections:
                report.longrepr.addsection(title, text.rstrip())
        else:
            report.sections += sections
