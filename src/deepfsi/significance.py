"""How sure a comparison is: bootstrap intervals over classes, and the Wilcoxon signed-rank test."""
