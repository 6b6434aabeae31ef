"""Designs for several budgets and numbers of masks, and several looks."""
