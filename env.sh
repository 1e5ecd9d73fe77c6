# source env.sh: activates the environment for your own nodes and tools, in bash and zsh.
# It also removes another ROS installation from this shell: two of them in one process do not work.

_gibson_sim_root="$(cd "$(dirname "${BASH_SOURCE[0]:-${(%):-%x}}")" && pwd)"
if [ ! -f "$_gibson_sim_root/.venv/bin/activate" ]; then
    echo "error: no environment in $_gibson_sim_root/.venv; create it with: make setup" >&2
    unset _gibson_sim_root
    return 1 2>/dev/null || exit 1
fi
unset PYTHONPATH LD_LIBRARY_PATH CMAKE_PREFIX_PATH COLCON_PREFIX_PATH _ROS_WHEELS_BOOTSTRAP_COMPLETE
. "$_gibson_sim_root/.venv/bin/activate"
# Lets programs find packages by name (ament index).
export AMENT_PREFIX_PATH="$_gibson_sim_root/.venv"
# Large images between processes on this machine go through shared memory.
export FASTRTPS_DEFAULT_PROFILES_FILE="$_gibson_sim_root/config/fastdds.xml"
if [ -n "${BASH_VERSION:-}" ]; then
    # TAB completes commands, options and names: loaded when it is first pressed (124: bash tries again).
    _gibson_sim_completion() { eval "$(gibson-sim completion bash)" && return 124; }
    complete -F _gibson_sim_completion gibson-sim
fi
unset _gibson_sim_root
