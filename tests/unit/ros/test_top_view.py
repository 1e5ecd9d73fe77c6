"""The text of ``gibson-sim top``, from values made by hand."""

from __future__ import annotations

from dataclasses import replace

from gibson_sim.ros.nodes.top_view import Overview, Status, TopicRate, render

PHYSICS = Status("gibson_sim: physics", 0, "on time", (("real_time_factor", "0.998"), ("late_ticks", "3")), 0.4)
RENDER = Status("gibson_sim: render", 1, "skips images", (("draw_ms", "8.20"),), 0.1)
OVERVIEW = Overview(7, 12_340_000_000, 2.0, 1.5, 3, (RENDER, PHYSICS))


def test_head_has_time_and_the_factor_measured_by_the_clock() -> None:
    assert render(OVERVIEW).splitlines()[0] == "ROS domain 7: simulation time 12.34 s, real-time factor 0.750, 3 nodes"


def test_statuses_stand_by_name_with_level_message_and_all_values() -> None:
    lines = render(OVERVIEW).splitlines()
    assert lines[2:7] == [
        "gibson_sim: physics  OK  on time",
        "  real_time_factor 0.998   late_ticks 3",
        "",
        "gibson_sim: render  WARN  skips images",
        "  draw_ms 8.20",
    ]


def test_values_go_below_each_other_where_the_terminal_is_narrow() -> None:
    lines = render(replace(OVERVIEW, statuses=(PHYSICS,)), width=40).splitlines()
    assert lines[3:] == ["  real_time_factor 0.998", "  late_ticks 3"]


def test_status_that_is_not_repeated_is_stale_whatever_it_said() -> None:
    text = render(replace(OVERVIEW, statuses=(replace(PHYSICS, age_s=9.0),)))
    assert "gibson_sim: physics  STALE  no report for 9 s" in text.splitlines()


def test_colours_follow_the_level_and_are_off_by_default() -> None:
    assert "\x1b[33mWARN\x1b[0m" in render(OVERVIEW, color=True)
    assert "\x1b[32mOK\x1b[0m" in render(OVERVIEW, color=True)
    assert "\x1b" not in render(OVERVIEW)


def test_rates_of_topics_are_shown_in_wall_time_and_in_simulation_time() -> None:
    topics = (
        TopicRate("/odom", "nav_msgs/msg/Odometry", 90, 64_000, 2),
        TopicRate("/clock", "rosgraph_msgs/msg/Clock", 150, 1_800, 0),
    )
    lines = render(replace(OVERVIEW, topics=topics)).splitlines()
    assert lines[-3:] == [
        "topic   per s  per sim s  kB/s  subscribers  type",
        "/clock   75.0      100.0   0.9            0  rosgraph_msgs/msg/Clock",
        "/odom    45.0       60.0  32.0            2  nav_msgs/msg/Odometry",
    ]


def test_no_rate_in_simulation_time_while_it_stands_still() -> None:
    line = render(replace(OVERVIEW, sim_s=0.0, topics=(TopicRate("/a", "b/msg/C", 4, 0, 0),))).splitlines()[-1]
    assert line.split() == ["/a", "2.0", "-", "0.0", "0", "b/msg/C"]


def test_missing_clock_and_missing_reports_are_reported() -> None:
    text = render(Overview(7, None, 1.0, 0.0, 1))
    assert "no messages" in text
    assert "no node has reported" in text
