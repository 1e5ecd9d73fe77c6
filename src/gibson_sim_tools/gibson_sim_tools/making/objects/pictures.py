"""Draws the procedural textures of the built-in objects: labels, covers, wood, ..."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from gibson_sim.picture_files import write_picture

Rgb = NDArray[np.uint8]
Color = tuple[int, int, int]
_SUPERSAMPLING = 4
"""Supersampling factor."""
_JPEG_QUALITY = 82
_DARK: Color = (38, 36, 34)
_WHITE: Color = (246, 244, 238)


class Canvas:
    """A canvas for drawing; positions and sizes are fractions of width and height, from the top left."""

    def __init__(self, width: int, height: int, color: Color) -> None:
        self.width, self.height = width * _SUPERSAMPLING, height * _SUPERSAMPLING
        self.pixels: Rgb = np.full((self.height, self.width, 3), color, dtype=np.uint8)

    def rectangle(self, x0: float, y0: float, x1: float, y1: float, color: Color) -> None:
        """Fills a rectangle."""
        cv2.rectangle(self.pixels, self._at(x0, y0), self._at(x1, y1), color, -1)

    def disc(self, x: float, y: float, radius: float, color: Color) -> None:
        """Fills a circle. ``radius``: fraction of the height."""
        cv2.circle(self.pixels, self._at(x, y), round(radius * self.height), color, -1, cv2.LINE_AA)

    def polygon(self, corners: list[tuple[float, float]], color: Color) -> None:
        """Fills a polygon."""
        points = np.array([self._at(x, y) for x, y in corners], dtype=np.int32)
        cv2.fillPoly(self.pixels, [points], color, cv2.LINE_AA)

    def line(self, corners: list[tuple[float, float]], width: float, color: Color) -> None:
        """Draws a polyline. ``width``: fraction of the height."""
        points = np.array([self._at(x, y) for x, y in corners], dtype=np.int32)
        cv2.polylines(self.pixels, [points], False, color, max(1, round(width * self.height)), cv2.LINE_AA)

    def text(self, text: str, x: float, y: float, high: float, color: Color, weight: float = 0.16) -> None:
        """Writes a line of text centred at (x, y). ``high``: height of capitals as a fraction of the canvas height."""
        font = cv2.FONT_HERSHEY_DUPLEX
        pixels = high * self.height
        thick = max(1, round(pixels * weight))
        scale = cv2.getFontScaleFromHeight(font, max(4, round(pixels)), thick)
        (width, height), _ = cv2.getTextSize(text, font, scale, thick)
        left, below = round(x * self.width - width / 2), round(y * self.height + height / 2)
        cv2.putText(self.pixels, text, (left, below), font, scale, color, thick, cv2.LINE_AA)

    def finish(self) -> Rgb:
        """Downsamples and returns the picture, (H, W, 3) uint8 sRGB."""
        size = (self.width // _SUPERSAMPLING, self.height // _SUPERSAMPLING)
        return np.asarray(cv2.resize(self.pixels, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)

    def _at(self, x: float, y: float) -> tuple[int, int]:
        return round(x * self.width), round(y * self.height)


def write_pictures(folder: Path, names: list[str]) -> None:
    """Writes the textures with these names as ``<name>.jpg``.

    Raises:
        WriteError: a file cannot be written.
    """
    for name in names:
        write_picture(folder / f"{name}.jpg", PICTURES[name]()[:, :, ::-1], (cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY))


def noise(width: int, height: int, cells: tuple[float, float], seed: int, octaves: int = 4) -> NDArray[np.float64]:
    """Returns smooth, tileable noise, (height, width), about -1 to 1. ``cells``: number of waves across and down."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[0:height, 0:width].astype(np.float64)
    x, y = x / width * 2 * np.pi, y / height * 2 * np.pi
    total = np.zeros((height, width))
    for octave in range(octaves):
        for _ in range(6):
            across = round(rng.normal(0.0, cells[0] * 2**octave))
            down = round(rng.normal(0.0, cells[1] * 2**octave))
            total += np.sin(across * x + down * y + rng.uniform(0, 2 * np.pi)) / 2**octave
    return total / max(1e-9, float(np.abs(total).max()))


def _wood(light: Color, dark: Color, seed: int) -> Rgb:
    """Returns a tileable wood texture with the grain along x."""
    grain = noise(256, 256, (1.0, 9.0), seed, 4)
    rings = np.sin(11.0 * noise(256, 256, (0.3, 3.0), seed + 1, 1) + 2.0 * grain)
    fibre = noise(256, 256, (1.2, 60.0), seed + 2, 2)
    share = np.clip(0.5 + 0.28 * rings + 0.14 * grain + 0.10 * fibre, 0.0, 1.0)[:, :, None]
    return np.asarray(np.array(light) * share + np.array(dark) * (1.0 - share)).astype(np.uint8)


def _speckled(width: int, height: int, color: Color, cells: float, depth: float, seed: int) -> Rgb:
    share = 1.0 + depth * noise(width, height, (cells, cells), seed, 3)[:, :, None]
    return np.clip(np.array(color) * share, 0, 255).astype(np.uint8)


def _water() -> Rgb:
    c = Canvas(512, 160, (32, 110, 178))
    c.rectangle(0, 0, 1, 0.1, (18, 66, 124))
    for shift, tone in ((0.0, (74, 158, 214)), (0.03, (150, 208, 238)), (0.06, (232, 246, 252))):
        wave = [(x, 0.70 + shift * 2.6 + 0.06 * np.sin(4 * np.pi * (x + shift * 4))) for x in np.linspace(0, 1, 80)]
        c.polygon([*wave, (1, 1), (0, 1)], tone)
    for x in (0.25, 0.75):
        c.text("FONTE", x, 0.36, 0.26, _WHITE, 0.2)
        c.text("natural mineral water", x, 0.6, 0.085, (214, 236, 250), 0.1)
    return c.finish()


def _wine() -> Rgb:
    c = Canvas(512, 220, (236, 228, 208))
    c.rectangle(0, 0.03, 1, 0.06, (150, 116, 58))
    c.rectangle(0, 0.94, 1, 0.97, (150, 116, 58))
    for x in (0.25, 0.75):
        c.disc(x, 0.27, 0.13, (122, 26, 38))
        c.text("V", x, 0.27, 0.12, (236, 228, 208), 0.18)
        c.text("VIGNA ALTA", x, 0.56, 0.12, _DARK, 0.15)
        c.text("rosso  2019", x, 0.76, 0.08, (122, 26, 38), 0.12)
    return c.finish()


def _soda() -> Rgb:
    c = Canvas(512, 256, (206, 28, 40))
    for x in (0.25, 0.75):
        c.disc(x - 0.1, 0.72, 0.10, (236, 92, 52))
        c.disc(x + 0.13, 0.24, 0.07, (236, 92, 52))
        c.polygon(
            [(x - 0.25, 0.62), (x - 0.05, 0.5), (x + 0.25, 0.34), (x + 0.25, 0.42), (x - 0.02, 0.6), (x - 0.25, 0.74)], _WHITE
        )
        c.text("ZING", x, 0.46, 0.24, (250, 214, 60), 0.26)
        c.text("orange soda", x, 0.83, 0.07, _WHITE, 0.14)
    return c.finish()


def _food() -> Rgb:
    c = Canvas(512, 220, (34, 96, 62))
    c.rectangle(0, 0, 1, 0.14, (244, 232, 200))
    c.rectangle(0, 0.86, 1, 1, (244, 232, 200))
    for x in (0.25, 0.75):
        for dx, dy, r in ((-0.07, 0.66, 0.13), (0.0, 0.7, 0.15), (0.075, 0.65, 0.12)):
            c.disc(x + dx, dy, r, (202, 38, 30))
            c.disc(x + dx - 0.014, dy - 0.05, r * 0.25, (240, 120, 100))
            c.polygon([(x + dx - 0.02, dy - r), (x + dx, dy - r + 0.07), (x + dx + 0.02, dy - r)], (120, 170, 60))
        c.text("POMODORI", x, 0.31, 0.17, (250, 240, 214), 0.2)
    return c.finish()


def _cover(color: Color, accent: Color, title: tuple[str, str], author: str) -> Rgb:
    """Returns a book cover: the left eighth is the spine (text running down), the rest the front."""
    c = Canvas(288, 384, color)
    c.rectangle(0.125, 0.0, 0.128, 1.0, tuple(int(v * 0.7) for v in color))  # type: ignore[arg-type]
    c.rectangle(0.2, 0.06, 0.93, 0.065, accent)
    c.rectangle(0.2, 0.935, 0.93, 0.94, accent)
    c.text(title[0], 0.565, 0.2, 0.06, accent, 0.18)
    c.text(title[1], 0.565, 0.3, 0.06, accent, 0.18)
    c.disc(0.565, 0.58, 0.15, accent)
    c.disc(0.60, 0.555, 0.12, color)
    c.text(author, 0.565, 0.86, 0.034, accent, 0.14)
    spine = Canvas(384, 36, color)
    spine.text(" ".join(title), 0.45, 0.5, 0.42, accent, 0.16)
    spine.rectangle(0.9, 0.2, 0.97, 0.8, accent)
    picture = c.finish()
    picture[:, :36] = np.rot90(spine.finish(), -1)
    return picture


def _cereal() -> Rgb:
    """Returns a cereal box: the left 5/8 is the front, the right 3/8 a narrow side."""
    c = Canvas(416, 448, (240, 172, 38))
    c.polygon([(0, 0), (0.625, 0), (0.625, 0.34), (0, 0.44)], (196, 44, 36))
    c.text("GOLDEN", 0.312, 0.12, 0.075, _WHITE, 0.24)
    c.text("CRUNCH", 0.312, 0.24, 0.075, (255, 222, 90), 0.24)
    c.disc(0.312, 0.72, 0.2, (250, 250, 250))
    c.disc(0.312, 0.70, 0.17, (238, 226, 204))
    rng = np.random.default_rng(4)
    for angle, distance in zip(rng.uniform(0, 2 * np.pi, 70), np.sqrt(rng.uniform(0, 1, 70)), strict=True):
        tone = int(rng.integers(-18, 18))
        c.disc(
            0.312 + 0.165 * distance * np.cos(angle),
            0.70 + 0.145 * distance * np.sin(angle),
            0.02,
            (206 + tone, 138 + tone, 56 + tone),
        )
    c.text("500 g", 0.52, 0.95, 0.03, _DARK, 0.14)
    c.rectangle(0.625, 0, 1, 1, (196, 44, 36))
    c.rectangle(0.66, 0.1, 0.965, 0.8, (250, 244, 228))
    for k in range(11):
        c.rectangle(0.69, 0.16 + 0.055 * k, 0.93 - 0.09 * (k % 3 == 1), 0.17 + 0.055 * k, (110, 104, 96))
    for k in range(22):
        c.rectangle(0.69 + 0.011 * k, 0.86, 0.69 + 0.011 * k + (0.003, 0.006, 0.002)[k % 3], 0.95, _WHITE)
    return c.finish()


def _tea() -> Rgb:
    c = Canvas(384, 256, (36, 92, 78))
    c.rectangle(0.03, 0.05, 0.97, 0.06, (222, 186, 104))
    c.rectangle(0.03, 0.94, 0.97, 0.95, (222, 186, 104))
    c.text("HIGHLAND", 0.5, 0.28, 0.14, (236, 214, 150), 0.16)
    c.text("GREEN TEA", 0.5, 0.5, 0.11, (236, 214, 150), 0.14)
    for turn in (-0.6, 0.0, 0.6):
        tip = (0.5 + 0.09 * np.sin(turn), 0.86 - 0.22 * np.cos(turn))
        c.polygon(
            [(0.5, 0.88), (tip[0] - 0.025, (tip[1] + 0.88) / 2), tip, (tip[0] + 0.025, (tip[1] + 0.88) / 2)], (150, 190, 90)
        )
    return c.finish()


def _cardboard() -> Rgb:
    """Returns a tileable cardboard texture with printed marks."""
    base = _speckled(256, 256, (184, 142, 96), 20.0, 0.06, 5).astype(np.float64)
    base *= 1.0 + 0.015 * np.sin(np.arange(256) * 2 * np.pi / 8)[None, :, None]
    c = Canvas(256, 256, (0, 0, 0))
    c.pixels = np.asarray(
        cv2.resize(np.clip(base, 0, 255).astype(np.uint8), (256 * _SUPERSAMPLING, 256 * _SUPERSAMPLING)), dtype=np.uint8
    )
    for x in (0.74, 0.86):
        c.polygon([(x - 0.035, 0.77), (x, 0.7), (x + 0.035, 0.77)], (92, 66, 42))
        c.rectangle(x - 0.012, 0.77, x + 0.012, 0.86, (92, 66, 42))
    c.rectangle(0.7, 0.885, 0.9, 0.895, (92, 66, 42))
    c.text("FRAGILE", 0.28, 0.8, 0.07, (150, 44, 34), 0.18)
    return c.finish()


def _keys(rows: int, columns: float, seed: int, body: Color, key: Color, pad: bool = False) -> Rgb:
    """Returns a keyboard. ``pad``: add the touchpad of a laptop below the keys."""
    c = Canvas(512, 352 if pad else 160, body)
    rng = np.random.default_rng(seed)
    low = 0.62 if pad else 0.96
    high = (low - 0.05) / rows
    for row in range(rows):
        x = 0.025
        while x < 0.965:
            key_width = 0.95 / columns
            if row == rows - 1 and 0.27 < x < 0.4:
                key_width *= 5.5
            elif x < 0.03 and row > 0:
                key_width *= 1.0 + 0.25 * row
            end = 0.975 if x + key_width * 1.6 > 0.975 else x + key_width
            y = 0.05 + row * high
            c.rectangle(x + 0.004, y + 0.012, end - 0.004, y + high - 0.012, key)
            shine = tuple(min(255, v + 26) for v in key)
            c.rectangle(x + 0.007, y + 0.02, end - 0.007, y + high * 0.72, shine)  # type: ignore[arg-type]
            if end - x < key_width * 1.5 and key_width < 0.1:
                letter = chr(int(rng.integers(65, 91)))
                c.text(letter, (x + end) / 2 - 0.006, y + high * 0.4, high * 0.22, (206, 206, 206), 0.12)
            x = end
    if pad:
        c.rectangle(0.32, 0.68, 0.68, 0.95, tuple(max(0, v - 18) for v in body))  # type: ignore[arg-type]
    return c.finish()


def _screen() -> Rgb:
    y = np.linspace(0, 1, 240)[:, None, None]
    sky = np.array((58, 96, 150)) * (1 - y) + np.array((228, 170, 140)) * y
    c = Canvas(384, 240, (0, 0, 0))
    picture = np.broadcast_to(sky, (240, 384, 3)).astype(np.uint8)
    c.pixels = np.asarray(cv2.resize(picture, (384 * _SUPERSAMPLING, 240 * _SUPERSAMPLING)), dtype=np.uint8)
    c.disc(0.68, 0.52, 0.09, (252, 226, 190))
    for shift, tone in ((0.0, (92, 96, 130)), (0.12, (62, 70, 104)), (0.24, (34, 42, 70))):
        x = np.linspace(0, 1, 60)
        ridge = 0.62 + shift + 0.09 * np.sin(7 * x + 9 * shift) + 0.04 * np.sin(19 * x + 30 * shift)
        c.polygon([*zip(x.tolist(), ridge.tolist(), strict=True), (1, 1), (0, 1)], tone)
    c.rectangle(0, 0.93, 1, 1, (28, 30, 38))
    for k in range(6):
        c.rectangle(0.36 + 0.05 * k, 0.945, 0.385 + 0.05 * k, 0.985, ((220, 90, 70), (90, 170, 220), (240, 200, 80))[k % 3])
    return c.finish()


def _clock() -> Rgb:
    c = Canvas(256, 256, (248, 246, 240))
    for k in range(60):
        angle = 2 * np.pi * k / 60
        inner = 0.40 if k % 5 == 0 else 0.435
        ends = [(0.5 + r * np.sin(angle), 0.5 - r * np.cos(angle)) for r in (inner, 0.46)]
        c.line(ends, 0.014 if k % 5 == 0 else 0.006, _DARK)
    for number, (dx, dy) in {"12": (0, -1), "3": (1, 0), "6": (0, 1), "9": (-1, 0)}.items():
        c.text(number, 0.5 + 0.32 * dx, 0.5 + 0.32 * dy, 0.08, _DARK, 0.16)
    for angle, reach, width in ((-0.96, 0.22, 0.03), (0.87, 0.33, 0.02)):
        c.line([(0.5, 0.5), (0.5 + reach * np.sin(angle), 0.5 - reach * np.cos(angle))], width, _DARK)
    c.disc(0.5, 0.5, 0.03, (196, 60, 44))
    return c.finish()


def directions(width: int, height: int) -> NDArray[np.float64]:
    """Returns the unit direction of each pixel of an equirectangular image, (height, width, 3); the top row points up."""
    longitude = (np.arange(width) + 0.5) / width * 2 * np.pi
    latitude = np.pi / 2 - (np.arange(height) + 0.5) / height * np.pi
    ring = np.cos(latitude)[:, None]
    return np.stack([ring * np.cos(longitude), ring * np.sin(longitude), np.repeat(np.sin(latitude)[:, None], width, 1)], axis=2)


def _football() -> Rgb:
    """Returns a football: dark pentagons at the twelve corners of an icosahedron, and white hexagons."""
    golden = (1 + 5**0.5) / 2
    corners = np.array([(0, a, b * golden) for a in (-1, 1) for b in (-1, 1)], dtype=float)
    corners = np.concatenate([np.roll(corners, k, axis=1) for k in range(3)]) / np.hypot(1, golden)
    middles = np.array([a + b + c for i, a in enumerate(corners) for j, b in enumerate(corners[:i]) for c in corners[:j]
                        if min(a @ b, b @ c, a @ c) > 0.4])  # fmt: skip
    middles /= np.linalg.norm(middles, axis=1, keepdims=True)
    at = directions(1024, 512)
    to_five, to_six = np.sort(at @ corners.T, axis=2), np.sort(at @ middles.T, axis=2)
    # A pixel belongs to the pentagon or hexagon with the smaller angular distance, less an offset for their sizes.
    dark = np.arccos(to_five[..., -1].clip(-1, 1)) < np.arccos(to_six[..., -1].clip(-1, 1)) - 0.085
    seam = (np.arccos(to_six[..., -2].clip(-1, 1)) - np.arccos(to_six[..., -1].clip(-1, 1)) < 0.028) & ~dark
    picture = np.full((512, 1024, 3), (240, 240, 236), dtype=np.uint8)
    picture[seam] = (150, 150, 146)
    picture[dark] = (34, 34, 38)
    return np.asarray(cv2.resize(picture, (512, 256), interpolation=cv2.INTER_AREA), dtype=np.uint8)


def _beach() -> Rgb:
    colors = np.array(
        [(214, 52, 46), (246, 244, 238), (46, 120, 196), (246, 244, 238), (246, 196, 48), (246, 244, 238)], dtype=np.uint8
    )
    row = colors[np.arange(512) * 6 // 512]
    picture = np.repeat(row[None], 256, axis=0)
    picture[:14] = picture[-14:] = (246, 244, 238)
    return picture


def _apple() -> Rgb:
    y = np.linspace(0, 1, 128)[:, None]
    streaks = noise(256, 128, (26.0, 1.0), 11, 3)
    share = np.clip(0.75 - 0.9 * np.exp(-(((y - 0.02) / 0.18) ** 2)) - 0.35 * (y > 0.8) * (y - 0.8) * 4 + 0.28 * streaks, 0, 1)[
        ..., None
    ]
    return np.asarray(np.array((186, 24, 30)) * share + np.array((214, 190, 74)) * (1 - share)).astype(np.uint8)


def _orange() -> Rgb:
    at = np.random.default_rng(3).uniform(0, 1, (900, 2))
    picture = _speckled(256, 128, (240, 138, 28), 3.0, 0.05, 9)
    for x, y in at:
        cv2.circle(picture, (int(x * 256), int(y * 128)), 1, (222, 118, 20), -1, cv2.LINE_AA)
    return picture


def _wicker() -> Rgb:
    """Returns a tileable weave texture."""
    y, x = np.mgrid[0:128, 0:128] / 128.0
    over = (np.floor(x * 8) + np.floor(y * 16)) % 2
    across = np.abs(np.sin(np.pi * y * 16)) ** 0.6 * (0.75 + 0.25 * np.abs(np.sin(np.pi * x * 8)))
    down = np.abs(np.sin(np.pi * x * 8)) ** 0.6 * 0.8
    share = np.where(over > 0, across, down)[..., None]
    return np.asarray(np.array((206, 160, 100)) * share + np.array((86, 56, 28)) * (1 - share)).astype(np.uint8)


def _vase() -> Rgb:
    """Returns the glaze of a vase, the foot at the bottom and the rim at the top."""
    y = np.linspace(0, 1, 256)[:, None]
    wave = 0.02 * noise(512, 256, (3.0, 1.0), 21, 2)
    share = (1 / (1 + np.exp((y - 0.52 + wave) * 60)))[..., None]
    picture = np.array((44, 92, 116)) * share + np.array((214, 200, 176)) * (1 - share)
    return np.clip(picture * (1 + 0.05 * noise(512, 256, (12.0, 12.0), 22, 3)[..., None]), 0, 255).astype(np.uint8)


def _dial() -> Rgb:
    """Returns the control panel of an oven: a display and marks for the knobs."""
    c = Canvas(512, 96, (46, 48, 52))
    c.rectangle(0.4, 0.22, 0.6, 0.78, (8, 10, 12))
    c.text("12:30", 0.5, 0.5, 0.3, (96, 220, 210), 0.14)
    for x in (0.12, 0.26, 0.74, 0.88):
        for k in range(-4, 5):
            angle = k * 0.55
            ends = [(x + r * np.sin(angle) * 0.1875, 0.5 - r * np.cos(angle)) for r in (0.36, 0.42)]
            c.line(ends, 0.02, (214, 214, 214))
    return c.finish()


PICTURES: dict[str, Callable[[], Rgb]] = {
    "label_water": _water,
    "label_wine": _wine,
    "label_soda": _soda,
    "label_food": _food,
    "cover_blue": lambda: _cover((36, 62, 104), (232, 206, 140), ("THE QUIET", "ORBIT"), "M. Arden"),
    "cover_red": lambda: _cover((150, 40, 40), (244, 232, 210), ("A WINTER", "GARDEN"), "L. Okafor"),
    "cover_green": lambda: _cover((50, 96, 70), (240, 222, 168), ("ROBOTS", "AT HOME"), "S. Lindqvist"),
    "cover_cream": lambda: _cover((226, 212, 182), (120, 62, 36), ("BREAD", "AND SALT"), "P. Moreau"),
    "box_cereal": _cereal,
    "box_tea": _tea,
    "cardboard": _cardboard,
    "keys_laptop": lambda: _keys(5, 14.0, 1, (168, 170, 174), (40, 42, 46), pad=True),
    "keys_board": lambda: _keys(5, 20.0, 2, (44, 46, 50), (66, 68, 74)),
    "screen": _screen,
    "clock_face": _clock,
    "football": _football,
    "beach_ball": _beach,
    "skin_apple": _apple,
    "skin_orange": _orange,
    "wicker": _wicker,
    "glaze": _vase,
    "dial": _dial,
    "wood_oak": lambda: _wood((204, 164, 114), (178, 134, 88), 31),
    "wood_walnut": lambda: _wood((122, 82, 54), (92, 60, 38), 41),
    "wood_beech": lambda: _wood((224, 188, 144), (200, 158, 112), 51),
}
"""Functions that draw each picture, (H, W, 3) uint8 sRGB, by name."""
