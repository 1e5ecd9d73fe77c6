"""The live page in a real browser: what it shows moves, what is pressed drives, what is lost stops."""

from __future__ import annotations

import os
import shutil
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from support.simulation import Launched, Listener, require

require("rclpy", "gibson_msgs", "playwright")

from nav_msgs.msg import Odometry  # noqa: E402
from playwright.sync_api import sync_playwright  # noqa: E402

from gibson_sim.ros.topics import qos  # noqa: E402

pytestmark = [pytest.mark.ros, pytest.mark.egl]
DESKTOP, PHONE = {"width": 1360, "height": 820}, {"width": 390, "height": 844}


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    """Chromium, without a window; WebGL is drawn in software."""
    chromium = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if chromium is None:
        message = "SKIPPED: no Chromium on this machine; apt-get install chromium"
        warnings.warn(message, stacklevel=2)
        pytest.skip(message)
    arguments = ["--no-sandbox"] if os.geteuid() == 0 else []
    with sync_playwright() as playwright:
        running = playwright.chromium.launch(
            executable_path=chromium, args=[*arguments, "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
        )
        yield running
        running.close()


@pytest.fixture(scope="module")
def simulation(ros_domain: int) -> Iterator[Launched]:
    launched = Launched("run", "--web-port", "0", "--start", "1.0,4.7,0")
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
    for size, scheme in ((DESKTOP, "light"), (DESKTOP, "dark"), (PHONE, "light"), (PHONE, "dark")):
        page.set_viewport_size(size)
        page.emulate_media(color_scheme=scheme)
        page.wait_for_timeout(300)
        page.screenshot(path=str(tmp_path / f"{size['width']}_{scheme}.png"), full_page=True)
        assert page.evaluate("document.documentElement.scrollWidth") <= size["width"]


def test_a_key_drives_and_letting_go_stops(page: Any, listener: Listener) -> None:
    truth = Truth(listener)
    begin = truth.x
    page.keyboard.down("w")
    truth.wait_for(lambda: truth.x > begin + 0.3, "robot that drives while W is held")
    assert page.inner_text("#driver") == "you drive"
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
    assert "another page drives" in other.inner_text("#notes")
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
    page.click("#things li:has-text('bottle') button")
    page.wait_for_selector("#things li:has-text('bottle')", state="detached")


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


def _middle(page: Any, selector: str) -> tuple[float, float]:
    box = page.locator(selector).bounding_box()
    return box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
