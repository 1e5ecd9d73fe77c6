"""The live page in a real browser: displays, driving, and the stop of the robot when the connection is lost."""

from __future__ import annotations

import warnings
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from support.simulation import Launched, Listener, require

require("rclpy", "gibson_msgs", "playwright", "axe_playwright_python")

from axe_playwright_python.base import AXE_SCRIPT  # noqa: E402
from geometry_msgs.msg import PoseWithCovarianceStamped  # noqa: E402
from nav_msgs.msg import OccupancyGrid, Odometry  # noqa: E402
from rclpy.qos import DurabilityPolicy, QoSProfile  # noqa: E402

from gibson_sim.bags.reader import BagReader  # noqa: E402
from gibson_sim.errors import EnvironmentProblemError  # noqa: E402
from gibson_sim.ros.topics import qos  # noqa: E402
from gibson_sim_bench.browser import chromium, chromium_path  # noqa: E402

pytestmark = [pytest.mark.ros, pytest.mark.egl]
START_X = 1.0
"""Where the robot starts, m."""
DESKTOP, PHONE = {"width": 1360, "height": 820}, {"width": 390, "height": 844}


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    """Chromium, without a window; WebGL is drawn in software."""
    try:
        chromium_path()
    except EnvironmentProblemError as error:
        message = f"SKIPPED: {error}"
        warnings.warn(message, stacklevel=2)
        pytest.skip(message)
    with chromium(webgl=True) as running:
        yield running


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder in which the server runs."""
    return tmp_path_factory.mktemp("server")


@pytest.fixture(scope="module")
def simulation(ros_domain: int, folder: Path) -> Iterator[Launched]:
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)  # recordings of the page are below it
        launched = Launched("run", "--web-port", "0", "--start", f"{START_X},4.7,0")
    launched.wait_for_line("look: http://")
    yield launched
    launched.stop()


@pytest.fixture(scope="module")
def address(simulation: Launched) -> str:
    return simulation.wait_for_line("look: http://").partition("look: ")[2]


@pytest.fixture
def page(browser: Any, address: str) -> Iterator[Any]:
    """A page that is connected and shows the camera; it must log no error."""
    errors: list[str] = []
    page = browser.new_page(viewport=DESKTOP, bypass_csp=True)
    page.on("pageerror", lambda error: errors.append(str(error)))
    page.goto(address)
    page.wait_for_selector("#state.playing", timeout=60_000)
    page.wait_for_selector("canvas[data-stamp]", timeout=60_000)
    yield page
    page.close()
    assert errors == []


class Truth:
    """Where the robot really is, and how fast it moves."""

    def __init__(self, listener: Listener) -> None:
        self._listener = listener
        self._messages = listener.collect(Odometry, "ground_truth/odom", qos.STATE)
        self.wait_for(lambda: bool(self._messages), "truth")

    @property
    def x(self) -> float:
        return float(self._messages[-1].pose.pose.position.x)

    @property
    def stands(self) -> bool:
        return abs(self._messages[-1].twist.twist.linear.x) < 0.005

    def wait_for(self, condition: Any, what: str) -> None:
        self._listener.spin_until(condition, what)


def _stamp(page: Any) -> float:
    return float(page.get_attribute("canvas[data-stamp]", "data-stamp"))


def test_page_shows_image_and_map_at_desktop_and_phone_size(page: Any, tmp_path: Path) -> None:
    page.wait_for_function("document.querySelector('#catalogue').options.length > 10")
    first = _stamp(page)
    page.wait_for_function(f"Number(document.querySelector('canvas[data-stamp]').dataset.stamp) > {first + 0.5}")
    colours = """(selector) => {
        const c = document.querySelector(selector), d = c.getContext('2d').getImageData(0, 0, c.width, c.height).data;
        const step = 4 * Math.floor(d.length / 8000);
        return new Set(Array.from({length: 2000}, (_, k) => d.slice(step * k, step * k + 3).join())).size; }"""
    assert page.evaluate(colours, "canvas[data-stamp]") > 100 and page.evaluate(colours, "#map") >= 3
    page.wait_for_selector("[role=treeitem]")
    for size, scheme in ((DESKTOP, "light"), (DESKTOP, "dark"), (PHONE, "light"), (PHONE, "dark")):
        page.set_viewport_size(size)
        page.emulate_media(color_scheme=scheme)
        page.wait_for_timeout(300)
        page.screenshot(path=str(tmp_path / f"{size['width']}_{scheme}.png"), full_page=True)
        assert _outside(page) == []
        stick = page.locator("#stick").bounding_box()
        assert stick["y"] + stick["height"] <= size["height"], "the stick must be seen without scrolling"


def test_a_key_drives_and_letting_go_stops(page: Any, listener: Listener) -> None:
    truth = Truth(listener)
    begin = truth.x
    page.keyboard.down("w")
    truth.wait_for(lambda: truth.x > begin + 0.3, "robot that drives while W is held")
    assert page.inner_text("#driver") == "driving"
    page.keyboard.up("w")
    truth.wait_for(lambda: truth.stands, "robot that stands after W")
    place = truth.x
    page.keyboard.down("s")
    truth.wait_for(lambda: truth.x < place - 0.2, "robot that drives back")
    page.keyboard.up("s")


def test_a_lost_page_stops_the_robot(browser: Any, address: str, listener: Listener) -> None:
    truth = Truth(listener)
    page = browser.new_page(viewport=DESKTOP, bypass_csp=True)
    page.goto(address)
    page.wait_for_selector("#state.playing", timeout=60_000)
    begin = truth.x
    page.keyboard.down("w")
    truth.wait_for(lambda: truth.x > begin + 0.1, "robot that drives")
    page.close()  # with the key down
    truth.wait_for(lambda: truth.stands, "robot that stands once its page is gone")


def test_two_pages_show_the_same_state_and_only_one_drives(page: Any, browser: Any, address: str) -> None:
    other = browser.new_page(viewport=PHONE, bypass_csp=True)
    other.goto(address)
    other.wait_for_selector("canvas[data-stamp]", timeout=60_000)
    page.keyboard.down("a")
    page.wait_for_timeout(300)
    other.keyboard.down("d")
    other.wait_for_selector("#notes p.bad")
    assert "another page is driving" in other.inner_text("#notes")
    other.keyboard.up("d")
    page.keyboard.up("a")
    other.close()


def test_a_hidden_page_gets_no_images(page: Any) -> None:
    page.evaluate("""() => { Object.defineProperty(document, 'hidden', {value: true, configurable: true});
        document.dispatchEvent(new Event('visibilitychange')); }""")
    page.wait_for_timeout(500)
    before = _stamp(page)
    page.wait_for_timeout(500)
    assert _stamp(page) == before
    page.evaluate("""() => { Object.defineProperty(document, 'hidden', {value: false, configurable: true});
        document.dispatchEvent(new Event('visibilitychange')); }""")
    page.wait_for_function(f"Number(document.querySelector('canvas[data-stamp]').dataset.stamp) > {before}")


def test_time_is_paused_stepped_and_played(page: Any) -> None:
    page.click("#pause")
    page.wait_for_selector("#state.paused")
    before = float(page.inner_text("#time"))
    page.click("#step")
    page.wait_for_function(f"Number(document.querySelector('#time').textContent) > {before}")
    page.click("#play")
    page.wait_for_selector("#state.playing")


def _choose(page: Any, name: str) -> None:
    """Takes the tool that spawns, and chooses what."""
    page.wait_for_function("document.querySelector('#catalogue').options.length > 10")
    page.click("[data-mode=spawn]")
    page.select_option("#catalogue", label=name)


def _spawn(page: Any, name: str, selector: str, position: dict[str, float]) -> str:
    """Spawns something by a click on the map or in 3-D, and selects it in the tree; returns its name."""
    _choose(page, name)
    page.evaluate("document.querySelector('#notes').replaceChildren()")
    page.click(selector, position=position)
    page.wait_for_selector("#notes p:has-text('spawned')", timeout=60_000)
    spawned: str = page.locator("#notes p:has-text('spawned')").first.inner_text().split()[-1]
    page.click("[data-mode=look]")
    _select(page, spawned)
    return spawned


def _select(page: Any, name: str) -> None:
    """Selects something in the tree."""
    page.fill("#search", name)
    page.click(f"[role=treeitem][data-key='e:{name}'] > span", timeout=60_000)
    page.wait_for_selector(f"#inspector h2:text-is('{name}')")


def _delete(page: Any) -> None:
    """Deletes the selected thing: the button asks for three seconds only, which a busy machine may exceed."""
    page.locator("#delete").evaluate("(b) => { if (!b.classList.contains('sure')) b.click(); b.click(); }")
    page.wait_for_selector("#inspector-empty", state="visible")
    page.fill("#search", "")


def test_an_object_is_spawned_moved_and_deleted_by_clicks(page: Any) -> None:
    page.click("[data-mode=spawn]")
    page.wait_for_function("document.querySelector('#catalogue').options.length > 10")
    assert page.input_value("#catalogue") == "ball", "things come first; a robot is seldom what one wants to put down"
    box = page.locator("#map").bounding_box()
    place = {"x": box["width"] * 0.45, "y": box["height"] * 0.5}
    name = _spawn(page, "bottle_water", "#map", place)
    page.click("[data-mode=move]")
    page.click("#map", position={"x": place["x"] + 25, "y": place["y"]})
    page.wait_for_selector(f"#notes p:has-text('moved {name}')")
    page.click("#delete")
    page.wait_for_selector("#delete.sure")  # it asks first
    assert page.locator(f"[data-key='e:{name}']").count() == 1
    _delete(page)
    page.wait_for_selector(f"[data-key='e:{name}']", state="detached")


def test_page_warns_of_an_object_off_the_floor_and_its_legend_explains_the_symbols(page: Any) -> None:
    page.wait_for_selector("#legend li[data-of=robot]:visible")
    assert page.locator("#legend li[data-of=path]").count() == 0, "no path is drawn"
    drawn = """() => [...document.querySelectorAll('#legend canvas')].map(
        (c) => c.getContext('2d').getImageData(0, 0, c.width, c.height).data.some((v) => v))"""
    assert all(page.evaluate(drawn)), "each symbol is drawn as on the map"
    _choose(page, "bottle_water")
    page.click("#map", position={"x": 3, "y": 3})  # beside the building
    page.wait_for_selector("#notes p.bad:has-text('no floor')")
    page.wait_for_selector("#notes p:has-text('spawned')", timeout=60_000)
    _select(page, page.locator("#notes p:has-text('spawned')").first.inner_text().split()[-1])
    _delete(page)


def test_an_object_is_dragged_on_the_map(page: Any, listener: Listener) -> None:
    _reset(page, listener)
    _spawn(page, "box_cardboard", "#map", _pixel(page, 2.2, 4.7))
    x, y = _selected_place(page)
    _drag(page, "#map", _pixel(page, x, y), _pixel(page, x + 0.3, y + 0.2))
    page.wait_for_function(f"Math.abs(Number(document.querySelector('#pose-x').value) - {x + 0.3}) < 0.1", timeout=60_000)
    assert _selected_place(page)[1] == pytest.approx(y + 0.2, abs=0.1)
    _delete(page)


def test_an_object_is_placed_selected_and_dragged_in_3_d(page: Any, listener: Listener) -> None:
    _reset(page, listener)
    page.wait_for_function("Number(document.querySelector('#scene3d').dataset.drawn) > 3", timeout=60_000)
    box = page.locator("#scene3d").bounding_box()
    at = {"x": box["width"] / 2, "y": box["height"] * 0.3}  # ahead of the robot, whose back is seen
    name = _spawn(page, "box_cardboard", "#scene3d", at)
    _select(page, "robot")
    on_it = {"x": at["x"], "y": at["y"] - 4}
    for _ in range(30):  # until the model with it has been downloaded
        page.click("#scene3d", position=on_it)
        page.wait_for_timeout(500)
        if page.inner_text("#inspector h2") == name:
            break
    assert page.inner_text("#inspector h2") == name
    x, y = _selected_place(page)
    _drag(page, "#scene3d", on_it, {"x": on_it["x"] - 40, "y": on_it["y"]})
    page.wait_for_selector(f"#notes p:has-text('moved {name}')")
    now = "Number(document.querySelector('#pose-{0}').value)"
    page.wait_for_function(f"Math.hypot({now.format('x')} - {x}, {now.format('y')} - {y}) > 0.1", timeout=60_000)
    _delete(page)


def test_a_pose_is_set_by_numbers(page: Any, listener: Listener) -> None:
    _reset(page, listener)
    name = _spawn(page, "mug", "#map", _pixel(page, 2.4, 4.7))
    page.wait_for_function(
        "document.querySelector('#inspector .hint').textContent === 'cup · hall'", timeout=60_000
    )  # class and room
    x, y = _selected_place(page)
    page.fill("#pose-x", f"{x + 0.5:.3f}")
    page.press("#pose-x", "Enter")
    page.wait_for_selector(f"#notes p:has-text('moved {name}')")
    page.wait_for_function(f"Math.abs(Number(document.querySelector('#pose-x').value) - {x + 0.5}) < 0.03", timeout=60_000)
    assert _selected_place(page)[1] == pytest.approx(y, abs=0.05)
    _delete(page)


def test_a_rate_that_another_page_has_set_is_shown(page: Any, browser: Any, address: str) -> None:
    other = browser.new_page(viewport=DESKTOP, bypass_csp=True)
    other.goto(address)
    other.wait_for_selector("#state.playing")
    for rate in ("0.5", "1"):
        page.select_option("#rate", rate)
        other.wait_for_function(f"document.querySelector('#rate').value === '{rate}'")
    other.close()


def test_an_image_keeps_its_aspect_in_a_tall_window(page: Any) -> None:
    page.set_viewport_size({"width": 1100, "height": 1300})
    page.wait_for_selector("#stage canvas[data-stamp]")
    canvas = page.evaluate("(({width, height}) => [width, height])(document.querySelector('canvas[data-stamp]'))")
    page.wait_for_timeout(300)
    box = page.locator("#stage figure").bounding_box()
    assert box["width"] / box["height"] == pytest.approx(canvas[0] / canvas[1], rel=0.01)


def test_the_scene_is_drawn_in_3_d(page: Any) -> None:
    page.wait_for_function("Number(document.querySelector('#scene3d').dataset.drawn) > 3", timeout=60_000)
    assert page.evaluate("document.querySelector('#scene3d').getContext('webgl2') !== null")
    x, y = _middle(page, "#scene3d")
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(x + 60, y + 10, steps=4)
    page.mouse.up()
    assert len(page.locator("#scene3d").screenshot()) > 10_000


def test_a_number_of_any_topic_is_plotted(page: Any) -> None:
    page.wait_for_selector("#plot-topic option[value='/odom']", state="attached")
    page.select_option("#plot-topic", "/odom")
    page.wait_for_selector("#plot-field option[value='twist.twist.linear.x']", state="attached")
    assert page.input_value("#plot-field") == "twist.twist.linear.x", "the speed comes first, not the seconds of its stamp"
    page.click("#plot-new")
    page.select_option("#plot-topic", "/joint_states")
    page.wait_for_selector("#plot-field option[value='position[1]']", state="attached")
    assert "wheel_right_joint" in page.inner_text("#plot-field option[value='position[1]']", timeout=5000)
    page.select_option("#plot-field", "velocity[1]")
    page.click("#plot-new")
    page.keyboard.down("w")
    page.wait_for_function("Number(document.querySelector('.plot-head b').textContent) > 0.3", timeout=60_000)
    page.keyboard.up("w")
    page.wait_for_function(
        "[...document.querySelectorAll('.plot canvas')].every((c) => Number(c.dataset.samples) > 20)", timeout=60_000
    )
    assert "m/s" in page.inner_text(".plot-head >> nth=0")
    drawn = "() => { const c = document.querySelector('.plot canvas'), d = c.getContext('2d').getImageData(0, 0, c.width, c.height).data; "
    drawn += "let n = 0; for (let k = 0; k < d.length; k += 4) n += d[k + 2] > 140 && d[k] < 90 && d[k + 3] > 180; return n; }"
    assert page.evaluate(drawn) > 50, "the curve is drawn in the accent colour"
    page.click(".plot-head button >> nth=0")
    page.click(".plot-head button >> nth=0")
    assert page.locator(".plot").count() == 0


def test_a_drawer_is_opened_by_its_slider_and_a_door_by_its_button(page: Any, listener: Listener) -> None:
    _reset(page, listener)
    _spawn(page, "cabinet_drawers", "#map", _pixel(page, 2.6, 4.7))
    page.wait_for_selector("#joints input[data-joint*=drawer_2]")
    assert page.locator("#joints input").count() == 3
    for part, opening in (("100", "> 95"), ("0", "< 5")):
        page.locator("#joints input[data-joint*=drawer_2]").evaluate(
            "(input, part) => { input.value = part; input.dispatchEvent(new Event('change')); }", part
        )
        text = "document.querySelector('.joint:has([data-joint*=drawer_2]) output').textContent"
        page.wait_for_function(f"parseFloat({text}) {opening}", timeout=60_000)
    _delete(page)
    name = _spawn(page, "oven_body", "#map", _pixel(page, 2.6, 4.7))  # which has one door
    row = page.locator(f"[data-key='e:{name}']")
    for word, opening in (("Open", "> 0.9"), ("Close", "< 0.05")):
        row.locator(f"button:has-text('{word}')").click(timeout=60_000)
        part = f"document.querySelector(\"[data-key='e:{name}'] .bar\").style.getPropertyValue('--part')"
        page.wait_for_function(f"Number({part}) {opening}", timeout=60_000)
    _delete(page)


def test_an_object_is_selected_on_the_map(page: Any, listener: Listener) -> None:
    _reset(page, listener)
    place = _pixel(page, 1.9, 4.3)
    name = _spawn(page, "mug", "#map", place)
    _select(page, "robot")
    page.click("#map", position=place)
    page.wait_for_selector(f"#inspector h2:text-is('{name}')")
    page.fill("#search", "")
    page.wait_for_selector(f"[data-key='e:{name}'][aria-selected=true]")
    _delete(page)


def test_a_recording_is_made_listed_and_plotted(page: Any, folder: Path) -> None:
    page.click("#tab-recordings")
    page.click("#record")
    page.wait_for_selector("#record.on")
    page.wait_for_selector("#recording:visible")
    page.wait_for_function("/[3-9]\\d\\d kB|MB/.test(document.querySelector('#record-what').textContent)", timeout=60_000)
    name = page.inner_text("#record-what").partition(":")[0]
    page.click("#record")
    page.wait_for_selector("#record:not(.on)", timeout=60_000)
    assert page.inner_text("#record-error") == ""
    with BagReader(folder / name) as bag:
        topics = bag.topics()
        assert topics["/odom"].count > 10 and "/camera/image_raw" not in topics
    row = page.locator(f"#recordings li:has-text('{Path(name).name}')")
    row.wait_for()
    assert "messages" in row.inner_text()
    row.locator("button").click()
    page.wait_for_selector("#viewer-frame:visible", timeout=180_000)
    plots = page.frame_locator("#viewer-frame")
    plots.locator("svg.path").wait_for(timeout=60_000)
    assert plots.locator("h1").inner_text() == Path(name).name
    page.keyboard.press("Escape")
    page.wait_for_selector("#viewer", state="hidden")


def test_the_report_of_a_trial_opens_in_a_frame_that_runs_no_script(page: Any, folder: Path) -> None:
    trial = folder / "out" / "web" / "trial"
    trial.mkdir(parents=True)
    (trial / "results.json").write_text('{"totals": {"passed": 3, "runs": 4}}')
    script = "<script>parent.document.title = 'taken'; document.body.append('script')</script>"
    (trial / "index.html").write_text(f"<!doctype html><title>t</title><h1>Trial of a stack</h1>{script}")
    page.click("#tab-recordings")
    page.click("#recordings-refresh")
    row = page.locator("#recordings li:has-text('trial')")
    row.wait_for()
    assert "3 of 4 runs passed" in row.inner_text()
    row.locator("button").click()
    frame = page.frame_locator("#viewer-frame")
    frame.locator("h1").wait_for()
    assert frame.locator("body").inner_text().strip() == "Trial of a stack" and page.title() == "Gibson Sim"
    page.click("#viewer-close")
    page.wait_for_selector("#viewer", state="hidden")


def test_pictures_of_all_cameras_are_one_file(page: Any, tmp_path: Path) -> None:
    with page.expect_download() as found:
        page.click("#pictures")
    found.value.save_as(tmp_path / "pictures.zip")
    with zipfile.ZipFile(tmp_path / "pictures.zip") as pictures:
        assert pictures.testzip() is None
        assert {"camera.jpg", "camera_depth.jpg", "view_top.jpg"} <= set(pictures.namelist())
        assert all(pictures.read(name).startswith(b"\xff\xd8") for name in pictures.namelist())


def test_a_page_opened_while_time_is_paused_shows_the_current_state(page: Any) -> None:
    page.click("#pause")
    page.wait_for_selector("#state.paused")
    page.wait_for_timeout(1500)
    page.reload()
    page.wait_for_selector("canvas[data-stamp]")
    page.wait_for_function("document.querySelector('#pose').textContent.includes('m/s')")
    page.wait_for_function("Number(document.querySelector('#scene3d').dataset.drawn) > 0", timeout=60_000)
    page.wait_for_selector("#scene-note", state="hidden")
    page.evaluate("document.querySelector('figure:has([data-topic*=view_follow]) canvas').removeAttribute('data-stamp')")
    page.click("#topics button:has-text('view_follow')")
    page.wait_for_selector("#stage canvas[data-topic*=view_follow]")
    page.click("#step")
    page.wait_for_selector("#stage canvas[data-topic*=view_follow][data-stamp]")
    page.click("#topics button:has-text('view_follow')")
    page.click("#play")
    page.wait_for_selector("#state.playing")


def test_the_estimate_of_a_localiser_is_an_ellipse(page: Any, listener: Listener) -> None:
    latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    publisher = listener.node.create_publisher(PoseWithCovarianceStamped, "amcl_pose", latched)
    message = PoseWithCovarianceStamped()
    message.pose.pose.position.x, message.pose.pose.position.y = 3.0, 3.0
    message.pose.covariance[0], message.pose.covariance[7] = 0.25, 0.04  # 2 sigma: 1.0 m by 0.4 m
    count = """() => { const c = document.querySelector('#map'), d = c.getContext('2d').getImageData(0, 0, c.width, c.height).data; let n = 0;
        for (let k = 0; k < d.length; k += 4) n += d[k] === 138 && d[k + 1] === 83 && d[k + 2] === 0; return n; }"""
    before = page.evaluate(count)
    publisher.publish(message)
    page.wait_for_function(f"({count})() > {before} + 20")
    listener.node.destroy_publisher(publisher)


def test_the_map_shows_one_floor_of_a_house(page: Any, listener: Listener) -> None:
    latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    page.wait_for_function("document.querySelector('#map').dataset.labels.length > 0")
    assert page.is_hidden("#floor"), "a house of one floor has no choice"
    publishers = []
    for number, z in enumerate((0.0, 2.86)):
        grid = OccupancyGrid(data=[0] * 100)
        grid.info.width, grid.info.height, grid.info.resolution, grid.info.origin.position.z = 10, 10, 1.0, z
        publishers.append(listener.node.create_publisher(OccupancyGrid, f"floor_{number}/map", latched))
        publishers[-1].publish(grid)
    page.wait_for_selector("#floor", state="visible")
    assert page.locator("#floor option").all_inner_texts() == ["Floor 0 (robot)", "Floor 1"]
    rooms = page.get_attribute("#map", "data-labels")
    page.select_option("#floor", "1")
    page.wait_for_function("document.querySelector('#map').dataset.labels === ''")
    page.wait_for_selector("#legend li[data-of=robot]", state="detached")
    page.select_option("#floor", "0")
    page.wait_for_function("(rooms) => document.querySelector('#map').dataset.labels === rooms", arg=rooms)
    for publisher in publishers:
        listener.node.destroy_publisher(publisher)
    page.wait_for_selector("#floor", state="hidden")


def test_labels_do_not_cover_each_other_and_rooms_come_first(page: Any) -> None:
    written = """async (labels) => {
        const { FloorMap } = await import('/page/map.js'), canvas = document.createElement('canvas');
        const map = new FloorMap(canvas, {}), boxes = [], c = map.context;
        map.view = { scale: 100, x: 2, y: 2 };
        Object.defineProperties(canvas, { clientWidth: { value: 400 }, clientHeight: { value: 400 } });
        c.fillText = (text, x, y) => boxes.push([text, x, y - 11, x + c.measureText(text).width, y + 3]);
        c.font = '11px sans-serif'; map.labels = [];
        for (const [text, x, y, rank] of labels) map.label(text, x, y, 5, '#000', rank);
        map.writeLabels(400, 400, '#fff');
        return boxes; }"""
    room, thing = 2, 3
    labels = [["cup", 2.0, 2.0, thing], ["bedroom_1", 2.0, 2.0, room], ["bedroom_2", 2.05, 2.0, room], ["hall", 3.95, 2.0, room]]
    boxes = page.evaluate(written, labels + [["cup", 2.0, 2.0, thing]] * 20)
    assert [box[0] for box in boxes] == ["bedroom_1", "bedroom_2", "hall", "cup", "cup"], "above and below; the rest fits nowhere"
    for k, (name, *a) in enumerate(boxes):
        assert a[0] >= 0 and a[2] <= 400, f"{name} ends at the edge"
        for other, *b in boxes[k + 1 :]:
            assert not (a[0] < b[2] and a[2] > b[0] and a[1] < b[3] and a[3] > b[1]), f"{name} lies over {other}"


def test_labels_do_not_cover_symbols(page: Any) -> None:
    placed = """async () => {
        const { FloorMap } = await import('/page/map.js'), canvas = document.createElement('canvas');
        const map = new FloorMap(canvas, {}), boxes = [], c = map.context;
        map.view = { scale: 100, x: 2, y: 2 };
        Object.defineProperties(canvas, { clientWidth: { value: 400 }, clientHeight: { value: 400 } });
        c.fillText = (text, x, y) => boxes.push(x);
        c.font = '11px sans-serif'; map.labels = []; map.marks = [];
        map.label('hall', 2, 2, 5, '#000', 2);
        map.mark(2.15, 2, 8); // to the right of the point
        map.writeLabels(400, 400, '#fff');
        map.labels.push({ ...map.labels[0], at: [100, 100] });
        for (const [x, y] of [[1, 3], [1.2, 3], [0.8, 3]]) map.mark(x, y, 20, true); // robots on all sides
        map.writeLabels(400, 400, '#fff');
        return boxes; }"""
    left, *again = page.evaluate(placed)
    assert left < 190, "to the left of its point, where no symbol is"
    assert again == [left], "no name of a room is written over a robot"


def test_a_long_name_breaks_between_its_words(page: Any) -> None:
    breaks = """async (name) => {
        const { nameElement } = await import('/page/dom.js'), e = nameElement(name);
        return [e.textContent, e.innerHTML]; }"""
    assert page.evaluate(breaks, "bedroom_1_cabinet/a<b>") == [
        "bedroom_1_cabinet/a<b>",
        "bedroom_<wbr>1_<wbr>cabinet/<wbr>a&lt;b&gt;",
    ]


PANELS = ("images", "map", "view3d", "scene", "inspector", "drive", "plots", "log", "recordings", "task")


def _share(page: Any) -> float:
    """Returns the width of the images as a part of the window's."""
    return float(page.evaluate("document.querySelector('#panel-images').getBoundingClientRect().width / innerWidth"))


def test_the_panels_fill_the_window(page: Any) -> None:
    for size in (DESKTOP, {"width": 1920, "height": 1080}):
        page.set_viewport_size(size)
        covered = page.evaluate("""() => [...document.querySelectorAll('.group')].reduce((sum, g) => sum + g.offsetWidth * g.offsetHeight, 0)
            / (innerWidth * (innerHeight - document.querySelector('header').offsetHeight))""")
        assert covered > 0.95
        assert _outside(page) == []


def test_splitters_and_sides_are_kept_in_the_browser(page: Any) -> None:
    before = _share(page)
    bar = page.locator("[role=separator][aria-label='border between Scene and Images']")
    x, y = _middle(page, "[role=separator][aria-label='border between Scene and Images']")
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(x + 100, y, steps=4)
    page.mouse.up()
    dragged = _share(page)
    assert dragged < before - 0.05
    bar.focus()
    page.keyboard.press("ArrowRight")
    assert _share(page) < dragged
    page.click("#side-right")
    page.wait_for_selector("#map", state="hidden")
    kept = _share(page)
    page.reload()
    page.wait_for_selector("canvas[data-stamp]", timeout=60_000)
    assert page.is_hidden("#map") and _share(page) == pytest.approx(kept, abs=0.01)
    page.click("#layout-reset")
    page.wait_for_selector("#map", state="visible")
    assert _share(page) == pytest.approx(before, abs=0.01)


def test_a_tab_is_dragged_beside_another_panel_and_a_panel_fills_the_window(page: Any) -> None:
    box = page.locator("#map").bounding_box()
    tab = page.locator("#tab-log").bounding_box()
    page.mouse.move(tab["x"] + 10, tab["y"] + 10)
    page.mouse.down()
    page.mouse.move(box["x"] + box["width"] - 10, box["y"] + box["height"] / 2, steps=8)
    page.wait_for_selector(".drop.right")
    page.mouse.up()
    page.wait_for_selector("#panel-log:visible")
    log = page.locator("#panel-log").bounding_box()
    assert log["x"] > page.locator("#map").bounding_box()["x"] + 50 and page.is_visible("#panel-plots")
    page.locator("#tab-images").dblclick()
    assert page.locator("#panel-images").bounding_box()["width"] > 0.95 * DESKTOP["width"]
    page.keyboard.press("Escape")
    assert page.locator("#panel-images").bounding_box()["width"] < 0.7 * DESKTOP["width"]
    page.click("#layout-reset")


def test_the_tree_finds_things_by_name_class_and_room(page: Any, listener: Listener) -> None:
    _reset(page, listener)
    cup = _spawn(page, "mug", "#map", _pixel(page, 2.4, 4.7))
    ball = _spawn(page, "ball", "#map", _pixel(page, 6.4, 2.9))
    page.fill("#search", "")
    page.wait_for_selector(f"[data-key='e:{ball}']")
    page.wait_for_function(
        "[...document.querySelectorAll('.branch > span')].map((e) => e.textContent).join() === 'Robots,hall,kitchen'"
    )
    names = "[...document.querySelectorAll('[role=treeitem]:not(.branch)')].map((row) => row.dataset.key).join()"
    for sought, found in (
        ("kitchen", f"e:{ball}"),
        ("BALL", f"e:{ball}"),
        ("cup", f"e:{cup}"),
        ("robot", "e:robot"),
        ("nothing", ""),
    ):
        page.fill("#search", sought)
        page.wait_for_function(f"{names} === '{found}'")
    page.fill("#search", "")
    page.select_option("#grouping", "nearest")
    page.wait_for_function(f"{names} === 'e:robot,e:{cup},e:{ball}'")
    page.select_option("#grouping", "rooms")
    page.locator(".branch:has-text('kitchen')").click()
    page.wait_for_selector(".branch[aria-expanded=false]:has-text('kitchen')")
    assert page.locator(f"[data-key='e:{ball}']").count() == 0
    page.keyboard.press("ArrowRight")  # the row has the focus
    page.wait_for_selector(".branch[aria-expanded=true]:has-text('kitchen')")
    page.keyboard.press("ArrowDown")
    page.keyboard.press("Enter")
    page.wait_for_selector(f"#inspector h2:text-is('{ball}')")
    _delete(page)
    _select(page, cup)
    _delete(page)


def test_images_are_large_or_in_a_grid_or_stills_in_a_strip(page: Any) -> None:
    page.wait_for_selector("#strip canvas[data-topic*=view_top][data-stamp]", timeout=60_000)
    still = page.get_attribute("#strip canvas[data-topic*=view_top]", "data-stamp")
    page.wait_for_timeout(700)
    assert page.get_attribute("#strip canvas[data-topic*=view_top]", "data-stamp") == still, "a still is no video"
    page.click("#strip figure:has([data-topic*=view_top]) button.name")
    page.wait_for_selector("#stage canvas[data-topic*=view_top]")
    page.wait_for_function(
        f"Number(document.querySelector('[data-topic*=view_top]').dataset.stamp) > {still} + 0.5", timeout=60_000
    )
    assert page.locator("#topics button[aria-pressed=true]").all_inner_texts() == ["view_top"]
    page.click("#grid")
    assert page.locator("#stage figure").count() == page.locator("#topics button").count() > 2
    page.click("#grid")
    page.click("#strip figure:has([data-topic^='/camera/image']) button.name")


def test_the_first_image_comes_before_the_scene_in_3_d(browser: Any, address: str) -> None:
    page = browser.new_page(viewport=DESKTOP, bypass_csp=True)
    page.add_init_script("""addEventListener('DOMContentLoaded', () => new MutationObserver((_, me) => {
        if (document.querySelector('canvas[data-stamp]')) { performance.mark('image'); me.disconnect(); }
    }).observe(document, { subtree: true, attributes: true, attributeFilter: ['data-stamp'] }));""")
    page.goto(address)
    assert page.is_visible("#panel-map") and page.is_visible("#panel-images"), "the frame is there at once"
    page.wait_for_function("Number(document.querySelector('#scene3d').dataset.drawn) > 0", timeout=60_000)
    image, scene = page.evaluate("""() => [performance.getEntriesByName('image')[0].startTime,
        performance.getEntriesByType('resource').find((e) => e.name.includes('/data/scene')).startTime]""")
    assert image < scene + 1 or scene > 4000, "at once, or after the page has waited for an image"
    page.close()


def test_a_machine_that_skips_images_is_busy_and_nothing_is_amber(page: Any) -> None:
    shown = """async (reports) => {
        const { Log } = await import('/page/log.js'), found = [], log = new Log((counts) => found.push(counts));
        const values = [['images_per_s', '12.3'], ['due_per_s', '30'], ['skipped', '18']];
        const render = { name: 'gibson_sim: render', level: 1, message: 'skips images', values };
        for (let k = 0; k < reports; k++) log.set([render], k);
        const item = document.querySelector('#diagnostics li'), tab = document.querySelector('#tab-log');
        const is = [found.at(-1) ?? null, item.className, item.children[1].textContent, tab.className];
        log.set([{ ...render, message: 'no images of camera', level: 2 }], 9);
        return [...is, item.className, tab.className]; }"""
    found = page.evaluate(shown, 4)
    assert found[0] == [12.3, 30] and found[1:4] == ["level0", "12 of 30 images/s", ""]
    assert found[4:] == ["level2", "level2"], "an error is one at once"


def test_a_busy_machine_is_offered_slower_time_and_fewer_cameras(page: Any, browser: Any, address: str) -> None:
    page.click("#grid")  # all cameras at once, which software cannot draw
    page.wait_for_selector("#busy:visible", timeout=90_000)
    assert "this machine is busy" in page.inner_text("#busy")
    page.click("#busy-slow")
    page.wait_for_function("document.querySelector('#rate').value === '0.5'")
    page.select_option("#rate", "1")
    page.click("#busy-one")
    assert page.locator("#topics button[aria-pressed=true]").count() == 1


def test_a_joint_of_an_arm_follows_its_slider(page: Any) -> None:
    moved = """async () => {
        const { Inspector } = await import('/page/inspector.js'), sent = [];
        const inspector = new Inspector((type, values) => sent.push([type, values]), {});
        inspector.setRobots([{ name: 'robot', namespace: '', x: 1, y: 2, z: 0, yaw: 0 }]);
        inspector.select({ name: 'robot', robot: true, x: 1, y: 2, z: 0, yaw: 0, floor: 0, class: 'robot' });
        inspector.setJoints({ '': [{ name: 'arm_2', lower: -1, upper: 2, unit: 'rad', position: 0.25 }] });
        const input = document.querySelector('[data-joint=arm_2]'), before = input.value;
        input.value = '1.5'; input.dispatchEvent(new Event('input'));
        inspector.setJoints({ '': [{ name: 'arm_2', lower: -1, upper: 2, unit: 'rad', position: 0.4 }] });
        return [Number(before), sent, Number(input.value), input.closest('.joint').querySelector('output').textContent]; }"""
    before, sent, shown, text = page.evaluate(moved)
    assert before == pytest.approx(0.25, abs=0.01) and shown == 1.5, "it stays where it was put while the joint follows"
    [(kind, values)] = sent
    assert kind == "joint" and values["joint"] == "arm_2" and values["position"] == 1.5 and text == "0.400 rad"


@pytest.mark.parametrize("size", [DESKTOP, PHONE], ids=["desktop", "phone"])
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_axe_reports_no_serious_accessibility_violations(page: Any, size: dict[str, int], scheme: str) -> None:
    page.set_viewport_size(size)
    page.emulate_media(color_scheme=scheme)
    page.evaluate(AXE_SCRIPT)
    page.wait_for_selector("[role=treeitem]", state="attached")
    row = page.locator("[role=treeitem]:not(.branch)").first
    if size is DESKTOP:
        row.click()
    rules = "{ runOnly: ['wcag2a', 'wcag2aa', 'wcag21a', 'wcag21aa', 'best-practice'] }"
    for number, tab in enumerate(page.locator("[role=tab]").evaluate_all("(tabs) => tabs.map((tab) => tab.id)")):
        page.click(f"#{tab}")
        page.wait_for_timeout(150)
        # The whole page once, then what each tab shows: all of it for each tab would take half a minute.
        shown = f"'#{page.get_attribute(f'#{tab}', 'aria-controls')}', " if number else ""
        found = page.evaluate(f"axe.run({shown}{rules})")["violations"]
        serious = [(v["id"], [n["html"][:200] for n in v["nodes"]]) for v in found if v["impact"] in ("serious", "critical")]
        assert serious == [], f"{tab}, {scheme}"


def test_a_phone_shows_each_panel_within_its_window(browser: Any, address: str) -> None:
    context = browser.new_context(viewport=PHONE, bypass_csp=True, has_touch=True, is_mobile=True)
    page = context.new_page()
    page.goto(address)
    page.wait_for_selector("canvas[data-stamp]", timeout=60_000)
    tabs = page.locator("[role=tab]").evaluate_all("(tabs) => tabs.map((tab) => tab.id)")
    seen: set[str] = set()
    for tab in tabs:
        page.tap(f"#{tab}")
        page.wait_for_timeout(150)
        assert _outside(page) == [], tab
        seen |= {name for name in PANELS if page.is_visible(f"#panel-{name}")}
    assert seen == set(PANELS)
    page.tap("#tab-map")
    page.wait_for_selector("#map[data-map]")
    page.tap("[data-mode=goal]")
    page.tap("#map", position={"x": 100, "y": 150})
    page.wait_for_selector("#notes p:has-text('goal_pose')")
    context.close()


def test_the_keyboard_reaches_every_control(page: Any) -> None:
    page.wait_for_selector("[role=treeitem]", state="attached")
    reachable = """() => [...document.querySelectorAll('button, input, select, canvas[tabindex], [role=separator], [role=treeitem][tabindex="0"]')]
        .filter((e) => e.checkVisibility() && !e.disabled && e.tabIndex >= 0).map((e) => { e.dataset.expected = '1'; }).length"""
    expected = page.evaluate(reachable)
    page.evaluate("document.activeElement?.blur()")
    for _ in range(expected + 10):
        page.keyboard.press("Tab")
        page.evaluate("""() => { const e = document.activeElement;
            if (e !== document.body) { e.dataset.reached = '1'; e.dataset.ring = getComputedStyle(e).outlineStyle; } }""")
    missed = page.evaluate("""() => [...document.querySelectorAll('button, input, select, canvas[tabindex], [role=separator]')]
        .filter((e) => e.dataset.expected && e.checkVisibility() && !e.disabled && e.tabIndex >= 0 && !e.dataset.reached)
        .map((e) => e.id || e.textContent)""")  # of those that were there: a busy machine shows two more controls
    assert missed == []
    rings = page.evaluate(
        "[...document.querySelectorAll('[data-reached]')].filter((e) => e.dataset.ring === 'none').map((e) => e.id)"
    )
    assert rings == [], "the focus is seen"
    page.locator("#map").focus()
    view = page.get_attribute("#map", "data-view")
    page.keyboard.press("ArrowRight")
    page.keyboard.press("+")
    page.wait_for_function("(view) => document.querySelector('#map').dataset.view !== view", arg=view)
    assert page.inner_text("#driver") == "not driving", "arrows move the map, not the robot"


def _reset(page: Any, listener: Listener) -> None:
    """Brings the robot back to its start: where the tests before have left it, it may block what this one does."""
    truth = Truth(listener)
    page.click("#reset")
    truth.wait_for(lambda: truth.stands and abs(truth.x - START_X) < 0.01, "robot at its start")


def _pixel(page: Any, x: float, y: float) -> dict[str, float]:
    """Returns the pixel of the map that shows a place, metres."""
    page.wait_for_selector("#map[data-map]")
    box, (scale, middle_x, middle_y) = (
        page.locator("#map").bounding_box(),
        map(float, page.get_attribute("#map", "data-view").split()),
    )
    return {"x": box["width"] / 2 + (x - middle_x) * scale, "y": box["height"] / 2 - (y - middle_y) * scale}


def _selected_place(page: Any) -> tuple[float, float]:
    """Returns x and y (m) of the selected thing, as the inspector shows them."""
    x, y = (float(page.input_value(f"#pose-{key}")) for key in ("x", "y"))
    return x, y


def _drag(page: Any, selector: str, begin: dict[str, float], end: dict[str, float]) -> None:
    """Drags from one pixel of an element to another."""
    box = page.locator(selector).bounding_box()
    page.mouse.move(box["x"] + begin["x"], box["y"] + begin["y"])
    page.mouse.down()
    page.mouse.move(box["x"] + end["x"], box["y"] + end["y"], steps=6)
    page.mouse.up()


def _outside(page: Any) -> list[str]:
    """Returns the visible elements that end outside of the window, beside what scrolls within a panel."""
    found: list[str] = page.evaluate("""() => {
        const scrolls = (e) => { for (let p = e.parentElement; p && p !== document.body; p = p.parentElement)
            if (/auto|scroll|hidden/.test(getComputedStyle(p).overflow)) return true; return false; };
        const out = [];
        for (const e of document.querySelectorAll('header *, #dock *')) {
            const r = e.getBoundingClientRect();
            if (!r.width || !r.height || !e.checkVisibility() || e.closest('svg.sprite')) continue;
            const out_of_it = r.right > innerWidth + 0.5 || r.left < -0.5 || r.bottom > innerHeight + 0.5;
            if (out_of_it && !scrolls(e)) out.push(e.id || e.className || e.tagName);
        }
        if (document.documentElement.scrollWidth > innerWidth) out.push('document');
        return out; }""")
    return found


def _middle(page: Any, selector: str) -> tuple[float, float]:
    box = page.locator(selector).bounding_box()
    return box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
