"""Images of textures: every suffix that is named as supported, with and without opacity. Pillow encodes what is decoded here."""

from __future__ import annotations

import io
import struct
import zlib
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from conformance.rules import rule
from gibson_sim.formats.load_mesh import load_mesh
from gibson_sim.formats.mesh import Mesh
from gibson_sim.formats.textures import IMAGE_SUFFIXES, decode_image

FORMAT = "Images"
COLOR = (10, 200, 30, 128)
LOSSY = (".jpg", ".jpeg", ".webp")


def _encoded(suffix: str, mode: str, **options: object) -> bytes:
    buffer = io.BytesIO()
    image = Image.fromarray(np.full((3, 2, 4), COLOR, dtype=np.uint8)).convert(mode)
    image.save(buffer, format=Image.registered_extensions()[suffix], **options)
    return buffer.getvalue()


def _textured(folder: Path, image: str, data: bytes) -> Mesh:
    """Returns a triangle whose material reads an image."""
    (folder / image).write_bytes(data)
    (folder / "a.mtl").write_text(f"newmtl m\nmap_Kd {image}\n")
    (folder / "a.obj").write_text("mtllib a.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nusemtl m\nf 1/1 2/1 3/1\n")
    return load_mesh(folder / "a.obj", [folder])


@pytest.mark.parametrize("suffix", IMAGE_SUFFIXES)
@rule(FORMAT, "PNG, JPEG, BMP, TGA, TIFF, WebP, GIF, PPM", "done", "8 bits per channel; 16 are rounded down to 8")
def test_every_kind_of_image_is_drawn(tmp_path: Path, suffix: str) -> None:
    mesh = _textured(tmp_path, f"wood{suffix}", _encoded(suffix, "RGB"))
    assert mesh.warnings == ()
    texture = mesh.parts[0].material.texture
    assert texture is not None
    assert texture.pixels.shape == (3, 2, 3)
    np.testing.assert_allclose(texture.pixels[0, 0], COLOR[:3], atol=3 if suffix in LOSSY else 0)


@pytest.mark.parametrize("suffix", [".png", ".tga", ".tif", ".webp"])
@rule(FORMAT, "opacity (RGBA)", "done", "not premultiplied: colours are those of the file")
def test_opacity_leaves_colours_as_they_are(suffix: str) -> None:
    pixels = decode_image(_encoded(suffix, "RGBA"))
    assert pixels is not None
    np.testing.assert_allclose(pixels, np.full((3, 2, 4), COLOR), atol=3 if suffix in LOSSY else 0)


@pytest.mark.parametrize("suffix", [".png", ".jpg", ".bmp", ".tga", ".tif", ".ppm"])
@rule(FORMAT, "greyscale", "done")
def test_greyscale_is_drawn_grey(suffix: str) -> None:
    pixels = decode_image(_encoded(suffix, "L"))
    assert pixels is not None
    assert pixels.shape == (3, 2, 3)
    # Rec. 601 luma, by which Pillow converts: 0.299 * 10 + 0.587 * 200 + 0.114 * 30.
    np.testing.assert_allclose(pixels, 124, atol=1)


@pytest.mark.parametrize("suffix", [".png", ".tga", ".tif"])
@rule(FORMAT, "greyscale with opacity", "done")
def test_greyscale_keeps_its_opacity(suffix: str) -> None:
    pixels = decode_image(_encoded(suffix, "LA"))
    assert pixels is not None
    assert pixels[0, 0].tolist() == [124, 124, 124, 128]


@pytest.mark.parametrize("suffix", [".png", ".bmp", ".tga", ".tif", ".gif"])
@rule(FORMAT, "palettes", "done")
def test_palettes_are_applied(suffix: str) -> None:
    pixels = decode_image(_encoded(suffix, "P"))
    assert pixels is not None
    assert pixels[0, 0, :3].tolist() == list(COLOR[:3])


@rule(FORMAT, "PNG tRNS, GIF transparent colour", "done", "these pixels have opacity 0")
def test_transparent_colours_are_cut_out() -> None:
    grey = decode_image(_encoded(".png", "L", transparency=124))
    color = decode_image(_encoded(".png", "RGB", transparency=COLOR[:3]))
    palette = io.BytesIO()
    image = Image.new("P", (2, 1))
    image.putpalette([1, 2, 3, 4, 5, 6])
    image.putpixel((0, 0), 1)
    image.save(palette, "GIF", transparency=1)
    gif = decode_image(palette.getvalue())
    assert grey is not None and color is not None and gif is not None
    assert (grey[0, 0].tolist(), color[0, 0].tolist()) == ([124, 124, 124, 0], [*COLOR[:3], 0])
    assert gif[0].tolist() == [[4, 5, 6, 0], [1, 2, 3, 255]]


@pytest.mark.parametrize("origin", [0x00, 0x10, 0x20, 0x30])
@rule(FORMAT, "TGA image origin", "done", "all four corners")
def test_origin_of_a_tga(origin: int) -> None:
    # 2 x 1 pixels, 24 bits, blue green red: red, then green.
    header = bytes([0, 0, 2, 0, 0, 0, 0, 0, 0, 0, 0, 0, 2, 0, 1, 0, 24, origin])
    pixels = decode_image(header + bytes([0, 0, 255, 0, 255, 0]))
    assert pixels is not None
    rows = [[255, 0, 0], [0, 255, 0]]
    assert pixels[0].tolist() == (rows[::-1] if origin & 0x10 else rows)


@rule(FORMAT, "TGA run-length coding", "done")
def test_run_length_coded_tga() -> None:
    assert np.array_equal(np.asarray(decode_image(_encoded(".tga", "RGBA", compression="tga_rle"))), np.full((3, 2, 4), COLOR))


@rule(FORMAT, "JPEG, TIFF in CMYK", "done", "converted without a colour profile")
def test_cmyk_becomes_rgb() -> None:
    for suffix in (".jpg", ".tif"):
        pixels = decode_image(_encoded(suffix, "CMYK"))
        assert pixels is not None
        np.testing.assert_allclose(pixels[0, 0, :3], COLOR[:3], atol=3)


@rule(FORMAT, "broken images", "left out", "the surface is drawn in its base colour")
def test_broken_image_is_named(tmp_path: Path) -> None:
    for suffix in (".png", ".tga", ".tif"):
        mesh = _textured(tmp_path, f"wood{suffix}", _encoded(suffix, "RGB")[:20])
        assert mesh.parts[0].material.texture is None
        (warning,) = mesh.warnings
        assert f"wood{suffix} cannot be decoded" in warning


@pytest.mark.parametrize("suffix", [".ktx2", ".dds", ".exr", ".svg"])
@rule(FORMAT, "KTX2, DDS, EXR, SVG", "left out", "convert them to PNG")
def test_other_kinds_are_named(tmp_path: Path, suffix: str) -> None:
    mesh = _textured(tmp_path, f"wood{suffix}", b"\xabKTX 20\xbb\r\n\x1a\n" + bytes(60))
    (warning,) = mesh.warnings
    assert f"wood{suffix} cannot be decoded" in warning


@pytest.mark.parametrize(
    ("data", "expected"),
    [
        (b"P6 1 1 100\n" + bytes([100, 50, 0]), [255, 128, 0]),
        (b"P6\n# a\n1 # b\n1\n1023\n" + struct.pack(">3H", 1023, 511, 0), [255, 127, 0]),
        (b"P5 1 1 15\n\x05", [85, 85, 85]),
        (b"P3 1 1 15 15 5 0\n", [255, 85, 0]),
        (b"P3 1 1 1023 1023 511 0\n", [255, 127, 0]),
        (b"P2 1 1 255 7\n", [7, 7, 7]),
        (b"P4 1 1\n\x80", [0, 0, 0]),
    ],
)
@rule(FORMAT, "PGM, PPM: maxval", "done", "values are proportional to it")
def test_values_of_a_pnm_are_proportional_to_its_maximum(data: bytes, expected: list[int]) -> None:
    pixels = decode_image(data)
    assert pixels is not None
    assert pixels.tolist() == [[expected]]


def _grey_png(bits: int, row: bytes, transparent: int) -> bytes:
    """Returns a greyscale PNG of 2 x 1 pixels with a transparent value."""
    chunks = [
        (b"IHDR", struct.pack(">IIBBBBB", 2, 1, bits, 0, 0, 0, 0)), (b"tRNS", struct.pack(">H", transparent)),
        (b"IDAT", zlib.compress(b"\0" + row)), (b"IEND", b""),
    ]  # fmt: skip
    return b"\x89PNG\r\n\x1a\n" + b"".join(
        struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body)) for kind, body in chunks
    )


@pytest.mark.parametrize(
    ("bits", "row", "transparent", "greys"),
    [
        (1, b"\x40", 0, (0, 255)), (2, b"\x60", 1, (85, 170)), (4, b"\x3a", 3, (51, 170)), (8, b"\x03\x04", 3, (3, 4)),
        (16, struct.pack(">HH", 1000, 1001), 1000, (3, 3)),
    ],
)  # fmt: skip
@rule(FORMAT, "PNG tRNS of 1, 2, 4, 8 and 16 bit grey", "done", "compared at the depth of the file")
def test_transparent_grey_of_every_depth(bits: int, row: bytes, transparent: int, greys: tuple[int, int]) -> None:
    pixels = decode_image(_grey_png(bits, row, transparent))
    assert pixels is not None
    assert pixels.tolist() == [[[greys[0]] * 3 + [0], [greys[1]] * 3 + [255]]]


@pytest.mark.parametrize("has_palette", [False, True])
@rule(FORMAT, "TGA of 16 bits", "done", "its highest bit: 1 = opaque, if the header counts one attribute bit; else it is unused")
def test_attribute_bit_of_a_tga(has_palette: bool) -> None:
    colors = struct.pack("<HH", 0x8000 | 31 << 10, 31 << 5)  # red with the bit, green without
    for descriptor, expected in ((0x20, [[255, 0, 0], [0, 255, 0]]), (0x21, [[255, 0, 0, 255], [0, 255, 0, 0]])):
        head = [0, 1, 1, 0, 0, 2, 0, 16] if has_palette else [0, 0, 2, 0, 0, 0, 0, 0]
        size = [0, 0, 0, 0, 2, 0, 1, 0, 8 if has_palette else 16, descriptor]
        pixels = decode_image(bytes(head + size) + colors + (b"\0\1" if has_palette else b""))
        assert pixels is not None
        assert pixels.tolist() == [expected]
