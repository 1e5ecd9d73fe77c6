"""Which scenes train, validate and test. Fixed before the first training; a test reads no other scene than the held-out ones."""

TRAINING = ("boulevard_flat", "corner_shop", "garden_house", "harbour_flat", "orchard_house", "print_works_office")
VALIDATION = ("courtyard_flat", "mill_house")
HELD_OUT = ("linden_flat", "river_office")
"""Never seen in training, nor when a parameter was chosen."""
