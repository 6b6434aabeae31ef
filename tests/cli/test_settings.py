"""Options made from fields: one for each, with the field's text, and none that is written twice."""

from collections import Counter

import pytest

from deepfsi.camera.camera import Camera
from deepfsi.cli import fields as fields_module
from deepfsi.jobs.exposures import exposure_kinds
from deepfsi.jobs.job import SETTING_ALIASES, Job
from deepfsi.jobs.training import Training
from shared.commands import COMMANDS

OWN = {"design", "masks", "photons", "camera", "seed"}
RANGED = {"span"}  # a range of budgets is given as --photons LOW:HIGH
OF_STUDIES = {"design", "seed"}
OF_COMMANDS = {"design": set(), "compare": OF_STUDIES}


def declared() -> dict[str, str]:
    """Name of the option and text of every field of a job."""
    names = {place: name for name, place in SETTING_ALIASES.items()}
    tables = {"camera": Camera.model_fields, "training": Training.model_fields}
    found = {name: Job.model_fields[name].description for name in OWN}
    found |= {
        n: kind.model_fields[n].description
        for n, kind in exposure_kinds().items()
        if n not in RANGED
    }
    for table, fields in tables.items():
        for name, field in fields.items():
            if name not in fields_module.NO_OPTIONS:
                found[names.get((table, name), name)] = field.description
    return found


@pytest.mark.parametrize("command", OF_COMMANDS)
def test_every_field_has_one_option_with_its_text(command):
    declared_options = COMMANDS[command].declared
    count = Counter(option for each in declared_options for option in each.names)
    assert set(count.values()) == {1}
    texts = {each.names[0]: each.field.description for each in declared_options}
    for name, text in declared().items():
        if name not in OF_COMMANDS[command]:
            assert texts[f"--{name.replace('_', '-')}"].startswith(text)
