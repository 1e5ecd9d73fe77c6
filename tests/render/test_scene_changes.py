"""Bodies that are added and removed while a scene is drawn: pictures equal those of a scene loaded with them, and nothing leaks."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest

from gibson_sim.description.shapes import Appearance, Pattern, Shape, VisualSpec
from gibson_sim.errors import SceneMismatchError
from gibson_sim.formats.load_mesh import primitive_mesh
from gibson_sim.formats.mesh import Material, Mesh, TextureSource
from gibson_sim.render.batching.scene_geometry import Loader
from gibson_sim.render.context import gl as GL
from gibson_sim.render.renderer import MeshFiles, Renderer
from gibson_sim.scenes.spec import DrawnScene, LightSpec
from gibson_sim.types import OUTPUTS, Frame, Pose, SceneState
from render.drawing import BLUE, DARK, EYE, GREEN, RED, box, eye_at, facing_quad, loader_of, scene, state
from support.surfaces import bumpy_grid, bumpy_sphere, detail_from

pytestmark = [pytest.mark.egl, pytest.mark.usefixtures("egl")]

CAMERA = eye_at((-1.0, 0.0, 1.0), (3.0, 0.0, 0.0), outputs=OUTPUTS)
WALL = replace(box((5.0, 0.0, 0.0), GREEN, (0.1, 8.0, 4.0)), name="wall", semantic_class="wall")
PLACES = {"robot": (3.0, 1.0, 0.0), "crate": (3.0, -1.0, 0.0), "ball": (2.5, 0.0, 0.3)}
LIT = LightSpec(sun=0.8, ambient=0.3, sun_direction=(0.5, 0.3, -1.0), shadows=True)
FILES = MeshFiles()


def _body(name: str, color=RED, label: str = "", shape: Shape | None = None, **changes: object) -> VisualSpec:
    shape = shape or Shape("box", (0.5, 0.5, 0.5))
    return VisualSpec(f"{name}_visual", f"{name}/base", shape, color=color, semantic_class=label, **changes)  # type: ignore[arg-type]


ROBOT = _body("robot", BLUE, "robot")
CRATE = _body("crate", RED, "box")
BALL = _body("ball", (0.9, 0.8, 0.1, 1.0), "ball", Shape("sphere", (0.3, 0.0, 0.0)))


def _scene(
    *bodies: VisualSpec, revision: int = 1, light: LightSpec = DARK, static: tuple[VisualSpec, ...] = (WALL,)
) -> DrawnScene:
    links = tuple(dict.fromkeys(b.link for b in bodies))
    return replace(scene(*static, *bodies, links=links, light=light), revision=revision)


def _state(drawn: DrawnScene) -> SceneState:
    return state(drawn.links, [PLACES[link.split("/")[0]] for link in drawn.links], revision=drawn.revision)


def _equal(one: Frame, other: Frame) -> bool:
    return all(np.array_equal(getattr(one, o), getattr(other, o), equal_nan=getattr(one, o).dtype.kind == "f") for o in OUTPUTS)


def _fresh(drawn: DrawnScene, meshes: MeshFiles | Loader = FILES) -> Frame:
    with Renderer(drawn, meshes) as renderer:
        return renderer.render(_state(drawn), [CAMERA])[0]


def _changed(*scenes: DrawnScene, meshes: MeshFiles | Loader = FILES) -> Frame:
    """Returns the picture of the last scene, after all scenes before it were drawn."""
    with Renderer(scenes[0], meshes) as renderer:
        renderer.render(_state(scenes[0]), [CAMERA])
        for drawn in scenes[1:]:
            renderer.update(drawn)
            frame = renderer.render(_state(drawn), [CAMERA])[0]
    return frame


def test_a_body_added_later_looks_like_one_loaded_with_the_scene() -> None:
    after = _scene(ROBOT, CRATE, revision=2)
    frame = _changed(_scene(ROBOT), after)
    assert _equal(frame, _fresh(after))
    assert (frame.instance == after.instances.index("crate")).sum() > 10


def test_a_body_that_was_loaded_with_the_scene_can_go() -> None:
    after = _scene(CRATE, revision=2)
    frame = _changed(_scene(ROBOT, CRATE), after)
    assert _equal(frame, _fresh(after))
    assert (frame.rgb[..., 2] <= frame.rgb[..., 0]).all(), "nothing blue is left"


def test_a_body_can_be_replaced_by_another_model_of_the_same_name() -> None:
    other = replace(CRATE, shape=Shape("cylinder", (0.2, 1.5, 0.0)), color=GREEN)
    after = _scene(ROBOT, other, revision=3)
    assert _equal(_changed(_scene(ROBOT, CRATE), _scene(ROBOT, revision=2), after), _fresh(after))


def test_the_order_of_links_may_change() -> None:
    after = _scene(BALL, CRATE, ROBOT, revision=2)
    assert _equal(_changed(_scene(ROBOT, CRATE), after), _fresh(after))


def test_a_class_that_comes_first_renumbers_all_others() -> None:
    first, after = _scene(ROBOT), _scene(ROBOT, BALL, revision=2)
    assert first.semantic_classes == ("unlabelled", "robot", "wall")
    assert after.semantic_classes.index("wall") != first.semantic_classes.index("wall")
    frame = _changed(first, after)
    assert _equal(frame, _fresh(after))
    assert {after.semantic_classes[k] for k in np.unique(frame.semantic)} == {"unlabelled", "ball", "robot", "wall"}


def test_links_whose_visuals_have_different_classes_keep_them() -> None:
    lid = replace(CRATE, name="lid", pose=replace(CRATE.pose, position=(0.0, 0.0, 0.5)), semantic_class="lid")
    two = _scene(ROBOT, CRATE, lid, revision=2)
    after = _scene(ROBOT, BALL, CRATE, lid, revision=3)
    assert _equal(_changed(_scene(ROBOT), two, after), _fresh(after))


def test_shadows_of_bodies_come_and_go_with_them() -> None:
    scenes = [_scene(ROBOT, *more, revision=k, light=LIT) for k, more in enumerate(((), (CRATE, BALL), (BALL,)), 1)]
    assert _equal(_changed(*scenes), _fresh(scenes[-1]))
    assert _equal(_changed(*scenes[:2]), _fresh(scenes[1]))


def test_shadows_appear_with_the_first_body_of_a_scene_that_stood_still() -> None:
    after = _scene(CRATE, revision=2, light=LIT)
    assert _equal(_changed(_scene(light=LIT), after), _fresh(after))


def test_each_body_has_its_own_appearance_and_pattern() -> None:
    striped = replace(ROBOT, appearance=Appearance(pattern=Pattern("checker", 0, ((1.0, 0.0, 0.0), (1.0, 1.0, 1.0)), 0.2)))
    cloudy = replace(CRATE, appearance=Appearance(hue=0.3, pattern=Pattern("noise", 5, ((0.0, 0.0, 1.0), (0.0, 1.0, 0.0)), 0.3)))
    plain = _scene(ROBOT)
    for after in (_scene(ROBOT, cloudy, revision=2), _scene(striped, cloudy, BALL, revision=2)):
        assert _equal(_changed(plain, after), _fresh(after))
    later = _scene(ROBOT, replace(cloudy, appearance=striped.appearance), revision=3)
    assert _equal(_changed(plain, _scene(ROBOT, cloudy, revision=2), later), _fresh(later))


@pytest.mark.parametrize(
    "material",
    [
        Material(base_color=(0.8, 0.6, 0.2, 1.0), metallic=1.0, roughness=0.2),
        Material(base_color=(0.2, 0.9, 0.2, 0.4), alpha_mode="blend"),
    ],
    ids=["shiny", "translucent"],
)
def test_materials_that_the_scene_did_not_have_before_are_drawn(material: Material) -> None:
    quad = facing_quad(0.0, 0.6, material)
    card = replace(CRATE, shape=Shape("mesh", mesh="/card"), color=None)
    after = _scene(ROBOT, card, revision=2, light=LIT)
    assert _equal(_changed(_scene(ROBOT, light=LIT), after, meshes=loader_of(quad)), _fresh(after, meshes=loader_of(quad)))


def test_a_changed_static_world_is_reloaded() -> None:
    moved = replace(WALL, pose=replace(WALL.pose, position=(4.0, 0.0, 0.0)))
    after = _scene(ROBOT, revision=2, static=(moved,))
    assert _equal(_changed(_scene(ROBOT), after), _fresh(after))


def test_changed_files_are_reloaded() -> None:
    card = replace(WALL, shape=Shape("mesh", mesh="/card"), color=None)
    quads = {name: loader_of(facing_quad(0.0, 0.6, Material(base_color=color))) for name, color in (("old", RED), ("new", GREEN))}
    content = "old"
    first, after = (replace(_scene(ROBOT, revision=k, static=(card,)), content_hash=name) for k, name in enumerate(quads, 1))
    with Renderer(first, meshes=lambda shape: quads[content](shape)) as renderer:
        renderer.render(_state(first), [CAMERA])
        content = "new"
        assert renderer.update(after)
        assert _equal(renderer.render(_state(after), [CAMERA])[0], _fresh(after, meshes=quads["new"]))
        assert not renderer.update(replace(_scene(ROBOT, CRATE, revision=3, static=(card,)), content_hash="new"))


def test_light_that_has_changed_is_drawn() -> None:
    after = _scene(ROBOT, revision=2, light=LIT)
    assert _equal(_changed(_scene(ROBOT), after), _fresh(after))


def test_states_of_the_revision_before_are_refused() -> None:
    first, after = _scene(ROBOT), _scene(ROBOT, CRATE, revision=2)
    with Renderer(first) as renderer:
        renderer.update(after)
        with pytest.raises(SceneMismatchError, match="revision 1, but revision 2 is loaded"):
            renderer.render(_state(first), [EYE])


def test_a_body_on_an_unknown_link_is_left_out_with_a_warning() -> None:
    after = replace(_scene(ROBOT, CRATE, revision=2), links=("robot/base",))
    with Renderer(_scene(ROBOT)) as renderer:
        renderer.update(after)
        assert renderer.warnings == ("visual 'crate_visual': link 'crate/base' is not in the scene; it is not drawn",)
        assert (renderer.render(_state(after), [CAMERA])[0].instance != 3).all()


class _Meshes:
    """A loader that counts its calls and returns a textured quad for every file."""

    def __init__(self) -> None:
        self.read: Counter[str] = Counter()
        self._quads: dict[str, Mesh] = {}

    def __call__(self, shape: Shape) -> Mesh:
        if shape.kind != "mesh":
            return primitive_mesh(shape)
        self.read[shape.mesh] += 1
        if shape.mesh not in self._quads:
            pixels = np.full((8, 8, 3), 40 * (1 + len(self._quads)), dtype=np.uint8)
            self._quads[shape.mesh] = facing_quad(
                0.0, 0.3, Material(base_color=(1.0, 1.0, 1.0, 1.0), texture=TextureSource(shape.mesh, pixels), unlit=True)
            )
        return self._quads[shape.mesh]


@pytest.fixture
def alive(monkeypatch: pytest.MonkeyPatch) -> Counter[str]:
    """Number of current OpenGL objects of each kind."""
    counts: Counter[str] = Counter()
    create, delete = GL.Gl.create, GL.Gl.delete

    def counted_create(gl: GL.Gl, function: str, *arguments: int) -> int:
        counts[function.removeprefix("glCreate").removeprefix("glGen")] += 1
        return create(gl, function, *arguments)

    def counted_delete(gl: GL.Gl, function: str, name: int) -> None:
        counts[function.removeprefix("glDelete")] -= 1
        delete(gl, function, name)

    monkeypatch.setattr(GL.Gl, "create", counted_create)
    monkeypatch.setattr(GL.Gl, "delete", counted_delete)
    return counts


def test_two_hundred_cycles_leave_no_opengl_object_behind(alive: Counter[str]) -> None:
    meshes = _Meshes()
    card = replace(CRATE, shape=Shape("mesh", mesh="/card.glb"), color=None)
    with Renderer(_scene(ROBOT, light=LIT), meshes=meshes) as renderer:
        seen = []
        for k in range(200):
            for drawn in (_scene(ROBOT, card, BALL, revision=2 * k + 2, light=LIT), _scene(ROBOT, revision=2 * k + 3, light=LIT)):
                renderer.update(drawn)
                renderer.render(_state(drawn), [EYE])
            seen.append(Counter(alive))
        assert seen[-1] == seen[1]
        assert renderer.info["textures"] == 0
        assert meshes.read["/card.glb"] == 1
    assert not +alive, "closed, and something is still there"


def test_a_texture_comes_and_goes_with_its_body() -> None:
    meshes = _Meshes()
    card = replace(CRATE, shape=Shape("mesh", mesh="/card.glb"), color=None)
    after = _scene(ROBOT, card, revision=2)
    with Renderer(_scene(ROBOT), meshes=meshes) as renderer:
        renderer.update(after)
        assert renderer.info["textures"] == 1
        frame = renderer.render(_state(after), [CAMERA])[0]
        assert frame.rgb[frame.instance == 3] == pytest.approx(40, abs=1)
        renderer.update(_scene(ROBOT, revision=3))
        assert renderer.info["textures"] == 0
    assert _equal(frame, _fresh(after, meshes=meshes))


def test_equal_bodies_share_their_triangles() -> None:
    crates = [_body(f"crate{k}", RED, "box") for k in range(50)]
    PLACES.update({f"crate{k}": (3.0 + 0.01 * k, 0.05 * k - 1.2, -0.5) for k in range(50)})
    after = _scene(ROBOT, *crates, revision=2)
    with Renderer(_scene(ROBOT)) as renderer:
        one = renderer.info["batches"]
        renderer.update(after)
        assert renderer.info["batches"] == one + 1
        assert renderer.info["triangles"] == 12 * 52
        frame = renderer.render(_state(after), [CAMERA])[0]
    assert _equal(frame, _fresh(after))


def test_levels_of_detail_of_world_and_body_are_as_in_a_scene_loaded_whole() -> None:
    meshes = {"/ground": Mesh((bumpy_grid(80),)), "/rock": Mesh((bumpy_sphere(40, 0.4),))}
    ground = VisualSpec("ground", "", Shape("mesh", mesh="/ground"), Pose((3.0, 0.0, -0.5)), GREEN)
    rock = replace(CRATE, shape=Shape("mesh", mesh="/rock"))

    def loader(shape: Shape) -> Mesh:
        return meshes[shape.mesh] if shape.kind == "mesh" else primitive_mesh(shape)

    after = _scene(ROBOT, rock, revision=2, static=(ground,))
    with detail_from(1000):
        with Renderer(_scene(ROBOT, static=(ground,)), meshes=loader) as renderer:
            renderer.update(after)
            frame, drawn = renderer.render(_state(after), [CAMERA])[0], renderer.drawn_triangles
        assert drawn < 0.5 * renderer.info["triangles"], "levels of detail are in use"
        assert _equal(frame, _fresh(after, meshes=loader))
