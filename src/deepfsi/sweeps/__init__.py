"""Many designs: recipes, their trials, the records of these, and their summary."""
