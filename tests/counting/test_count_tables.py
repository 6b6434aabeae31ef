"""Tables of any counter: readouts by the scanner's law, and one line for what does not fit."""

import numpy as np
import pytest

from deepfsi.base.errors import InputError
from deepfsi.base.tables import NumberTable
from deepfsi.camera.detectors import DetectorMap
from deepfsi.counting import tables
from deepfsi.counting.tables import TableSettings, count_table
from deepfsi.lab.virtual_optics import VirtualCamera, arrival_rates
from deepfsi.patterns.folder import Patterns
from deepfsi.physics.detection import Detection
from lab.virtual_samples import SUMMED_REFLECTANCE, every_optics, expected, patterns, scenes

CELLS = (0, 0, 1, 2, 0, 0, 1, 2, 0, 0, 0, 2)
SCENES = scenes()
FLUX, DARK = 1e10, 1e9


def exported(folder, light="free-dwell", rails="single", cells=None):
    """Patterns with pictures of whole microseconds, the shortest of 10: longer than their share."""
    return patterns(folder, light, rails, 2e-5, cells)


@every_optics
@pytest.mark.parametrize("cells", [None, CELLS], ids=["one", "three"])
def test_counts_between_markers_give_the_scanners_readouts(tmp_path, light, rails, cells):
    """So much light that noise is left out, whatever a picture lasts beyond its share."""
    shown = exported(tmp_path / "p", light, rails, cells)
    seen = cells and Detection.by(DetectorMap(count=3, cells=cells))
    one_photon = SUMMED_REFLECTANCE * len(SCENES) / SCENES.sum()
    manifest, wanted = shown.manifest, expected(shown, SCENES, one_photon, seen)
    if cells:
        wanted = wanted.reshape(*wanted.shape[:-1], -1, 3)
    rates = arrival_rates(Patterns.read(tmp_path / "p"), SCENES, VirtualCamera(dark=DARK), FLUX)
    values = np.rint(rates * manifest.picture_s[:, None]).reshape(len(SCENES), -1)
    assert values.shape[1] == len(tables.column_names(manifest))

    def check(values, **settings):
        """Readouts over the budget."""
        counts, scenes = count_table(NumberTable(values), manifest, TableSettings(**settings))
        photons = counts.photons.reshape(-1, *[1] * (wanted.ndim - 1))
        assert [scene.name for scene in scenes] == ["1", "2", "3"]
        assert counts.faults == ()
        np.testing.assert_allclose(counts.signal()[:, 0] / photons, wanted, rtol=1e-5, atol=1e-6)
        return counts

    counts = check(values)
    late = np.rint(rates * (manifest.picture_s - 3e-6)[:, None]).reshape(len(SCENES), -1)
    assert check(late, settle_s=3e-6).settle_s == 3e-6
    assert counts.dark_rate == pytest.approx(DARK, rel=1e-3)
    bare = values[:, 2 * manifest.inputs : -2 * manifest.inputs]
    check(bare, photons=float(counts.photons[0]), background=DARK * counts.exposure_s)


@pytest.fixture(scope="module")
def counted(tmp_path_factory):
    """Manifest of one detector, and values (3, F) of its frames."""
    folder = tmp_path_factory.mktemp("p") / "p"
    manifest = exported(folder).manifest
    rates = arrival_rates(Patterns.read(folder), SCENES, VirtualCamera(), 1e9)[..., 0]
    return manifest, np.rint(rates * manifest.picture_s)


def refuse(manifest, said: str, table: NumberTable, **settings) -> None:
    with pytest.raises(InputError, match=said) as error:
        count_table(table, manifest, TableSettings(**settings))
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("shape", "settings", "said"),
    [
        ((3, 8), {}, r"3 rows and 8 columns: .* row of 5 values \(5 frames of masks\), or 9"),
        ((3, 5), {}, "give `photons`"),
        ((3, 9), {"settle_s": 1.0}, "nothing of the shortest frame"),
        ((3, 9), {"background": -1.0}, "background = -1"),
    ],
)
def test_what_does_not_fit_is_one_line(counted, shape, settings, said):
    refuse(counted[0], said, NumberTable(np.ones(shape)), **settings)


def test_names_and_values_that_do_not_fit_are_one_line(counted):
    manifest, values = counted
    names = tables.column_names(manifest)
    for said, *table in (
        ("'off' where 'on' stands", values, ("off", "on", *names[2:])),
        ("is no count: give whole numbers, 0 or more", values + 0.5),
        ("scene twice", values, (), {"scene": ("a", "b", "a")}),
        ("equally bright", 0 * values),
    ):
        refuse(manifest, said, NumberTable(*table))


def test_law_units_of_an_analogue_detector_are_counts_with_read_noise(tmp_path):
    """Mean and variance of what `--gain` and `--read-noise` say, in gates of other lengths."""
    manifest, draws, gain, noise = exported(tmp_path / "p").manifest, 4000, 2.5e4, 30.0
    rates = arrival_rates(Patterns.read(tmp_path / "p"), SCENES[:1], VirtualCamera(dark=1e7), 1e8)[
        0, :, 0
    ]
    rng = np.random.default_rng(6)
    photons = rng.poisson(rates * manifest.picture_s, (draws, len(rates)))
    values = (photons + noise * rng.standard_normal(photons.shape)) / gain
    settings = TableSettings(gain=gain, read_noise=noise)
    counts, _ = count_table(NumberTable(values), manifest, settings)
    assert counts.faults == ()
    found, variance = counts.arrivals[:, 0, 0], counts.variance[:, 0, 0]
    wanted = rates[manifest.mask_frames] * counts.lengths_s[0]
    error = np.sqrt(variance.mean(axis=0) / draws)
    assert (abs(found.mean(axis=0) - wanted) < 5 * error).all()
    assert found.var(axis=0) == pytest.approx(variance.mean(axis=0), rel=5 * np.sqrt(2 / draws))
    ends_s = 2 * manifest.picture_s[0] * draws
    error = np.sqrt((rates[0] + rates[1] + 2 * noise**2 / manifest.picture_s[0]) / ends_s)
    assert counts.flux[0] == pytest.approx(rates[0] - rates[1], abs=5 * error)
    assert counts.dark_rate.mean() == pytest.approx(rates[1], abs=5 * error)
    assert (counts.excess[:, 0, 0] > 0.5 * noise**2).any()


# Clicks


def clicks_of(manifest, mean: float, scenes: int = 60, gates: int = 8) -> NumberTable:
    """Clicks of exposures to so many photons a gate with all ON, half of them behind masks."""
    light = {"on": mean, "off": 0.0, "mask": mean / 2}
    relative = manifest.picture_s / manifest.picture_s[0]
    chance = -np.expm1(-relative * [light[frame.role] for frame in manifest.frames])
    drawn = np.random.default_rng(2).binomial(gates, chance, (scenes, len(chance)))
    return NumberTable(drawn.astype(float), tuple(tables.column_names(manifest)))


def test_clicks_of_a_table_are_read_as_they_are_and_tell_the_budget(counted):
    """The budget by what all-ON gates miss, to five standard errors of 2 x 8 x 60 gates."""
    manifest, mean = counted[0], 0.8
    table = clicks_of(manifest, mean)
    counts, scenes = count_table(table, manifest, TableSettings(clicks=8))
    assert (len(scenes), counts.gates) == (60, 8)
    rail, mask, column, _ = manifest.readout_table
    drawn = table.values[:, manifest.mask_frames]
    assert np.array_equal(counts.signal()[:, 0, rail, mask], drawn[:, column])
    error, rate = np.sqrt(np.expm1(mean) / (2 * 8 * 60)) / mean, 8 * mean / manifest.picture_s[0]
    assert counts.flux == pytest.approx(np.full(60, rate), rel=5 * error)
    assert (counts.background == 0).all()
