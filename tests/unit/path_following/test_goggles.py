"""Goggles: histograms and grey world by hand, networks of any image size, and one-line errors for other files."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gibson_path_following.errors import ModelError, PathFollowingError, SettingError, ViewError
from gibson_path_following.images.goggles import (
    ColourReference,
    GreyWorldGoggles,
    HistogramGoggles,
    LearnedGoggles,
    load_reference,
    make_goggles,
)
from gibson_path_following.options import GogglesOptions
from gibson_path_following.paths.path_folder import save_path
from support import onnx_bytes as ox
from support.path_views import straight_path

MIRRORED = {"channels": np.array([2, 1, 0], dtype=np.int64)}


def network(
    height: int | str = "height", width: int | str = "width", small: str = "small", out: str = "image", *,
    small_type: str = "uint8", small_shape: tuple[int | str, ...] = (1, 64, 96, 3),
) -> bytes:  # fmt: skip
    """Returns a network that exchanges red and blue."""
    inputs = [ox.value("image", "uint8", [1, height, width, 3]), ox.value(small, small_type, small_shape)]
    gather = ox.node("Gather", [out, "channels"], "adapted", axis=3)
    return ox.model([gather], inputs, [ox.value("adapted", "uint8", [1, height, width, 3])], MIRRORED)


def write(folder: Path, content: bytes) -> Path:
    file = folder / "goggles.onnx"
    file.write_bytes(content)
    return file


def grey(*levels: int) -> np.ndarray:
    """Returns an image of one row, a pixel for each level."""
    return np.array(levels, np.uint8)[None, :, None].repeat(3, axis=2)


def test_each_colour_gets_the_levels_of_the_reference_in_their_order() -> None:
    reference = ColourReference.of_images([np.array([[[10, 0, 200], [30, 0, 220]]], np.uint8)])
    adapted = HistogramGoggles(reference)(np.array([[[250, 7, 60], [90, 9, 61]]], np.uint8))
    # Half of the pixels are below, half above: a quarter and three quarters of the way through the reference's levels.
    assert adapted.tolist() == [[[30, 0, 200], [10, 0, 220]]]


def test_an_image_with_the_levels_of_the_reference_stays_as_it_is() -> None:
    image = np.random.default_rng(3).integers(0, 256, (64, 96, 3)).astype(np.uint8)
    adapted = HistogramGoggles(ColourReference.of_images([image]))(image)
    assert np.abs(adapted.astype(int) - image).max() <= 1


def test_grey_world_takes_the_mean_colour_for_that_of_the_light() -> None:
    # sRGB 188, 137, 99 are 0.503, 0.250, 0.124 of white's light: the reference, 137, is 0.250 bright.
    seen = np.array([[[188, 137, 99]] * 2], np.uint8)
    adapted = GreyWorldGoggles(ColourReference.of_images([grey(137, 137)]))(seen)
    assert np.abs(adapted.astype(int) - 137).max() <= 1


def test_a_black_image_stays_black_in_a_grey_world() -> None:
    assert not GreyWorldGoggles(ColourReference.of_images([grey(100)]))(grey(0, 0)).any()


def test_a_reference_survives_its_file_and_that_of_a_path_is_of_its_images(tmp_path: Path) -> None:
    path = straight_path()
    nodes = tuple(replace(node, view=(np.full((64, 96, 3), 50, np.uint8),)) for node in path.nodes)
    save_path(replace(path, nodes=nodes), tmp_path / "path")
    reference = load_reference(str(tmp_path / "path"))
    (tmp_path / "look.csv").write_text(reference.as_text())
    assert np.abs(ColourReference.load(tmp_path / "look.csv").quantiles - 50.0).max() <= 1.0


@pytest.mark.parametrize("text", ["", "1,2,3\n", "1,2\n" * 256, "1,2,300\n" * 256, "nan,0,0\n" * 256, "colour\n"])
@pytest.mark.filterwarnings("ignore:loadtxt")
def test_a_file_without_a_reference_is_refused_in_one_line(tmp_path: Path, text: str) -> None:
    (tmp_path / "look.csv").write_text(text)
    with pytest.raises(ModelError, match=r"look\.csv.*install the package again") as caught:
        ColourReference.load(tmp_path / "look.csv")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("size", [(64, 96), (63, 95), (480, 640), (1, 1)])
def test_a_network_takes_images_of_any_size(tmp_path: Path, size: tuple[int, int]) -> None:
    image = np.random.default_rng(1).integers(0, 256, (*size, 3)).astype(np.uint8)
    assert (LearnedGoggles(write(tmp_path, network()))(image) == image[..., ::-1]).all()


def test_an_image_that_is_too_large_for_a_network_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ViewError, match="2100x1000 pixels, Goggles take up to 2097152"):
        LearnedGoggles(write(tmp_path, network()))(np.zeros((1000, 2100, 3), np.uint8))


def _with_external_data() -> bytes:
    tensors = [ox.external_tensor("w", [1], "/etc/hostname")]
    return ox.model([ox.node("Add", ["a", "w"], "c")], [ox.value("a", "float32", [1])], [ox.value("c", "float32", [1])], tensors)


def _with_two_outputs() -> bytes:
    inputs = [ox.value("image", "uint8", [1, 64, 96, 3]), ox.value("small", "uint8", [1, 64, 96, 3])]
    nodes = [ox.node("Gather", [name, "channels"], f"adapted_{name}", axis=3) for name in ("image", "small")]
    return ox.model(
        nodes, inputs, [ox.value(f"adapted_{name}", "uint8", [1, 64, 96, 3]) for name in ("image", "small")], MIRRORED
    )


REQUIRED = r"must have the inputs image uint8 \(1, any, any, 3\) and small uint8 \(1, 64, 96, 3\) and one output; use a file that"
IMAGE = r"image uint8 \(1, any, any, 3\)"


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"", r"is empty, or holds only zeros; export it again"),
        (b"GIF89a and so on", r"is not an ONNX file, or is truncated"),
        (network()[:-40], r"is not an ONNX file, or is truncated"),
        (_with_external_data(), r"has its weights in other files, which are not read"),
        (network(small="thumbnail"), rf"has the inputs '{IMAGE}, thumbnail uint8 \(1, 64, 96, 3\)' and 1 output, {REQUIRED}"),
        (network(small_shape=(1, 32, "b", 3)), rf"has the inputs '{IMAGE}, small uint8 \(1, 32, any, 3\)' and 1 output, {REQUIRED}"),
        (network(small_shape=(1, 64, 96)), rf"has the inputs '{IMAGE}, small uint8 \(1, 64, 96\)' and 1 output, {REQUIRED}"),
        (network(small_type="float32"), rf"has the inputs '{IMAGE}, small float \(1, 64, 96, 3\)' and 1 output, {REQUIRED}"),
        (network(height=64, width=96), rf"has the inputs 'image uint8 \(1, 64, 96, 3\), small uint8 .*' and 1 output, {REQUIRED}"),
        (_with_two_outputs(), rf"and 2 outputs, {REQUIRED}"),
        (network(out="small"), r"its output is uint8 \(1, 64, 96, 3\), must be uint8 \(1, 22, 34, 3\), as its image"),
    ],
)  # fmt: skip
def test_a_file_without_a_goggles_network_is_refused_in_one_line(tmp_path: Path, content: bytes, words: str) -> None:
    with pytest.raises(ModelError, match=words) as caught:
        make_goggles("learned", str(write(tmp_path, content)))
    assert "\n" not in str(caught.value) and len(str(caught.value)) < 500


def test_sizes_of_small_that_a_file_leaves_free_fit(tmp_path: Path) -> None:
    for shape in (("n", "h", "w", "c"), (1, "h", "w", 3)):
        file = write(tmp_path, network(small_shape=shape))
        assert make_goggles("learned", str(file))(np.full((5, 7, 3), (1, 2, 3), np.uint8))[0, 0].tolist() == [3, 2, 1]


def test_impossible_options_are_refused_with_the_possible_ones(tmp_path: Path) -> None:
    with pytest.raises(ModelError, match=r"cannot read .*none\.onnx: No such file"):
        make_goggles("learned", str(tmp_path / "none.onnx"))
    with pytest.raises(SettingError, match="mode is 'rose', must be learned, histogram or grey_world"):
        make_goggles("rose")
    with pytest.raises(SettingError, match="parameter mode is 'rose', must be one of learned, histogram, grey_world"):
        GogglesOptions(mode="rose")
    with pytest.raises(SettingError, match=r"model is 'a\.onnx', which mode histogram does not use"):
        GogglesOptions(mode="histogram", model="a.onnx")
    with pytest.raises(SettingError, match="reference is 'kitchen', which mode learned does not use"):
        GogglesOptions(reference="kitchen")
    with pytest.raises(PathFollowingError, match="kitchen"):
        load_reference(str(tmp_path / "kitchen"))
