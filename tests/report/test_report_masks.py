"""Pictures of masks: one symmetric scale, every value once."""

import numpy as np
import pytest

from deepfsi.evaluation.results import lit_masks
from deepfsi.report import masks
from deepfsi.report.masks import brightest_masks, signed
from shared.figures import assert_legible


def test_masks_have_a_symmetric_scale_and_one_colour_bar():
    matrix = np.random.default_rng(1).normal(0.3, 1, (14, 24))
    figure = masks.masks_figure(matrix, (4, 6), title="a $title$ as it is")
    images = [ax.images[0] for ax in figure.axes if ax.images and ax.get_visible()]
    assert len(images) == 12
    limits = {image.get_clim() for image in images}
    assert limits == {(-np.abs(matrix).max(), np.abs(matrix).max())}
    assert np.ptp(images[0].to_rgba(np.zeros((1, 1)))[0, 0, :3]) < 0.02  # 0 is grey
    labels = [ax.get_xlabel() for ax in figure.axes if ax.get_xlabel()]
    assert labels == ["share of a pixel's photons, Mᵢⱼ"]
    energy = [np.abs(image.get_array()).sum() for image in images]
    assert energy == sorted(energy, reverse=True)
    assert figure.get_suptitle() == "a $title$ as it is"


def tiles_of(figure):
    return [ax for ax in figure.axes if ax.get_visible() and ax.get_title(loc="left")]


@pytest.mark.parametrize("shape", [(4, 6), (24,)])
def test_masks_have_their_number_and_their_dwell(shape):
    matrix = np.random.default_rng(1).normal(size=(14, 24))
    dwells = np.arange(14) / 100
    figure = masks.masks_figure(matrix, shape, dwells=dwells)
    assert_legible(figure)
    for ax, mask in zip(tiles_of(figure), brightest_masks(matrix, 12), strict=True):
        dwell = f"dwell {mask:.2g} %"
        if len(shape) == 2:
            assert ax.get_title(loc="left") == f"mask {mask + 1}"
            assert ax.get_xlabel() == dwell
            np.testing.assert_array_equal(ax.images[0].get_array().ravel(), matrix[mask])
        else:
            assert ax.get_title(loc="left") == f"mask {mask + 1}, {dwell}"


def test_masks_that_are_not_negative_have_a_scale_from_zero():
    matrix = np.random.default_rng(1).uniform(0, 0.3, (3, 24))
    figure = masks.masks_figure(matrix, (4, 6))
    assert {ax.images[0].get_clim() for ax in tiles_of(figure)} == {(0, matrix.max())}
    *_, bar = figure.axes
    assert bar.get_xticklabels()[0].get_text() == "0"
    curves = masks.masks_figure(matrix, (24,))
    assert curves.axes[0].get_ylim() == pytest.approx((0, 1.05 * matrix.max()))


def test_spectra_are_curves():
    matrix = np.random.default_rng(3).normal(size=(4, 30))
    figure = masks.masks_figure(matrix, (30,))
    curves = [ax.lines[-1].get_ydata() for ax in figure.axes if ax.get_visible()]
    assert len(curves) == 4
    assert all(any(np.array_equal(curve, row) for row in matrix) for curve in curves)
    assert not any(ax.images for ax in figure.axes)
    low, high = figure.axes[0].get_ylim()
    assert low == -high


def test_dark_masks_can_be_drawn():
    masks.masks_figure(np.zeros((1, 4)), (2, 2)).draw_without_rendering()


def test_masks_without_light_are_none_of_the_brightest():
    """In either rail; a mask of one rail that is dark is lit."""
    rails = np.random.default_rng(1).uniform(0.1, 0.3, (2, 8, 24))
    rails[:, 2], rails[0, 5], rails[:, 7] = 0, 0, 0
    assert lit_masks(rails) == lit_masks(rails[1]) == 6
    assert set(brightest_masks(rails, 8)) == {0, 1, 3, 4, 5, 6}
    assert len(brightest_masks(rails, 3)) == 3
    np.testing.assert_array_equal(signed(rails), rails[0] - rails[1])
    for one in (rails[:1], rails[0]):
        np.testing.assert_array_equal(signed(one), rails[0])
    titles = {ax.get_title(loc="left") for ax in tiles_of(masks.masks_figure(rails[1], (4, 6)))}
    assert titles == {f"mask {number}" for number in (1, 2, 4, 5, 6, 7)}
