"""Pictures from tables of counts: exact without noise, in every form of masks and tables."""

import numpy as np
import pytest
import pywt
from scipy.ndimage import gaussian_filter

from deepfsi.base.errors import InputError
from deepfsi.hardware.pictures.tables import TableMasks, compare_picture, read_pictures
from deepfsi.jobs.designs import formula_masks

SCENE = np.random.default_rng(0).integers(0, 50, (8, 4)).astype(float)


@pytest.fixture
def table(tmp_path):
    def save(values: np.ndarray, name: str = "counts.npy") -> str:
        path = tmp_path / name
        if name.endswith(".csv"):
            np.savetxt(path, values, delimiter=",", fmt="%d")
        else:
            np.save(path, values)
        return str(path)

    return save


def rails_of(masks: np.ndarray, scene: np.ndarray = SCENE) -> np.ndarray:
    """Counts (2, m) without noise of masks ±1."""
    return np.stack([(masks > 0) @ scene.ravel(), (masks < 0) @ scene.ravel()])


@pytest.mark.parametrize("name", ["counts.npy", "counts.csv"])
@pytest.mark.parametrize("formula", ["hadamard-natural", "hadamard-sequency", "hadamard"])
def test_a_picture_without_noise_is_the_scene(table, formula, name):
    counts = rails_of(formula_masks(formula, (8, 4)))
    settings = TableMasks(formula, size=(8, 4))
    found = read_pictures([table(counts.T.astype(int), name)], settings)
    assert np.allclose(found.pictures[0], SCENE)


@pytest.mark.parametrize("kind", ["signed", "binary", "grey"])
def test_masks_from_a_file_give_the_scene(table, kind):
    rng = np.random.default_rng(1)
    on = rng.random((48, 32)) < 0.5
    masks = {"signed": 2.0 * on - 1, "binary": on, "grey": rng.random((48, 32))}[kind]
    # grey light is no whole number: a large scene, rounded; its full scale is its brightest cell
    shown, scale = (masks / masks.max(), 1e9) if kind == "grey" else (on, 1)
    rails = np.stack([shown, 1 - shown]) @ SCENE.ravel()
    counts = table(np.rint(scale * rails.T))
    found = read_pictures([counts], TableMasks(table(masks, "masks.npy"), size=(8, 4)))
    assert np.allclose(found.pictures[0] / scale, SCENE, atol=1e-7)


def test_single_masks_and_raster_give_the_scene(table):
    single = TableMasks("hadamard-natural", size=(8, 4), rails="single")
    ones = table((formula_masks("hadamard-natural", (8, 4)) > 0) @ SCENE.ravel()[:, None])
    assert np.allclose(read_pictures([ones], single).pictures[0], SCENE)
    some = (formula_masks("hadamard-natural", (8, 4)) > 0)[1:]  # without all ON
    short = table(some @ SCENE.ravel()[:, None], "short.npy")
    file = table(some, "some.npy")
    found = read_pictures([short], TableMasks(file, size=(8, 4))).pictures[0]
    assert np.allclose(some @ found.ravel(), some @ SCENE.ravel())
    scan = table(SCENE.reshape(-1, 1), "scan.npy")
    raster = read_pictures([scan], TableMasks("raster", size=(8, 4)))
    assert np.allclose(raster.pictures[0], SCENE)
    assert raster.light is None
    assert "without inverses" in raster.note


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ({"masks": "hadamrd"}, "no masks 'hadamrd'"),
        ({"masks": "hadamard-natural", "size": (4, 4)}, "32 masks, and 16 are needed"),
        ({"masks": "hadamard-natural", "size": (8, 4), "rails": "turns"}, "give a column of masks"),
        ({"masks": "hadamard-natural"}, "no square"),
        ({"masks": "hadamard-natural", "size": (8, 4), "exposures_s": (1.0, 2.0)}, "2 `exposures`"),
        ({"masks": "wavelet-hare-2"}, "unknown wavelet"),
        ({"masks": "wavelet-haar-3"}, "multiple of 8"),
    ],
)
def test_what_does_not_fit_is_refused(table, settings, said):
    counts = table(rails_of(formula_masks("hadamard-natural", (8, 4))).T)
    with pytest.raises(InputError, match=said):
        read_pictures([counts], TableMasks(**settings))


def pyramid(tree: list) -> np.ndarray:
    """Coefficients (H, W) with the coarsest means in the upper left corner."""
    out = tree[0]
    for down, across, both in tree[1:]:
        out = np.block([[out, across], [down, both]])
    return out


SMOOTH = gaussian_filter(np.random.default_rng(4).random((64, 64)), 3) * 1000


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize(("name", "wavelet"), [("haar", "haar"), ("legall", "bior2.2")])
def test_wavelet_coefficients_of_either_sign_give_the_picture(table, name, wavelet, sign):
    tree = pywt.wavedec2(SMOOTH, wavelet, mode="periodization", level=3)
    tree = [tree[0], *((sign * a, sign * b, c) for a, b, c in tree[1:])]
    found = read_pictures([table(pyramid(tree))], TableMasks(f"wavelet-{name}-3"))
    assert np.allclose(found.pictures[0], SMOOTH)
    assert found.wavelets[0]["reversed"] is (sign < 0)
    assert found.light is None
    assert "cannot be said" in found.note


def test_the_scatter_of_details_is_poisson_s_for_poisson_counts(table):
    # a uniform scene behind patterns of the height 2^-level: each detail is a difference of counts
    rng, light, levels = np.random.default_rng(5), 400.0, 3
    tree = pywt.wavedec2(np.full((64, 64), light), "haar", mode="periodization", level=levels)
    noisy = [tree[0]]
    for level, parts in zip((3, 2, 1), tree[1:], strict=True):
        size, rate = parts[0].shape, light * 2**level / 2
        noisy.append(tuple(rng.poisson(rate, size) - rng.poisson(rate, size) for _ in range(3)))
    found = read_pictures([table(pyramid(noisy))], TableMasks("wavelet-haar-3")).wavelets[0]
    assert found["level"] == 1
    ratio = np.array(found["variance_over_poisson"])
    # a median of absolute values has 37 % efficiency
    assert abs(ratio.mean() - 1) < 4 * np.sqrt(2 / 1024 / 0.37)
    steady = read_pictures([table(pyramid(tree))], TableMasks("wavelet-haar-3"))
    assert steady.pictures[0] == pytest.approx(np.full((64, 64), light))


def test_agreement_with_a_picture_of_another_camera(table):
    settings = TableMasks("raster", size=(8, 4))
    found = read_pictures([table(SCENE.reshape(-1, 1))], settings)
    same = compare_picture(found, table(3 * SCENE + 7, "other.npy")).agreement
    assert np.allclose(same.reference, SCENE)
    assert same.tables[0]["correlation"] == pytest.approx(1)
    assert same.tables[0]["residual"] == pytest.approx(0, abs=1e-9)
    noise = np.random.default_rng(6).standard_normal(SCENE.shape) * SCENE.std()
    rest = compare_picture(found, table(SCENE + noise, "n.npy")).agreement.tables[0]
    r = np.corrcoef(SCENE.ravel(), (SCENE + noise).ravel())[0, 1]
    assert rest["correlation"] == pytest.approx(r)
    assert rest["residual"] == pytest.approx(np.sqrt(1 / r**2 - 1))
    with pytest.raises(InputError, match="same shape"):
        compare_picture(found, table(np.ones((4, 4)), "s.npy"))
