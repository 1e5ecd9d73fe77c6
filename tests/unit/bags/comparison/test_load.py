"""Bags of standard messages become arrays."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from gibson_sim.bags.comparison.load import load_recording
from gibson_sim.errors import ConfigError, RecordError
from support.drives import NS, StandardBag
from support.exif import jpeg_with_orientation

WALL_NS = 1_700_000_000 * NS


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return tmp_path / "bag"


def odometry(bag: StandardBag) -> None:
    for i in range(20):
        bag.odometry("/odom", i * NS // 10, 0.1 * i, 0.0, math.pi * (i / 20), 1.0, 0.5)


def test_times_begin_with_the_first_stamp_and_headings_do_not_jump(folder: Path) -> None:
    with StandardBag(folder) as bag:
        for i in range(20):
            bag.odometry("/odom", 5 * NS + i * NS // 10, 0.1 * i, 0.0, 3.0 + 0.1 * i, 1.0, 1.0)
    found = load_recording(folder).odometry
    assert found is not None
    assert (found.t[0], found.t[-1], found.x[-1]) == pytest.approx((0.0, 1.9, 1.9))
    assert found.yaw[-1] - found.yaw[0] == pytest.approx(1.9)


def test_stamped_commands_are_read_like_plain_ones(folder: Path) -> None:
    with StandardBag(folder) as bag:
        odometry(bag)
        twist = bag.make("geometry_msgs/msg/Twist", linear=bag.vector(0.3), angular=bag.vector(z=-0.2))
        bag.write("/cmd_vel", NS, bag.make("geometry_msgs/msg/TwistStamped", header=bag.header(NS // 2, "base"), twist=twist))
    found = load_recording(folder).commands
    assert found is not None
    # A command counts from its arrival.
    assert (found.t[0], found.linear[0], found.angular[0]) == pytest.approx((1.0, 0.3, -0.2))


def test_arrivals_by_wall_time_are_mapped_to_the_clock_of_the_stamps(folder: Path) -> None:
    with StandardBag(folder, latency_ns=WALL_NS) as bag:
        odometry(bag)
        bag.twist("/cmd_vel", 15 * NS // 10, 0.3, 0.0)
    found = load_recording(folder)
    assert found.commands is not None
    assert found.commands.t[0] == pytest.approx(1.5, abs=1e-3)
    assert any("different clocks" in note for note in found.notes)


def test_map_whose_size_is_not_that_of_its_values_is_left_out(folder: Path) -> None:
    with StandardBag(folder) as bag:
        odometry(bag)
        make = bag.make
        origin = make(
            "geometry_msgs/msg/Pose",
            position=make("geometry_msgs/msg/Point", x=0.0, y=0.0, z=0.0),
            orientation=make("geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=0.0, w=1.0),
        )
        header = bag.header(0, "map")
        info = make("nav_msgs/msg/MapMetaData", map_load_time=header.stamp, resolution=0.05, width=4, height=6, origin=origin)
        bag.write("/map", NS, make("nav_msgs/msg/OccupancyGrid", header=header, info=info, data=np.zeros(48, np.int8)))
    found = load_recording(folder)
    assert found.map is None
    assert "/map: a map of 4x6 cells has 48 values: it is left out" in found.notes


def test_localisation_by_tf_is_the_truth_where_no_better_one_exists(folder: Path) -> None:
    with StandardBag(folder) as bag:
        odometry(bag)
        for i in range(3):
            transform = bag.make(
                "geometry_msgs/msg/Transform", translation=bag.vector(1.0, 2.0),
                rotation=bag.make("geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=math.sin(math.pi / 4), w=math.cos(math.pi / 4)),
            )  # fmt: skip
            stamped = bag.make(
                "geometry_msgs/msg/TransformStamped", header=bag.header(i * NS, "map"), child_frame_id="odom", transform=transform
            )
            bag.write("/tf", i * NS, bag.make("tf2_msgs/msg/TFMessage", transforms=[stamped]))
    found = load_recording(folder).truth
    assert found is not None
    # 1.9 m along x of odom, which is y of the map.
    assert (found.x[-1], found.y[-1]) == pytest.approx((1.0, 2.0 + 1.9))
    assert found.source == "tf map -> odom"


def test_lidar_is_where_the_fixed_transforms_put_it(folder: Path) -> None:
    with StandardBag(folder) as bag:
        odometry(bag)
        half_turn = bag.make("geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=1.0, w=0.0)
        level = bag.make("geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=0.0, w=1.0)
        links = []
        for parent, child, x, rotation in (
            ("base_footprint", "base_link", 0.1, level),
            ("base_link", "base_scan", 0.2, half_turn),
        ):
            transform = bag.make("geometry_msgs/msg/Transform", translation=bag.vector(x), rotation=rotation)
            links.append(
                bag.make(
                    "geometry_msgs/msg/TransformStamped", header=bag.header(0, parent), child_frame_id=child, transform=transform
                )
            )
        bag.write("/tf_static", 0, bag.make("tf2_msgs/msg/TFMessage", transforms=links))
        for i in range(3):
            bag.scan("/scan", i * NS, [1.0, 0.05, 99.0, np.inf], 0.0, 0.5, (0.1, 10.0))
    found = load_recording(folder).scans
    assert found is not None
    assert found.mount == pytest.approx((0.3, 0.0, math.pi))
    # Ranges beyond the maximum are beams without a return.
    assert found.ranges[0].tolist() == [1.0, math.inf, math.inf, math.inf]


def test_images_become_statistics_and_small_copies(folder: Path) -> None:
    with StandardBag(folder) as bag:
        for i in range(3):
            bag.image("/camera/image_raw", i * NS, np.full((48, 64, 3), 51 * (i + 1)))
    found = load_recording(folder).pictures
    assert found is not None
    assert found.statistics[:, 0] == pytest.approx([0.2, 0.4, 0.6])
    assert found.thumbnails[0].shape == (180, 240, 3)


def test_an_image_is_not_rotated_by_its_exif_orientation(folder: Path) -> None:
    jpeg = np.frombuffer(jpeg_with_orientation(np.zeros((48, 64, 3), np.uint8)), np.uint8)
    with StandardBag(folder) as bag:
        msg = bag.make("sensor_msgs/msg/CompressedImage", header=bag.header(NS, "camera"), format="jpeg", data=jpeg)
        bag.write("/camera/image_raw/compressed", NS, msg)
    found = load_recording(folder).pictures
    assert found is not None and found.thumbnails[0].shape == (180, 240, 3)


def test_map_has_walls_where_it_is_occupied(folder: Path) -> None:
    with StandardBag(folder) as bag:
        odometry(bag)
        point = bag.make("geometry_msgs/msg/Point", x=-1.0, y=-2.0, z=0.0)
        level = bag.make("geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=0.0, w=1.0)
        info = bag.make(
            "nav_msgs/msg/MapMetaData", map_load_time=bag.header(0, "").stamp, resolution=0.5, width=3, height=2,
            origin=bag.make("geometry_msgs/msg/Pose", position=point, orientation=level),
        )  # fmt: skip
        data = np.array([0, 100, -1, 64, 65, 0], dtype=np.int8)
        bag.write("/map", 0, bag.make("nav_msgs/msg/OccupancyGrid", header=bag.header(0, "map"), info=info, data=data))
    found = load_recording(folder).map
    assert found is not None
    assert found.occupied.tolist() == [[False, True, False], [False, True, False]]
    assert (found.resolution, found.origin) == (0.5, (-1.0, -2.0))


def test_missing_topics_are_reported(folder: Path) -> None:
    with StandardBag(folder) as bag:
        odometry(bag)
    notes = load_recording(folder).notes
    assert any(note.startswith("no cmd_vel") and "response to commands" in note for note in notes)
    assert any(note.startswith("no imu") for note in notes)


def test_requested_topic_that_is_missing_is_an_error(folder: Path) -> None:
    with StandardBag(folder) as bag:
        odometry(bag)
    with pytest.raises(ConfigError, match="no such topic"):
        load_recording(folder, {"imu": "/imu9"})


def test_folder_without_a_bag_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(RecordError, match="no bag"):
        load_recording(tmp_path / "nothing")


def test_stamps_that_span_years_are_refused(folder: Path) -> None:
    with StandardBag(folder) as bag:
        odometry(bag)
        bag.odometry("/odom", 2_000_000_000 * NS, 0.0, 0.0, 0.0, 0.0, 0.0)
    with pytest.raises(RecordError, match=r"span 2e\+09 s, at most 604,800 s are compared"):
        load_recording(folder)
