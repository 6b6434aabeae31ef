"""Many trials: recipes, records on disk, worker processes, summaries and plans."""
