"""Two trials, run by run: which runs got better or worse, and whether the difference can be chance. Pure: results go in, sentences come out."""
