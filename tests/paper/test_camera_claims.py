"""Words and numbers of the camera study: one name a design, all its trainings, why one falls."""

import base64
from dataclasses import asdict, replace

import numpy as np
import pytest

from deepfsi_paper.camera import claims
from deepfsi_paper.camera.laboratory import (
    ASSUMED,
    DEVICE,
    EFFECTS,
    EXPOSURES,
    FREE,
    LAB,
    LABELS,
    OURS,
    SWEPT,
    DigitTest,
    Measures,
    RunTime,
    Views,
)
from shared.results import a_point, some_results

RIVALS = {"pca": "FSI", "truncated-hadamard": "TH", "raster": "RS", "hadamard": "HB"}
NAMES = {**LABELS, **RIVALS}


def a_test(name, exposure, level, commonest=0.2):
    rates = np.random.default_rng(0).uniform(level - 0.05, level + 0.05, (3, 20, 10))
    return DigitTest(
        design=name,
        label=NAMES[name],
        specific=name != "hadamard",
        masks=92,
        assumed=ASSUMED,
        effect="none",
        value=0.0,
        exposure_s=exposure,
        rates=rates.tolist(),
        commonest=commonest,
    )


@pytest.fixture(scope="module")
def finding():
    """What is said of designs in the order of their names; HB falls with more light."""
    tests = {}
    for place, name in enumerate(NAMES):
        for step, exposure in enumerate(sorted(EXPOSURES)):
            tests[(name, exposure)] = a_test(name, exposure, 0.85 - 0.1 * place + 0.03 * step)
    tests[("hadamard", 1e-3)] = a_test("hadamard", 1e-3, 0.45, commonest=0.31)
    tests[("hadamard", 1e-1)] = a_test("hadamard", 1e-1, 0.2, commonest=0.93)
    tests[("raster", 1e-1)] = a_test("raster", 1e-1, 0.3)
    varied = [
        replace(tests[(name, exposure)], effect=effect, value=value)
        for name in NAMES
        for exposure in SWEPT
        for effect, values in EFFECTS.items()
        for value in values
    ]
    scenes = np.zeros((10, 4, 4)).tolist()
    measures = Measures(
        calibration={"spots": 25, "shown": 25, "residual": 0.05},
        camera=LAB.model_dump(mode="json"),
        views=Views(scenes, np.zeros((10, 32, 32)).tolist(), [str(digit) for digit in range(10)]),
        frame=base64.b64encode(bytes(DEVICE.frame_bytes)).decode(),
        tests=[*tests.values(), *varied],
        times=[RunTime(name, label, 0.1, 1000, 10**6) for name, label in NAMES.items()],
    )
    return claims.show(some_results([a_point(0.9, 0.01)], extra=asdict(measures)))


def test_means_are_over_trainings_and_intervals_over_draws():
    test = a_test(OURS, 1e-2, 0.5)
    rates = np.array(test.rates)
    assert test.accuracy.mean == pytest.approx(rates.mean())
    assert len(test.by_draw) == 20
    np.testing.assert_allclose(test.by_training, rates.mean(axis=(1, 2)))
    np.testing.assert_allclose(test.by_digit, rates.mean(axis=0))
    assert test.single.shape == (60, 10)
    np.testing.assert_array_equal(test.single[20], rates[1, 0])


def test_a_design_that_falls_with_more_light_is_explained(finding):
    assert "3 trained designs each" in finding.found
    assert "HB falls from 0.4" in finding.found
    assert "93% of its answers are one class (31% before)" in finding.found
    assert finding.found.count(" falls from ") == 1  # RS falls too, and gives no class more often


def test_every_design_has_one_name(finding):
    """DeepFSI alone names no design of the study: two of its designs are DeepFSI's."""
    shown = [finding.found]
    shown += [text for claim in finding.claims for text in (claim.text, claim.measured)]
    for picture in finding.pictures:
        shown += [picture.caption, *words_of(picture.figure)]
    for table in finding.tables:
        shown += [table.caption, *table.heads, *(str(cell) for row in table.rows for cell in row)]
    for text in shown:
        left = text.replace("\n", " ")
        for label in (LABELS[OURS], LABELS[FREE]):
            left = left.replace(label, "")
        assert "DeepFSI" not in left
        assert "DFSI" not in left


def words_of(figure):
    texts = [text.get_text() for ax in figure.axes for text in ax.texts]
    texts += [ax.get_title(loc="left") for ax in figure.axes]
    return texts + [text.get_text() for legend in figure.legends for text in legend.get_texts()]


def test_dotted_lines_and_axes_are_explained(finding):
    captions = [picture.caption for picture in finding.pictures]
    assert "Dotted line: chance" in captions[0]
    effects = next(caption for caption in captions if "one effect at a time" in caption)
    assert "Dotted lines: ambient light as bright as a mean scene" in effects
    assert "logarithmic" in effects


def test_claims_are_true_of_numbers_that_make_them_so(finding):
    assert [claim.holds for claim in finding.claims[:2]] == [True, True]


def test_the_table_has_the_trainings_apart(finding):
    table = finding.tables[0]
    place = table.heads.index("trainings, least to most")
    ours = next(row for row in table.rows if row[:2] == (1e-2, LABELS[OURS]))
    low, high = map(float, ours[place].split(" to "))
    assert low <= ours[2] <= high
    assert len({len(row) for row in table.rows} | {len(table.heads)}) == 1
