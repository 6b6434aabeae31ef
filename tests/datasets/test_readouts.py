"""Tables of measured readouts: any file, any names, either orientation, three splits."""

import numpy as np
import pytest
from scipy.io import savemat

from deepfsi.base import InputError
from deepfsi.datasets import Variables, read_readouts

NAMES = Variables("volts", "digit", "shown", "clock", ("laser",))


def recordings(count, label, seed):
    rng = np.random.default_rng(seed)
    return {
        "volts": rng.normal(size=(4, count)),  # modes x recordings, signed, as MATLAB keeps them
        "laser": rng.normal(size=(2, count)),
        "shown": rng.permutation(count)[None] % 7,
        "clock": 10.0 * rng.permutation(count)[None] + label,
        "digit": np.array([[float(label)]]),
    }


@pytest.fixture
def files():
    return {f"run{label}": recordings(12 + label, label, label) for label in (2, 10, 1)}


@pytest.fixture
def matlab(tmp_path, files):
    folder = tmp_path / "matlab"
    folder.mkdir()
    for name, content in files.items():
        savemat(folder / f"{name}.mat", content)
    (folder / "LICENSE.txt.md").write_text("no table")
    return folder


def test_a_folder_of_mat_files_is_one_table(matlab, files):
    table = read_readouts(matlab, NAMES)
    ordered = [files[name] for name in ("run1", "run2", "run10")]  # 2 before 10
    assert table.classes == ("1", "2", "10")
    assert table.ordered
    assert np.array_equal(table.values, np.concatenate([each["volts"].T for each in ordered]))
    assert np.array_equal(
        table.monitors["laser"], np.concatenate([each["laser"].T for each in ordered])
    )
    assert np.array_equal(table.y, np.repeat([0, 1, 2], [13, 14, 22]))
    assert np.array_equal(table.position, np.concatenate([each["clock"][0] for each in ordered]))
    assert len(np.unique(table.picture)) == 7


def test_npz_csv_and_rows_in_place_of_columns_give_the_same(matlab, files, tmp_path):
    expected = read_readouts(matlab, NAMES)
    for place, name in enumerate(("run1", "run2", "run10")):
        content = files[name]
        (tmp_path / "numpy").mkdir(exist_ok=True)
        turned = {key: each.T for key, each in content.items()}
        np.savez(tmp_path / "numpy" / f"{name}.npz", **turned)
        columns = [*content["volts"], *content["laser"], content["clock"][0]]
        head = "m0,m1,m2,m3,laser0,laser1,clock,digit,shown"
        lines = [head] if not place else []
        words = [f"{content['digit'].item():.15g}"] * len(content["clock"][0])
        for row, word, shown in zip(
            zip(*columns, strict=True), words, content["shown"][0], strict=True
        ):
            lines.append(",".join([*(repr(float(each)) for each in row), word, str(shown)]))
        with (tmp_path / "all.csv").open("a") as table:
            table.write("\n".join(lines) + "\n")
    names = Variables(None, "digit", "shown", "clock", ("laser*",))
    for table in (
        read_readouts(tmp_path / "numpy", NAMES),
        read_readouts(tmp_path / "all.csv", names),
    ):
        assert np.array_equal(table.values, expected.values)
        assert np.array_equal(table.y, expected.y)
        assert table.classes == expected.classes
        assert np.array_equal(table.position, expected.position)
        [laser] = table.monitors.values()
        assert np.array_equal(laser, expected.monitors["laser"])
        same = lambda of: of[:, None] == of[None]  # noqa: E731
        assert np.array_equal(same(table.picture), same(expected.picture))


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
    with pytest.raises(InputError, match="pictures"):
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
        (NAMES._replace(values="laser"), ""),
    ],
)
def test_bad_names_are_refused_in_one_line(matlab, names, words):
    if not words:  # any array may be the readouts
        assert read_readouts(matlab, names).values.shape == (49, 2)
        return
    with pytest.raises(InputError, match=words):
        read_readouts(matlab, names)


def test_bad_content_is_refused_in_one_line(tmp_path, files):
    with pytest.raises(InputError, match="no table of readouts"):
        read_readouts(tmp_path / "nothing")
    with pytest.raises(InputError, match="holds no file"):
        read_readouts(tmp_path)
    content = files["run2"]
    content["volts"][1, 3] = np.nan
    savemat(tmp_path / "run2.mat", content)
    with pytest.raises(InputError, match="give `label`"):
        read_readouts(tmp_path / "run2.mat")
    with pytest.raises(InputError, match="readouts of recording 4"):
        read_readouts(tmp_path, NAMES)
    content["volts"][1, 3] = 0
    savemat(tmp_path / "run2.mat", content)
    with pytest.raises(InputError, match="two classes"):
        read_readouts(tmp_path, NAMES)
    savemat(tmp_path / "run3.mat", files["run10"] | {"volts": np.ones((3, 22))})
    with pytest.raises(InputError, match=r"4 in run2\.mat and 3 in run3\.mat"):
        read_readouts(tmp_path, NAMES)
