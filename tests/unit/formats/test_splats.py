"""Files of Gaussian splats."""

from __future__ import annotations

import gzip
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gibson_sim.errors import MeshError
from gibson_sim.formats.splats import Splats, load_splats, read_splats, splats_ply
from support.plys import ply
from support.splat_files import compressed_ply, random_splats, spz

HERE = Path("room.ply")


def _close(found: Splats, true: Splats, position: float, scale: float, turn: float, opacity: float, sh: float) -> None:
    """Checks that splats differ by rounding alone; scales by a factor, rotations up to their sign."""
    np.testing.assert_allclose(found.positions, true.positions, atol=position)
    np.testing.assert_allclose(np.log(found.scales / true.scales), 0.0, atol=scale)
    np.testing.assert_allclose(np.abs((found.quats_xyzw * true.quats_xyzw).sum(axis=1)), 1.0, atol=turn)
    np.testing.assert_allclose(found.opacities, true.opacities, atol=opacity)
    np.testing.assert_allclose(found.sh, true.sh, atol=sh)


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_a_ply_gives_back_what_was_written(degree: int) -> None:
    true = random_splats(40, degree)
    found = read_splats(HERE, splats_ply(true))
    assert (len(found), found.degree, found.up_axis) == (40, degree, "z")
    _close(found, true, 0.0, 1e-5, 1e-6, 1e-6, 0.0)


def test_the_numbers_of_a_ply_mean_what_the_training_code_means_by_them() -> None:
    names = ["x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2", *(f"f_rest_{k}" for k in range(9)), "opacity"]
    names += ["scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"]
    row = f"1 2 3 0 0 0 0.1 0.2 0.3 11 12 13 21 22 23 31 32 33 0 0 {math.log(2.0)} {math.log(3.0)} 0 2 0 0"
    text = "\n".join(["ply", "format ascii 1.0", "element vertex 1", *(f"property float {n}" for n in names), "end_header"])
    found = read_splats(HERE, f"{text}\n{row}\n".encode())
    np.testing.assert_allclose(found.positions, [[1, 2, 3]])
    np.testing.assert_allclose(found.scales, [[1, 2, 3]], rtol=1e-6)
    np.testing.assert_allclose(found.quats_xyzw, [[1, 0, 0, 0]])  # files have w first, of any length
    np.testing.assert_allclose(found.opacities, [0.5])
    # The file has the three coefficients of red first, then those of green and of blue.
    np.testing.assert_allclose(
        found.sh[0], [[0.1, 0.2, 0.3], [11.0, 21.0, 31.0], [12.0, 22.0, 32.0], [13.0, 23.0, 33.0]], rtol=1e-6
    )


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
@pytest.mark.parametrize("colors", [True, False])
def test_a_compressed_ply_is_off_by_the_rounding_of_its_bits(degree: int, colors: bool) -> None:
    true = random_splats(300, degree)  # two chunks
    found = read_splats(HERE, compressed_ply(true, colors=colors))
    if not colors:
        true = replace(true, sh=np.concatenate([found.sh[:, :1], true.sh[:, 1:]], axis=1))
        np.testing.assert_allclose(found.sh[:, 0], random_splats(300, degree).sh[:, 0], atol=0.5 / 255 / 0.282 + 1e-6)
    _close(found, true, 0.5 / 1023 + 1e-6, 2.0 / 2046, 1e-5, 0.5 / 255 + 1e-6, 8 / 512 + 1e-6)


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
@pytest.mark.parametrize(("version", "position", "turn"), [(1, 3e-4, 2e-4), (2, 2e-4, 2e-4), (3, 2e-4, 1e-5), (4, 2e-4, 1e-5)])
def test_an_spz_is_off_by_the_rounding_of_its_bits(version: int, position: float, turn: float, degree: int) -> None:
    true = random_splats(60, degree)
    true = replace(
        true, quats_xyzw=np.where(np.abs(true.quats_xyzw[:, 3:]) < 0.3, [[0, 0, 0, 1]], true.quats_xyzw).astype(np.float32)
    )
    found = read_splats(HERE, spz(true, version))
    assert found.up_axis == "y"
    _close(found, true, position, 1 / 31.9, turn, 0.5 / 255 + 1e-6, 0.5 / 255 / 0.15 + 1e-6)


def test_negative_coordinates_of_an_spz_have_a_sign() -> None:
    true = replace(random_splats(2), positions=np.array([[-3.5, 0.25, -0.125], [100.0, -100.0, 0.0]], dtype=np.float32))
    np.testing.assert_array_equal(read_splats(HERE, spz(true)).positions, true.positions)


def test_spherical_harmonics_of_degree_4_are_left_out() -> None:
    true = random_splats(5, 3)
    found = read_splats(HERE, spz(true, 4, degree=4))
    assert found.degree == 3
    np.testing.assert_allclose(found.sh[:, 1:], true.sh[:, 1:], atol=0.5 / 128)


def _all_kinds() -> list[bytes]:
    splats = random_splats(300, 1)
    return [splats_ply(splats), compressed_ply(splats), spz(splats, 2), spz(splats, 4)]


@pytest.mark.parametrize("kind", range(4))
@pytest.mark.parametrize("kept", [0.001, 0.02, 0.3, 0.7, 0.99])
def test_a_file_that_is_cut_is_refused_in_one_line(kind: int, kept: float) -> None:
    data = _all_kinds()[kind]
    with pytest.raises(MeshError) as caught:
        read_splats(HERE, data[: int(kept * len(data))])
    assert str(caught.value).startswith("room.ply: ") and "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (ply(), "is a mesh, not splats.*SuperSplat"),
        (b"\x89PNG\r\n\x1a\n", "is not a file of splats.*SPZ"),
        (b"", "is not a file of splats"),
        (gzip.compress(b"something else, which is long enough"), "gzip file, but not SPZ"),
        (gzip.compress(b"NGSP" + bytes([9, 0, 0, 0, 1, 0, 0, 0, 0, 12, 0, 0])), "SPZ of version 9; known: 1 to 4"),
        (gzip.compress(b"NGSP" + bytes([2, 0, 0, 0, 1, 0, 0, 0, 7, 12, 0, 0])), "degree 7, must be 0 to 4"),
        (gzip.compress(b"NGSP" + bytes([2, 0, 0, 0, 255, 255, 255, 255, 0, 12, 0, 0])), "4294967295 splats, must have at most 8000000"),
        (gzip.compress(b"NGSP" + bytes([2, 0, 0, 0, 0, 0, 0, 0, 0, 12, 0, 0])), "holds no splats"),
        (splats_ply(random_splats(3, 1)).replace(b"f_rest_8", b"f_best_8"), "has 8 columns f_rest_, must have 0, 9, 24, 45"),
        (splats_ply(random_splats(3)).replace(b"rot_2", b"rat_2"), "have no rot_2"),
        (b"ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nend_header\n\xf71\n", r"vertex has a value that is not a number \(.*xf71"),
        (compressed_ply(random_splats(300)).replace(b"element chunk 2", b"element chunk 1"), "300 splats are in 2 chunks, the file has 1"),
        (splats_ply(random_splats(3)).replace(b"element vertex 3", b"element vertex 4000000000"), "do not fit"),
    ],
)  # fmt: skip
def test_a_file_of_another_kind_is_refused_and_the_message_says_why(data: bytes, message: str) -> None:
    with pytest.raises(MeshError, match=message):
        read_splats(HERE, data)


def test_a_small_file_that_unpacks_to_much_takes_no_memory() -> None:
    bomb = gzip.compress(b"NGSP" + bytes([2, 0, 0, 0, 1, 0, 0, 0, 0, 12, 0, 0]) + bytes(20_000_000))
    assert len(read_splats(HERE, bomb)) == 1  # what the header promises is read, and no more


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("positions", np.nan, "position of 1 of 9 splats is NaN"),
        ("positions", 1e9, r"position of 1 .*splat 4: 1e\+09"),
        ("scales", 1e7, "scale of 1 of 9"),
        ("sh", np.inf, "colour of 1 of 9"),
        ("quats_xyzw", np.nan, "rotation of 1 of 9"),
        ("opacities", np.nan, "opacity of 1 of 9"),
    ],
)
def test_an_impossible_number_is_refused_and_the_message_names_the_splat(name: str, value: float, message: str) -> None:
    splats = random_splats(9)
    values = getattr(splats, name).copy()
    values[4] = value
    with pytest.raises(MeshError, match=message):
        read_splats(HERE, splats_ply(replace(splats, **{name: values})))


def test_a_splat_without_size_or_that_is_opaque_is_read() -> None:
    splats = replace(
        random_splats(2), scales=np.array([[0, 1, 1], [1, 1, 1]], dtype=np.float32), opacities=np.ones(2, dtype=np.float32)
    )
    found = read_splats(HERE, splats_ply(splats))
    assert found.scales[0, 0] == 0.0 and found.opacities.tolist() == [1.0, 1.0]


def test_a_missing_file_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(MeshError, match=r"none\.ply: cannot be read: No such file"):
        load_splats(tmp_path / "none.ply")


def test_an_spz_without_compression_is_named() -> None:
    data = gzip.decompress(spz(random_splats(5), 2))
    with pytest.raises(
        MeshError, match=r"is an SPZ of version 2 that is not compressed, as such a file must be: compress it with gzip"
    ):
        read_splats(Path("a.spz"), data)
