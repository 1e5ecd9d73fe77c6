"""Photographs with poses, of our scanner and of the programs of others: images, lenses, depth. From files alone; knows no mesh."""
