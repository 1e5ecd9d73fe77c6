"""Import of posed photographs, such as a phone's export, as a scene: ``importing`` defines all stages, from the images to the maps for a robot."""
