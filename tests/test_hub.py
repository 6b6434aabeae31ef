"""Folders of a design for a model hub: what was saved is loaded, with a card; nothing else is."""

import numpy as np
import pytest

from conftest import once
from deepfsi import InputError
from deepfsi.hub import FILE, HubDesign


def test_a_folder_holds_the_design_and_a_card(tmp_path, digits):
    design = once(digits, "pca")
    HubDesign(design).save_pretrained(tmp_path)
    assert {path.name for path in tmp_path.iterdir()} == {FILE, "README.md", "config.json"}
    card = (tmp_path / "README.md").read_text()
    assert "library_name: deepfsi" in card
    assert "2508.01981" in card
    loaded = HubDesign.from_pretrained(tmp_path).design
    counts = design.expose(digits.x_test[:20], 1e4)
    assert np.array_equal(loaded.classify(counts, 1e4), design.classify(counts, 1e4))
    HubDesign.from_pretrained(tmp_path).save_pretrained(tmp_path / "again")


def test_a_folder_without_a_design_is_refused(tmp_path):
    with pytest.raises(InputError, match=f"no design file at .*{FILE}"):
        HubDesign.from_pretrained(tmp_path)
