"""Following paths by images, as the paper's Table 2 has it: methods, domains, many runs, intervals, a page. Simulation alone: sim-to-sim."""
