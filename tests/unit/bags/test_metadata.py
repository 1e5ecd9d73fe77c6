from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import yaml

from gibson_sim.bags.metadata import FileRecord, TopicQos, TopicRecord, bag_information, dump_qos, read_metadata, write_metadata

INFINITE = {"sec": 9223372036, "nsec": 854775807}


def _profile() -> SimpleNamespace:
    """Looks like rclpy.qos.QoSProfile."""
    forever = SimpleNamespace(nanoseconds=2**63 - 1)
    return SimpleNamespace(
        history=SimpleNamespace(name="KEEP_LAST"),
        depth=3,
        reliability=SimpleNamespace(name="BEST_EFFORT"),
        durability=SimpleNamespace(name="TRANSIENT_LOCAL"),
        deadline=forever,
        lifespan=SimpleNamespace(nanoseconds=2_500_000_000),
        liveliness=SimpleNamespace(name="AUTOMATIC"),
        liveliness_lease_duration=forever,
        avoid_ros_namespace_conventions=False,
    )


def test_profile_of_rclpy_is_written_in_the_format_of_rosbag2() -> None:
    assert TopicQos.of(_profile()).as_dict() == {
        "history": "keep_last",
        "depth": 3,
        "reliability": "best_effort",
        "durability": "transient_local",
        "deadline": INFINITE,
        "lifespan": {"sec": 2, "nsec": 500_000_000},
        "liveliness": "automatic",
        "liveliness_lease_duration": INFINITE,
        "avoid_ros_namespace_conventions": False,
    }


def test_metadata_file_has_every_field_of_version_9(tmp_path: Path) -> None:
    topic = TopicRecord("/scene", "gibson_msgs/msg/Scene", [TopicQos.latched().as_dict()], "RIHS01_00", 2)
    write_metadata(tmp_path, bag_information([topic], [FileRecord("run_0.mcap", 5_000, 9_000, 2)]))
    qos = {
        "history": "keep_last", "depth": 1, "reliability": "reliable", "durability": "transient_local", "deadline": INFINITE,
        "lifespan": INFINITE, "liveliness": "automatic", "liveliness_lease_duration": INFINITE,
        "avoid_ros_namespace_conventions": False,
    }  # fmt: skip
    assert yaml.safe_load((tmp_path / "metadata.yaml").read_text()) == {
        "rosbag2_bagfile_information": {
            "version": 9,
            "storage_identifier": "mcap",
            "duration": {"nanoseconds": 4_000},
            "starting_time": {"nanoseconds_since_epoch": 5_000},
            "message_count": 2,
            "topics_with_message_count": [
                {
                    "topic_metadata": {
                        "name": "/scene",
                        "type": "gibson_msgs/msg/Scene",
                        "serialization_format": "cdr",
                        "offered_qos_profiles": [qos],
                        "type_description_hash": "RIHS01_00",
                    },
                    "message_count": 2,
                }
            ],
            "compression_format": "",
            "compression_mode": "",
            "relative_file_paths": ["run_0.mcap"],
            "files": [
                {
                    "path": "run_0.mcap",
                    "starting_time": {"nanoseconds_since_epoch": 5_000},
                    "duration": {"nanoseconds": 4_000},
                    "message_count": 2,
                }
            ],
            "custom_data": None,
            "ros_distro": "jazzy",
        }
    }


def test_equal_values_are_written_out_instead_of_referenced() -> None:
    assert "&" not in dump_qos([TopicQos().as_dict()])


def test_bag_of_several_files_begins_with_the_first_message_and_ends_with_the_last() -> None:
    files = [FileRecord("run_0.db3", 5_000, 9_000, 2), FileRecord("run_1.db3"), FileRecord("run_2.db3", 9_500, 12_000, 3)]
    information = bag_information([TopicRecord("/a", "std_msgs/msg/String", [], "RIHS01_00", 5)], files, "sqlite3")
    assert information["starting_time"] == {"nanoseconds_since_epoch": 5_000}
    assert information["duration"] == {"nanoseconds": 7_000}
    assert information["storage_identifier"] == "sqlite3"
    assert information["relative_file_paths"] == ["run_0.db3", "run_1.db3", "run_2.db3"]
    assert [file["message_count"] for file in information["files"]] == [2, 0, 3]


def test_metadata_that_is_missing_or_broken_is_read_as_empty(tmp_path: Path) -> None:
    assert read_metadata(tmp_path) == {}
    for text in ("[", "just text", "rosbag2_bagfile_information: 3"):
        (tmp_path / "metadata.yaml").write_text(text)
        assert read_metadata(tmp_path) == {}
