"""Planning: samples the values of each run of a scenario and checks that the scenario can be satisfied. Starts no process, writes no file."""
