"""The HTML page of a trial."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np

from gibson_sim.trials.comparison import compare
from gibson_sim.trials.records import Cause, PlacedObject, RunResult, Verdict
from gibson_sim.trials.report.maps import SceneMap, map_svg, scene_map
from gibson_sim.trials.report.page import trial_page
from gibson_sim.trials.report.paths import read_path, simplify
from gibson_sim.trials.report.results import TrialResults
from support.scenes import write_house, write_room
from support.trial_results import failed, passed, trial

VOID = ("meta", "img", "image", "circle", "path", "polyline", "rect", "br")


class Page(HTMLParser):
    """A page, read strictly: every element is closed in its order."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.ids: list[str] = []
        self.links: list[str] = []
        self.sources: list[str] = []
        self.tags: set[str] = set()
        self.words = ""
        self.feed(text)
        self.close()
        assert not self.open

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        values = dict(attrs)
        self.tags.add(tag)
        self.ids += [values["id"] or ""] if "id" in values else []
        self.links += [values["href"] or ""] if tag == "a" else []
        self.sources += [values[name] or "" for name in ("src", "href") if name in values and tag != "a"]
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.handle_starttag(tag, attrs)
        assert tag in VOID

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if self.open and self.open[-1] != "style":
            self.words += f"{data} "


def page_of(shown: TrialResults, folder: Path) -> tuple[str, Page]:
    text = trial_page(shown, folder, ["--runs", "4"], "made by hand", maps={})
    return text, Page(text)


def keep(folder: Path, result: RunResult, **files: bytes | str) -> Path:
    own = folder / "runs" / f"{result.run.number:04d}"
    own.mkdir(parents=True)
    for name, data in files.items():
        (own / name.replace("__", ".")).write_bytes(data if isinstance(data, bytes) else data.encode())
    return own


def test_page_shows_totals_verdicts_and_causes(tmp_path: Path) -> None:
    text, page = page_of(
        trial([passed(0), failed(1), passed(2, scene="orchard_house"), failed(3, "it stood", "blocked")], planned=9), tmp_path
    )
    assert "<b>2 of 4</b> runs passed (50 %; 95 % interval 15 to 85 %)" in text
    assert "Ended early: 4 of 9 planned runs were executed." in page.words
    assert "linden_flat, gibson_bot" in page.words
    for found in ("collisions", "2 of 4", "blocked", "rooms.yaml", "lockstep", "made by hand", "61 s of wall time"):
        assert found in page.words


def test_page_leads_to_each_failed_run(tmp_path: Path) -> None:
    _, page = page_of(trial([passed(0), failed(1), failed(2)]), tmp_path)
    assert page.ids == ["run-1", "run-2"]
    assert {"#run-1", "#run-2"} <= set(page.links)
    assert {link for link in page.links if link.startswith("#")} <= {f"#{name}" for name in page.ids}


def test_page_names_the_commands_that_repeat_a_run(tmp_path: Path) -> None:
    result = failed(13)
    (keep(tmp_path, result) / "bag").mkdir()
    _, page = page_of(trial([result]), tmp_path)
    assert f"gibson-sim replay {tmp_path}/runs/0013/bag --verify" in page.words
    assert "gibson-sim trial rooms.yaml --runs 4 --run 13" in page.words
    assert "runs/0013/bag" in page.links


def test_page_does_not_repeat_a_run_that_has_no_bag(tmp_path: Path) -> None:
    _, page = page_of(trial([failed(13)]), tmp_path)
    assert "replay" not in page.words


def test_page_is_escaped_against_whatever_a_stack_prints(tmp_path: Path) -> None:
    evil = "</script><script>alert(1)</script>\0\x1b]0;x\x07 </pre> \ud800 'a' \"b\""
    result = replace(
        failed(1, evil, scene=f"{evil}.sdf", robot=evil), verdicts=(Verdict(evil, False, evil),), cause=Cause("stack died", evil)
    )
    result = replace(result, outcome=replace(result.outcome, detail=evil, status=evil))
    keep(
        tmp_path,
        result,
        stack__log=evil.encode(errors="replace") + b"\xff" * 100 + b"\n" + b"z" * 2_000_000,
    )
    text, page = page_of(trial([result], name=evil, file=evil, machine={"name": evil}), tmp_path)
    text.encode("utf-8")
    assert "script" not in page.tags
    assert "\0" not in text
    assert "\x1b" not in text
    assert len(text) < 60_000
    assert "alert(1)" in page.words


def test_page_loads_nothing_from_elsewhere(tmp_path: Path) -> None:
    result = failed(1)
    keep(tmp_path, result, path__png=b"\x89PNG", motion__png=b"\x89PNG", film__jpg=b"\xff\xd8", path__json="[[0, 0], [1, 1]]")
    text, page = page_of(trial([result, passed(2)]), tmp_path)
    assert len(page.sources) == 3
    assert all(source.startswith("data:image/") for source in page.sources)
    assert all(not re.match(r"[a-z]+:|/", link) for link in page.links)
    assert "default-src &#x27;none&#x27;" in text


def test_page_shows_the_comparison(tmp_path: Path) -> None:
    before, after = [passed(n) for n in range(9)], [failed(n) if n < 7 else passed(n) for n in range(9)]
    found = {**compare(before, after).to_json(), "file": "before.json"}
    _, page = page_of(trial(after, comparison=found), tmp_path)
    assert "7 runs got worse, 0 got better" in page.words
    assert "before.json" in page.words


def test_page_of_no_runs_is_a_page(tmp_path: Path) -> None:
    _, page = page_of(trial([], planned=5), tmp_path)
    assert "0 of 5 planned runs were executed" in page.words


def test_map_of_a_house_names_the_floor(tmp_path: Path) -> None:
    house = str(write_house(tmp_path / "house"))
    floor = scene_map(house)
    assert floor is not None and floor.floor == "floor 0"
    text = trial_page(trial([passed(0, scene=house)]), tmp_path, [], "made by hand", maps={house: floor})
    assert re.search(r"<h3>[^<]*house, floor 0: ", text)
    room = scene_map(str(write_room(tmp_path / "room")))
    assert room is not None and room.floor == ""


def test_map_distinguishes_failed_paths_by_more_than_colour() -> None:
    floor = SceneMap(np.zeros((2, 4, 4), dtype=np.uint8), (0.0, 4.0, 0.0, 2.0))
    good, bad = passed(1, start=(1.0, 1.0, 0.0)), failed(2, start=(2.0, 1.0, 0.0))
    svg = map_svg(floor, [(bad, ((2.0, 1.0), (3.0, 1.5))), (good, ((1.0, 1.0), (1.0, 2.0)))])
    assert 'viewBox="-0.300 -2.300 4.600 2.600"' in svg
    assert '<polyline points="1.000,-1.000 1.000,-2.000"/>' in svg  # y points up
    assert svg.index('class="passed"') < svg.index('class="failed"')
    assert svg.count('<path class="end"') == 1  # a cross
    assert ">2</text>" in svg


def test_map_shows_the_obstacles_of_a_failed_run() -> None:
    things = (PlacedObject("box", "box_cardboard", (1.0, 2.0, 0.0)),)
    runs = [(made(0, things=things), ((0.0, 0.0), (10.0, 0.0))) for made in (passed, failed)]
    unit = 0.106  # a hundredth of the width, 10 m and the margins
    assert map_svg(None, runs).count("<rect") == 1
    assert f'<rect class="thing" x="{1.0 - 0.7 * unit:.3f}" y="{-2.0 - 0.7 * unit:.3f}"' in map_svg(None, runs)


def test_numbers_on_a_map_do_not_cover_each_other() -> None:
    runs = [(failed(n), ((0.0, 0.0), (5.0, 5.0))) for n in range(30)]
    svg = map_svg(None, runs)
    places = re.findall(r'<text x="([-\d.]+)" y="([-\d.]+)"', svg)
    assert len(places) == len(set(places)) == 8
    assert svg.count("<polyline") == 30


def test_without_a_map_and_paths_nothing_is_drawn() -> None:
    assert map_svg(None, []) == ""


def test_a_path_keeps_its_corners() -> None:
    xy = np.array(
        [(x, 0.01 * (i % 2)) for i, x in enumerate(np.linspace(0, 3, 31))] + [(3.0, y) for y in np.linspace(0.1, 2, 20)]
    )
    kept = simplify(xy, 0.02)
    assert kept.tolist() == [[0.0, 0.0], [3.0, 0.0], [3.0, 2.0]]


def test_a_damaged_path_is_none(tmp_path: Path) -> None:
    for text in ("", "{}", "[1]", "[[1]]", '[["a", 1]]', "[[NaN, 1]]", json.dumps([[1, 2, 3]])):
        (tmp_path / "path.json").write_text(text)
        assert read_path(tmp_path) == ()
    (tmp_path / "path.json").write_text("[[1, 2], [3, 4]]")
    assert read_path(tmp_path) == ((1.0, 2.0), (3.0, 4.0))
