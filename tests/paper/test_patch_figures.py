"""Masks of image patches: the brightest first, on a scale of their own."""

import numpy as np
import pytest

from deepfsi_paper.ovit.figures import LearnedMasks, patch_masks_figure


def patch_rows(budgets=(1e2, 1e4, 1e6), masks=9, side=3):
    rng = np.random.default_rng(1)
    return [
        LearnedMasks(photons, side, [], [], rng.normal(size=(masks, side**2)) / 20)
        for photons in budgets
    ]


@pytest.mark.parametrize("budgets", [(1e2,), (1e2, 1e4, 1e6)])
def test_all_masks_of_a_patch_brightest_first(budgets):
    rows = patch_rows(budgets)
    figure = patch_masks_figure(rows)
    panels, bars = figure.axes[: len(rows)], figure.axes[len(rows) :]
    for ax, bar, row in zip(panels, bars, rows, strict=True):
        (image,) = ax.images
        end = np.abs(row.matrix).max()
        assert image.get_clim() == (-end, end)
        ticks = [text.get_text() for text in bar.get_xticklabels()]
        assert ticks == [f"−{end:.2g}", "0", f"{end:.2g}"]
        assert bar.get_xlabel() == "share of a pixel's photons, Mᵢⱼ"
        assert ax.get_title(loc="left").endswith("9 of 9 masks")
        sheet = np.ma.filled(image.get_array(), np.nan)
        finer = len(sheet) // (3 * 4 - 1)
        sheet = sheet[::finer, ::finer]
        tiles = [sheet[i : i + 3, j : j + 3] for i in (0, 4, 8) for j in (0, 4, 8)]
        light = [np.abs(tile).sum() for tile in tiles]
        assert light == sorted(light, reverse=True)
        assert sorted(light) == pytest.approx(sorted(np.abs(row.matrix).sum(axis=1)))
        assert np.isnan(sheet[3]).all()


def test_masks_that_do_not_fill_their_square():
    figure = patch_masks_figure(patch_rows(masks=7))
    assert len([ax for ax in figure.axes if ax.images]) == 3


def test_of_many_masks_the_brightest_are_drawn_large():
    figure = patch_masks_figure(patch_rows((1e4,), masks=64))
    ax = figure.axes[0]
    assert ax.get_title(loc="left") == "10⁴ photons: 16 of 64 masks"
    assert ax.images[0].get_array().shape[0] % (4 * 4 - 1) == 0
