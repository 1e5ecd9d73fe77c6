"""People on their paths."""

from __future__ import annotations

import math
from xml.etree.ElementTree import canonicalize

import pytest

from gibson_sim.description.shapes import Shape
from gibson_sim.scenes.spawning import built_in_spawnables, load_spawnable
from gibson_sim.trials.execution.walking import person_pose, person_urdf
from gibson_sim.trials.records import Person
from gibson_sim.trials.scenario.spec import PersonRule
from gibson_sim.types import Pose

ANNA = Person("anna", ((0.0, 0.0), (3.0, 0.0), (3.0, 1.0)), 0.5, 0.25, 1.75)


@pytest.mark.parametrize(
    ("time", "pose"),
    [
        (0.0, (0.0, 0.0, 0.0)),
        (2.0, (1.0, 0.0, 0.0)),
        (7.0, (3.0, 0.5, math.pi / 2)),  # 3.5 m
        (9.0, (3.0, 0.5, -math.pi / 2)),  # 4.5 m: half a metre on the way back
        (12.0, (2.0, 0.0, math.pi)),  # 6 m
        (18.0, (1.0, 0.0, 0.0)),  # 8 m there and back, and 1 m again
    ],
)
def test_person_walks_to_and_fro(time: float, pose: tuple[float, float, float]) -> None:
    x, y, yaw = person_pose(ANNA, time)
    assert (x, y) == pytest.approx(pose[:2])
    assert math.cos(yaw - pose[2]) == pytest.approx(1.0)


def test_built_in_person_is_that_of_trials_at_its_default_size() -> None:
    rule = PersonRule()
    made = person_urdf(Person("person", (), rule.speed, rule.radius, rule.height))
    file = built_in_spawnables()["person"] / "person.urdf"
    assert canonicalize(made, strip_text=True) == canonicalize(from_file=file, strip_text=True)


def test_person_without_a_way_stays() -> None:
    assert person_pose(Person("ben", ((1.0, 2.0),), 0.5, 0.25, 1.75), 9.0) == (1.0, 2.0, 0.0)


def test_model_is_a_static_capsule_that_stands_on_the_floor() -> None:
    body = load_spawnable("", person_urdf(ANNA), name="anna", pose=Pose((0.0, 0.0, 0.0)))
    assert body.static
    assert body.semantic_class == "person"
    shapes = [(c.shape, c.pose.position[2]) for link in body.model.links for c in link.collisions]
    spheres = sorted(z for shape, z in shapes if shape.kind == "sphere")
    assert spheres == pytest.approx([0.25, 1.5])
    (cylinder, middle) = next((s, z) for s, z in shapes if s.kind == "cylinder")
    assert isinstance(cylinder, Shape)
    assert sorted(cylinder.size)[-1] == pytest.approx(1.25)
    assert middle == pytest.approx(0.875)
