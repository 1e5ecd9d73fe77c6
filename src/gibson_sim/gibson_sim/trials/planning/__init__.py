"""Planning: what is drawn for each run of a scenario, and checks that it can be met. Nothing is started, and nothing is written."""
