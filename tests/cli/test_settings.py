"""Options made from fields: each once, with the field's text, and none that is written twice."""

import pytest

from deepfsi.camera.camera import Camera
from deepfsi.jobs.exposures import exposure_kinds
from deepfsi.jobs.job import SETTING_ALIASES, Job, find_table
from deepfsi.jobs.training import Training
from shared.commands import COMMANDS


@pytest.mark.parametrize("command", ["design", "compare"])
def test_an_option_of_a_job_has_the_text_of_its_field(command):
    params = COMMANDS[command].params
    names = [option for each in params for option in each.opts]
    assert len(set(names)) == len(names)
    tables = {"": Job, "camera": Camera, "training": Training}
    found = set()
    for each in params:
        table, name = find_table(each.name)
        model = exposure_kinds().get(name) if table == "exposure" else tables[table]
        if name in model.model_fields and each.name != "device":  # which is torch's
            assert each.help.startswith(model.model_fields[name].description)
            found.add(each.name)
    assert {"masks", "camera", "light", "epochs", "cap", *SETTING_ALIASES} <= found
