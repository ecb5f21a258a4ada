"""A whole run: from paths and a recipe to a folder of results."""
