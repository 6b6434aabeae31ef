"""Data sets by name are listed, checked and downloaded."""

import pytest
from dataset_samples import refused

from deepfsi.datasets import check, download, list_datasets, load_dataset


def test_list_tells_the_truth_about_digits():
    data, info = load_dataset("digits"), list_datasets()[0]
    assert info.images == len(data.x_train) + len(data.x_test)
    assert (info.pixels, info.classes) == (data.pixels, len(data.classes))


@pytest.mark.parametrize("action", [check, download])
def test_unknown_name_to_check_or_download(action):
    with refused("unknown data set 'fashion'", "'fashion-mnist'?"):
        action("fashion")


def test_digits_need_no_download():
    with refused("digits", "scikit-learn"):
        download("digits")
