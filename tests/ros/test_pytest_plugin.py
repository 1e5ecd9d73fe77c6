"""The pytest plugin with real simulations, in sessions of their own, as in a robot's repository."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from gibson_sim.errors import AlreadyRunningError
from gibson_sim.processes.domain_lock import DomainLock
from support.simulation import PATIENCE_S, require, wait_until

require("rclpy", "gibson_msgs")

pytestmark = pytest.mark.ros
PYTEST = (sys.executable, "-m", "pytest", "-p", "gibson_sim.pytest", "-p", "no:cacheprovider", "-W", "error")
DRIVES = """
import sys

import pytest

found, domains = [], set()

@pytest.mark.parametrize("attempt", [1, 2])
def test_the_same_drive_gives_the_same_poses_and_scans(sim, attempt):
    domains.add(sim.domain_id)
    assert sim.spawn("box_cardboard", at=(2.5, 4.7, 0.0), name="box") == "box"
    assert set(sim.entities()) >= {"robot", "box"}
    sim.subscribe("scan")
    sim.drive_to(1.5, 4.7, within=0.1)
    assert sim.robot_pose().distance_to(1.5, 4.7) < 0.1
    assert not sim.contacts
    sim.drive(0.4, 0.0, 2.0)
    assert "box" in {contact.body for contact in sim.contacts}
    scans = sim.messages("scan")
    assert [scan.header.stamp.nanosec % 100_000_000 for scan in scans] == [0] * len(scans)
    found.append((sim.time, repr(sim.robot_pose()), [scan.ranges.tolist() for scan in scans]))
    assert len(found) == attempt and found[0] == found[-1]

def test_time_stands_still_between_calls_and_passes_exactly(sim):
    begin = sim.time
    sim.step(0.5)
    assert sim.time == pytest.approx(begin + 0.5, abs=1e-6)
    sim.pause()
    sim.step(1 / 240)
    assert sim.time == pytest.approx(begin + 0.5 + 1 / 240, abs=1e-6)
    with pytest.raises(Exception, match="the simulation is paused"):
        sim.wait_until(lambda: False)
    sim.play()

def test_expiry(sim):
    domains.add(sim.domain_id)
    sim.wait_until(lambda: sim.robot_pose().x > 90, timeout=0.5)

def test_program(sim):
    assert domains == {sim.domain_id}, "a reset sufficed"
    sim.start([sys.executable, "-c", "raise SystemExit('no map')"])
    sim.wait_until(lambda: False)
"""
DIES = """
import os
import signal
import time

import pytest

@pytest.mark.simulation(start="inside,the,wall")
def test_no_start(sim):
    pass

@pytest.mark.simulation(lockstep=False)
def test_in_real_time(sim):
    time.sleep(1.0)  # the ticks meanwhile are no part of the drive
    sim.drive(0.3, 0.0, 0.5)
    assert sim.robot_pose().x > 1.05
    assert sim.latest("scan").ranges
    os.kill(sim._process._process.pid, signal.SIGKILL)
    sim.step(1.0)
"""
STAYS = """
import sys

def test_it(sim, tmp_path):
    program = sim.start([sys.executable, "-c", "import os, time; open('program', 'w').write(str(os.getpid())); time.sleep(1000)"])
    open("domain", "w").write(str(sim.domain_id))
    sim.wait_until(lambda: False, timeout=1e6)
"""


def test_a_session_with_two_workers(tmp_path: Path) -> None:
    (tmp_path / "test_drives.py").write_text(DRIVES)
    (tmp_path / "test_dies.py").write_text(DIES)
    done = subprocess.run([*PYTEST, "-n", "2", "--dist", "loadfile"], cwd=tmp_path, capture_output=True, text=True, check=False)
    said = done.stdout
    assert re.search(r"3 failed, 3 passed, 1 error in", said), said
    assert re.search(
        r"WaitError: waited 0.5 s of simulation time for `sim.wait_until\(lambda: sim.robot_pose\(\).x > 90, timeout=0.5\)`; "
        r"at 0.517 s; robot at x 1.00 m, y 4.70 m, yaw 0 deg; no collisions",
        said,
    ), said
    assert re.search(r"GibsonSimError: the program `.*` ended with code 1: no map", said), said
    assert re.search(r"- output of `.*`, which ended with code 1 -+\nno map\n", said), said
    assert re.search(r"_ ERROR at setup of test_no_start _+\n.*\nthe simulation cannot start: .*inside,the,wall.*\n", said), said
    assert "SimulationEndedError: the simulation has ended: it was killed by SIGKILL" in said
    assert "physics  | INFO scene flat is ready" in said


def test_nothing_is_left_when_pytest_is_killed(tmp_path: Path) -> None:
    (tmp_path / "test_stays.py").write_text(STAYS)
    session = subprocess.Popen([*PYTEST, "-q"], cwd=tmp_path, stdout=subprocess.DEVNULL)
    program, domain = tmp_path / "program", tmp_path / "domain"
    wait_until(lambda: program.is_file() and domain.is_file() and bool(program.read_text()), "program of the test")
    os.kill(session.pid, signal.SIGKILL)
    session.wait(PATIENCE_S)

    def is_free() -> bool:
        try:
            DomainLock(int(domain.read_text())).close()
        except AlreadyRunningError:
            return False
        return True

    wait_until(is_free, "end of the simulation")
    wait_until(lambda: not Path(f"/proc/{program.read_text()}").exists(), "end of the program")


def test_the_package_of_a_robot_tests_itself(root: Path) -> None:
    folder = root / "docs" / "examples" / "robot_package"
    environment = {**os.environ, "PYTHONPATH": str(folder), "PYTHONDONTWRITEBYTECODE": "1"}
    done = subprocess.run(PYTEST, cwd=folder, env=environment, capture_output=True, text=True, check=False)
    assert "2 passed in" in done.stdout, done.stdout
