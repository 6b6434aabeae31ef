"""Masks made for the scene in view, beside masks that are known before."""
