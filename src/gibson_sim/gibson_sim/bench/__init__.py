"""Measurements that anyone can repeat: what is timed, how, and the report. The only place where results are numbers of a clock."""
