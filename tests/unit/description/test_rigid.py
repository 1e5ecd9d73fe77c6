"""Joining fixed links into rigid groups."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gibson_sim.description.rigid_groups import physics_urdf, rigid_groups
from gibson_sim.description.urdf import read_urdf
from gibson_sim.errors import RobotError

MASS = '<inertial><mass value="{kg}"/><inertia ixx="{i}" ixy="0" ixz="0" iyy="{i}" iyz="0" izz="{i}"/></inertial>'
BALL = '<collision><geometry><sphere radius="0.1"/></geometry></collision>'


def write(tmp_path: Path, b: str, joint: str = "fixed") -> Path:
    """Returns a file with links a (2 kg) and b, 1 m ahead of it."""
    path = tmp_path / "r.urdf"
    path.write_text(
        f'<robot name="r"><link name="root"/><link name="a">{BALL}{MASS.format(kg=2, i=0.1)}</link><link name="b">{b}</link>'
        '<joint name="j0" type="fixed"><parent link="root"/><child link="a"/></joint>'
        f'<joint name="j" type="{joint}"><parent link="a"/><child link="b"/><origin xyz="1 0 0"/></joint></robot>'
    )
    return path


def test_fixed_links_share_mass_centre_and_inertia(tmp_path: Path) -> None:
    groups, warnings = rigid_groups(read_urdf(write(tmp_path, MASS.format(kg=2, i=0.1))))
    assert (len(groups), warnings) == (1, ())
    assert groups[0].mass == 4.0
    assert groups[0].center == pytest.approx([0.5, 0.0, 0.0])
    # Two points of 2 kg at 0.5 m add 1 kg m^2 about y and z to 0.2.
    assert np.diag(groups[0].inertia) == pytest.approx([0.2, 1.2, 1.2])


def test_link_without_mass_adds_none(tmp_path: Path) -> None:
    groups, _ = rigid_groups(read_urdf(write(tmp_path, "")))
    assert (groups[0].mass, groups[0].center.tolist()) == (2.0, [0.0, 0.0, 0.0])


def test_members_keep_their_place(tmp_path: Path) -> None:
    groups, _ = rigid_groups(read_urdf(write(tmp_path, "")))
    assert groups[0].members["b"][:3, 3].tolist() == [1.0, 0.0, 0.0]


def test_moving_link_is_a_group_of_its_own(tmp_path: Path) -> None:
    groups, _ = rigid_groups(read_urdf(write(tmp_path, MASS.format(kg=1, i=0.1), "continuous")))
    assert [group.name for group in groups] == ["root", "b"]


def test_link_with_its_own_friction_is_a_group_of_its_own(tmp_path: Path) -> None:
    groups, _ = rigid_groups(
        read_urdf(write(tmp_path, BALL + '<contact><lateral_friction value="0"/></contact>' + MASS.format(kg=1, i=0.1)))
    )
    assert [group.friction for group in groups] == [None, 0.0]


ROLLING = '<contact><rolling_friction value="0.002"/><spinning_friction value="0.001"/></contact>'


def test_link_with_its_own_rolling_friction_is_a_group_of_its_own_and_keeps_it_for_the_engine(tmp_path: Path) -> None:
    model = read_urdf(write(tmp_path, BALL + ROLLING + MASS.format(kg=1, i=0.1)))
    groups, _ = rigid_groups(model)
    assert [(group.rolling_friction, group.spinning_friction) for group in groups] == [(0.0, 0.0), (0.002, 0.001)]
    again = tmp_path / "again.urdf"
    again.write_text(physics_urdf(model, groups))
    assert [link.rolling_friction for link in read_urdf(again).links] == [0.0, 0.002]


def test_link_with_soft_contacts_is_a_group_of_its_own_and_keeps_them_for_the_engine(tmp_path: Path) -> None:
    soft = '<contact><stiffness value="1000"/><damping value="20"/></contact>'
    model = read_urdf(write(tmp_path, BALL + soft + MASS.format(kg=1, i=0.1)))
    groups, _ = rigid_groups(model)
    again = tmp_path / "again.urdf"
    again.write_text(physics_urdf(model, groups))
    assert [(link.stiffness, link.contact_damping) for link in read_urdf(again).links] == [(0.0, 0.0), (1000.0, 20.0)]


def test_root_that_nothing_moves_needs_no_mass(tmp_path: Path) -> None:
    model = read_urdf(write(tmp_path, MASS.format(kg=1, i=0.1), "continuous"))
    massless = replace(
        model, links=(replace(model.links[0], name="root"), replace(model.links[1], inertial=None), model.links[2])
    )
    assert "has no mass" in rigid_groups(massless)[1][0]
    assert rigid_groups(massless, fixed_root=True)[1] == ()


def test_moving_link_without_mass_gets_a_small_one_and_a_warning(tmp_path: Path) -> None:
    groups, warnings = rigid_groups(read_urdf(write(tmp_path, "", "continuous")))
    assert groups[1].mass == 0.05
    assert "'b' has no mass" in warnings[0]


def test_floating_joint_is_refused(tmp_path: Path) -> None:
    with pytest.raises(RobotError, match="floating"):
        rigid_groups(read_urdf(write(tmp_path, "", "floating")))


def test_written_urdf_reads_back_without_visuals(tmp_path: Path) -> None:
    visual = '<visual><geometry><sphere radius="1"/></geometry></visual>'
    model = read_urdf(write(tmp_path, visual + BALL + MASS.format(kg=1, i=0.1), "continuous"))
    again = tmp_path / "again.urdf"
    again.write_text(physics_urdf(model, rigid_groups(model)[0]))
    back = read_urdf(again)
    assert [one.name for one in back.links] == ["root", "b"]
    assert all(one.visuals == () for one in back.links)
    assert back.transforms()["b"][:3, 3] == pytest.approx([1.0, 0.0, 0.0])


def test_an_assumed_mass_acts_at_the_centre_of_the_shapes(tmp_path: Path) -> None:
    box = '<{0}><origin xyz="0 0 0.5"/><geometry><box size="0.4 0.3 0.1"/></geometry></{0}>'
    path = tmp_path / "box.urdf"
    # Collision shapes count before visuals, and visuals where there is nothing else.
    for shapes in (box.format("collision") + '<visual><geometry><sphere radius="1"/></geometry></visual>', box.format("visual")):
        path.write_text(f'<robot name="r"><link name="a">{shapes}</link></robot>')
        (group,), _ = rigid_groups(read_urdf(path))
        assert (group.mass, group.mass_is_assumed) == (1.0, True)
        assert group.center == pytest.approx([0.0, 0.0, 0.5])
        # 1/12 (b^2 + c^2) of 0.4 x 0.3 x 0.1 m
        assert group.inertia == pytest.approx(np.diag([0.1, 0.17, 0.25]) / 12)


def test_an_assumed_mass_is_shared_among_shapes_by_their_volumes(tmp_path: Path) -> None:
    path = tmp_path / "boxes.urdf"
    small, large = (
        f'<collision><origin xyz="{x} 0 0"/><geometry><box size="{length} 1 1"/></geometry></collision>'
        for x, length in ((-0.5, 1), (1.5, 3))
    )
    path.write_text(f'<robot name="r"><link name="a">{small}{large}</link></robot>')
    (group,), _ = rigid_groups(read_urdf(path))
    # Together they are a box of 4 x 1 x 1 m around x = 1.
    assert group.center == pytest.approx([1.0, 0.0, 0.0])
    assert np.diag(group.inertia) == pytest.approx([2 / 12, 17 / 12, 17 / 12])
