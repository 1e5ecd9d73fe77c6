"""Where the links of all bodies are: read from the engine once for each state that anybody asks for."""

from __future__ import annotations

from collections.abc import Sequence

from gibson_sim.geometry.transforms import turned
from gibson_sim.physics.body import BodyInWorld
from gibson_sim.physics.bullet import Bullet
from gibson_sim.physics.frames import FrameTable
from gibson_sim.types import Pose, SceneState, Vec3


class LinkPoses:
    """Reads states, and keeps the last one until something moves."""

    def __init__(self, bullet: Bullet) -> None:
        self._bullet = bullet
        self._bodies: tuple[BodyInWorld, ...] = ()
        self._state: SceneState | None = None
        self._table: FrameTable | None = None
        """Of all bodies together; None = they changed."""
        self.links: tuple[str, ...] = ()
        """Names ``<body>/<link>`` of all links, body by body, the roots first."""

    def change_bodies(self, bodies: tuple[BodyInWorld, ...], new_links: tuple[str, ...] = ()) -> None:
        """Takes up other bodies; ``new_links`` are those of a body that came last, so that thousands come quickly."""
        self._bodies = bodies
        self.links = self.links + new_links if new_links else tuple(link for one in bodies for link in one.full_links)
        self._state = self._table = None

    def forget(self) -> None:
        """Call it when something moved, or time did."""
        self._state = None

    def state(self, stamp_ns: int, step: int, revision: int) -> SceneState:
        """Returns the poses of all links now; its arrays are read-only and stay as they are."""
        if self._state is None:
            if self._table is None:
                self._table = FrameTable.joined([body.table for body in self._bodies])
            self._state = self._read(self._bodies, self._table, self.links, stamp_ns, step, revision)
        return self._state

    def state_of(self, one: BodyInWorld, stamp_ns: int, step: int, revision: int) -> SceneState:
        """Returns the poses of at least the links of one body now."""
        if self._state is not None:
            return self._state
        return self._read((one,), one.table, one.full_links, stamp_ns, step, revision)

    def _read(
        self, bodies: Sequence[BodyInWorld], table: FrameTable, links: tuple[str, ...], stamp_ns: int, step: int, revision: int
    ) -> SceneState:
        positions, quats, twists = table.links(self._bullet.raw_states(*(body.body for body in bodies)))
        for array in (positions, quats, twists):
            array.setflags(write=False)
        return SceneState(stamp_ns, step, revision, links, positions, quats, twists)


def link_pose(state: SceneState, link: str) -> Pose:
    """Returns T_world_link; ``link``: its whole name, ``<body>/<link>``."""
    row = state.links.index(link)
    x, y, z = state.positions[row].tolist()
    qx, qy, qz, qw = state.quats_xyzw[row].tolist()
    return Pose((x, y, z), (qx, qy, qz, qw))


def link_twist(state: SceneState, link: str) -> tuple[Vec3, Vec3]:
    """Returns linear (m/s) and angular (rad/s) velocity of the link's origin against the world, in the LINK's frame."""
    row = state.links.index(link)
    x, y, z, w = state.quats_xyzw[row].tolist()
    *linear, p, q, r = state.twists[row].tolist()
    inverse = (-x, -y, -z, w)
    return turned(inverse, (linear[0], linear[1], linear[2])), turned(inverse, (p, q, r))
