"""Files that end before the recording did: whole passes are counted, wherever it was cut."""

import numpy as np
import pytest
import recording_samples
from recording_samples import Run, lamp, schedule, train

from deepfsi.base import InputError
from deepfsi.hardware.counting import count_run
from deepfsi.hardware.counting.markers import align
from deepfsi.hardware.photons import PtuFile, read_markers

run, whole = recording_samples.run, recording_samples.whole


def cut_after(run: Run, markers: int, more: int) -> None:
    """Cut a file so many records after its marker of that number."""
    path = run.folder / "photons.ptu"
    offset, content = PtuFile(path).header.offset, path.read_bytes()
    words = np.frombuffer(content[offset : offset + (len(content) - offset) // 4 * 4], "<u4")
    places = np.flatnonzero((words >> 31 == 1) & (words >> 25 & 63 < 16))
    path.write_bytes(content[: offset + 4 * (int(places[markers - 1]) + 1 + more)])
    assert len(read_markers(path)[0]) == markers


@pytest.mark.parametrize(("pause", "rate"), [(0.0, 0.0), (1e-3, 0.0), (0.02, 5e-3)])
def test_whole_passes_of_a_cut_file_are_counted(run, pause, rate):
    """Between two passes, or in the first frame of one, the file was refused whole."""
    starts = train(run.patterns.manifest, 3, rate, pauses=pause)
    run.record(starts, starts.ravel(), run.photons)
    content = (run.folder / "photons.ptu").read_bytes()
    wanted, frames = count_run(run.folder).counts, starts.shape[1]
    held = [frames - 1, frames, frames + 1, frames + 2, frames + 4]
    held += [2 * frames - 2, 2 * frames - 1, 2 * frames, 2 * frames + 1, 3 * frames - 1]
    for markers in held:
        for more in (0, 2):
            cut_after(run, markers, more)
            kept = markers // frames
            if not kept:
                run.refused("photons.ptu has no whole exposure")
            else:
                counts = count_run(run.folder)
                assert counts.valid[:, 0].tolist() == [scene < kept for scene in range(3)]
                assert (counts.counts[:kept] == wanted[:kept]).all()
                assert {fault.scene for fault in counts.faults} == set(range(kept, 3))
            (run.folder / "photons.ptu").write_bytes(content)


def test_a_recording_that_is_not_cut_has_all_passes(run):
    """Nobody knows which pass lacks, unless the file says that its end does."""
    manifest = run.patterns.manifest
    true = train(manifest, 2, pauses=0.05)
    with pytest.raises(InputError, match="2 whole passes, and there are 3 scenes"):
        align(true.ravel(), manifest, 3)
    found = align(true.ravel(), manifest, 3, counter=lamp(manifest, true), cut=True)
    assert np.isfinite(found.starts_s).all(axis=1).tolist() == [True, True, False]


def test_a_cut_file_whose_passes_are_not_certain_is_refused(run):
    """Markers before and between the passes may be of one that was not found."""
    manifest = run.patterns.manifest
    true = train(manifest, 3, pauses=0.05)
    markers = np.append(true[0, 3], true[1:].ravel())
    with pytest.raises(InputError, match="not certain"):
        align(markers, manifest, 4, cut=True)


@pytest.mark.parametrize("kept", [[1, 2, 5], [1, 2, 3, 4, 5]])
def test_the_last_pass_of_a_cut_file_is_not_made_of_two(kept):
    """Frames 1 to 4 of a pass and frame 0 of the next fit a whole pass; photons tell."""
    manifest = schedule([1000])
    true = train(manifest, 2)
    markers = true.ravel()[kept]
    found = align(markers, manifest, 2, cut=True)
    assert np.isnan(found.starts_s).all()
    assert {fault.scene for fault in found.faults if fault.kind == "lost"} == {0, 1}
    try:
        found = align(markers, manifest, 2, counter=lamp(manifest, true), cut=True)
    except InputError as error:
        assert "not certain" in str(error)  # noqa: PT017 - one of two right answers
    else:
        known = np.isfinite(found.starts_s)
        assert (np.abs(found.starts_s - true)[known] < 3e-5).all()
