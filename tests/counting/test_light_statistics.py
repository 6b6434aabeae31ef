"""Rates of false alarms of the checks of the light, and what is told from where on.

Counts are `EXCESS` times Poisson's, so that their p-values are exact. Light changes by just what is
harmless, and the level is of many alarms: so many passes are called faulty in the mean.
"""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from recording_samples import schedule
from scipy.stats import binom

from deepfsi.camera.detectors import DetectorMap
from deepfsi.counting import checks, flux
from deepfsi.counting.checks import LightMonitor, PassLight, check_light
from deepfsi.counting.flux import EXCESS, HARMLESS, HARMLESS_DARK, Arrivals, Background, Flux
from deepfsi.patterns.manifest import Brightness

MASKS, PASSES, LEVEL = 20, 5000, 500.0
FRAMES = MASKS + 4


def drawn(rng, mean):
    return EXCESS * rng.poisson(np.asarray(mean) / EXCESS)


def curve_of(photons, seconds=1.0, name="", sees_part=False) -> flux.LightCurve:
    photons = np.asarray(photons, float)
    frames, ends = photons.shape[1], (len(photons[0]) - 2, len(photons[0]) - 1)
    names = tuple(f"frame {k}" for k in range(frames))
    places = np.arange(len(photons)), (0, ends[0]), (1, ends[1]), names, name, sees_part
    return flux.LightCurve(photons, np.broadcast_to(seconds, photons.shape), *places)


def known(passes, rate, seconds=1e6) -> Background:
    """Background that is known well."""
    every = np.ones(passes)
    return Background(rate * seconds * every, seconds * every)


def test_p_values_are_binomial():
    """Of a window with so many photons or more, of as many in both, whose widths `EXCESS` sets."""
    one, other = np.array([[0], [1], [7], [40]]), np.array([0, 3, 30])
    p = flux.excess_p_value(EXCESS * one, 2.0, EXCESS * other, 3.0, ratio=1.3)
    np.testing.assert_allclose(p, binom.sf(one - 1, one + other, 2.6 / 5.6))
    for seconds, base_s in ((0.0, 3.0), (2.0, 0.0)):
        assert flux.excess_p_value(5, seconds, 5, base_s) == 1
    assert flux.excess_p_value(0, 1.0, -1.0, 1.0) == 1


@pytest.mark.parametrize("mean", [60.0, 3e3])
@pytest.mark.parametrize("level", [0.02, 0.3])
def test_p_values_of_a_change_are_as_likely_as_they_say(mean, level):
    rng, draws = np.random.default_rng(0), 20_000
    one, other = drawn(rng, np.outer([mean, 3 * mean], np.ones(draws)))
    found = np.mean(flux.change_p_value(one, 1.0, other, 3.0, 1.0) <= level)
    error = 5 * (level / draws) ** 0.5
    assert level * (0.7 if mean < 100 else 0.95) - error < found < level + error


def bright(rng, mean):
    """Masks as bright as may be, by all-ON frames that are known well."""
    rates, seconds = np.full(FRAMES, (1 + HARMLESS) * mean), np.ones(FRAMES)
    rates[[0, -2]], rates[[1, -1]], seconds[[0, -2]] = mean, 0, 1e6
    return rates * seconds, seconds, 0.0, MASKS / FRAMES


def steady(rng, mean):
    rates = np.append([(1 + HARMLESS) * mean, 0], np.zeros(MASKS))
    return np.append(rates, [mean, 0]), np.ones(FRAMES), 0.0, 1 / 2


def dark(rng, mean):
    """Background that rises by as much as may be of the light beyond it."""
    light = 20 * mean
    rates = np.append([light + mean, mean], np.zeros(MASKS))
    rates = np.append(rates, [light + mean, mean + HARMLESS_DARK * light])
    return rates, np.full(FRAMES, 1e4), mean / 1e4, 1 / 2


BORDERS = {"brighter": bright, "unsteady": steady, "unsteady in the dark": dark}


@pytest.mark.parametrize("mean", [100.0, 3e4])
@pytest.mark.parametrize("kind", BORDERS)
def test_so_many_passes_are_called_faulty_as_the_level_says(kind, mean):
    rng = np.random.default_rng(1)
    counts, seconds, background, share = BORDERS[kind](rng, mean)
    curve = curve_of(drawn(rng, np.tile(counts, (PASSES, 1))), seconds)
    every = np.ones(PASSES, bool)
    light = PassLight(curve, known(PASSES, background, 1e10), every, every.copy())
    found = sum(fault.kind == kind.split()[0] for fault in light.find_faults(LEVEL))
    wanted = PASSES * -np.expm1(-share * LEVEL / PASSES)
    assert wanted * (0.5 if mean < 1e3 else 0.93) - 5 * wanted**0.5 < found
    assert found < wanted + 5 * wanted**0.5
    assert np.count_nonzero(~light.sound) == found


@pytest.mark.parametrize(("dark", "seconds"), [(60.0, 1.0), (3e4, 0.1)])
def test_so_many_dark_passes_are_taken_for_lit_as_the_level_says(dark, seconds):
    """By their all-ON frames, or by all that are not all OFF."""
    photons = drawn(np.random.default_rng(2), np.full((PASSES, FRAMES), dark))
    curve = curve_of(photons, seconds)
    wanted = PASSES * -np.expm1(-LEVEL / PASSES)
    found = PassLight.of(curve, known(PASSES, dark / seconds), LEVEL).lit.sum()
    assert wanted * (0.6 if dark < 100 else 0.9) - 5 * wanted**0.5 < found
    assert found < wanted + 5 * wanted**0.5
    dim = known(PASSES, (1 - 8 / (2 * dark) ** 0.5) * dark / seconds)
    assert PassLight.of(curve, dim, 1e-3).lit.mean() > 0.9, "light of eight standard errors"


UNLIKE = Brightness(low=0.8, high=1.25, between=1.1, within=0.02)
ALIKE = Brightness(low=0.999, high=1.0, between=1.0, within=0.0)


def flux_of(on, brightness, background=None, used=None, level=1e-3, seconds=1.0):
    """Flux of passes whose all-ON frames count `on` (P,) together."""
    on = np.asarray(on, float)
    photons = on[:, None] * [0.3, 0, 0.7, 0]
    seconds = seconds * np.array([0.3, 1, 0.7, 1])
    used = np.ones(len(on), bool) if used is None else used
    given = {"used": used, "brightness": brightness, "level": level}
    background = known(len(on), 0.0) if background is None else background
    return Flux.of(curve_of(photons, seconds), background, **given)


@pytest.mark.parametrize(("light", "dark", "dark_s"), [(3e4, 0.0, 1.0), (1e5, 2e5, 0.05)])
def test_levels_of_light_have_the_error_of_their_photons_and_of_the_background(light, dark, dark_s):
    """Of two scenes the brighter one is so by as much as is harmless; half of the level is its."""
    rng, level, runs = np.random.default_rng(3), 0.4, 1000
    found, seconds = 0, 0.25
    for _ in range(runs):
        rates = light * np.array([1 + HARMLESS, 1]) + dark
        on = drawn(rng, seconds * rates)
        background = Background(drawn(rng, [dark * dark_s] * 2), np.full(2, dark_s))
        made = flux_of(on, ALIKE, background, level=level, seconds=seconds)
        found += len(made.levels) > 1
    assert abs(found / runs - level / 2) < 5 * (level / 2 / runs) ** 0.5


@pytest.mark.parametrize("passes", [(1, 1), (2, 6), (40, 8)])
@pytest.mark.parametrize("brightness", [UNLIKE, ALIKE])
def test_a_change_is_told_beyond_what_scenes_differ_by(passes, brightness):
    """Five standard deviations of the mean of each, 1.25 times the range at most, and 5 %."""
    low, high, between, within = (getattr(brightness, key) for key in Brightness.model_fields)
    apart = np.log(between) + 5 * within * sum(1 / n for n in passes) ** 0.5
    allowed = np.exp(min(apart, 1.25 * np.log(high / low))) * 1.05
    for change, levels in ((0.999 * allowed, 1), (1.001 * allowed, 2)):
        made = flux_of(1e12 * np.repeat([1, change], passes), brightness)
        assert len(made.levels) == levels
        assert made.trend is None
        wanted = np.repeat([1, change], passes)
        wanted = wanted if levels > 1 else wanted.mean() + 0 * wanted
        np.testing.assert_allclose(made.rate, 1e12 * wanted)


@pytest.mark.parametrize("slope", [-0.04, 0.04])
@pytest.mark.parametrize("passes", [2, 3, 11])
def test_every_stretch_of_another_light_is_found(passes, slope):
    """The lamp is half as bright from one scene to another; or the dark is twice as bright."""
    for start in range(passes):
        for stop in range(start + 1, min(passes, start + passes - 1) + 1):
            on = np.full(passes, 1e6)
            on[start:stop] = 5e5 + 5e5 * slope * np.linspace(-0.5, 0.5, stop - start)
            edges = np.unique([0, start, stop, passes])
            found = flux_of(on, UNLIKE).levels
            assert [(each.first, each.last + 1) for each in found] == [*pairwise(edges)]
            rates = [on[first:last].mean() for first, last in pairwise(edges)]
            assert [each.rate for each in found] == pytest.approx(rates)
            dark = curve_of(np.stack([1e7 + on, on, 1e7 + on, on], axis=1), 0.5)
            background = Background.of(dark, 1e-3)
            np.testing.assert_allclose(background.rate, 2 * np.repeat(rates, np.diff(edges)))
            night = curve_of(on.round(-5)[:, None] * [0.1, 1, 0.1, 1], 1e9)
            for seen, second in ((background, 1.0), (Background.of(night, 1e-3), 2e9)):
                lengths = np.diff(edges).repeat(np.diff(edges))
                np.testing.assert_allclose(seen.seconds, second * lengths)


def test_passes_that_are_not_used_have_the_level_before_them():
    used = np.array([0, 1, 1, 0, 1, 1, 0], bool)
    on = 1e6 * np.array([9, 1, 1, 9, 4, 4, 9])
    made = flux_of(on, UNLIKE, used=used)
    np.testing.assert_allclose(made.rate, 1e6 * np.array([1, 1, 1, 1, 4, 4, 4]))
    assert [(each.first, each.last) for each in made.levels] == [(1, 2), (4, 5)]
    assert not flux_of(on, UNLIKE, used=0 * used).rate.any()
    assert np.isnan(flux_of(on, UNLIKE, seconds=0.0).rate).all()
    rates = 1e6 * np.exp(-0.15 * np.arange(8))
    decay = flux_of(rates, UNLIKE, used=np.arange(8) % 7 > 0)
    rates[[0, 7]] = rates[[1, 6]]
    np.testing.assert_allclose(decay.rate, rates)
    assert decay.trend == pytest.approx(np.exp(-0.75))


@pytest.mark.parametrize(("photons", "within"), [(1e12, 0.05), (400.0, 0.0), (400.0, 0.05)])
@pytest.mark.parametrize("passes", [5, 12])
def test_a_lamp_that_fades_is_told_beyond_what_a_line_through_scenes_may_show(
    passes, photons, within
):
    """1.5 times the step of two classes and 5 %, and five standard errors of the line's ends."""
    wide = Brightness(low=0.1, high=10.0, between=1.2, within=within)
    when = np.arange(passes) - (passes - 1) / 2
    noise = np.random.default_rng(4).standard_normal((40_000, passes))
    error = np.std(np.ptp(when) / (when @ when) * (noise @ when))
    for factor, fades in ((0.97, False), (1.03, True)):
        sound = 0.0
        for _ in range(5):  # its own light sets its noise
            on = photons * np.exp(factor * sound * when / np.ptp(when))
            sound = 1.5 * np.log(1.2 * 1.05) + 5 * error * np.hypot(within, np.mean(1 / on) ** 0.5)
        made = flux_of(photons * np.exp(factor * sound * when / np.ptp(when)), wide)
        assert (made.trend is not None) is fades
    assert made.trend == pytest.approx(np.exp(1.03 * sound))
    assert flux_of(np.geomspace(1e6, 1e9, 4), wide).trend is None, "a line through four passes"


def test_a_light_fades_where_a_line_leaves_smaller_squares_than_a_step():
    """Over 12 passes less two of the line; or less two levels, and the edge between them."""
    wide = Brightness(low=0.0, high=100.0, between=2.0, within=0.0)
    when, fades = np.arange(12), []
    for share in np.linspace(0.5, 0.7, 41):
        logs = np.log(8) * (share * when / 11 + (1 - share) * (when > 5))
        line = np.polyval(np.polyfit(when, logs, 1), when)
        levels = np.log(np.exp(logs).reshape(2, 6).mean(axis=1)).repeat(6)
        by_line, by_step = (((logs - each) ** 2).sum() for each in (line, levels))
        fades.append(by_line / 10 < by_step / 9)
        assert (flux_of(1e9 * np.exp(logs), wide).trend is not None) is fades[-1].item()
    assert len({*fades}) == 2


@pytest.mark.parametrize(
    ("passes", "wrong", "flickers"),
    [
        (20, [3, 5], True),
        (20, [3, 4], False),
        (30, [3, 9], False),
        (30, [3, 9, 4], True),
        (5, [1], False),
    ],
)
def test_a_tenth_of_passes_further_apart_than_one_disturbance_is_a_flicker(passes, wrong, flickers):
    photons = np.tile([1e6, 0, 1e5, 1e6, 0], (passes, 1))
    photons[wrong, 0] *= 2
    found = PassLight.of(curve_of(photons), known(passes, 0.0), 1e-3).find_faults(1e-3)
    kinds = [fault.kind for fault in found if fault.scene is None]
    assert kinds == ["flicker"] * flickers


def test_faults_say_what_was_seen():
    """Of light without noise, in passes of a tenth of a second a frame."""
    photons = np.tile([1e6, 2e4, 5e5, 3e5, 2e5, 1e6, 2e4], (30, 1))
    photons[4, [0, 5]], photons[4, 2:5] = 2e4, 0
    photons[7, 2:5] = 2e6, 1e5, 3e6
    photons[11, 0], photons[17, 6] = 5e5, 9e4
    background = known(30, 2e5)
    light = PassLight.of(curve_of(photons, 0.1, name=" on input 3"), background, 1e-3)
    assert np.flatnonzero(~light.lit).tolist() == [4]
    found = light.find_faults(1e-3)
    assert [fault.words(["zero", "one"]) for fault in found] == [
        "dark scene 4: no light on input 3: 2e+05 counts/s with all light, 2e+05 with none",
        "brighter scene 7, frame 4: frame 4 on input 3 is 3 times as bright as all light (frames "
        "2, 4): stray light, or a lamp that went down for the all-ON frames, or a counter that is "
        "blind at this rate",
        "unsteady scene 11: light on input 3 changed within the pass: 500000 photons in frame 0 at "
        "its start, 1000000 at its end",
        "unsteady scene 17: light on input 3 changed within the pass: 20000 photons in frame 1 at "
        "its start, 90000 at its end",
        "flicker: the light was unsteady in 3 of 29 passes, so it may have been in others: use a "
        "steady lamp, and keep stray light out",
    ]
    assert np.flatnonzero(~light.sound).tolist() == [4, 7, 11, 17]
    none = PassLight.of(curve_of(np.zeros((1, 5)), 0.0), known(1, 0.0, 0.0), 1e-3)
    assert [fault.kind for fault in none.find_faults(1e-3)] == ["dark"]
    part = PassLight.of(curve_of(photons, 0.1, sees_part=True), background, 1e-3)
    assert part.sound.all()
    again = part.find_faults(1e-3)
    assert [(one.kind, one.scene) for one in again] == [(one.kind, one.scene) for one in found[1:]]


@pytest.mark.parametrize(
    ("many", "words"),
    [(1, ""), (5, " (frames 2, 3, 4, 5, 6)"), (6, " (frames 2, 3, 4, 5, 6 and 1 more)")],
)
def test_at_most_five_frames_are_listed(many, words):
    photons = np.array([[1e6, 0, *[3e6] * many, 1e6, 0]])
    [fault] = PassLight.of(curve_of(photons), known(1, 0.0), 1e-3).find_faults(1e-3)
    assert f"all light{words}: stray" in fault.detail


def test_curves_are_of_arms_and_of_their_detectors():
    """Of two arms the second is bright where the first is dark; noise is made Poisson's."""
    photons = 1.0 + np.arange(2 * 5 * 4).reshape(2, 5, 4)
    arrivals = Arrivals(schedule([1000]).frames, photons, 4 * photons, np.full((2, 5), 8.0))
    one, other, *each = flux.light_curves(arrivals, np.arange(2), [(2, 1), (0, 4)])
    assert (one.bright, one.dark, other.bright, other.dark) == ((0, 3), (1, 4), (1, 4), (0, 3))
    np.testing.assert_allclose(one.photons, photons[..., :2].sum(axis=-1) / 4)
    np.testing.assert_allclose(other.photons, photons[..., 2:].sum(axis=-1) / 4)
    assert (one.seconds == 2).all()
    for column, curve in enumerate(each):
        np.testing.assert_allclose(curve.photons, photons[..., column] / 4)
        assert curve.bright == (one if column < 2 else other).bright
    names = [curve.name for curve in (one, other, *each)]
    assert names == [f" on input {name}" for name in ("3 and 2", "1 and 5", 3, 2, 1, 5)]
    assert [curve.sees_part for curve in (one, other, *each)] == [False] * 2 + [True] * 4
    [alone] = flux.light_curves(replace(arrivals, variance=0 * photons), np.arange(2), [(7,)])
    assert (alone.name, alone.seconds.min()) == ("", 8.0)
    np.testing.assert_allclose(alone.photons, photons[..., 0])
    assert [flux.name_inputs(each) for each in ((0,), (1, 2, 3), (1, 2, 4))] == [
        "1", "2 to 4", "2 and 3 and 5"
    ]  # fmt: skip


def detectors_of(photons, seconds=1.0, dark=0.0):
    """Detectors that count photons (D, P) in the two all-ON frames of each pass, half in each."""
    lights = []
    for number, counts in enumerate(np.asarray(photons, float)):
        curve = curve_of(
            counts[:, None] * [0.5, 0, 0.5, 0], seconds / 2, f" on input {number}", True
        )
        lights.append(PassLight.of(curve, known(len(counts), dark), 1e-3))
    return lights


@pytest.mark.parametrize("spread", [0.0, 0.02])
@pytest.mark.parametrize(("mean", "seconds", "dark"), [(1e4, 0.1, 0.0), (300.0, 5.0, 100.0)])
def test_a_gain_is_told_beyond_what_scenes_and_photons_do(mean, seconds, dark, spread):
    """6 deviations of the share that a detector has in the mean of scenes, and 5 % of it."""
    rng, count, scenes = np.random.default_rng(5), 8, 4
    alike = DetectorMap(count=count, shares=((1 / count,) * count,) * 2, spread=(spread,) * count)
    signal = mean * count * scenes
    scene = rng.normal(0, spread, (40_000, scenes)).mean(axis=1)
    allowed = 0.0
    for _ in range(4):  # its own share sets its noise
        light = mean * (1 + count * allowed) + dark * seconds
        own = rng.poisson(light, (40_000, scenes)).sum(axis=1) / signal
        allowed = HARMLESS / count + 6 * (own + scene).std()
    for factor, faults in ((0.97, 0), (1.03, 1)):
        shares = np.append(1 / count + factor * allowed, np.full(count - 1, 0.0))
        shares[1:] = (1 - shares[0]) / (count - 1)
        seen = np.repeat(shares[:, None], scenes, axis=1) * mean * count + dark * seconds
        found = checks.find_unequal_gains(detectors_of(seen, seconds, dark), alike)
        assert len(found) == faults
    assert f"{8 * shares[0]:.2g} times the light on input 0 that" in found[0].detail
    assert not checks.find_unequal_gains(detectors_of(0 * seen, seconds), alike)
    assert not checks.find_unequal_gains(detectors_of(seen), DetectorMap(count=count))


def test_any_mixture_of_classes_is_no_gain():
    shares = ((0.7, 0.2, 0.1), (0.1, 0.5, 0.4))
    known_shares = DetectorMap(count=3, shares=shares, spread=(0.0,) * 3)
    for part, faults in ((0.0, 0), (0.3, 0), (1.0, 0), (1.15, 1), (-0.3, 1)):
        mixed = 1e9 * ((1 - part) * np.array(shares[0]) + part * np.array(shares[1]))
        found = checks.find_unequal_gains(detectors_of(mixed[:, None]), known_shares)
        assert len(found) == faults
    for rest in np.random.default_rng(0).normal(0, 3e-13, (30, 3, 40)):  # no light, by rounding
        unlit = detectors_of(1000 + rest, dark=1000.0)
        assert not checks.find_unequal_gains(unlit, known_shares)


@pytest.mark.parametrize(("lit", "dark"), [(3e4, 0.0), (3e4, 5e3), (81.0, 0.0)])
def test_a_detector_is_blind_where_it_surely_lacks_the_harmless_light(lit, dark):
    """5 % of the mean light of all detectors, less six deviations of what it counts and of one."""
    light = np.array([[lit, lit], [lit, lit], [lit, lit], [0, 0]])
    manifest_of = schedule([1000]).model_copy(update={"detectors": DetectorMap(count=4)})
    rest = np.linspace(0, lit / 10, 30_001)
    sure = 0.05 * (6 * lit + rest) / 4 - rest > 6 * np.sqrt(8 * dark + rest + 1)
    border = float(rest[~sure][0])
    for counted, kinds in ((0.98 * border, ["blind"]), (1.02 * border, [])):
        light[3] = counted / 2
        photons = np.zeros((2, 5, 4)) + dark
        photons[:, [0, 3]] += light.T[:, None] / 2
        arrivals = Arrivals(manifest_of.frames, photons, photons, np.ones((2, 5)))
        faults = check_light(arrivals, manifest_of, (0, 1, 2, 3)).faults
        assert [fault.kind for fault in faults if fault.kind == "blind"] == kinds
    arms = Arrivals(manifest_of.frames, photons[..., :2], photons[..., :2], np.ones((2, 5)))
    kinds = {fault.kind for fault in check_light(arms, schedule([1000]), (0, 1)).faults}
    assert kinds == {"dark"}, "of an arm with one detector"


def test_a_scene_is_dark_below_a_tenth_of_the_light_of_the_lit_ones():
    labelled, said = np.arange(5) == 2, "dark scenes are [1, 2], and the labelled ones [2]"
    for dim, late in ((0.09, True), (0.11, False)):
        light = 7 + np.array([1, dim, 0, 1, 1])
        assert (said in str(checks.find_late(labelled, light))) is late
        assert not checks.find_late(labelled | True, light)
        assert not checks.find_late(labelled & False, light)


def border_lit(rng, passes, manifest):
    """Arrivals of masks that are as bright as may be, by all-ON frames that are known well."""
    frames = len(manifest.frames)
    rates = np.full((passes, frames, manifest.inputs), (1 + HARMLESS) * 1e3)
    seconds = np.ones((passes, frames))
    rates[:, [1, -1]], rates[:, [0, -2]], seconds[:, [0, -2]] = 0, 1e3, 1e4
    photons = drawn(rng, rates * seconds[..., None])
    return Arrivals(manifest.frames, photons, photons, seconds)


MANIFEST = schedule([1000] * 20).model_copy(update={"detectors": DetectorMap(count=2)})


def test_arms_detectors_and_checks_share_the_false_alarms(monkeypatch):
    """So the first of four checks has a fourth of them, in recordings and in live runs."""
    alarms, runs, scenes = 3.0, 40, 3
    monkeypatch.setattr(checks, "FALSE_ALARMS", alarms)
    assert len(BORDERS) + 1 == checks.CHECKS, "and that of the level"
    rng, wanted = np.random.default_rng(6), runs * alarms / 4 * 20 / 24
    recorded = live = 0
    for _ in range(runs):
        lit = border_lit(rng, scenes, MANIFEST)
        monitor = LightMonitor(MANIFEST, (4, 2), scenes)
        recorded += len(check_light(lit, MANIFEST, (4, 2)).faults)
        for scene in range(scenes):
            frames = [Arrivals(lit.frames[part], *(
                getattr(lit, name)[scene, part] for name in Arrivals.ARRAYS
            )) for part in (slice(0, 2), slice(2, -2), slice(-2, None))]  # fmt: skip
            assert monitor.begin(frames[0]) == (True, ())
            live += len(monitor.end(frames))
    assert live == recorded, "scenes share the level as passes do"
    assert 0.2 * wanted < recorded < wanted + 5 * wanted**0.5


def test_a_live_run_follows_its_light_and_names_a_change_once():
    one_arm = schedule([1000] * 3).model_copy(update={"brightness": UNLIKE})
    monitor, lamp = LightMonitor(one_arm, (0,), 6), [1e6, 1e6, 4e6, 0, 4e6, 4e6]
    seconds = np.full(7, 0.5)
    for scene, rate in enumerate(lamp):
        dark = 2e3 if scene < 3 else 9e4
        photons = 0.5 * (dark + np.array([rate, 0, rate / 2, rate / 4, rate / 2, rate, 0]))[:, None]
        if scene == 4:
            photons[-2] /= 2
        lists = [
            Arrivals(one_arm.frames[part], photons[part], photons[part], seconds[part])
            for part in (slice(0, 2), slice(2, -2), slice(-2, None))
        ]
        lit, faults = monitor.begin(lists[0])
        assert lit is (rate > 0)
        assert [(fault.kind, fault.scene) for fault in faults] == [("level", 2)] * (scene == 2)
        assert monitor.dark == pytest.approx([dark])
        if lit and scene < 5:
            assert monitor.flux == pytest.approx(rate)
        if faults:
            assert "is 4 times as bright as before, and scenes do not differ so" in str(faults[0])
        kinds = {3: ["dark"], 4: ["unsteady"]}
        assert [fault.kind for fault in monitor.end(lists)] == kinds.get(scene, [])


def test_a_dark_scene_is_looked_at_as_rarely_as_it_may(monkeypatch):
    monkeypatch.setattr(checks, "NO_LIGHT", 0.2)
    rng, manifest, runs = np.random.default_rng(7), schedule([1000]), 400
    found = 0
    for _ in range(runs):
        photons = drawn(rng, [[3e3], [3e4]])
        first = Arrivals(manifest.frames[:2], photons, photons, np.array([0.1, 1.0]))
        found += LightMonitor(manifest, (0,), 1).begin(first)[0]
    assert abs(found - 0.2 * runs) < 5 * (0.16 * runs) ** 0.5
