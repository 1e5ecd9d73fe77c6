"""Building blocks of the scripted baselines: driving, moving an arm, handling objects, opening doors."""
