"""The pytest plugin, with a stand-in for the simulation."""

from __future__ import annotations

import subprocess
import sys

import pytest

import gibson_sim.pytest
import gibson_sim.testing.pool  # loaded once, not anew in each inner session: NumPy warns of that

OPTIONS = ("-p", "no:cacheprovider", "-W", "error")
STAND_IN = """
import os
import pytest

class Simulation:
    environment = {**os.environ, "ROS_DOMAIN_ID": "77"}
    def report_sections(self):
        return [("simulation", "robot at x 1"), ("log of the simulation", "it said this"), ("output of `nav`", " ")]

class Pool:
    def acquire(self, given, bag):
        print("settings", sorted(given.items()))
        return Simulation()
    def release(self, simulation):
        print("given back", os.environ.get("ROS_DOMAIN_ID"))

@pytest.fixture(scope="session")
def _simulation_pool():
    return Pool()
"""
NEAREST_COMES_FIRST = """
import os
import pytest

pytestmark = pytest.mark.simulation(scene="arena", seed=1)

@pytest.fixture
def simulation_settings():
    return {"scene": "flat", "seed": 0, "publish_hz": 20}

@pytest.mark.simulation(seed=2)
class TestIt:
    @pytest.mark.simulation(cameras=True)
    def test_it(self, sim):
        assert os.environ["ROS_DOMAIN_ID"] == "77"
"""


@pytest.fixture(autouse=True)
def _no_other_plugins(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PYTEST_DISABLE_PLUGIN_AUTOLOAD", "1")


def _run(pytester: pytest.Pytester, *options: str) -> pytest.RunResult:
    """Runs an inner session with the plugin in this process."""
    return pytester.runpytest_inprocess(*OPTIONS, *options, plugins=[gibson_sim.pytest])


def test_plugin_loads_neither_ros_nor_numpy_nor_the_rest_of_the_package() -> None:
    source = "import sys, gibson_sim.pytest; print(*sorted(name for name in sys.modules if name.startswith(('gibson', 'rclpy', 'numpy'))))"
    done = subprocess.run([sys.executable, "-c", source], capture_output=True, text=True, check=True)
    assert done.stdout == "gibson_sim gibson_sim.field_docs gibson_sim.pytest\n"


def test_the_nearest_marker_comes_first_and_the_fixture_last(pytester: pytest.Pytester, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("ROS_DOMAIN_ID", raising=False)
    pytester.makeconftest(STAND_IN)
    pytester.makepyfile(NEAREST_COMES_FIRST)
    result = _run(pytester, "-s", "--strict-markers")
    result.assert_outcomes(passed=1)
    result.stdout.fnmatch_lines(["*settings [[]('cameras', True), ('publish_hz', 20), ('scene', 'arena'), ('seed', 2)[]]"])
    result.stdout.fnmatch_lines(["*given back None"])  # the variables are as before


def test_only_the_report_of_a_failed_test_has_the_log(pytester: pytest.Pytester) -> None:
    pytester.makeconftest(STAND_IN)
    pytester.makepyfile("def test_good(sim): pass\ndef test_bad(sim): assert False")
    result = _run(pytester)
    result.assert_outcomes(passed=1, failed=1)
    result.stdout.fnmatch_lines(
        ["*_ test_bad _*", "*- simulation -*", "robot at x 1", "*- log of the simulation -*", "it said this"]
    )
    result.stdout.no_fnmatch_line("*output of `nav`*")
    assert result.stdout.str().count("it said this") == 1


def test_a_failed_test_gives_its_simulation_back(pytester: pytest.Pytester) -> None:
    pytester.makeconftest(STAND_IN)
    pytester.makepyfile("def test_bad(sim): assert False")
    _run(pytester, "-s", "-x").stdout.fnmatch_lines(["*given back*"])


def test_a_package_that_is_not_installed_is_an_error_of_one_line(pytester: pytest.Pytester) -> None:
    pytester.makepyfile("def test_it(sim): pass")
    with pytest.MonkeyPatch.context() as patch:
        patch.delitem(sys.modules, "gibson_sim.testing.pool")
        patch.setitem(sys.modules, "gibson_sim.testing.headless_simulation", None)
        patch.setattr("gibson_sim.errors._OWN_PACKAGES", ())
        result = _run(pytester)
    result.assert_outcomes(errors=1)
    said = "the Python package gibson_sim is not installed: `pip install gibson_sim`"
    result.stdout.fnmatch_lines(["*_ ERROR at setup of test_it _*", said, "*= short test summary info =*"], consecutive=True)


@pytest.mark.parametrize(
    ("marker", "said"),
    [
        ('scne="flat"', "simulation setting 'scne' is unknown; did you mean 'scene'*"),
        ('"flat"', "the marker `simulation` takes settings by name only, such as scene='flat'"),
        ('scene="flat", record=3', "simulation setting 'record' is 3, must be True or False"),
    ],
)
def test_a_wrong_marker_is_an_error_of_one_line(pytester: pytest.Pytester, marker: str, said: str) -> None:
    pytester.makepyfile(f"import pytest\n@pytest.mark.simulation({marker})\ndef test_it(sim): pass")
    result = _run(pytester)
    result.assert_outcomes(errors=1)
    result.stdout.fnmatch_lines(["*_ ERROR at setup of test_it _*", said, "*= short test summary info =*"], consecutive=True)


def test_the_marker_is_listed(pytester: pytest.Pytester) -> None:
    _run(pytester, "--markers").stdout.fnmatch_lines(["@pytest.mark.simulation(*settings*): settings of the fixture `sim`*"])


def test_the_junit_report_of_a_failed_test_has_the_log(pytester: pytest.Pytester) -> None:
    pytester.makeconftest(STAND_IN)
    pytester.makepyfile("def test_bad(sim): assert False")
    _run(pytester, "--junitxml=results.xml")
    assert "it said this" in (pytester.path / "results.xml").read_text()
