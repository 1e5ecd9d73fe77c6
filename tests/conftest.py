"""Fixtures that all tests share."""

from __future__ import annotations

import os
import signal
import socket
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from gibson_sim.reach import PROFILE_VARIABLE, RANGE_VARIABLE
from gibson_sim.testing.processes import free_domains
from support import strict
from support.simulation import Listener, new_context, require

ROOT = Path(__file__).resolve().parents[1]

if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    # A script started the tests with `&`: what they start, and interrupt, would ignore it, too.
    signal.signal(signal.SIGINT, signal.default_int_handler)


def pytest_configure() -> None:
    """Removes the time limits of property-based tests: a busy machine is not a fault of the code."""
    try:
        from hypothesis import HealthCheck, settings
    except ImportError:
        return
    settings.register_profile("gibson_sim", deadline=None, suppress_health_check=[HealthCheck.too_slow])
    settings.load_profile("gibson_sim")


def pytest_make_parametrize_id(val: object) -> str | None:
    """Names a test of bytes by their number: the content may hold the time (gzip), and then two workers collect different tests."""
    return f"{len(val)}_bytes" if isinstance(val, bytes) else None


@pytest.fixture(scope="session")
def root() -> Path:
    """The source tree."""
    return ROOT


@pytest.fixture(scope="session")
def data_dir() -> Path:
    """The folder with worlds that other people made: ``$GIBSON_SIM_TEST_DATA``, or ``shared/data`` beside this clone."""
    folder = Path(os.environ.get("GIBSON_SIM_TEST_DATA", ROOT.parent / "shared" / "data"))
    if not folder.is_dir():
        message = f"SKIPPED: no real worlds at {folder}; set GIBSON_SIM_TEST_DATA to a folder that holds them"
        warnings.warn(message, stacklevel=2)
        pytest.skip(message)
    return folder


@pytest.fixture(scope="session")
def ros_domain() -> Iterator[int]:
    """A domain of its own for this process and its children, on this machine alone.

    A socket keeps it: one of the domain's ports is in use during the whole session, so that neither the other worker nor a
    ``HeadlessSimulation``, also of another program, takes the domain while no node runs in it.
    """
    require("rclpy", "gibson_msgs")
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as guard:
        for domain_id in free_domains("60-101", os.getpid()):
            try:
                guard.bind(("127.0.0.1", 7400 + 250 * domain_id + 8))  # none that Fast DDS uses
            except OSError:
                continue
            break
        else:
            pytest.fail("each of the ROS domains 60 to 101 is in use")
        yield from _environment_of(domain_id)


def _environment_of(domain_id: int) -> Iterator[int]:
    changes = {
        "ROS_DOMAIN_ID": str(domain_id),
        RANGE_VARIABLE: "SYSTEM_DEFAULT",
        PROFILE_VARIABLE: str(ROOT / "config" / "fastdds_local.xml"),
    }
    before = {k: os.environ.get(k) for k in changes}
    os.environ.update(changes)
    yield domain_id
    for key, value in before.items():
        if value is None:
            os.environ.pop(key)
        else:
            os.environ[key] = value


@pytest.fixture(scope="module")
def ros_context(ros_domain: int) -> Iterator[Any]:
    """One participant for all clients of a module: it lives as long as the context has a node."""
    from rclpy.node import Node

    context = new_context()
    keeper = Node("test_keeper", context=context, use_global_arguments=False, start_parameter_services=False)
    yield context
    keeper.destroy_node()
    context.try_shutdown()


@pytest.fixture
def listener(ros_context: Any) -> Iterator[Listener]:
    """A client that is closed after the test."""
    client = Listener(ros_context)
    yield client
    client.close()


@pytest.fixture
def other_listener(ros_domain: int) -> Iterator[Listener]:
    """A client in a participant of its own: one participant cannot know a topic under two types."""
    context = new_context()
    client = Listener(context)
    yield client
    client.close()
    context.try_shutdown()


@pytest.hookimpl(trylast=True)
def pytest_sessionfinish(session: pytest.Session) -> None:
    """Fails a strict run that skipped what this machine can do, or that needed an unexplained second attempt; notes all failures in a file."""
    reporter = session.config.pluginmanager.get_plugin("terminalreporter")
    if reporter is None or hasattr(session.config, "workerinput"):
        return
    refused = strict.faults(reporter.stats) if os.environ.get(strict.VARIABLE) else []
    if refused and session.exitstatus == pytest.ExitCode.OK:
        session.exitstatus = pytest.ExitCode.TESTS_FAILED
    if noted := os.environ.get(strict.FAILURES_VARIABLE):
        with Path(noted).open("a", encoding="utf-8") as file:
            file.writelines(f"{line}\n" for line in strict.failures(reporter.stats) + refused)


def pytest_terminal_summary(terminalreporter: Any) -> None:
    """Shows what failed at the first attempt and not at the second, and what a strict run refuses."""
    for report in terminalreporter.stats.get("rerun", ()):
        terminalreporter.section(f"FLAKY: {report.nodeid} failed at its first attempt", yellow=True)
        terminalreporter.line(report.longreprtext)
    if os.environ.get(strict.VARIABLE):
        for line in strict.faults(terminalreporter.stats):
            terminalreporter.line(f"REFUSED: {line}", red=True)
