"""Folders of recordings: prepared once, and read or refused where they are damaged."""

import numpy as np
import pytest
import recording_samples
from recording_samples import named, patterns_of

from deepfsi.base.errors import InputError
from deepfsi.counting.acquisition import Acquisition, Scene
from deepfsi.counting.recording import Recording
from deepfsi.patterns.folder import Patterns

run, whole = recording_samples.run, recording_samples.whole


@pytest.mark.parametrize(
    ("changes", "match"),
    [
        ({"scenes": [{"name": "a"}] * 4}, "photons.ptu .* 3 whole passes"),
        ({"exposure_s": 1.0}, "acquisition.json: an exposure of 1 s does not fit"),
        ({"exposure_s": 1e-12}, "photons.ptu has times in steps of 1 ps, too coarse"),
        ({"repeats": 99}, "acquisition.json: 99 repeats do not fit"),
        ({"inputs": [0, 1]}, "acquisition.json has 2 inputs"),
        ({"inputs": [3]}, "no light on input 4: "),
        ({"marker_bit": 1}, "0 frame markers on marker input 0: write the bit"),
        ({"manifest_sha256": "0" * 64}, "manifest.json is not the one"),
        ({"schema_version": 2}, "at schema_version: give 1"),
    ],
)
def test_acquisitions_that_do_not_fit_are_refused(run, changes, match):
    run.edit(**changes)
    run.refused(match)


def test_a_folder_is_prepared_once_and_of_one_export(run, tmp_path):
    held = sorted(p.name for p in run.folder.iterdir())
    assert held == ["acquisition.json", "calibration", "counts.npz", "patterns", "photons.ptu"]
    assert (run.folder / "patterns" / "design.safetensors").read_bytes() == b"not read"
    source, other = run.folder / "patterns", tmp_path / "other"
    for folder, patterns, asked, match in (
        (run.folder, source, named(1), "exists already"),
        (other, source, named(1, manifest_sha256="0" * 64), "of other patterns"),
        (other, source, named(1, inputs=(0, 1)), "2 inputs"),
        (other, tmp_path / "none", named(1), r"manifest\.json is missing: make patterns"),
    ):
        with pytest.raises(InputError, match=match):
            Recording.prepare(folder, Patterns.read(patterns), asked)
    assert list(tmp_path.iterdir()) == [run.folder]


def test_changed_mirror_counts_are_refused(run):
    """Rows in another order would give wrong pictures and classes without a word."""
    path = run.folder / "patterns" / "mirrors.npy"
    np.save(path, np.load(path)[::-1])
    with pytest.raises(InputError, match=r"mirrors\.npy was changed after it was written"):
        Recording.read(run.folder)


@pytest.mark.parametrize("light", ["equal-dwell", "free-dwell"])
@pytest.mark.parametrize("repeats", [None, 3])
def test_gates_of_the_usual_exposure_end_before_a_late_marker_could_cut_one(
    tmp_path, light, repeats
):
    """In the frame with the least room they leave just the usual tolerance, in none less."""
    manifest = patterns_of(tmp_path / "p", light).manifest
    found = Acquisition.plan(manifest, (Scene(name="a"),), settle_s=1e-5, repeats=repeats)
    assert found.repeats == (repeats or 1)
    opened = 1e-5 + manifest.shares * found.exposure_s * found.repeats
    left = manifest.picture_s[manifest.mask_frames] - opened
    assert left.min() == pytest.approx(manifest.usual_tolerance_s, rel=1e-6)
