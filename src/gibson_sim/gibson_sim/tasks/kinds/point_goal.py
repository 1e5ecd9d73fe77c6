"""Drive to a position past movable obstacles."""

from __future__ import annotations

from gibson_sim.errors import SceneError
from gibson_sim.maps.paths import path_length
from gibson_sim.tasks.episode import Episode, Goal
from gibson_sim.tasks.ground import Ground
from gibson_sim.tasks.placing import at_distance, clutter, free_place
from gibson_sim.tasks.scripts.driving import Driver, pose_xy
from gibson_sim.tasks.task import Policy, Task, generator

MODELS = ("box_small", "box_cardboard", "basket", "bin_waste", "ball", "toy_ball", "book_stack", "stool")
"""Objects used as obstacles."""
THINGS = 8
"""Number of obstacles."""
DISTANCE = (2.5, 10.0)
"""Minimum and maximum length of the path from start to goal, metres."""
RADIUS = 0.30
"""Distance to the goal within which it is reached, metres."""


class PointGoal(Task):
    """Start and goal are sampled independently of the objects; the shortest path ignores them."""

    name = "point-goal"
    environment = "PointGoal"
    about = "drive to a position; movable objects lie in the way"
    rewards_by_path = True

    def generate(self, seed: int, ground: Ground) -> Episode:
        """Returns the episode of a seed; see ``Task.generate``."""
        rng = generator(self, seed)
        start = free_place(ground, rng)
        try:
            goal, _ = at_distance(ground, rng, start, *DISTANCE)
        except SceneError:
            goal, _ = at_distance(ground, rng, start, 1.0, DISTANCE[1])
        path = ground.space.planner.path(pose_xy(start), pose_xy(goal))
        clear = ((pose_xy(start), ground.space.clearance + 0.15), (pose_xy(goal), ground.space.clearance + 0.05))
        items = clutter(ground, rng, path, MODELS, THINGS, keep_clear=clear)
        return Episode(
            task=self.name,
            seed=seed,
            start=start,
            items=items,
            goal=Goal(f"Go to x = {goal.position[0]:.2f} m, y = {goal.position[1]:.2f} m.", goal.position, RADIUS),
            shortest=max(path_length(path) - RADIUS, 0.1),
            time_limit=90.0,
        )

    def scripted(self, episode: Episode, ground: Ground) -> Policy:
        """Returns a driver that drives around the objects if a path exists, and pushes through them otherwise."""
        assert episode.goal.position is not None
        return Driver(ground, episode.goal.position[:2], episode.items, near=RADIUS)
