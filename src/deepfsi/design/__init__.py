"""A finished design: masks, classifier, its file, evaluation and early stopping."""
