"""The list of mutants fits the code: what no longer does would say nothing."""

import pytest

from mutants.run import ROOT, Mutant, read_mutants

MUTANTS = read_mutants()


def test_there_are_fifty_and_each_says_another_fault() -> None:
    assert len({mutant.wrong for mutant in MUTANTS}) == len(MUTANTS) >= 50


@pytest.mark.parametrize("mutant", MUTANTS, ids=lambda mutant: mutant.wrong)
def test_a_mutant_fits_the_code_at_one_place_and_is_code(mutant: Mutant) -> None:
    path = ROOT / "src" / "deepfsi" / mutant.file
    source = path.read_text()
    changed = mutant.apply(source)
    assert changed != source
    compile(changed, str(path), "exec")
    assert all((ROOT / "tests" / each).exists() for each in mutant.tests)
