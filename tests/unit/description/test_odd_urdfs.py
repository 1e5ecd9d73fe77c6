"""URDFs with impossible values: refused with a reason, or corrected with a warning."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from gibson_sim.description.rigid_groups import MAX_MOVING_JOINTS, rigid_groups
from gibson_sim.description.urdf import UrdfModel, parse_urdf
from gibson_sim.errors import RobotError


def parse(body: str) -> UrdfModel:
    return parse_urdf(f'<robot name="r">{body}</robot>', Path("r.urdf"))


def chain(length: int, kind: str = "revolute") -> str:
    links = "".join(f'<link name="l{i}"/>' for i in range(length + 1))
    return links + "".join(
        f'<joint name="j{i}" type="{kind}"><parent link="l{i}"/><child link="l{i + 1}"/></joint>' for i in range(length)
    )


def inertial(mass: float, ixx: float, iyy: float, izz: float) -> str:
    inside = f'<mass value="{mass}"/><inertia ixx="{ixx}" ixy="0" ixz="0" iyy="{iyy}" iyz="0" izz="{izz}"/>'
    return f'<link name="a"><inertial>{inside}</inertial></link>'


def test_two_hundred_moving_joints_are_refused_and_two_hundred_fixed_ones_are_not() -> None:
    with pytest.raises(RobotError, match=r"has 200 moving joints.* at most 121 moving"):
        rigid_groups(parse(chain(200)))
    assert len(rigid_groups(parse(chain(MAX_MOVING_JOINTS)))[0]) == MAX_MOVING_JOINTS + 1
    (one,) = rigid_groups(parse(chain(200, "fixed")))[0]
    assert len(one.members) == 201


@pytest.mark.parametrize(
    ("link", "words"),
    [
        (inertial(0.0, 1.0, 1.0, 1.0), "link 'a' has no mass; 1 kg is used"),
        (inertial(2.0, 0.0, 0.0, 0.0), "link 'a' has an invalid inertia (principal moments 0, 0, 0 kg m^2: {}"),
        (inertial(2.0, 1.0, 1.0, 9.0), "link 'a' has an invalid inertia (principal moments 1, 1, 9 kg m^2: {}"),
    ],
)
def test_an_impossible_mass_or_inertia_is_replaced_with_a_warning(link: str, words: str) -> None:
    (group,), warnings = rigid_groups(parse(link))
    rule = "each must be above 0 and below the sum of the others); that of a small sphere is used"
    assert warnings == (f"r.urdf: {words.format(rule)}",)
    assert group.mass > 0.0
    assert np.linalg.eigvalsh(group.inertia).min() > 0.0


def test_an_inertia_that_violates_the_triangle_inequality_is_kept_and_named_but_not_where_it_is_rounding() -> None:
    (group,), warnings = rigid_groups(parse(inertial(2.0, 1.0, 1.0, 2.5)))
    assert warnings == (
        "r.urdf: links move with inertias that no body has, a principal moment is above the sum of the others; check their <inertia>: "
        "'a' (1, 1, 2.5 kg m^2)",
    )
    assert np.diag(group.inertia).tolist() == [1.0, 1.0, 2.5]
    assert rigid_groups(parse(inertial(2.0, 1.0, 1.0, 2.01)))[1] == ()


def test_every_missing_mesh_has_its_line() -> None:
    shapes = "".join(
        f'<{kind}><geometry><mesh filename="package://p/{kind}.stl"/></geometry></{kind}>' for kind in ("visual", "collision")
    )
    assert parse(f'<link name="a">{shapes}</link>').warnings == (
        "r.urdf: link 'a': visual: mesh package://p/visual.stl does not exist; left out",
        "r.urdf: link 'a': collision: mesh package://p/collision.stl does not exist; left out",
    )


@pytest.mark.parametrize(
    ("body", "words"),
    [
        ('<link name="a"/><link name="a"/>', "two links are named 'a'"),
        (chain(1) + '<joint name="j0" type="fixed"><parent link="l0"/><child link="l1"/></joint>', "two joints are named 'j0'"),
        (chain(2) + '<joint name="back" type="fixed"><parent link="l2"/><child link="l0"/></joint>', "the joints form a cycle"),
        (chain(2) + '<joint name="loop" type="fixed"><parent link="l0"/><child link="l2"/></joint>', "link 'l2' has two parents"),
        (inertial(-1.0, 1.0, 1.0, 1.0), "mass is -1 kg, must not be negative"),
        (inertial(2.0, -1.0, 1.0, 1.0), "link 'a': ixx is -1 kg m^2, must not be negative; is its sign wrong?"),
        (inertial(2.0, 1.0, 1.0, -0.5), "link 'a': izz is -0.5 kg m^2, must not be negative"),
        (chain(1).replace("/></joint>", '/><limit effort="-5" velocity="1"/></joint>'), "effort is -5 and velocity 1, neither may be negative"),
        (inertial(float("nan"), 1.0, 1.0, 1.0), "must be a finite number"),
        ('<link name="a"><visual><geometry><mesh filename="m.stl" scale="1 0 1"/></geometry></visual></link>', "no factor may be 0"),
    ],
)  # fmt: skip
def test_a_broken_tree_or_number_is_refused(body: str, words: str) -> None:
    with pytest.raises(RobotError) as error:
        parse(body)
    assert words in str(error.value)


def test_a_missing_texture_is_named_once() -> None:
    material = '<material name="m"><texture filename="m.png"/></material>'
    visual = '<visual><geometry><sphere radius="1"/></geometry><material name="m"/></visual>'
    found = parse(f'{material}<link name="a">{visual * 2}</link>')
    assert found.warnings == ("r.urdf: texture m.png does not exist; left out",)
    assert found.links[0].visuals[0].color is None
