"""Data sets of named sources, folders of images, hyperspectral cubes and arrays.

A `Dataset` holds scenes as reflectance in [0, 1], one row each, with integer labels, already
divided into a training and a test part. Where the source has no test part of its own, a seeded
stratified fifth of it is set aside. The training scenes are always in random order, so that the
last of them are a fair sample to validate on (`Dataset.hold_out`).
"""
