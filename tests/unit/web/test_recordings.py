"""Files below the folder of recordings that a page may list and open, and those that it may not."""

from __future__ import annotations

import json
import os
import threading
from pathlib import Path

import pytest

from gibson_sim.bags.writer import BagWriter
from gibson_sim.web import recordings as module
from gibson_sim.web.recordings import RecordingError, Recordings

REPORT = b"<!doctype html><h1>Trial</h1>"


def _trial(folder: Path, report: bytes = REPORT) -> Path:
    folder.mkdir(parents=True)
    (folder / "results.json").write_text(json.dumps({"totals": {"passed": 2, "runs": 5}}))
    (folder / "index.html").write_bytes(report)
    return folder


def _bag(folder: Path) -> Path:
    with BagWriter(folder, reserve_bytes=0) as writer:
        writer.add_topic("/text", "std_msgs/msg/String")
        writer.write("/text", bytes(16), 1_000_000_000, 1_000_000_000)
        writer.write("/text", bytes(16), 3_500_000_000, 3_500_000_000)
    return folder


def test_bags_and_trials_on_all_levels_are_listed_the_newest_first(tmp_path: Path) -> None:
    trial = _trial(tmp_path / "trial")
    _bag(trial / "runs" / "0001" / "bag")
    os.utime(_bag(tmp_path / "first") / "metadata.yaml", (1_000, 1_000))
    (tmp_path / "notes").mkdir()
    listed = Recordings(tmp_path).list()
    assert listed["folder"] == str(tmp_path)
    entries = listed["entries"]
    assert {entry["name"]: (entry["kind"], entry["text"]) for entry in entries} == {
        "trial": ("trial", "2 of 5 runs passed"),
        "trial/runs/0001/bag": ("bag", "2 messages"),
        "first": ("bag", "2 messages"),
    }
    assert entries[-1]["name"] == "first" and entries[-1]["seconds"] == 2.5
    assert entries[-1]["bytes"] == sum(file.stat().st_size for file in (tmp_path / "first").iterdir())


def test_a_folder_that_does_not_exist_has_no_recordings(tmp_path: Path) -> None:
    assert Recordings(tmp_path / "none").list()["entries"] == []


def test_a_trial_folder_itself_is_listed(tmp_path: Path) -> None:
    recordings = Recordings(_trial(tmp_path / "trial"))
    [entry] = recordings.list()["entries"]
    assert entry["name"] == "." and recordings.report(entry["key"]) == REPORT


def test_a_report_is_read_by_the_key_of_the_last_listing_alone(tmp_path: Path) -> None:
    _trial(tmp_path / "trial")
    recordings = Recordings(tmp_path)
    with pytest.raises(RecordingError, match="no trial with this key"):
        recordings.report("trial")
    [entry] = recordings.list()["entries"]
    assert recordings.report(entry["key"]) == REPORT
    with pytest.raises(RecordingError, match="no bag with this key"):
        recordings.plots(entry["key"])
    for key in ("../trial", "trial/../..", "", entry["key"].upper() + "x"):
        with pytest.raises(RecordingError):
            recordings.report(key)


def test_symbolic_links_are_neither_listed_nor_followed(tmp_path: Path) -> None:
    secret = _trial(tmp_path / "secret", b"secret")
    folder = tmp_path / "web"
    trial = _trial(folder / "trial")
    (folder / "link").symlink_to(secret)
    (folder / "files").mkdir()
    for name in ("index.html", "results.json"):
        (folder / "files" / name).symlink_to(secret / name)
    recordings = Recordings(folder)
    [entry] = recordings.list()["entries"]
    assert entry["name"] == "trial"
    (trial / "index.html").unlink()
    (trial / "index.html").symlink_to(secret / "index.html")  # after the listing
    with pytest.raises(RecordingError, match="cannot be read"):
        recordings.report(entry["key"])
    (trial / "index.html").unlink()
    (trial / "index.html").write_bytes(REPORT)
    assert recordings.report(entry["key"]) == REPORT
    trial.rename(tmp_path / "moved")
    (folder / "trial").symlink_to(secret)
    with pytest.raises(RecordingError, match="cannot be read"):
        recordings.report(entry["key"])


def test_a_report_that_is_no_regular_file_or_too_large_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    trial = _trial(tmp_path / "trial")
    recordings = Recordings(tmp_path)
    [entry] = recordings.list()["entries"]
    monkeypatch.setattr(module, "MAX_REPORT_BYTES", 10)
    with pytest.raises(RecordingError, match="at most"):
        recordings.report(entry["key"])
    (trial / "index.html").unlink()
    os.mkfifo(trial / "index.html")  # which would block
    with pytest.raises(RecordingError, match="not a regular file"):
        recordings.report(entry["key"])


def test_unreadable_recordings_are_listed_with_a_reason(tmp_path: Path) -> None:
    _trial(tmp_path / "trial")
    (tmp_path / "trial" / "results.json").write_text('{"totals": [')
    (tmp_path / "bag").mkdir()
    (tmp_path / "bag" / "metadata.yaml").write_text("a: [")
    texts = {entry["name"]: entry["text"] for entry in Recordings(tmp_path).list()["entries"]}
    assert texts == {"trial": "its results cannot be read", "bag": "its metadata cannot be read"}


def test_the_search_is_limited(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    _trial(tmp_path.joinpath(*"abcde"))
    _trial(tmp_path.joinpath(*"klmnop"))  # one level too deep
    assert [entry["name"] for entry in Recordings(tmp_path).list()["entries"]] == ["a/b/c/d/e"]
    monkeypatch.setattr(module, "MAX_FOLDERS", 3)
    assert Recordings(tmp_path).list()["entries"] == []


def test_plots_of_a_bag_are_those_of_bag_plot_and_are_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    _bag(tmp_path / "run")
    recordings = Recordings(tmp_path)
    [entry] = recordings.list()["entries"]
    page = recordings.plots(entry["key"])
    assert b"<h1>run</h1>" in page and b"2 messages" in page and b"<script" not in page
    monkeypatch.setattr(module.subprocess, "Popen", None)  # a second plot would fail
    assert recordings.plots(entry["key"]) == page


def test_a_bag_that_cannot_be_plotted_is_reported_with_the_reason(tmp_path: Path) -> None:
    bag = _bag(tmp_path / "run")
    next(bag.glob("*.mcap")).write_bytes(b"nothing")
    recordings = Recordings(tmp_path)
    [entry] = recordings.list()["entries"]
    with pytest.raises(RecordingError, match=r"^bag .* cannot be read"):
        recordings.plots(entry["key"])


def test_a_link_in_a_bag_is_not_plotted(tmp_path: Path) -> None:
    bag = _bag(tmp_path / "run")
    (bag / "more.mcap").symlink_to("/dev/zero")
    recordings = Recordings(tmp_path)
    [entry] = recordings.list()["entries"]
    with pytest.raises(RecordingError, match="symbolic links"):
        recordings.plots(entry["key"])


def test_the_end_of_the_server_ends_a_plot(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    _bag(tmp_path / "run")
    recordings = Recordings(tmp_path)
    [entry] = recordings.list()["entries"]
    started, popen = threading.Event(), module.subprocess.Popen

    def slow(command: list[str], **options: object) -> object:
        process = popen(["sleep", "600"], **options)  # type: ignore[call-overload]
        started.set()
        return process

    monkeypatch.setattr(module.subprocess, "Popen", slow)
    errors: list[Exception] = []

    def plot() -> None:
        try:
            recordings.plots(entry["key"])
        except RecordingError as error:
            errors.append(error)

    thread = threading.Thread(target=plot)
    thread.start()
    assert started.wait(60)
    while recordings._process is None and thread.is_alive():
        pass
    recordings.close()
    thread.join(60)
    assert not thread.is_alive() and len(errors) == 1
