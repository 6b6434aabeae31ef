"""Pictures of scenes share a scale, and those that are lost are blank."""

import numpy as np
import pytest

from deepfsi.base.errors import InputError
from deepfsi.report.pictures import pictures_figure
from shared.figures import assert_legible


@pytest.mark.parametrize("shape", [(9, 12, 16), (1, 8, 8), (4, 30), (60, 4, 4)])
def test_pictures_share_a_scale(shape):
    pictures = np.random.default_rng(0).normal(1, 1, shape)
    pictures[0].flat[0] = np.nan
    names = [f"scene_{k}.png" for k in range(len(pictures))]
    figure = pictures_figure(pictures, names)
    if len(pictures) > 3:
        assert_legible(figure)
    images = [image for ax in figure.axes for image in ax.get_images()]
    assert len(images) == min(48, len(pictures))
    for image, wanted in zip(images, pictures, strict=False):
        shown = np.ma.filled(image.get_array(), np.nan)
        np.testing.assert_array_equal(shown, np.atleast_2d(wanted))
        assert image.get_clim() == (np.nanmin(pictures[:48]), np.nanmax(pictures[:48]))
    with pytest.raises(InputError, match="one name of each"):
        pictures_figure(pictures, names[1:])


def test_pictures_that_are_all_lost_are_drawn():
    figure = pictures_figure(np.full((2, 4, 4), np.nan), ["a", "b"])
    figure.draw_without_rendering()


def test_captions_keep_the_ends_of_long_names():
    names = ["disc/a-long-name-of-a-series-000014.png", "disc/a-long-name-of-a-series-000015.png"]
    figure = pictures_figure(np.ones((2, 4, 4)), names)
    captions = [ax.get_title(loc="left") for ax in figure.axes[:2]]
    assert captions == ["…ries-000014.png", "…ries-000015.png"]
