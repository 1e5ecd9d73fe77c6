"""Features of the standard that this simulator supports: the table behind GetSimulatorFeatures and ``docs/simulation_interfaces.md``."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Feature:
    """One constant of ``SimulatorFeatures``."""

    name: str
    number: int
    supported: bool
    remark: str
    """Note to the user, Markdown."""


FEATURES = (
    Feature("SPAWNING", 0, True, "`spawn_entity`, at most 2,000 entities"),
    Feature("DELETING", 1, True, "`delete_entity`, also entities of the world file; a reset of everything restores those"),
    Feature(
        "NAMED_POSES",
        2,
        True,
        "`get_named_poses`: start poses, free places, rooms and doors, by the scene's names (`floor_0/kitchen`)",
    ),
    Feature("POSE_BOUNDS", 3, True, "`get_named_pose_bounds`: a box about the pose, in its frame"),
    Feature("ENTITY_TAGS", 4, True, "initially `semantic_class`, then the tags from `set_entity_info`"),
    Feature("ENTITY_BOUNDS", 5, True, "`get_entity_bounds`: always a box, in the frame of the root link"),
    Feature("ENTITY_BOUNDS_BOX", 6, True, "filter in the world frame, against the bounding box of an entity's collision shapes"),
    Feature("ENTITY_BOUNDS_CONVEX", 7, True, "the same with 3 to 256 points"),
    Feature("ENTITY_CATEGORIES", 8, True, "robot, human, dynamic object, static object; others by `set_entity_info`"),
    Feature("SPAWNING_RESOURCE_STRING", 9, True, "URDF and SDF as text"),
    Feature("ENTITY_STATE_GETTING", 10, True, "`get_entity_state`, `get_entities_states`; the acceleration is always 0"),
    Feature("ENTITY_STATE_SETTING", 11, True, "`set_entity_state`; an acceleration is ignored"),
    Feature("ENTITY_INFO_GETTING", 12, True, "`get_entity_info`"),
    Feature("ENTITY_INFO_SETTING", 13, True, "`set_entity_info`"),
    Feature("SPAWNABLES", 14, True, "`get_spawnables`"),
    Feature("SIMULATION_RESET", 20, True, "`reset_simulation`; if time was running, it runs on after the reset"),
    Feature("SIMULATION_RESET_TIME", 21, True, "/clock is 0 again, unless `reset_time` is `monotonic`"),
    Feature("SIMULATION_RESET_STATE", 22, True, "poses, velocities, joints, odometry, commands"),
    Feature("SIMULATION_RESET_SPAWNED", 23, True, "removes the entities from `spawn_entity` and `spawn_entities`"),
    Feature("SIMULATION_STATE_GETTING", 24, True, "`get_simulation_state`"),
    Feature("SIMULATION_STATE_SETTING", 25, True, "`set_simulation_state`"),
    Feature("SIMULATION_STATE_PAUSE", 26, True, "also from STOPPED: the simulation starts paused"),
    Feature("STEP_SIMULATION_SINGLE", 31, True, "`step_simulation`: a step is one physics step, `1 / step_hz` s"),
    Feature("STEP_SIMULATION_MULTIPLE", 32, True, "as fast as the machine allows; other services respond meanwhile"),
    Feature("STEP_SIMULATION_ACTION", 33, True, "`simulate_steps`: feedback after each step, can be cancelled"),
    Feature("WORLD_LOADING", 40, True, "`load_world`; the new world has no robot: spawn one"),
    Feature("WORLD_RESOURCE_STRING", 41, True, "SDF as text"),
    Feature("WORLD_TAGS", 42, True, "`get_available_worlds` filters by them"),
    Feature("WORLD_UNLOADING", 43, True, "`unload_world`"),
    Feature("WORLD_INFO_GETTING", 44, True, "`get_current_world`"),
    Feature(
        "AVAILABLE_WORLDS",
        45,
        True,
        "`get_available_worlds`; all worlds are files of this machine, so `offline_only` makes no difference",
    ),
    Feature("SPAWNING_ENTITIES", 50, True, "`spawn_entities`; if one entity cannot be spawned, the others are kept"),
)


def supported_features() -> tuple[int, ...]:
    """Returns the numbers for ``SimulatorFeatures.features``."""
    return tuple(feature.number for feature in FEATURES if feature.supported)


def feature_table() -> str:
    """Returns the table as Markdown."""
    rows = ["| feature | | remark |", "|---|---|---|"]
    rows += [f"| `{f.name}` ({f.number}) | {'yes' if f.supported else 'no'} | {f.remark} |" for f in FEATURES]
    return "\n".join(rows) + "\n"
