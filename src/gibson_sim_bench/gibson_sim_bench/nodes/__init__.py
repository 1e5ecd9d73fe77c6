"""ROS nodes of the benchmarks, each in its own process; only this subpackage of ``gibson_sim_bench`` imports ROS."""
