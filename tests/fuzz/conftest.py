"""Samples of all readers."""

import pytest

from fuzz.readers import make_samples


@pytest.fixture(scope="session")
def samples(tmp_path_factory):
    folder = tmp_path_factory.mktemp("samples")
    make_samples(folder)
    return folder
