"""The gallery shows every output, camera, effect and light, with captions."""

from __future__ import annotations

import numpy as np
import pytest

from gibson_sim.resources import find_config
from gibson_sim.scenes.randomise import load_rules
from gibson_sim.sensors.gallery import COLUMNS, HEIGHT, WIDTH, gallery
from gibson_sim.types import Pose
from render.drawing import box, scene

pytestmark = [pytest.mark.egl, pytest.mark.usefixtures("egl")]


def test_gallery_has_rows_of_pictures_that_are_not_empty() -> None:
    room = scene(box((0.0, 0.0, 0.0), size=(8.0, 8.0, 0.1)), box((3.0, 0.0, 1.0)), box((-3.0, 1.0, 1.0), (0.8, 0.2, 0.1, 1.0)))
    picture = gallery(room, Pose((0.0, 0.0, 1.25)), load_rules(find_config("example", "randomisation")))
    assert picture.dtype == np.uint8
    assert picture.shape[1] > COLUMNS * WIDTH
    rows = picture.shape[0] // HEIGHT
    assert rows >= 6
    step = picture.shape[0] // (picture.shape[0] // (HEIGHT + 26))
    for top in range(0, picture.shape[0] - HEIGHT, step):
        assert picture[top : top + HEIGHT].std() > 10.0
