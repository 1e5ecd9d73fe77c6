"""Collisions of the robots in a bag, from each kind of topic that reports them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import pytest

from gibson_sim.bags.check import check_bag
from gibson_sim.bags.plots.touches import Touch, robot_namespaces
from gibson_sim.bags.reader import BagReader
from gibson_sim.bags.writer import BagWriter

TICK_NS = 100_000_000
COLLISIONS, CONTACTS, BUMPER = "gibson_msgs/msg/CollisionCount", "gibson_msgs/msg/Contacts", "std_msgs/msg/Bool"
GROUND = ("left", "ground", "", 1.0, 30.0)
Rows = Sequence[tuple[str, int, bytes]]


@pytest.fixture
def write(messages: Any, tmp_path: Path) -> Callable[[dict[str, str], Rows], Path]:
    """Returns a function that writes a bag of a robot ``left``, from topics with their types, and (topic, tick of 0.1 s, message)."""

    def write_rows(types: dict[str, str], rows: Rows) -> Path:
        with BagWriter(tmp_path / "bag", reserve_bytes=0) as bag:
            bag.add_topic("/left/odom", "nav_msgs/msg/Odometry")
            for topic, type_name in types.items():
                bag.add_topic(topic, type_name)
            for tick in range(41):
                bag.write("/left/odom", messages.odometry(tick * TICK_NS, 0.0, 0.0), tick * TICK_NS, tick * TICK_NS)
                for topic, at, data in rows:
                    if at == tick:
                        bag.write(topic, data, tick * TICK_NS, tick * TICK_NS)
        return tmp_path / "bag"

    return write_rows


def test_collision_with_contacts_reports_body_duration_and_force(write: Callable[..., Path], messages: Any) -> None:
    """It pushes a box from 1.0 s to 2.0 s, and meanwhile brushes a wall at 1.5 s; standing on the ground is no contact."""
    rows = []
    for tick in range(41):
        pushing, brushing = 10 <= tick <= 20, tick == 15
        count = (tick >= 10) + (tick >= 15)
        rows.append(
            (
                "/left/collisions",
                tick,
                messages.collisions(tick * TICK_NS, count, pushing + brushing, "wall" if count == 2 else "box"),
            )
        )
        points = [GROUND, *[("left", "box", "body", 0.0, float(tick))] * pushing, *[("left", "wall", "", 0.0, 3.0)] * brushing]
        rows.append(("/contacts", tick, messages.contacts(tick * TICK_NS, *points)))
    touches = check_bag(write({"/left/collisions": COLLISIONS, "/contacts": CONTACTS}, rows)).touches
    assert touches == (
        Touch("left", "box", 1.0, 2.0, 20.0, movable=True),
        Touch("left", "wall", 1.5, 1.5, 3.0),
    )
    assert [touch.text() for touch in touches] == [
        "left: pushed box from 1.0 s to 2.0 s, with up to 20 N",
        "left: touched wall at 1.5 s, with up to 3 N",
    ]


def test_collision_between_two_contact_messages_is_not_lost(write: Callable[..., Path], messages: Any) -> None:
    rows = [
        ("/left/collisions", tick, messages.collisions(tick, int(tick >= 7), 0, "mug", 9.0 * (tick >= 7))) for tick in range(41)
    ]
    rows += [("/contacts", tick, messages.contacts(tick, GROUND)) for tick in range(0, 41, 10)]
    touches = check_bag(write({"/left/collisions": COLLISIONS, "/contacts": CONTACTS}, rows)).touches
    assert [touch.text() for touch in touches] == ["left: touched mug at 0.7 s, with up to 9 N"]


def test_collisions_before_the_recording_are_not_reported(write: Callable[..., Path], messages: Any) -> None:
    rows = [("/left/collisions", tick, messages.collisions(tick, 5, 0, "mug", 9.0)) for tick in range(41)]
    assert check_bag(write({"/left/collisions": COLLISIONS}, rows)).touches == ()


def test_contact_that_lasts_to_the_end_is_reported_as_such(write: Callable[..., Path], messages: Any) -> None:
    rows = [
        ("/left/collisions", tick, messages.collisions(tick, int(tick >= 30), int(tick >= 30), "wall_1")) for tick in range(41)
    ]
    report = check_bag(write({"/left/collisions": COLLISIONS}, rows))
    assert "contact: left: pressed against wall_1 from 3.0 s to the end of the recording" in report.text().splitlines()


def test_contacts_alone_leave_out_the_supporting_floor(write: Callable[..., Path], messages: Any) -> None:
    """As another recorder may have chosen: no collision count. The wall is body b or body a."""
    rows = [("/contacts", tick, messages.contacts(tick, GROUND)) for tick in range(41) if tick not in (12, 30)]
    rows += [("/contacts", 12, messages.contacts(0, GROUND, ("left", "wall", "", 0.0, 5.0)))]
    rows += [("/contacts", 30, messages.contacts(0, GROUND, ("shelf", "left", "base", 0.0, 6.0)))]
    touches = check_bag(write({"/contacts": CONTACTS}, rows)).touches
    assert [(touch.other, touch.begin, touch.force) for touch in touches] == [("wall", 1.2, 5.0), ("shelf", 3.0, 6.0)]


def test_bumper_of_a_real_robot(write: Callable[..., Path], messages: Any) -> None:
    rows = [("/left/bumper", tick, messages.flag(tick in (5, 20, 21, 22, 23, 24, 25, 26))) for tick in range(41)]
    touches = check_bag(write({"/left/bumper": BUMPER}, rows)).touches
    assert [touch.text() for touch in touches] == [
        "left: the bumper was hit at 0.5 s",
        "left: the bumper was pressed from 2.0 s to 2.6 s",
    ]


@pytest.mark.parametrize(
    ("topics", "robots"),
    [
        (["/odom", "/ground_truth/odom"], ("",)),
        (["/left/odom", "/left/ground_truth/odom", "/right/ground_truth/odom"], ("left", "right")),
        (["/odom", "/wheel/odom"], ("",)),
        (["/wheel/odometry"], ("",)),
    ],
)
def test_robots_are_distinguished_by_their_odometry(
    messages: Any, tmp_path: Path, topics: list[str], robots: tuple[str, ...]
) -> None:
    with BagWriter(tmp_path / "bag", reserve_bytes=0) as bag:
        for topic in topics:
            bag.add_topic(topic, "nav_msgs/msg/Odometry")
            bag.write(topic, messages.odometry(0, 0.0, 0.0), 0, 0)
    with BagReader(tmp_path / "bag") as reader:
        assert robot_namespaces(reader.topics()) == robots
