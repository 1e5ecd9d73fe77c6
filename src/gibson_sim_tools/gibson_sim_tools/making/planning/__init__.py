"""Plans buildings: rooms, furniture and lamps from a kind and a seed. Pure; see docs/making_scenes.md."""

from gibson_sim_tools.making.planning.checks import check_building
from gibson_sim_tools.making.planning.drawing import draw_plan
from gibson_sim_tools.making.planning.planner import plan_building

__all__ = ["check_building", "draw_plan", "plan_building"]
