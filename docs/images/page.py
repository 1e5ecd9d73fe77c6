"""Films the live page in a browser: page.webp, and screenshots for desktop and phone, light and dark.

python docs/images/page.py [FOLDER]

It needs Chromium and the package playwright, which `make setup` installs.
"""

from __future__ import annotations

import subprocess
import sys
import time
from itertools import pairwise
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from gibson_sim_bench.browser import chromium

DESKTOP, PHONE = {"width": 1440, "height": 900}, {"width": 390, "height": 844}
FILM_WIDTH, RATE_HZ = 960, 5
"""Width of the film, pixels, and its pictures a second."""

_Y, _YAW = (f"Number(document.querySelector('#pose').innerText.match(/{pattern}/)[1])" for pattern in (r"y (\S+)", r"m +(\S+)°"))
"""The robot's y (m) and yaw (degrees), as the page shows them."""


def main() -> None:
    """Writes the film and the screenshots."""
    folder = Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent
    command = [sys.executable, "-m", "gibson_sim.cli.main", "run", "--web-port", "0", "--scene", "linden_flat"]
    run = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
    try:
        assert run.stderr is not None
        address = next(line for line in run.stderr if line.startswith("look: ")).split()[1]
        with chromium(webgl=True) as browser:
            _film(_opened(browser, address, DESKTOP, "light"), folder / "page.webp")
            for name, size, theme in (("desktop", DESKTOP, "dark"), ("phone", PHONE, "light")):
                page = _opened(browser, address, size, theme)
                page.wait_for_function("[...document.querySelectorAll('#strip canvas')].every((c) => c.dataset.stamp)")
                page.click("#reset")
                page.wait_for_timeout(1000)
                if name == "desktop":
                    _plot(page, "twist.twist.linear.x")
                    page.click("[data-key='e:bathroom_door'] > span")
                    page.keyboard.down("w")
                    page.wait_for_timeout(2000)
                    page.keyboard.up("w")
                page.wait_for_timeout(3000)
                page.screenshot(path=folder / f"page_{name}.jpg", type="jpeg", quality=80)
                page.close()
    finally:
        run.terminate()
        run.wait()


def _opened(browser: Any, address: str, size: dict[str, int], theme: str) -> Any:
    """Returns a page that shows the camera."""
    page = browser.new_page(viewport=size, color_scheme=theme, bypass_csp=True)
    page.goto(address)
    page.wait_for_selector("canvas[data-stamp]", timeout=60_000)
    return page


def _plot(page: Any, *fields: str) -> None:
    """Plots fields of the odometry, in one plot."""
    page.select_option("#plot-topic", "/odom")
    for number, field in enumerate(fields):
        page.wait_for_selector(f"#plot-field option[value='{field}']", state="attached")
        page.select_option("#plot-field", field)
        page.click("#plot-over" if number else "#plot-new")


def _film(page: Any, path: Path) -> None:
    """Plots the speed, drives by keys, puts a box on the map, closes a door, and turns the scene in 3-D, while it takes pictures."""
    pictures: list[NDArray[np.uint8]] = []
    times: list[float] = []

    def shoot(seconds: float) -> None:
        end = time.monotonic() + seconds
        while (began := time.monotonic()) < end:
            times.append(began)
            picture = cv2.imdecode(np.frombuffer(page.screenshot(type="jpeg", quality=90), np.uint8), cv2.IMREAD_COLOR)
            pictures.append(
                cv2.resize(picture, (FILM_WIDTH, FILM_WIDTH * picture.shape[0] // picture.shape[1]), interpolation=cv2.INTER_AREA)
            )
            page.wait_for_timeout(max(0.0, 1000.0 / RATE_HZ - 1000.0 * (time.monotonic() - began)))

    _plot(page, "twist.twist.linear.x", "twist.twist.angular.z")
    shoot(1.0)
    for key, there in (("a", f"{_YAW} > -115 && {_YAW} < -60"), ("w", f"{_Y} < 4.4"), ("d", f"{_YAW} < -120 || {_YAW} > 100")):
        page.keyboard.down(key)  # out of the hall, into the living room, and towards the kitchen
        while not page.evaluate(there):
            shoot(0.2)
        page.keyboard.up(key)
        shoot(0.6)
    page.click("[data-mode=spawn]")
    page.select_option("#catalogue", label="box_cardboard")
    box = page.locator("#map").bounding_box()
    page.mouse.click(box["x"] + 0.46 * box["width"], box["y"] + 0.62 * box["height"])
    shoot(1.5)
    page.click("[data-mode=look]")
    page.click("[data-key='e:bathroom_door'] > span")
    page.click("[data-key='e:bathroom_door'] button")
    shoot(2.5)
    page.locator("#tab-view3d").dblclick()
    shoot(1.0)
    box = page.locator("#scene3d").bounding_box()
    page.mouse.move(box["x"] + 0.5 * box["width"], box["y"] + 0.5 * box["height"])
    for _ in range(4):
        page.mouse.wheel(0, 180)
        shoot(0.2)
    page.mouse.down()
    for k in range(8):
        page.mouse.move(box["x"] + (0.5 + 0.04 * k) * box["width"], box["y"] + (0.5 + 0.02 * k) * box["height"])
        shoot(0.3)
    page.mouse.up()
    page.keyboard.press("Escape")
    shoot(1.0)
    page.close()
    animation = cv2.Animation()
    animation.frames = pictures
    animation.durations = [round(1000.0 * (after - before)) for before, after in pairwise([*times, times[-1] + 1.0])]
    cv2.imwriteanimation(str(path), animation, [cv2.IMWRITE_WEBP_QUALITY, 70])
    print(f"{path}: {len(pictures)} pictures, {path.stat().st_size / 1e6:.1f} MB")


if __name__ == "__main__":
    main()
