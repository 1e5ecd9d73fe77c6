import sys

import pytest

pytestmark = pytest.mark.simulation(scene="flat", start="1.0,4.7,0")
NODE = [sys.executable, "-m", "my_robot.careful_drive"]


def test_stops_before_the_wall(sim):
    sim.start(NODE, answers="cmd_vel after scan")
    sim.step(30.0)
    assert sim.robot_pose().x > 1.5
    assert not sim.contacts


def test_stops_before_a_box_and_goes_on_when_it_is_gone(sim):
    sim.spawn("box_cardboard", at=(2.5, 4.7, 0.0), name="box")
    sim.start(NODE, answers="cmd_vel after scan")
    sim.step(10.0)
    stopped = sim.robot_pose()
    assert stopped.x < 2.2
    sim.delete("box")
    sim.wait_until(lambda: sim.robot_pose().x > 2.6, timeout=10)
    assert not sim.contacts
