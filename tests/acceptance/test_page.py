"""The live page in a real browser: what it shows moves, what is pressed drives, what is lost stops."""

from __future__ import annotations

import warnings
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from support.simulation import Launched, Listener, require

require("rclpy", "gibson_msgs", "playwright")

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


def test_the_image_and_the_map_are_there_at_desktop_and_phone_size(page: Any, tmp_path: Path) -> None:
    page.wait_for_function("document.querySelector('#catalogue').options.length > 10")
    first = _stamp(page)
    page.wait_for_function(f"Number(document.querySelector('canvas[data-stamp]').dataset.stamp) > {first + 0.5}")
    colours = """(selector) => {
        const c = document.querySelector(selector), d = c.getContext('2d').getImageData(0, 0, c.width, c.height).data;
        const step = 4 * Math.floor(d.length / 8000);
        return new Set(Array.from({length: 2000}, (_, k) => d.slice(step * k, step * k + 3).join())).size; }"""
    assert page.evaluate(colours, "canvas[data-stamp]") > 100 and page.evaluate(colours, "#map") >= 3
    page.wait_for_selector("#things li")
    for size, scheme in ((DESKTOP, "light"), (DESKTOP, "dark"), (PHONE, "light"), (PHONE, "dark")):
        page.set_viewport_size(size)
        page.emulate_media(color_scheme=scheme)
        page.wait_for_timeout(300)
        page.screenshot(path=str(tmp_path / f"{size['width']}_{scheme}.png"), full_page=True)
        assert page.evaluate("document.documentElement.scrollWidth") <= size["width"]
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


def test_two_pages_show_the_same_and_one_drives(page: Any, browser: Any, address: str) -> None:
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


def test_a_thing_is_spawned_moved_and_deleted_by_clicks(page: Any) -> None:
    page.wait_for_function("document.querySelector('#catalogue').options.length > 10")
    assert page.input_value("#catalogue") == "ball", "things come first; a robot is seldom what one wants to put down"
    page.select_option("#catalogue", label="bottle_water")
    page.click("[data-mode=spawn]")
    box = page.locator("#map").bounding_box()
    place = {"x": box["width"] * 0.45, "y": box["height"] * 0.5}
    page.click("#map", position=place)
    page.wait_for_selector("#things li:has-text('bottle')")
    page.click("#things li:has-text('bottle') span")
    page.click("[data-mode=move]")
    page.click("#map", position={"x": place["x"] + 25, "y": place["y"]})
    page.wait_for_selector("#notes p:has-text('moved bottle')")
    remove = page.locator("#things li:has-text('bottle') button")
    remove.click()
    page.wait_for_selector("#things li:has-text('bottle') button.sure")  # it asks first
    assert page.locator("#things li:has-text('bottle')").count() == 1
    _delete(remove)
    page.wait_for_selector("#things li:has-text('bottle')", state="detached")


def test_what_is_spawned_where_and_what_the_symbols_mean_is_said(page: Any) -> None:
    page.wait_for_function("document.querySelector('#catalogue').options.length > 10")
    page.select_option("#catalogue", label="bottle_water")
    assert page.inner_text("[data-mode=spawn]") == "Spawn bottle_water"
    page.wait_for_selector("#legend li[data-of=robots]:visible")
    page.wait_for_selector("#legend li[data-of=paths]", state="hidden")
    page.click("[data-mode=spawn]")
    page.click("#map", position={"x": 3, "y": 3})  # beside the building
    page.wait_for_selector("#notes p.bad:has-text('no floor')")
    page.wait_for_selector("#things li:has-text('bottle')")
    _delete(page.locator("#things li:has-text('bottle') button"))
    page.wait_for_selector("#things li:has-text('bottle')", state="detached")


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
    canvas = page.evaluate("(({width, height}) => [width, height])(document.querySelector('canvas[data-stamp]'))")
    page.wait_for_timeout(300)
    box = page.locator("figure").bounding_box()
    assert box["width"] / box["height"] == pytest.approx(canvas[0] / canvas[1], rel=0.01)


def test_the_scene_is_drawn_in_3_d(page: Any) -> None:
    page.click("#three")
    page.wait_for_function("Number(document.querySelector('#scene3d').dataset.drawn) > 3", timeout=60_000)
    assert page.evaluate("document.querySelector('#scene3d').getContext('webgl2') !== null")
    page.mouse.move(*_middle(page, "#scene3d"))
    page.mouse.down()
    page.mouse.move(_middle(page, "#scene3d")[0] + 60, _middle(page, "#scene3d")[1] + 10, steps=4)
    page.mouse.up()
    assert len(page.locator("#scene3d").screenshot()) > 10_000
    page.click("#three")


def test_a_number_of_any_topic_is_plotted(page: Any) -> None:
    page.click("#plots-toggle")
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
    drawn += "let n = 0; for (let k = 0; k < d.length; k += 4) n += d[k + 2] > 180 && d[k] < 90 && d[k + 3] > 180; return n; }"
    assert page.evaluate(drawn) > 50, "the curve is drawn in the accent colour"
    page.click(".plot-head button >> nth=0")
    page.click(".plot-head button >> nth=0")
    assert page.locator(".plot").count() == 0
    page.click("#plots-toggle")


def test_a_drawer_is_opened_and_closed(page: Any, listener: Listener) -> None:
    _reset(page, listener)
    page.wait_for_function("document.querySelector('#catalogue').options.length > 10")
    page.select_option("#catalogue", label="cabinet_drawers")
    page.click("[data-mode=spawn]")
    page.click("#map", position=_pixel(page, 2.6, 4.7))
    page.click("[data-mode=look]")
    row = page.locator("#doors li:has-text('drawer 2')")
    row.wait_for()
    assert page.locator("#doors li").count() == 3
    for word, opening in (("Open", "> 0.95"), ("Close", "< 0.05")):
        assert row.locator("button").inner_text() == word
        row.locator("button").click()
        page.wait_for_function(f"Number([...document.querySelectorAll('#doors li')].find((l) => l.textContent.includes('drawer 2'))"
                               f".querySelector('.bar').style.getPropertyValue('--part')) {opening}", timeout=60_000)  # fmt: skip
        page.wait_for_timeout(300)


def test_a_thing_is_selected_on_the_map(page: Any, listener: Listener) -> None:
    _reset(page, listener)
    page.select_option("#catalogue", label="mug")
    page.click("[data-mode=spawn]")
    place = _pixel(page, 1.9, 4.3)
    page.click("#map", position=place)
    page.wait_for_selector("#things li:has-text('cup')")
    page.click("[data-mode=look]")
    page.wait_for_timeout(1500)  # until the map knows where it lies
    page.click("#map", position=place)
    page.wait_for_selector("#things li[aria-selected=true]:has-text('cup')")


def test_a_recording_is_made_and_ended(page: Any, folder: Path) -> None:
    page.click("#record")
    page.wait_for_selector("#record.on")
    page.wait_for_function("/[3-9]\\d\\d kB|MB/.test(document.querySelector('#record-what').textContent)", timeout=60_000)
    name = page.inner_text("#record-what").partition(":")[0]
    page.click("#record")
    page.wait_for_selector("#record:not(.on)", timeout=60_000)
    assert page.inner_text("#record-error") == ""
    with BagReader(folder / name) as bag:
        topics = bag.topics()
        assert topics["/odom"].count > 10 and "/camera/image_raw" not in topics


def test_pictures_of_all_cameras_are_one_file(page: Any, tmp_path: Path) -> None:
    with page.expect_download() as found:
        page.click("#pictures")
    found.value.save_as(tmp_path / "pictures.zip")
    with zipfile.ZipFile(tmp_path / "pictures.zip") as pictures:
        assert pictures.testzip() is None
        assert {"camera.jpg", "camera_depth.jpg", "view_top.jpg"} <= set(pictures.namelist())
        assert all(pictures.read(name).startswith(b"\xff\xd8") for name in pictures.namelist())


def test_a_page_that_is_opened_while_time_is_paused_shows_the_present(page: Any) -> None:
    page.click("#pause")
    page.wait_for_selector("#state.paused")
    page.wait_for_timeout(1500)
    page.reload()
    page.wait_for_selector("canvas[data-stamp]")
    page.wait_for_function("document.querySelector('#pose').textContent.includes('m/s')")
    page.click("#three")
    page.wait_for_function("Number(document.querySelector('#scene3d').dataset.drawn) > 0", timeout=60_000)
    page.wait_for_selector("#scene-note", state="hidden")
    page.click("#three")
    page.click("#topics button:has-text('view_follow')")  # which was not drawn at this tick
    page.wait_for_function("document.querySelectorAll('.why')[1].textContent.includes('press Step')")
    page.click("#step")
    page.wait_for_selector("canvas[data-topic*=view_follow][data-stamp]")
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
        for (let k = 0; k < d.length; k += 4) n += d[k] === 180 && d[k + 1] === 83 && d[k + 2] === 9; return n; }"""
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
    page.wait_for_selector("#legend li[data-of=robots]", state="hidden")
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
        c.strokeText = (text, x, y) => boxes.push([text, x, y - 11, x + c.measureText(text).width, y + 3]);
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


def test_a_name_of_a_node_is_not_broken_within_a_word(page: Any) -> None:
    lines = """(name) => {
        const li = document.createElement('li'), span = document.createElement('span'), small = document.createElement('small');
        span.textContent = name; small.textContent = 'slower than the requested rate; '.repeat(8);
        li.append(span, small); document.querySelector('#diagnostics').append(li);
        const range = document.createRange(); range.selectNodeContents(span);
        const [width, lines] = [li.scrollWidth - li.clientWidth, range.getClientRects().length];
        li.remove(); return [width, lines]; }"""
    for size in (DESKTOP, PHONE):
        page.set_viewport_size(size)
        assert page.evaluate(lines, "render") == [0, 1]
        too_wide, count = page.evaluate(lines, "n" * 200)
        assert too_wide == 0 and count > 1, "a name wider than the panel is broken"


def test_a_long_name_breaks_between_its_words(page: Any) -> None:
    breaks = """async (name) => {
        const { nameElement } = await import('/page/dom.js'), e = nameElement(name);
        return [e.textContent, e.innerHTML]; }"""
    assert page.evaluate(breaks, "bedroom_1_cabinet/a<b>") == [
        "bedroom_1_cabinet/a<b>",
        "bedroom_<wbr>1_<wbr>cabinet/<wbr>a&lt;b&gt;",
    ]


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


def _delete(button: Any) -> None:
    """Presses a button that asks first, and presses it again at once: it asks for three seconds only, which a busy machine may exceed."""
    button.evaluate("(b) => { if (!b.classList.contains('sure')) b.click(); b.click(); }")


def _middle(page: Any, selector: str) -> tuple[float, float]:
    box = page.locator(selector).bounding_box()
    return box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
