"""Finding a device that can draw, and messages that say what to install if there is none."""

from __future__ import annotations

import ast
import os
import subprocess
import sys
import warnings

import pytest

from gibson_sim.errors import GraphicsUnavailableError
from gibson_sim.render.context import list_devices, open_context
from gibson_sim.render.context.egl import Egl
from gibson_sim.render.renderer import Renderer, RenderOptions
from render.drawing import scene


@pytest.mark.parametrize("use", [lambda name: open_context(library=name), lambda name: list_devices(library=name)])
def test_without_the_library_the_error_names_it_and_what_to_install(use):
    with pytest.raises(GraphicsUnavailableError) as caught:
        use("libNoSuchEGL.so.1")
    message = str(caught.value)
    assert "libNoSuchEGL.so.1" in message
    for package in ("libegl1", "libegl-mesa0", "libgl1-mesa-dri"):
        assert package in message
    assert "\n" not in message


def test_a_library_that_is_not_egl_is_refused_by_name():
    with pytest.raises(GraphicsUnavailableError, match=r"libc\.so\.6 is not a complete EGL library"):
        open_context(library="libc.so.6")


def test_a_renderer_without_the_library_is_refused():
    with pytest.raises(GraphicsUnavailableError, match=r"libNoSuchEGL\.so\.1"):
        Renderer(scene(), options=RenderOptions(library="libNoSuchEGL.so.1"))


@pytest.mark.egl
@pytest.mark.usefixtures("egl")
def test_at_least_one_device_is_usable_and_has_a_description():
    devices = list_devices()
    assert [d.index for d in devices] == list(range(len(devices)))
    usable = [d for d in devices if d.usable]
    assert usable
    assert all(d.renderer and d.version and not d.problem for d in usable)
    assert all(d.problem for d in devices if not d.usable)


@pytest.mark.egl
@pytest.mark.usefixtures("egl")
def test_a_device_can_be_chosen_by_number():
    number = next(d.index for d in list_devices() if d.usable)
    context = open_context(number)
    assert context.device.index == number
    context.close()


@pytest.mark.egl
@pytest.mark.usefixtures("egl")
@pytest.mark.parametrize("number", [-1, 99])
def test_a_device_that_does_not_exist_is_refused_by_number(number):
    with pytest.raises(GraphicsUnavailableError, match=f"EGL device {number} does not exist"):
        open_context(number)


@pytest.mark.egl
@pytest.mark.usefixtures("egl")
def test_a_context_may_be_closed_twice():
    context = open_context()
    context.close()
    context.close()


@pytest.mark.egl
@pytest.mark.usefixtures("egl")
def test_a_device_is_opened_by_its_uuid_as_well_as_by_its_number() -> None:
    device = next(d for d in list_devices() if d.usable)
    if not device.uuid or [d.uuid for d in list_devices()].count(device.uuid) > 1:
        pytest.skip("the drivers here give their devices no UUIDs of their own")
    for wanted in (device.index, str(device.index), device.uuid, f"GPU-{device.uuid}", device.uuid[:13]):
        context = open_context(wanted)
        assert (context.device.index, context.device.uuid) == (device.index, device.uuid)
        context.close()


@pytest.mark.egl
@pytest.mark.usefixtures("egl")
@pytest.mark.parametrize(("given", "found"), [(None, "brilinear"), ("", ""), ("no_quad_lod", "no_quad_lod")])
def test_how_mesa_blends_textures_is_chosen_unless_the_user_has(
    monkeypatch: pytest.MonkeyPatch, given: str | None, found: str
) -> None:
    monkeypatch.setenv("GALLIVM_PERF", given or "")
    if given is None:
        monkeypatch.delenv("GALLIVM_PERF")
    Egl()
    assert os.environ["GALLIVM_PERF"] == found


_CORES_OF_THREADS = """
import os
from gibson_sim.render.context import open_context
from gibson_sim.render.context.cores import drawing_threads
context = open_context()
own = [sorted(os.sched_getaffinity(thread)) for thread, _ in sorted(drawing_threads().items(), key=lambda item: item[1])]
print(context.device.software, sorted(os.sched_getaffinity(0)), own)
"""


@pytest.mark.egl
@pytest.mark.usefixtures("egl")
@pytest.mark.parametrize("few", [False, True], ids=["as many as cores", "one"])
def test_threads_of_a_software_renderer_have_a_core_each_unless_there_are_fewer(few: bool):
    environment = {**os.environ, **({"LP_NUM_THREADS": "1"} if few else {})}
    done = subprocess.run([sys.executable, "-c", _CORES_OF_THREADS], env=environment, capture_output=True, text=True, check=True)
    software, rest = done.stdout.split(maxsplit=1)
    usable, own = ast.literal_eval(rest.replace("] [", "], ["))
    if software != "True":
        warnings.warn("SKIPPED: a GPU draws here, no software renderer", stacklevel=1)
        pytest.skip("a GPU draws here, no software renderer")
    if few or len(usable) < 2 or len(own) < len(usable):
        assert all(cores == usable for cores in own)
    else:
        assert own[: len(usable)] == [[core] for core in usable]
