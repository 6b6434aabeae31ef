"""Tables of measured readouts: any file, any names, either orientation, three splits."""

import numpy as np
import pytest
from dataset_samples import refused
from scipy.io import savemat

from deepfsi.datasets.readouts import Variables, read_readouts

NAMES = Variables("volts", "digit", "shown", "clock", ("laser",))


def recordings(label):
    rng = np.random.default_rng(label)
    count = 12 + label
    return {
        "volts": rng.normal(size=(4, count)),  # modes x recordings, signed, as MATLAB keeps them
        "laser": rng.normal(size=(2, count)),
        "shown": rng.permutation(count)[None] % 7,
        "clock": 10.0 * rng.permutation(count)[None] + label,
        "digit": np.array([[float(label)]]),
    }


RUNS = {f"run{label}": recordings(label) for label in (1, 2, 10)}
JOINED = {
    name: np.concatenate([run[name].T for run in RUNS.values()])
    for name in ("volts", "laser", "shown", "clock")
}


@pytest.fixture
def matlab(tmp_path):
    folder = tmp_path / "matlab"
    folder.mkdir()
    for name, run in RUNS.items():
        savemat(folder / f"{name}.mat", run)
    (folder / "LICENSE.txt.md").write_text("no table")
    return folder


def numpy(folder):
    """The same, with rows in place of columns."""
    for name, run in RUNS.items():
        np.savez(folder / f"{name}.npz", **{key: each.T for key, each in run.items()})
    return folder, NAMES


def text(folder):
    digits = np.repeat([1, 2, 10], [13, 14, 22])
    rows = np.column_stack([*JOINED.values(), digits])
    head = "m0,m1,m2,m3,laser0,laser1,shown,clock,digit"
    np.savetxt(folder / "all.csv", rows, "%.17g", ",", header=head, comments="")
    return folder / "all.csv", NAMES._replace(values=None, monitors=("laser*",))


@pytest.mark.parametrize("write", [numpy, text, None], ids=["npz", "csv", "mat"])
def test_recordings_of_every_kind_of_file_are_one_table(matlab, tmp_path, write):
    source, names = write(tmp_path) if write else (matlab, NAMES)
    table = read_readouts(source, names)
    assert table.classes == ("1", "2", "10")  # 2 before 10
    assert table.ordered
    assert np.array_equal(table.values, JOINED["volts"])
    assert np.array_equal(table.y, np.repeat([0, 1, 2], [13, 14, 22]))
    assert np.array_equal(table.position, JOINED["clock"][:, 0])
    assert np.array_equal(table.picture, JOINED["shown"][:, 0])
    [laser] = table.monitors.values()
    assert np.array_equal(laser, JOINED["laser"])


def test_files_are_classes_where_no_label_is_named(matlab):
    table = read_readouts(matlab, NAMES._replace(label=None, order=None))
    assert table.classes == ("run1", "run2", "run10")
    assert not table.ordered


def test_splits(matlab):
    table = read_readouts(matlab, NAMES)
    assert table.splits == ("random", "later", "pictures")
    for split in table.splits:
        test = table.test_part(split, seed=3)
        data = table.dataset(split, seed=3)
        assert len(data.x_test) == test.sum()
        assert len(data.x_train) == (~test).sum()
        assert set(table.y[test]) == set(table.y[~test]) == {0, 1, 2}
    later = table.test_part("later")
    for label in range(3):
        rows = table.y == label
        assert table.position[rows & later].min() > table.position[rows & ~later].max()
        assert (rows & later).sum() == rows.sum() // 5
    pictures = table.test_part("pictures")
    assert not set(table.picture[pictures]) & set(table.picture[~pictures])
    alone = read_readouts(matlab, NAMES._replace(picture=None))
    assert alone.splits == ("random", "later")
    with refused("pictures"):
        alone.test_part("pictures")


def test_scale_maps_the_span_of_each_readout_to_0_to_1(matlab):
    table = read_readouts(matlab, NAMES)
    data = table.dataset("random")
    x = np.concatenate([data.x_train, data.x_test])
    assert np.allclose(x.min(axis=0), 0)
    assert np.allclose(x.max(axis=0), 1)
    restored = data.x_test * table.gain + table.offset
    assert np.allclose(restored, table.values[table.test_part("random")], atol=1e-6)


@pytest.mark.parametrize(
    ("names", "words"),
    [
        (NAMES._replace(values="amps"), "has no 'amps', but"),
        (NAMES._replace(values=None, monitors=()), "give `values`"),
        (NAMES._replace(label="volts"), "label, picture and order are of"),
    ],
)
def test_bad_names_are_refused_in_one_line(matlab, names, words):
    with refused(words):
        read_readouts(matlab, names)
    assert read_readouts(matlab, NAMES._replace(values="laser")).values.shape == (49, 2)


LOST = RUNS["run2"]["volts"].copy()
LOST[1, 3] = np.nan


@pytest.mark.parametrize(
    ("runs", "words"),
    [
        ({}, "holds no file"),
        ({"run2": RUNS["run2"] | {"volts": LOST}}, "readouts of recording 4"),
        ({"run2": RUNS["run2"]}, "two classes"),
        (RUNS | {"run3": RUNS["run10"] | {"volts": np.ones((3, 22))}}, "3 in run3.mat"),
    ],
)
def test_bad_content_is_refused_in_one_line(tmp_path, runs, words):
    for name, run in runs.items():
        savemat(tmp_path / f"{name}.mat", run)
    with refused(words):
        read_readouts(tmp_path, NAMES)


def test_a_file_alone_needs_a_label(matlab):
    with refused("give `label`"):
        read_readouts(matlab / "run2.mat")
    with refused("no table of readouts"):
        read_readouts(matlab / "nothing")
