"""Randomised scenes: the seed decides every pixel, and nothing but colours changes."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from gibson_sim.description.shapes import Appearance, Pattern, Shape, VisualSpec
from gibson_sim.formats.load_mesh import MeshLoader
from gibson_sim.formats.mesh import Material, TextureSource
from gibson_sim.render.renderer import Renderer
from gibson_sim.scenes.load import load_scene
from gibson_sim.scenes.randomise import ClassRules, Rules, TextureRules, load_rules, randomise
from gibson_sim.scenes.scene_meshes import scene_roots
from gibson_sim.scenes.spec import DrawnScene, LightSpec, drawn_scene
from gibson_sim.types import Frame, Pose
from render.drawing import EYE, draw, eye_at, facing_quad, loader_of, mesh_visual, scene, state

pytestmark = [pytest.mark.egl, pytest.mark.usefixtures("egl")]

BRIGHT = LightSpec(sun=0.0, ambient=1.0, background=(0.0, 0.0, 0.0))
GEOMETRY = ("depth", "semantic", "instance", "normal")
CAMERA = eye_at((0.8, 0.6, 1.5), (4.0, 3.0, 0.6), width=160, height=120, outputs=("rgb", *GEOMETRY))
LOOKS = Rules(
    {
        "*": ClassRules((-0.5, 0.5), (0.0, 2.0), (0.5, 1.5), (0.0, 1.0), (0.0, 1.0), TextureRules(chance=0.5)),
        "window": ClassRules(),
    },
)


@pytest.fixture(scope="module")
def flat(root: Path) -> tuple[DrawnScene, MeshLoader]:
    spec = load_scene(root / "scenes" / "flat")
    return drawn_scene(spec, ()), MeshLoader(scene_roots(spec))


def _frame(drawn: DrawnScene, loader: MeshLoader) -> Frame:
    with Renderer(drawn, meshes=loader.shape) as renderer:
        return renderer.render(state(), [CAMERA])[0]


def test_the_seed_decides_every_pixel_and_geometry_stays_as_it_is(flat: tuple[DrawnScene, MeshLoader], root: Path) -> None:
    drawn, loader = flat
    example = load_rules(root / "config" / "randomisation" / "example.yaml")
    rules = Rules(LOOKS.classes, example.light)
    plain, first, again, other = (
        _frame(s, loader) for s in (drawn, randomise(drawn, 7, rules), randomise(drawn, 7, rules), randomise(drawn, 8, rules))
    )
    assert first.rgb is not None and again.rgb is not None and other.rgb is not None and plain.rgb is not None
    np.testing.assert_array_equal(first.rgb, again.rgb)
    for one in (other, plain):
        assert np.abs(first.rgb.astype(int) - one.rgb).mean() > 10
        for name in GEOMETRY:
            np.testing.assert_array_equal(getattr(first, name), getattr(one, name))


def _cube(appearance: Appearance) -> Frame:
    """Returns the picture of a box whose front, 1 m ahead, fills it: 2 x 2 m."""
    visual = VisualSpec("cube", "", Shape("box", (2.0, 4.0, 4.0)), Pose((2.0, 0.0, 0.0)), (0.5, 0.5, 0.5, 1.0), "", appearance)
    return draw(visual, light=BRIGHT)


def test_a_checker_has_its_colours_and_its_size() -> None:
    # 8 cells repeat in 4 m: each is 0.5 m, 16 px at 1 m.
    rgb = _cube(Appearance(pattern=Pattern("checker", colors=((1.0, 0.0, 0.0), (0.0, 0.0, 1.0)), size=4.0))).rgb
    assert rgb is not None
    red = (rgb[:, :, 0] > 200) & (rgb[:, :, 2] < 40)
    blue = (rgb[:, :, 2] > 200) & (rgb[:, :, 0] < 40)
    inside = [k for k in range(64) if 3 <= k % 16 <= 12]
    cells = red[np.ix_(inside, inside)]
    assert (cells | blue[np.ix_(inside, inside)]).all()
    grid = red[8::16, 8::16]
    assert (grid == (np.add.outer(np.arange(4), np.arange(4)) % 2 == int(not grid[0, 0]))).all()


def test_stripes_stand_upright_on_walls() -> None:
    rgb = _cube(Appearance(pattern=Pattern("stripes", colors=((0.0, 0.0, 0.0), (1.0, 1.0, 1.0)), size=4.0))).rgb
    assert rgb is not None
    assert np.ptp(rgb[:, 8].astype(int)) == 0
    assert np.ptp(rgb[8].astype(int)) > 200


def test_a_pattern_moves_with_its_link() -> None:
    appearance = Appearance(pattern=Pattern("noise", 3, ((0.0, 0.0, 0.0), (1.0, 1.0, 1.0)), 1.0))
    visual = VisualSpec("cube", "a/b", Shape("box", (1.0, 1.0, 1.0)), Pose((2.0, 0.0, 0.0)), None, "", appearance)
    with Renderer(scene(visual, links=("a/b",), light=BRIGHT)) as renderer:
        first = renderer.render(state(("a/b",), [(0.0, 0.0, 0.0)]), [EYE])[0].rgb
        away = renderer.render(state(("a/b",), [(0.0, 0.25, 0.0)]), [EYE])[0].rgb
        shifted = renderer.render(state(("a/b",), [(0.0, 0.25, 0.0)]), [eye_at((0.0, 0.25, 0.0))])[0].rgb
    assert first is not None and away is not None and shifted is not None
    assert np.ptp(first[28:36, 28:36].astype(int)) > 10
    assert np.abs(first.astype(int) - away).max() > 10
    np.testing.assert_allclose(first.astype(int), shifted.astype(int), atol=1)


def test_an_image_replaces_a_texture(tmp_path: Path) -> None:
    assert cv2.imwrite(str(tmp_path / "i.png"), np.full((8, 8, 3), (30, 60, 200), dtype=np.uint8))
    rgb = _cube(Appearance(pattern=Pattern("image", image=str(tmp_path / "i.png")))).rgb
    assert rgb is not None
    # A wall gets 85 % of the light from above and below.
    linear = 0.85 * (np.array([200, 60, 30]) / 255.0 + 0.055) ** 2.4 / 1.055**2.4
    np.testing.assert_allclose(rgb[31, 31], 255.0 * (1.055 * linear ** (1 / 2.4) - 0.055), atol=2)


def test_an_image_that_cannot_be_read_leaves_the_surface_as_it_is_with_a_warning(tmp_path: Path) -> None:
    appearance = Appearance(pattern=Pattern("image", image=str(tmp_path / "none.png")))
    visual = VisualSpec("cube", "", Shape("box", (2.0, 4.0, 4.0)), Pose((2.0, 0.0, 0.0)), (0.5, 0.5, 0.5, 1.0), "", appearance)
    with Renderer(scene(visual, light=BRIGHT)) as renderer:
        rgb = renderer.render(state(), [EYE])[0].rgb
        assert any("none.png" in w for w in renderer.warnings)
    np.testing.assert_array_equal(rgb, _cube(Appearance()).rgb)


def test_a_tint_turns_the_colours_of_a_texture() -> None:
    texture = TextureSource("test", np.full((4, 4, 3), (200, 40, 40), dtype=np.uint8))
    mesh = facing_quad(1.0, 1.0, Material(base_color=(1.0, 1.0, 1.0, 1.0), texture=texture, unlit=True))
    with Renderer(scene(replace(mesh_visual(), appearance=Appearance(hue=1 / 3))), meshes=loader_of(mesh)) as renderer:
        rgb = renderer.render(state(), [EYE])[0].rgb
    assert rgb is not None
    # A third of a turn takes red to green, and nothing else: unlit stays unlit.
    np.testing.assert_allclose(rgb[31, 31], (40, 200, 40), atol=1)


def test_an_appearance_of_one_visual_changes_no_pixel_of_another() -> None:
    left, right = (
        VisualSpec(name, "", Shape("sphere", (0.4, 0.0, 0.0)), Pose((2.0, y, 0.0)), (0.6, 0.5, 0.4, 1.0))
        for name, y in (("left", 0.6), ("right", -0.6))
    )
    before = draw(left, right).rgb
    after = draw(replace(left, appearance=Appearance(0.3, 1.5, 0.8, None, 1.0, 0.2)), right).rgb
    assert before is not None and after is not None
    np.testing.assert_array_equal(before[:, 32:], after[:, 32:])
    assert np.abs(before[:, :32].astype(int) - after[:, :32]).max() > 20


def test_geometry_of_a_furnished_room_with_material_maps_stays_as_it_is(data_dir: Path) -> None:
    spec = load_scene(data_dir / "drake_living_room" / "models" / "furnished_living_room.dmd.yaml")
    drawn, loader = drawn_scene(spec, ()), MeshLoader(scene_roots(spec))
    camera = eye_at((2.0, 2.0, 1.5), (-0.5, 0.0, 0.6), width=320, height=240, outputs=("rgb", *GEOMETRY))
    frames = []
    for one in (drawn, randomise(drawn, 7, LOOKS)):
        with Renderer(one, meshes=loader.shape) as renderer:
            frames.append(renderer.render(state(), [camera])[0])
    plain, changed = frames
    assert plain.rgb is not None and changed.rgb is not None
    assert np.abs(plain.rgb.astype(int) - changed.rgb).mean() > 10
    for name in GEOMETRY:
        np.testing.assert_array_equal(getattr(plain, name), getattr(changed, name))
