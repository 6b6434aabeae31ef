"""Folders of recordings: prepared once, and read or refused where they are damaged."""

import json
from hashlib import sha256
from pathlib import Path

import numpy as np
import pytest
import recording_samples
from hypothesis import given
from hypothesis import strategies as st
from recording_samples import made, many, named, patterns_of

from deepfsi.base import InputError
from deepfsi.hardware.counting import (
    Acquisition,
    Scene,
    acquisition,
    count_run,
    prepare_run,
    read_counts,
)
from deepfsi.hardware.pictures import reconstruct

run, whole = recording_samples.run, recording_samples.whole


@pytest.mark.parametrize(
    "name", ["acquisition.json", "photons.ptu", "patterns/manifest.json", "patterns/mirrors.npy"]
)
@pytest.mark.parametrize("content", [None, b"", b"garbage", b"[" * 100_000])
def test_bad_files_are_named(run, name, content):
    path = run.folder / name
    path.unlink()
    if content is not None:
        path.write_bytes(content)
    run.refused(name.split("/")[0])


@pytest.mark.parametrize(
    ("changes", "match"),
    [
        ({"scenes": []}, "acquisition.json cannot be used at scenes"),
        ({"scenes": [{"name": "a"}] * 4}, "photons.ptu .* 3 whole passes"),
        ({"scenes": [{"name": "a"}] * 2}, "photons.ptu .* follow the last of 2"),
        ({"scenes": [{"name": "a"}] * 65536}, "photons.ptu .* 65536 scenes"),
        ({"exposure_s": -1}, "exposure_s"),
        ({"exposure_s": 1.0}, "acquisition.json: an exposure of 1 s does not fit"),
        ({"exposure_s": 1e-300}, "acquisition.json: an exposure of 1e-300 s leaves"),
        ({"exposure_s": 1e-12}, "photons.ptu has times in steps of 1 ps, too coarse"),
        ({"settle_s": 0.9}, "acquisition.json: an exposure"),
        ({"repeats": 99}, "acquisition.json: 99 repeats do not fit"),
        ({"inputs": [0, 1]}, "acquisition.json has 2 inputs"),
        ({"inputs": [1, 1]}, "each detector needs an input of its own"),
        ({"inputs": [3]}, "no light on input 4: .* 25764 photons on input 3"),
        (
            {"marker_bit": 1},
            "0 frame markers on marker input 0; there are some on 2: give --marker 2",
        ),
        ({"marker_bit": 3}, "marker_bit"),
        ({"manifest_sha256": "0" * 64}, "manifest.json is not the one"),
        ({"manifest_sha256": None}, "acquisition.json has no manifest_sha256.* prepare"),
        ({"unknown": 1}, "unknown"),
        ({"schema_version": 2}, "schema 2, newer than this one"),
    ],
)
def test_acquisitions_that_do_not_fit_are_refused(run, changes, match):
    run.edit(**changes)
    run.refused(match)


def test_a_folder_is_prepared_once_and_of_one_export(run, tmp_path, monkeypatch):
    held = sorted(p.name for p in run.folder.iterdir())
    assert held == ["acquisition.json", "calibration", "counts.npz", "patterns", "photons.ptu"]
    assert (run.folder / "patterns" / "design.safetensors").read_bytes() == b"not read"
    source = run.folder / "patterns"
    with pytest.raises(InputError, match="exists already"):
        prepare_run(run.folder, source, named(1))
    with pytest.raises(InputError, match="of other patterns"):
        prepare_run(tmp_path / "other", source, named(1, manifest_sha256="0" * 64))
    with pytest.raises(InputError, match="2 inputs"):
        prepare_run(tmp_path / "other", source, named(1, inputs=(0, 1)))
    with pytest.raises(InputError, match=r"manifest\.json is missing: make patterns"):
        prepare_run(tmp_path / "other", tmp_path / "none", named(1))
    monkeypatch.setattr(acquisition, "MOST_RUN_FRAMES", 30)
    with pytest.raises(InputError, match=r"4 scenes of .* at most 30 frames are allowed: split it"):
        prepare_run(tmp_path / "other", source, named(4))
    assert not (tmp_path / "other").exists()
    assert list(tmp_path.iterdir()) == [run.folder]


def test_changed_mirror_counts_are_refused(run):
    """Rows in another order would give wrong pictures and classes without a word."""
    path = run.folder / "patterns" / "mirrors.npy"
    np.save(path, np.load(path)[::-1])
    for read in (count_run, read_counts, reconstruct):
        with pytest.raises(InputError, match=r"mirrors\.npy was changed after it was written"):
            read(run.folder)


FILES = (
    "acquisition.json",
    "patterns/manifest.json",
    "patterns/mirrors.npy",
    "photons.ptu",
    "counts.npz",
)


@pytest.fixture(scope="module")
def victim(tmp_path_factory) -> Path:
    """A small recording whose files are changed and put back."""
    return made(tmp_path_factory.mktemp("victim"), scenes=2).folder


NUMBERS = ["0", "-1", "1e308", "1e-308", "65537", "9999999999", "null", '""', "[]", "{}", "NaN"]


@st.composite
def mutations(draw: st.DrawFn) -> tuple[str, list[tuple[int, int, bytes]], str]:
    """A file, places in it with what is put for how many bytes, and what becomes of its hash."""
    name = draw(st.sampled_from(FILES))
    word = st.sampled_from([text.encode() for text in NUMBERS]) | st.binary(max_size=8)
    change = st.tuples(st.integers(0, 2**20), st.integers(0, 12), word)
    return name, draw(st.lists(change, min_size=1, max_size=4)), draw(st.sampled_from("snc"))


def mutate(content: bytes, changes: list[tuple[int, int, bytes]], json_: bool) -> bytes:
    """Put something at some places: of JSON at a value, else anywhere."""
    out = bytearray(content)
    for place, size, what in changes:
        at = place % max(len(out), 1)
        if json_:
            at = max(out.find(b": ", at), 0) + 2
            ends = [e for e in (out.find(b",", at), out.find(b"\n", at)) if e >= 0]
            size = min(ends, default=len(out)) - at
        out[at : at + size] = what
    return bytes(out)


@many
@given(mutation=mutations())
def test_changed_folders_are_read_or_refused(victim, mutation):
    if not (victim / "counts.npz").exists():
        count_run(victim)
    name, changes, rehash = mutation
    held = {each: (victim / each).read_bytes() for each in FILES}
    changed = mutate(held[name], changes, name.endswith("json"))
    try:
        (victim / name).write_bytes(changed)
        if name == "patterns/manifest.json" and rehash != "n":
            sign(victim)
        for work in (read_counts, count_run, reconstruct):
            try:
                work(victim)
            except InputError as error:
                assert "\n" not in str(error)  # noqa: PT017
    finally:
        for each, content in held.items():
            (victim / each).write_bytes(content)


def sign(folder: Path) -> None:
    """Make hashes fit a changed manifest, as far as it is JSON at all."""
    path = folder / "patterns" / "manifest.json"
    try:
        text = json.loads(path.read_bytes())
    except ValueError:
        return
    if isinstance(text, dict):
        text.pop("sha256", None)
        path.write_text(json.dumps(text, indent=1))
    digest = sha256(path.read_bytes()).hexdigest()
    about = json.loads((folder / "acquisition.json").read_text())
    (folder / "acquisition.json").write_text(json.dumps(about | {"manifest_sha256": digest}))


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
    left = manifest.picture_s[manifest.shown] - opened
    assert left.min() == pytest.approx(manifest.usual_tolerance_s, rel=1e-6)
