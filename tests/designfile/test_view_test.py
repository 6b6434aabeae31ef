"""Test of the view of a run: its law, false alarms and power."""

import re
from itertools import islice, product
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.special import logsumexp
from scipy.stats import multivariate_normal

from deepfsi.designfile import view_test
from deepfsi.designfile.view_test import SceneModel, SceneReadouts, ViewTest

SHAPE, PHOTONS, MASKS = (8, 8), 1e4, 16


@pytest.fixture(scope="module")
def model(digits):
    return SceneModel.fit(digits.x_train, digits.y_train)


@pytest.fixture(scope="module")
def masks(digits):
    """Blocks of 2 x 2 pixels, each for an equal part of the time, counts of a white pixel."""
    blocks = np.kron(np.eye(MASKS).reshape(MASKS, 4, 4), np.ones((2, 2))).reshape(MASKS, 64)
    return blocks * PHOTONS / digits.x_train.sum(axis=1).mean() / 4


def exposed(model, masks, scenes, rng):
    test, none = ViewTest(model, SHAPE), np.zeros(MASKS)
    for x in scenes:
        read = rng.poisson(masks @ x.clip(min=0)).astype(float)[None]
        test.add(SceneReadouts(masks, read, none, none.astype(int)))
    return test.result


def laws_of(model, view, rows):
    """Normal laws of the counts of a scene of each class, as a view shows it, written out."""
    means, axes, rest, shares = (
        np.asarray(each, float) for each in (model.means, model.axes, model.rest, model.shares)
    )
    usual = shares @ means / shares.sum()
    images = view.transform(np.concatenate([means, axes]).reshape(-1, *SHAPE)).reshape(-1, 64)
    images = images * usual.sum() / (shares / shares.sum() @ images[:10]).sum()
    images[:10] += view.stray * usual.mean()
    images /= 1 + view.stray
    expected = rows.masks @ usual
    lit = expected > 0
    free = 0.3 * shares @ images[:10] / shares.sum()
    gains = 0.03 * expected * (rows.inputs == np.unique(rows.inputs)[:, None])
    parts = np.concatenate([np.stack([*images[10:], free]) @ rows.masks.T, gains])[:, lit]
    noise = np.diag((expected + rows.noise + rows.masks**2 @ rest)[lit])
    return images[:10] @ rows.masks[lit].T, parts.T @ parts, noise, lit


SOUND = SimpleNamespace(transform=lambda x: x, stray=0.0)


def test_the_evidence_is_that_of_normal_laws(model, masks, digits):
    """Of scenes one after the other, whose classes' shares are learned; or of one scene alone."""
    rng = np.random.default_rng(2)
    sound = [SOUND, *view_test.view_faults(SHAPE, harmless=True)]
    seen = view_test.orientation_faults, view_test.view_faults, view_test.dark_faults
    faults = [view for kind in seen for view in kind(SHAPE)]
    masks = np.concatenate([masks, 0 * masks[:1]])  # the last frame is dark
    inputs, noise = np.arange(MASKS + 1) % 3, rng.uniform(0, 30, MASKS + 1)
    for scenes in (digits.x_test[[3, 3, 3]], digits.x_test[:5]):
        test, logs = ViewTest(model, SHAPE), np.zeros(len(sound) + len(faults))
        counts = rng.poisson(masks @ scenes.T.astype(float)).T
        rows = [SceneReadouts(masks, each[None].astype(float), noise, inputs) for each in counts]
        for row in rows:
            test.add(row)
        for k, view in enumerate((*sound, *faults)):
            shares = np.asarray(model.shares, float)
            known = 10 * shares / shares.sum()
            for row in rows:
                means, parts, photons, lit = laws_of(model, view, row)
                law = [multivariate_normal(mean, parts + photons) for mean in means]
                joint = np.array([each.logpdf(row.counts[0, lit]) for each in law])
                joint = joint + np.log(known / known.sum())
                logs[k] += logsumexp(joint)
                known = known + np.exp(joint - logsumexp(joint))
        best = logs[: len(sound)].max()
        np.testing.assert_allclose(
            test.result.odds, logs[len(sound) :] - best, rtol=1e-5, atol=1e-5
        )
        means, parts, photons, lit = laws_of(model, SOUND, rows[0])
        every = np.kron(np.ones((len(rows),) * 2), parts) + np.kron(np.eye(len(rows)), photons)
        law = [multivariate_normal(np.tile(mean, len(rows)), every) for mean in means]
        alike = [each.logpdf(np.concatenate([row.counts[0, lit] for row in rows])) for each in law]
        alike = logsumexp(alike + np.log(shares / shares.sum())) - best
        assert test.result.alike == pytest.approx(max(alike, 0), rel=1e-5)
        assert (test.result.scenes, len(scenes) == 3) == (len(scenes), alike > 0)


@pytest.mark.parametrize(
    ("scenes", "pixels", "classes"), [(150, 12, 3), (100, 300, 5), (400, 60, 2)]
)
def test_a_model_has_the_moments_of_its_scenes(scenes, pixels, classes):
    """Means of classes, 40 principal axes at most, five scenes for each, all variance of pixels."""
    rng = np.random.default_rng(1)
    labels = np.arange(scenes) % classes
    scale = np.geomspace(1, 0.01, pixels)
    x = rng.random((classes, pixels))[labels] + scale * rng.normal(size=(scenes, pixels))
    model = SceneModel.fit(x, labels)
    means = np.stack([x[labels == k].mean(axis=0) for k in range(classes)])
    away = x - means[labels]
    covariance = away.T @ away / (scenes - classes)
    count = min(40, scenes // 5, pixels)
    values, vectors = np.linalg.eigh(covariance)
    kept = (vectors * values)[:, ::-1][:, :count] @ vectors[:, ::-1][:, :count].T
    axes = model.axes.astype(float)
    np.testing.assert_allclose(model.means, means, rtol=1e-3, atol=1e-3)
    np.testing.assert_allclose(axes.T @ axes, kept, atol=4e-3)
    assert len(axes) == count
    assert (np.diff((axes**2).sum(axis=1)) < 1e-3).all()
    np.testing.assert_allclose((axes**2).sum(axis=0) + model.rest, np.diag(covariance), atol=4e-3)
    np.testing.assert_allclose(model.shares, np.bincount(labels) / scenes, rtol=1e-3)
    light = model.light(SceneReadouts.all_on(x.sum(axis=1), 1.0, 0.0, pixels), np.zeros(2))
    assert (light.share.mean(), light.share.std()) == pytest.approx((1, light.spread), rel=0.1)


def test_a_model_of_other_masks_is_refused(model):
    arrays = dict(vars(model))
    again = SceneModel.restored(arrays, 64, 10)
    assert all(np.array_equal(getattr(again, name), array) for name, array in arrays.items())
    for name, array in (
        ("means", arrays["means"][:9]),
        ("means", 0 * arrays["means"]),
        ("rest", arrays["rest"] - 1),
        ("shares", arrays["shares"] - 1),
        ("axes", arrays["axes"][:, :63]),
    ):
        with pytest.raises(ValueError, match="not of these masks"):
            SceneModel.restored(arrays | {name: array}, 64, 10)


@pytest.mark.parametrize(
    ("sizes", "enough"), [([20, 20], True), ([19, 60], False), ([40], True), ([39], False)]
)
def test_forty_scenes_and_twenty_of_each_class_are_enough(sizes, enough):
    assert SceneModel.are_enough(np.array(sizes)) is enough


def test_a_run_is_named_and_refused_from_evidence_of_200_on():
    """In the mean over faults; by one scene shown again and again it is named alone."""
    for ratios, alike, named, refused in (
        ([1, 398], 1, False, False),
        ([1, 400], 1, True, True),
        ([300, 103], 1, True, True),
        ([1, 800], 2.01, True, False),
        ([1, 800], 2.0, True, True),
    ):
        made = view_test.ViewResult(4, ("mirrored", "blurred"), np.log(ratios), np.log(alike))
        assert (made.named, made.refused) == (named, refused)
        assert (made.remark == made.refusal) is named
        assert ("one and the same" in made.refusal) is not refused
        assert made.evidence == pytest.approx(np.log(np.mean(ratios)))
    assert view_test.ViewResult(4, ("a",), np.zeros(1), refused_before=True).named
    assert "over 4 scenes" in made.refusal
    assert "device were blurred" in made.refusal
    assert "(evidence 10^2.6; a sound run reaches 200 once" in made.refusal


def test_faults_stay_open_until_they_are_200_times_less_likely():
    odds = np.log([1 / 199, 1 / 201, 2, 1, 0.5])
    made = view_test.ViewResult(10, tuple("abcde"), odds)
    assert [*made.open] == ["a", "c", "d", "e"]
    assert made.open["e"] == pytest.approx(10 * np.log(200) / np.log(2))
    assert made.open["c"] == made.open["d"] == np.inf
    assert "device is a or c or d or 1 others: about 76 scenes would, or" in made.remark
    three = view_test.ViewResult(10, tuple("acd"), odds[[0, 2, 3]])
    assert "a or c or d: about 10 scenes would" in three.remark
    assert "c: more light or scenes would" in view_test.ViewResult(1, ("c",), odds[2:3]).remark
    assert view_test.ViewResult(1, ("b",), odds[1:2]).remark is None
    assert made.as_dict()["open"] == [*made.open]


def lit_by(view, shape=SHAPE):
    return view.transform(np.ones((1, *shape)))[0]


@pytest.mark.parametrize("harmless", [False, True])
@pytest.mark.parametrize("shape", [(9, 9), (1, 33)])
def test_faults_are_what_their_words_say(shape, harmless):
    """By how a point, or an even picture, is seen; spectra have two sides alone."""
    height, width = shape
    found = {view.words: view for view in view_test.view_faults(shape[-2:], harmless)}
    numbers = {"blur": (0.5,), "stray": (0.2,), "to": (0.8,)} if harmless else {
        "blur": (1, 2), "stray": (0.5, 1, 3), "to": (0.6, 0.3)
    }  # fmt: skip
    big = np.zeros((1, 65, 65) if height > 1 else (1, 1, 65))
    big[..., 32] = np.eye(65)[32][:, None][..., 0] if height > 1 else 1
    for cells in numbers["blur"]:
        seen = found.pop(f"blurred by about {cells:g} cells (standard deviation)").transform(big)
        line, off = seen[0].sum(axis=0), np.arange(65) - 32
        assert np.sqrt(off**2 @ line) == pytest.approx(cells, rel=0.08)
        assert seen.sum() == pytest.approx(1, abs=1e-4)
    for share in numbers["stray"]:
        view = found.pop(f"mixed with stray light of about {share:g} of the scenes'")
        assert (view.stray, lit_by(view, shape).min()) == (share, 1)
    for share in numbers["to"]:
        light = lit_by(found.pop(f"darker at its corners, to about {share:g}"), shape)
        assert light[[0, 0, -1, -1], [0, -1, 0, -1]] == pytest.approx(np.full(4, share))
        assert light[height // 2, width // 2] == 1
    sides = {"right": (0, 1), "left": (0, -1), "bottom": (1, 0), "top": (-1, 0)}
    for side, way in [*sides.items()][: 4 if height > 1 else 2]:
        light = lit_by(found.pop(f"lit unevenly, brighter at the {side}"), shape)
        axis = int(way[0] == 0)
        tilt = np.take(light, [0, -1], axis=axis).mean(axis=1 - axis)
        half = 0.15 if harmless else 0.4
        assert tilt == pytest.approx(1 + half * sum(way) * np.array([-1, 1]))
        point = np.zeros((1, *shape))
        point[0, height // 2, width // 2] = 1
        seen = found.pop(f"shifted to the {side}").transform(point)[0]
        moved = [np.arange(n) @ seen.sum(axis=1 - k) - n // 2 for k, n in enumerate(shape)]
        share = 1 / 40 if harmless else 1 / 16
        assert moved == pytest.approx([share * n * d for n, d in zip(shape, way, strict=True)])
    spot = np.zeros((1, 65, 65))
    spot[0, 32, 48] = 1
    for degrees in ((2,) if harmless else (6, 15)) if height > 1 else ():
        for way, sign in (("clockwise", 1), ("counter-clockwise", -1)):
            seen = found.pop(f"turned by about {degrees} degrees {way}").transform(spot)[0]
            down, right = (np.arange(-32, 33) @ seen.sum(axis=axis) for axis in (1, 0))
            assert np.degrees(np.arctan2(down, right)) == pytest.approx(sign * degrees, abs=0.5)
    ends = {"top": -1, "bottom": 1, "left": -1, "right": 1}
    corners = product(("top", "bottom"), ("left", "right"))
    for corner in corners if height > 1 and not harmless else ():
        words = f"smaller by about 1/8, at its {' '.join(corner)} corner"
        seen = lit_by(found.pop(words), shape)
        assert seen.sum() == pytest.approx((7 / 8 * 9) ** 2, rel=0.02)
        off = [np.arange(-4, 5) @ seen.sum(axis=axis) / seen.sum() for axis in (1, 0)]
        assert off == pytest.approx([9 / 16 * ends[end] for end in corner], abs=0.05)
    assert not found


@pytest.mark.parametrize(
    ("shape", "places"), [((8, 8), 80), ((3, 5), 23), ((1, 40), 8), ((32, 32), 80), ((33, 32), 0)]
)
def test_dark_places_are_where_their_words_say(shape, places):
    seen = {view.words: lit_by(view, shape) for view in view_test.dark_faults(shape)}
    for words, light in seen.items():
        top, bottom, left, right = map(int, re.findall(r"\d+", words))
        dark = np.ones(shape)
        dark[top - 1 : bottom, left - 1 : right] = 0
        assert np.array_equal(light, dark)
    assert len(seen) == len([*view_test.dark_faults(shape)]) == places


def test_orientations_are_what_their_words_say():
    """Where the corner of a picture is seen, and the pixel right of it."""
    places = {
        "mirrored left to right": (2, 1),
        "mirrored top to bottom": (6, 7),
        "turned by 180 degrees": (8, 7),
        "turned by 90 degrees": (2, 5),
        "turned by 270 degrees": (6, 3),
        "mirrored at its falling diagonal": (0, 3),
        "mirrored at its rising diagonal": (8, 5),
    }
    points = np.eye(9)[:2].reshape(2, 3, 3)
    for view in view_test.orientation_faults((3, 3)):
        seen = view.transform(points).reshape(2, 9).argmax(axis=1)
        assert tuple(seen) == places.pop(view.words)
    assert not places
    assert len([*view_test.orientation_faults((3, 4))]) == 3
    assert len([*view_test.orientation_faults((5,))]) == 1


def test_sound_runs_are_let_pass_whatever_their_classes(digits, model, masks):
    """None of 20: with at most `FALSE_ALARM` each, two or more alarms have a chance of 0.005."""
    rng, alarms = np.random.default_rng(3), 0
    for label in [None] * 10 + list(range(10)):
        own = digits.x_test[digits.y_test == label] if label is not None else digits.x_test
        chosen = own[rng.permutation(len(own))[: 40 if label is None else 20]]
        alarms += exposed(model, masks, chosen.astype(float), rng).named
    assert alarms <= 1


@pytest.mark.parametrize(
    "view",
    [
        *view_test.orientation_faults(SHAPE),
        *view_test.view_faults(SHAPE),
        *islice(view_test.dark_faults(SHAPE), 3, 38, 11),
    ],
    ids=lambda view: view.words,
)
def test_each_fault_is_refused_and_named_in_40_scenes(digits, model, masks, view):
    rng = np.random.default_rng(4)
    scenes = digits.x_test[rng.integers(0, len(digits.x_test), 40)].astype(float)
    seen = view.transform(scenes.reshape(-1, *SHAPE)).reshape(scenes.shape)
    result = exposed(model, masks, seen + view.stray * scenes.mean(), rng)
    assert result.named
    assert result.likeliest == view.words
    assert view.words in result.remark
