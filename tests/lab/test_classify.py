"""Classes of runs and tables in Python: those of the command line, and what is refused."""

import re
from functools import partial
from pathlib import Path

import numpy as np
import pytest

import deepfsi
from conftest import quick
from deepfsi.counting.recording import Recording
from deepfsi.counting.tables import TableSettings, column_names
from deepfsi.datasets.display import read_display, write_pictures
from deepfsi.lab.virtual_optics import CAMERAS, VirtualCamera, arrival_rates
from deepfsi.patterns.folder import Patterns
from shared.virtual_runs import record

PAGE = Path(__file__).parents[2] / "docs/do/camera.md"
DESIGN, RUN = "small-dmd.safetensors", "run_0001"


@pytest.fixture(scope="module")
def lab(tmp_path_factory, digits):
    """A folder in which the lines of the page on the camera were run, and what they printed."""
    folder = tmp_path_factory.mktemp("lab")
    light = {"light": "free-dwell", "rails": "single", "photons": 1e5}
    quick(digits, masks=20, epochs=15, hidden=(40, 128), **light).save(folder / DESIGN)
    pictures = {
        f"{digits.classes[digits.y_test[k]]}/{k}.png": digits.x_test[k].reshape(8, 8)
        for k in range(4)
    }
    write_pictures(pictures, folder / "images")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        (block,) = re.findall(r"```python\n(.*?)```", PAGE.read_text(), flags=re.DOTALL)
        exec(block, {})
    return folder


def test_classes_are_those_of_the_design_as_it_was_shown(lab):
    patterns = Recording.read(lab / RUN).patterns
    shown = deepfsi.Design.load(lab / DESIGN).as_shown(*patterns.realised)
    counts = Recording.read(lab / RUN).read_counts()
    wanted = shown.classify(shown.readouts(counts.signal()), counts.photons[:, None])
    found = deepfsi.classify_run(lab / DESIGN, lab / RUN).scenes
    assert [scene.probability for scene in found] == wanted.mean(axis=1).max(axis=-1).tolist()


def test_counts_that_are_not_of_the_training_are_refused_unless_forced(lab):
    with pytest.raises(deepfsi.InputError, match=r"and `photons`; `force` classifies them all"):
        deepfsi.classify_run(lab / DESIGN, lab / RUN, photons=1e6)
    found = deepfsi.classify_run(lab / DESIGN, lab / RUN, photons=1e6, force=True)
    assert all(scene.unlike for scene in found.scenes)
    assert any("do not look like" in str(line) for line in found.summary())
    with pytest.raises(deepfsi.InputError, match=r"photon budget 0 is not allowed"):
        deepfsi.classify_run(lab / DESIGN, lab / RUN, photons=0)


@pytest.mark.parametrize("dark", [0.0, 3e3])
def test_scenes_with_too_little_light_get_no_class_and_others_do(lab, tmp_path, dark):
    """Two exposures at the training's light, two at 2 % of it or less than the dark, one dark."""
    manifest = Patterns.read(lab / "frames").manifest
    x = read_display(lab / "images").x[:2]
    rates = arrival_rates(Patterns.read(lab / "frames"), x, CAMERAS["ideal"], 1e7)[..., 0]
    gate_s = np.full(len(manifest.frames), 10e-3 / len(manifest.mask_frames))
    gate_s[manifest.mask_frames] = manifest.shares * 10e-3
    bright = np.random.default_rng(0).poisson((rates + dark / 10e-3) * gate_s)
    dim = np.random.default_rng(1).poisson(0.02 * rates * gate_s)
    table = tmp_path / "table.npy"
    np.save(table, np.concatenate([bright, dim, 0 * dim[:1]]))
    settings = TableSettings(background=dark or None)
    found = deepfsi.classify_table(lab / "frames", table, settings)
    assert [scene.predicted is None for scene in found.scenes] == [False, False, True, True, True]
    for scene in found.scenes[2:]:
        assert "budget" in {fault.kind for fault in scene.faults}
    forced = deepfsi.classify_table(lab / "frames", table, settings, force=True)
    assert [scene.predicted is None for scene in forced.scenes][2:] == [dark > 0, dark > 0, True]


@pytest.mark.parametrize("light", [1.0, 2e-4])
def test_a_row_of_photon_counts_that_is_there_twice_has_no_class(lab, tmp_path, light):
    """Where chance repeats a row, as in hardly any light, it is no fault; nor are voltages."""
    manifest = Patterns.read(lab / "frames").manifest
    x = read_display(lab / "images").x[[0, 1, 1, 2, 0]]
    rates = arrival_rates(Patterns.read(lab / "frames"), x, CAMERAS["ideal"], 1e7)[..., 0]
    gate_s = np.full(len(manifest.frames), 10e-3 / len(manifest.mask_frames))
    gate_s[manifest.mask_frames] = manifest.shares * 10e-3
    rows = np.random.default_rng(0).poisson(light * rates * gate_s)
    rows[4] = rows[0]
    rows = rows[:, manifest.mask_frames]
    np.save(tmp_path / "table.npy", rows)
    classify = partial(deepfsi.classify_table, lab / "frames", tmp_path / "table.npy")
    found = classify(TableSettings(photons=light * 1e5), force=True)
    repeated = [any(fault.kind == "repeated" for fault in scene.faults) for scene in found.scenes]
    assert repeated == ([True, False, False, False, True] if light == 1 else 5 * [False])
    np.save(tmp_path / "table.npy", 0.37 * rows)
    found = classify(TableSettings(photons=light * 1e5, gain=1 / 0.37), force=True)
    assert not any(fault.kind == "repeated" for fault in found.faults)


@pytest.mark.parametrize("with_ends", [True, False])
def test_a_table_whose_dark_scene_is_at_another_place_is_refused(lab, tmp_path, with_ends):
    """As of a display that lags by a scene; its black has a thousandth of the light."""
    manifest = Patterns.read(lab / "frames").manifest
    x = read_display(lab / "images").x[:3]
    shown = np.concatenate([1e-3 * x[:1], x])
    rates = arrival_rates(Patterns.read(lab / "frames"), shown, CAMERAS["ideal"], 1e7)[..., 0]
    rows = np.random.default_rng(0).poisson(rates * manifest.picture_s)
    which = slice(None) if with_ends else manifest.mask_frames
    heads = np.array(column_names(manifest))[which]

    def classified(rows):
        labels = ["dark", "0", "1", "2"]
        lines = [
            ",".join([str(k), label, *map(str, row[which])])
            for k, (label, row) in enumerate(zip(labels, rows, strict=True))
        ]
        table = tmp_path / "table.csv"
        table.write_text("\n".join([",".join(["scene", "label", *heads]), *lines]))
        return deepfsi.classify_table(lab / "frames", table, TableSettings(photons=1e5), force=True)

    found = classified(rows)
    assert [scene.predicted is None for scene in found.scenes] == [True, False, False, False]
    assert not any("lags" in remark for remark in found.remarks)
    with pytest.raises(deepfsi.InputError, match=r"late: .* dark scenes are \[1\].*display lags"):
        classified(rows[[1, 0, 2, 3]])


@pytest.fixture(scope="module")
def forty(lab, digits):
    """Forty test scenes, and classes of them as a virtual camera of some optics counts them."""
    chosen = np.random.default_rng(9).permutation(len(digits.x_test))[:40]
    x, names = digits.x_test[chosen].reshape(-1, 8, 8), [str(k) for k in chosen]

    def classified(folder, optics=None, scenes=40, flux=1e7):
        camera = VirtualCamera.model_validate(optics or {})
        told = {"names": names[:scenes], "seed": 0}
        record(folder, lab / "frames", x[:scenes], camera, flux, 10e-3, **told)
        Recording.read(folder).count()
        return deepfsi.classify_run(lab / DESIGN, folder)

    return classified


@pytest.mark.parametrize(
    ("optics", "scenes", "flux", "words"),
    [
        ({"view": ((-1, 0, 1), (0, 1, 0), (0, 0, 1))}, 40, 1e7, "mirrored left to right"),
        ({"view": ((-1, 0, 1), (0, -1, 1), (0, 0, 1))}, 40, 1e7, "turned by 180 degrees"),
        *(({}, 4, share * 1e7, "too little light for this design") for share in (0.02, 1e-3)),
    ],
)
def test_a_run_that_is_not_as_the_training_is_refused_unless_forced(
    forty, tmp_path, optics, scenes, flux, words
):
    """At 2 % of the light 15 of 40 digits were right."""
    with pytest.raises(deepfsi.InputError, match=f"{words}.*`force`"):
        forty(tmp_path / "run", optics, scenes, flux)
    forced = deepfsi.classify_run(tmp_path / "run/patterns", tmp_path / "run", force=True)
    assert all(scene.predicted for scene in forced.scenes)
    assert flux < 1e7 or any(words in remark for remark in forced.remarks)
    marks = ["view" in {fault.kind for fault in scene.faults} for scene in forced.scenes]
    assert flux < 1e7 or all(marks)


def test_a_sound_run_is_classified_and_a_short_one_says_what_it_does_not_exclude(forty, tmp_path):
    whole, short = forty(tmp_path / "whole"), forty(tmp_path / "short", scenes=2)
    assert not whole.view.named
    assert not any("exclude" in remark for remark in whole.remarks)
    assert any("2 scenes do not exclude" in remark for remark in short.remarks)
    assert any("lags by a whole scene cannot be seen" in remark for remark in whole.remarks)
    assert whole.as_dict()["view"]["scenes"] == 40
