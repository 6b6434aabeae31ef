"""Adaptive masks: each next mask is made from the posterior over the training scenes.

A mirror device can show any binary mask next. After each look the posterior of the scene is known
from all counts so far (`posterior`), with training scenes as prior (`prior`). The next mask is that
of which the counts are expected to tell most of the class (`choice`). The answer is the posterior
of the class. A `design` keeps prior and looks in one file.
"""
