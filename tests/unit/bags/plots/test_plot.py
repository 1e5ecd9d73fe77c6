"""Plots of bags: what is read, and what is drawn from it."""

from __future__ import annotations

import builtins
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import matplotlib
import numpy as np
import pytest
import yaml
from matplotlib.figure import Figure

from gibson_sim.bags.plots.load import load_run
from gibson_sim.bags.plots.panels import contact_rows, draw_paths, motion_limits, rates, velocity_parts
from gibson_sim.bags.plots.plot import draw_motion, write_plots
from gibson_sim.bags.plots.run_data import Arrivals, RecordedRun, RobotRun, Track, Velocities
from gibson_sim.bags.plots.style import STYLE
from gibson_sim.bags.writer import BagWriter, TopicQos
from gibson_sim.cli.command_line import run as run_command
from gibson_sim.errors import ConfigError, EnvironmentProblemError, RecordError
from support.scenes import write_house, write_room

NS = 1_000_000_000
TICK = NS // 10
WALL_NS = 1_795_580_456 * NS
ODOMETRY, TWIST = "nav_msgs/msg/Odometry", "geometry_msgs/msg/Twist"


def grid(messages: Any, width: int = 80, height: int = 60) -> bytes:
    """A map of 8 m by 6 m whose lower left corner is at (-1, -2), with a wall along its left side."""
    t = messages.types
    cells = np.zeros((height, width), dtype=np.int8)
    cells[:, 0] = 100
    origin = t["geometry_msgs/msg/Pose"](
        position=t["geometry_msgs/msg/Point"](x=-1.0, y=-2.0, z=0.0),
        orientation=t["geometry_msgs/msg/Quaternion"](x=0.0, y=0.0, z=0.0, w=1.0),
    )
    info = t["nav_msgs/msg/MapMetaData"](
        map_load_time=messages.time(0), resolution=0.1, width=width, height=height, origin=origin
    )
    return messages.cdr(t["nav_msgs/msg/OccupancyGrid"](header=messages.header(0, "map"), info=info, data=cells.ravel()))


def twist(messages: Any, linear: float, angular: float, sideways: float = 0.0) -> bytes:
    vector = messages.types["geometry_msgs/msg/Vector3"]
    fields = {"linear": vector(x=linear, y=sideways, z=0.0), "angular": vector(x=0.0, y=0.0, z=angular)}
    return messages.cdr(messages.types[TWIST](**fields))


def map_from_odom(messages: Any, x: float, yaw: float = 0.0) -> bytes:
    t = messages.types
    transform = t["geometry_msgs/msg/Transform"](
        translation=t["geometry_msgs/msg/Vector3"](x=x, y=0.0, z=0.0),
        rotation=t["geometry_msgs/msg/Quaternion"](x=0.0, y=0.0, z=float(np.sin(yaw / 2)), w=float(np.cos(yaw / 2))),
    )
    stamped = t["geometry_msgs/msg/TransformStamped"](
        header=messages.header(0, "map"), child_frame_id="odom", transform=transform
    )
    return messages.cdr(t["tf2_msgs/msg/TFMessage"](transforms=[stamped]))


@pytest.fixture
def write_run(messages: Any, tmp_path: Path) -> Callable[..., Path]:
    """Returns a function that writes a drive of robots: 2 s along the x axis of their odometry at 1 m/s, in truth north from (3, 0)."""

    def write(
        *, robots: tuple[str, ...] = ("",), truth: bool = True, tf_x: float | None = None, floor: bool = True, begin: int = 0
    ) -> Path:
        folder = tmp_path / "drive"
        with BagWriter(folder, reserve_bytes=0) as bag:
            if floor:
                bag.add_topic("/map", "nav_msgs/msg/OccupancyGrid", TopicQos.latched())
                bag.write("/map", grid(messages), begin, begin)
            if tf_x is not None:
                bag.add_topic("/tf", "tf2_msgs/msg/TFMessage")
            for robot in robots:
                prefix = f"/{robot}" if robot else ""
                bag.add_topic(f"{prefix}/odom", ODOMETRY)
                bag.add_topic(f"{prefix}/cmd_vel", TWIST)
                if truth:
                    bag.add_topic(f"{prefix}/ground_truth/odom", ODOMETRY)
            for i in range(21):
                now = begin + i * TICK
                if tf_x is not None:
                    bag.write("/tf", map_from_odom(messages, tf_x, np.pi / 2), now, now)
                for k, robot in enumerate(robots):
                    prefix = f"/{robot}" if robot else ""
                    bag.write(f"{prefix}/odom", messages.odometry(now, 0.1 * i, 0.0), now, now)
                    bag.write(f"{prefix}/cmd_vel", twist(messages, 1.0, 0.25), now, now)
                    if truth:
                        bag.write(f"{prefix}/ground_truth/odom", messages.odometry(now, 3.0 + k, 0.1 * i, np.pi / 2), now, now)
        return folder

    return write


def test_odometry_is_laid_onto_the_true_start(write_run: Callable[..., Path]) -> None:
    run = load_run(write_run())
    (robot,) = run.robots
    assert robot.odometry is not None and robot.commands is not None and run.floor is not None
    assert (robot.odometry.x[-1], robot.odometry.y[-1]) == (pytest.approx(3.0), pytest.approx(2.0)), "its own end is (2, 0)"
    assert (robot.commands.forward[0], robot.commands.turning[0], robot.commands.source) == (1.0, 0.25, "/cmd_vel")
    assert run.floor.extent == pytest.approx((-1.0, 7.0, -2.0, 4.0))
    assert (run.begin, round(run.end, 6), run.time_label) == (0.0, 2.0, "simulation time, s")


def test_bag_of_a_real_robot_needs_neither_truth_nor_map(write_run: Callable[..., Path], tmp_path: Path) -> None:
    folder = write_run(truth=False, floor=False, begin=WALL_NS)
    run = load_run(folder)
    assert (run.begin, run.end, run.floor, run.has_contact_topics) == (0.0, pytest.approx(2.0), None, False)
    assert run.time_label == "seconds since 2026-11-25 04:20:56 UTC"
    assert run.robots[0].reference is run.robots[0].odometry
    paths = write_plots(folder, [tmp_path / "made" / "real.png", tmp_path / "real.html"])
    assert all(path.stat().st_size > 10_000 for path in paths)


def test_map_without_a_pose_in_it_is_left_out_with_a_warning(write_run: Callable[..., Path]) -> None:
    run = load_run(write_run(truth=False))
    assert run.floor is None
    assert "the map is left out" in run.notes[0]


def test_pose_of_a_localiser_is_drawn(write_run: Callable[..., Path]) -> None:
    """The transform map -> odom is a quarter turn to the left at (5, 0): odometry (2, 0) is (5, 2) on the map."""
    run = load_run(write_run(truth=False, tf_x=5.0))
    estimate = run.robots[0].estimate
    assert estimate is not None and run.floor is not None
    assert (estimate.x[-1], estimate.y[-1], estimate.source) == (pytest.approx(5.0), pytest.approx(2.0), "tf map -> odom")


@pytest.mark.parametrize(("tf_x", "is_drawn"), [(3.0, False), (3.1, True)])
def test_truth_published_as_a_transform_is_no_estimate(write_run: Callable[..., Path], tf_x: float, is_drawn: bool) -> None:
    assert (load_run(write_run(tf_x=tf_x)).robots[0].estimate is not None) is is_drawn


def _write_run_in(scene: Path, z: float, messages: Any, tmp_path: Path) -> Path:
    """Writes a bag without a map that names its scene; its robot is ``z`` m high."""
    settings = yaml.safe_dump({"scene": str(scene)})
    with BagWriter(tmp_path / "with_scene", reserve_bytes=0) as bag:
        bag.add_topic("/run_info", "gibson_msgs/msg/RunInfo", TopicQos.latched())
        bag.add_topic("/ground_truth/odom", ODOMETRY)
        info = messages.types["gibson_msgs/msg/RunInfo"](
            header=messages.header(0), kind="physics", node="/physics", version="0", settings=settings, platform=""
        )
        bag.write("/run_info", messages.cdr(info), 0, 0)
        for i in range(3):
            bag.write("/ground_truth/odom", messages.odometry(i, 0.1 * i, 0.0, z=z), i, i)
    return tmp_path / "with_scene"


def test_scene_gives_the_map_that_the_bag_lacks(messages: Any, write_run: Callable[..., Path], tmp_path: Path) -> None:
    assert load_run(write_run(floor=False)).floor is None, "without run_info the scene is not known"
    scene = write_room(tmp_path / "room")
    run = load_run(_write_run_in(scene, 0.0, messages, tmp_path))
    floor = run.floor
    assert floor is not None, run.notes
    assert floor.source == f"scene {scene}"
    assert 100 in floor.cells and 0 in floor.cells


@pytest.mark.parametrize(("z", "number", "depth"), [(0.0, 0, 4.0), (3.05, 1, 2.0)])
def test_map_of_a_house_is_that_of_the_robot_s_floor(z: float, number: int, depth: float, messages: Any, tmp_path: Path) -> None:
    scene = write_house(tmp_path / "house")
    floor = load_run(_write_run_in(scene, z, messages, tmp_path)).floor
    assert floor is not None and floor.source == f"scene {scene}, floor {number}"
    rows = np.flatnonzero((floor.cells == 0).any(axis=1))
    assert (rows[-1] - rows[0] + 1) * floor.resolution == pytest.approx(depth, abs=0.15), "the upper floor is half as deep"


def test_one_robot_of_several(write_run: Callable[..., Path]) -> None:
    folder = write_run(robots=("left", "right"))
    assert [robot.name for robot in load_run(folder).robots] == ["left", "right"]
    (right,) = load_run(folder, "right").robots
    assert right.truth is not None
    assert (right.name, right.truth.x[0]) == ("right", 4.0)
    with pytest.raises(ConfigError, match=r"--robot 'rigt': the bag has left, right; did you mean 'right'\?"):
        load_run(folder, "rigt")


def test_the_legend_of_a_narrow_picture_does_not_cover_the_title(write_run: Callable[..., Path]) -> None:
    run = load_run(write_run())
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(6.2, 4.0), layout="constrained")
        draw_motion(figure, run)
        figure.draw_without_rendering()
    (legend,), title = figure.legends, figure.axes[0]._left_title
    assert title.get_text() == "Velocities" and len(legend.get_texts()) == 3
    assert not legend.get_window_extent().overlaps(title.get_window_extent())


def test_the_goal_is_in_the_picture_and_no_time_covers_start_end_or_goal(write_run: Callable[..., Path]) -> None:
    """The robot waits for 4 s at (3, 0), then drives north to (3, 2); the goal is outside the map."""
    run = load_run(write_run())
    t = np.append(0.0, np.linspace(4.0, 6.0, 20))
    north = np.append(0.0, np.linspace(0.0, 2.0, 20))
    waits = Track(t, np.full(21, 3.0), north, np.full(21, np.pi / 2), "/ground_truth/odom")
    run = replace(run, robots=(replace(run.robots[0], truth=waits, odometry=None),), end=6.0)
    figure = Figure(figsize=(5.8, 5.6), layout="constrained")
    axis = figure.subplots()
    draw_paths(axis, run, (9.0, 3.0))
    figure.draw_without_rendering()
    (goal,) = [line for line in axis.lines if line.get_label() == "goal"]
    assert (goal.get_xdata()[0], goal.get_ydata()[0]) == (9.0, 3.0)
    assert axis.get_xlim()[1] > 9.0 and axis.get_ylim()[1] > 3.0
    times = {text.get_text(): text.get_window_extent() for text in axis.texts}
    assert list(times) == ["5 s", "6 s"]
    for place in ((3.0, 0.0), (3.0, 2.0), (9.0, 3.0)):
        at = axis.transData.transform(place)
        assert not any(box.contains(*at) for box in times.values())


def test_page_refers_to_no_other_file(write_run: Callable[..., Path], tmp_path: Path) -> None:
    (path,) = write_plots(write_run(robots=("left", "right")), [tmp_path / "run.html"], created="made by a test")
    text = path.read_text()
    names = {"http://www.w3.org/2000/svg", "http://www.w3.org/1999/xlink"}
    assert set(re.findall(r"https?://[^\s\"'<]+", text)) <= {*names, "http://www.w3.org/1999/02/22-rdf-syntax-ns#",
        "http://purl.org/dc/elements/1.1/", "http://creativecommons.org/ns#", "https://matplotlib.org/",
        "http://purl.org/dc/dcmitype/StillImage"}  # fmt: skip
    references = re.findall(r'(?:src|href)="([^"]*)"', text)
    assert all(reference.startswith(("#", "data:")) for reference in references)
    ids = re.findall(r'\bid="([^"]+)"', text)
    assert len(ids) == len(set(ids)), "ids of several SVGs must not collide"
    assert text.count("<svg") == 3 and "odometry of left: 2.000 m driven" in text and "made by a test" in text


def test_picture_shows_the_true_path_where_it_was(write_run: Callable[..., Path], tmp_path: Path) -> None:
    """The same drive once with a wall on the map and once without: only then is there grey."""
    (with_map,) = write_plots(write_run(), [tmp_path / "map.png"])
    pixels = cv2.imread(str(with_map))
    assert pixels is not None
    grey = np.abs(pixels.astype(int) - np.array([175, 163, 156])).max(axis=2) < 4  # blue first
    assert grey.sum() > 1000
    wall = np.argwhere(grey)[:, 1].mean()
    ink = np.argwhere((pixels < 60).all(axis=2))[:, 1]
    assert (ink > wall).sum() > 500, "the path is right of the wall at the left side of the map"


def test_sideways_velocity_is_shown_only_where_there_is_any(
    messages: Any, write_run: Callable[..., Path], tmp_path: Path
) -> None:
    assert [part for part, _ in velocity_parts(load_run(write_run()))] == ["forward", "turning"]
    with BagWriter(tmp_path / "omni", reserve_bytes=0) as bag:
        bag.add_topic("/cmd_vel", TWIST)
        bag.write("/cmd_vel", twist(messages, 0.0, 0.0, sideways=0.3), 0, 0)
    assert [part for part, _ in velocity_parts(load_run(tmp_path / "omni"))] == ["forward", "sideways", "turning"]


def test_stamped_commands_are_read_too(messages: Any, tmp_path: Path) -> None:
    with BagWriter(tmp_path / "bag", reserve_bytes=0) as bag:
        bag.add_topic("/cmd_vel", "geometry_msgs/msg/TwistStamped")
        bag.write("/cmd_vel", messages.twist_stamped(0, 0.4, -0.2), 0, 0)
    commands = load_run(tmp_path / "bag").robots[0].commands
    assert commands is not None
    assert (commands.forward[0], commands.turning[0]) == (0.4, -0.2)


def test_contacts_that_are_drawn_are_those_of_check(messages: Any, tmp_path: Path) -> None:
    with BagWriter(tmp_path / "bag", reserve_bytes=0) as bag:
        bag.add_topic("/collisions", "gibson_msgs/msg/CollisionCount")
        bag.add_topic("/odom", ODOMETRY)
        for i in range(21):
            bag.write("/odom", messages.odometry(i * TICK, 0.0, 0.0), i * TICK, i * TICK)
            bag.write("/collisions", messages.collisions(i * TICK, int(i >= 4), int(4 <= i <= 9), "wall"), i * TICK, i * TICK)
    run = load_run(tmp_path / "bag")
    assert contact_rows(run) == [("", "wall")]
    assert (run.robots[0].touches[0].begin, run.robots[0].touches[0].end) == (pytest.approx(0.4), pytest.approx(0.9))


def test_rates_of_a_recording_of_a_fraction_of_a_microsecond_have_one_bin() -> None:
    times = np.array([0.4999999, 0.49999992, 0.49999995])
    edges, parts, _ = rates(RecordedRun(Path("bag"), times[0], times[-1], "s", (), None, False, (Arrivals("/x", times),)))
    assert len(edges) == 2 and parts.shape == (1, 1)


def test_rate_of_a_topic_that_stopped_is_none_from_then_on() -> None:
    """20 Hz for 30 s, silent from 10 s to 15 s."""
    times = np.arange(0.0, 30.0, 0.05) + 0.001
    run = RecordedRun(Path("bag"), 0.0, 30.0, "s", (), None, False, (Arrivals("/x", times[(times < 10) | (times >= 15)]),))
    edges, parts, names = rates(run)
    assert names == [("/x", pytest.approx(20.0))]
    assert edges.tolist() == list(range(31))
    assert (parts[0, 10:15] == 0.0).all() and parts[0, :10] == pytest.approx(1.0) and parts[0, 15:] == pytest.approx(1.0)


def test_a_long_rest_at_the_end_is_left_out_of_the_motion() -> None:
    """The robot drives until 10.0 s and stands until 60 s, then until 12 s."""

    def driven_until_10(end: float) -> RecordedRun:
        t = np.arange(0.0, end + 0.05, 0.1)
        speed, none = np.where(t < 10.05, 0.5, 1e-6), np.zeros(len(t))
        robot = RobotRun("", None, None, None, None, Velocities(t, speed, none, none, "/odom"), None, ())
        return RecordedRun(Path("bag"), 0.0, end, "s", (robot,), None, False, ())

    assert motion_limits(driven_until_10(60.0)) == (0.0, pytest.approx(12.0)), "two seconds of it are shown"
    assert motion_limits(driven_until_10(13.0)) == (0.0, 13.0), "a short rest is shown whole"


def test_command_writes_a_picture_beside_the_bag(write_run: Callable[..., Path], capsys: pytest.CaptureFixture[str]) -> None:
    folder = write_run()
    assert run_command(["bag", "plot", str(folder)]) == 0
    assert capsys.readouterr().out.strip() == str(folder.with_name("drive_plot.png"))
    assert folder.with_name("drive_plot.png").read_bytes().startswith(b"\x89PNG")


def test_file_of_another_kind_is_refused_before_anything_is_read(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"must end in \.png or \.html"):
        write_plots(tmp_path / "no_bag", [tmp_path / "plot.pdf"])
    with pytest.raises(RecordError, match="there is no bag"):
        write_plots(tmp_path / "no_bag", [tmp_path / "plot.png"])


def test_without_matplotlib_the_remedy_is_named(
    monkeypatch: pytest.MonkeyPatch, write_run: Callable[..., Path], tmp_path: Path
) -> None:
    real_import = builtins.__import__

    def refuse(name: str, *args: Any, **kwargs: Any) -> Any:
        if name == "matplotlib":
            raise ImportError(name)
        return real_import(name, *args, **kwargs)

    folder = write_run()
    monkeypatch.setattr(builtins, "__import__", refuse)
    with pytest.raises(
        EnvironmentProblemError, match=r"a plot needs matplotlib, which is not installed: .*gibson_sim\[analysis\]"
    ):
        write_plots(folder, [tmp_path / "plot.png"])
