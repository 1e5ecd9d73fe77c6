"""Pictures of ``Simulation`` equal those of a separate renderer of its current state."""

from __future__ import annotations

import doctest
import os
from dataclasses import replace

import numpy as np
import pytest

import gibson_sim as gs
from gibson_sim import simulation
from gibson_sim.maps.placement import populate

pytestmark = [pytest.mark.egl, pytest.mark.usefixtures("egl")]


def test_frames_are_those_of_a_renderer_made_by_hand() -> None:
    scene = populate("flat", "gibson_bot")
    with gs.Simulation("flat") as sim:
        sim.command(linear=0.3, angular=0.5)
        earlier, state = sim.state, sim.step(seconds=0.5)
        frame = sim.render("camera", outputs=gs.OUTPUTS, previous=earlier)
        (camera,) = scene.robots[0].cameras
        with gs.Renderer(gs.drawn_scene(scene, state.links)) as renderer:
            (wanted,) = renderer.render(state, [replace(camera, outputs=gs.OUTPUTS)], earlier)
        assert frame.stamp_ns == state.stamp_ns == 500_000_000
        for output in gs.OUTPUTS:
            assert np.array_equal(getattr(frame, output), getattr(wanted, output), equal_nan=output in ("position", "flow")), (
                output
            )


def test_images_show_spawned_moved_and_removed_bodies() -> None:
    with gs.Simulation("flat", views="top") as sim:
        assert [camera.name for camera in sim.cameras] == ["camera", "view_top"]
        empty = sim.render("view_top", outputs=["rgb"]).rgb
        sim.spawn("ball", "thing", (2.5, 4.5, 0.2))
        there = sim.render("view_top", outputs=["rgb"]).rgb
        sim.move("thing", (2.0, 5.0, 0.2))
        moved = sim.render("view_top", outputs=["rgb"]).rgb
        sim.remove("thing")
        assert not np.array_equal(there, empty)
        assert not np.array_equal(moved, there)
        assert np.array_equal(sim.render("view_top", outputs=["rgb"]).rgb, empty)


def test_numbers_of_labels_have_names_and_views_short_ones() -> None:
    with gs.Simulation("flat", views="top") as sim:
        sim.spawn("ball", "thing", (2.2, 4.7, 0.2))
        frame = sim.render("top", outputs=["semantic", "instance"])
        seen = {sim.semantic_classes[number] for number in np.unique(frame.semantic)}
        assert {"ball", "floor", "wall"} <= seen
        assert "thing" in {sim.instances[number] for number in np.unique(frame.instance)}


def test_depth_has_the_noise_of_its_camera() -> None:
    with gs.Simulation("flat") as sim:
        (camera,) = sim.cameras
        noisy = replace(camera, depth_noise=gs.DepthNoise(constant=0.05))
        clean, rough = sim.render(camera, outputs="depth").depth, sim.render(noisy, outputs="depth").depth
        near = np.isfinite(clean) & np.isfinite(rough)
        assert (rough - clean)[near].std() == pytest.approx(0.05, rel=0.05)


def test_earlier_states_are_those_of_the_same_things() -> None:
    with gs.Simulation("flat") as sim:
        earlier = sim.state
        with pytest.raises(gs.ConfigError, match="optical flow needs an earlier state"):
            sim.render(outputs="flow")
        sim.spawn("ball", "thing", (2.2, 4.7, 0.2))
        with pytest.raises(gs.ConfigError, match="take one from after the last spawn, remove or reset"):
            sim.render(outputs="flow", previous=earlier)
        with pytest.raises(gs.ConfigError, match=r"previous is .*, must be a state"):
            sim.render(outputs="flow", previous="x")  # type: ignore[arg-type]


def test_rendering_in_a_forked_process_is_refused() -> None:
    with gs.Simulation("flat") as sim:
        sim.render(outputs="rgb")
        reading, writing = os.pipe()
        child = os.fork()
        if not child:
            try:
                sim.render(outputs="rgb")
            except gs.RenderError as error:
                os.write(writing, str(error).encode())
            finally:
                os._exit(0)
        os.waitpid(child, 0)
        os.close(writing)
        assert b"belongs to the process that was forked" in os.read(reading, 1000)
        os.close(reading)


def test_light_can_be_changed_and_changed_back() -> None:
    with gs.Simulation("flat") as sim:
        light, bright = sim.light, sim.render(outputs=["rgb"]).rgb
        sim.light = replace(light, sun=0.05, ambient=0.1)
        dark = sim.render(outputs=["rgb"]).rgb
        assert dark.mean() < 0.7 * bright.mean()
        sim.light = light
        assert np.array_equal(sim.render(outputs=["rgb"]).rgb, bright)


def test_all_cameras_are_drawn_together_as_one_by_one() -> None:
    with gs.Simulation("flat", "left=gibson_bot,right=gibson_bot", start="1.0,4.7,0;6.4,3.3,90") as sim:
        together = sim.render_all(outputs=["depth"])
        assert [frame.camera.name for frame in together] == ["left/camera", "right/camera"]
        for frame in together:
            alone = sim.render(frame.camera.name, outputs=["depth"]).depth
            assert np.allclose(alone, frame.depth, atol=1e-5)


def test_unknown_cameras_and_outputs_are_named() -> None:
    with gs.Simulation("flat") as sim:
        with pytest.raises(gs.ConfigError, match="there is no camera 'camra'; there are: camera; did you mean 'camera'"):
            sim.render("camra")
        with pytest.raises(gs.ConfigError, match=r"outputs are .*'rbg'.*, must be one or more of rgb, depth"):
            sim.render(outputs=["rbg"])  # type: ignore[list-item]


def test_examples_of_docstrings_give_what_they_say() -> None:
    found = doctest.testmod(simulation, optionflags=doctest.NORMALIZE_WHITESPACE)
    assert (found.attempted, found.failed) == (3, 0)
