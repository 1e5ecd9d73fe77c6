"""A scene from a folder of posed photographs, such as the export of a phone: ``importing`` runs all stages, from the images to a driving robot."""
