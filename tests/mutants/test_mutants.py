"""The list of mutants fits the code: what no longer does would say nothing."""

import ast

import pytest

from mutants.run import ROOT, Mutant, read_mutants

MUTANTS = read_mutants()

SOURCE = """
class Box:
    size = 3

    def volume(self) -> int:
        for side in range(3):  # a comment
            print(side)
            print("size")
        return (self.size
                ** 3)


def volume() -> int:
    return 2
"""


def test_there_are_fifty_and_each_says_another_fault():
    assert len({mutant.wrong for mutant in MUTANTS}) == len(MUTANTS) >= 50


@pytest.mark.parametrize("mutant", MUTANTS, ids=lambda mutant: mutant.wrong)
def test_a_mutant_fits_the_code_at_one_place_and_is_code(mutant):
    path = mutant.file(ROOT)
    changed = mutant.apply(path.read_text())
    assert changed != ast.unparse(ast.parse(path.read_text()))
    compile(changed, str(path), "exec")
    assert mutant.tests
    assert all((ROOT / "tests" / each).exists() for each in mutant.tests)


@pytest.mark.parametrize(
    ("at", "old", "new", "line"),
    [
        ("Box.volume", "self.size**3", "self.size", "return self.size"),
        ("Box.volume", "return self.size ** 3", "return 1", "return 1"),
        ("Box.volume", "print(side)\nprint('size')", "", "pass"),
        ("Box.volume", "range(3)", "range(2)", "for side in range(2):"),
        ("Box.size", "3", "4", "size = 4"),
        ("volume", "2", "1", "return 1"),
        ("Box.area", "3", "7", None),
        ("Box.volume", "2", "7", None),
        ("Box", "3", "7", None),
        ("volume", "self.size", "7", None),
    ],
)
def test_a_mutant_is_found_by_its_code_however_that_is_formatted(at, old, new, line):
    """Unless it fits at no place, or at two."""
    mutant = Mutant("wrong", f"box:{at}", old, new, ())
    if line is None:
        with pytest.raises(ValueError, match=r"holds [^1] times"):
            mutant.apply(SOURCE)
    else:
        before = ast.unparse(ast.parse(SOURCE)).splitlines()
        assert line in {each.strip() for each in mutant.apply(SOURCE).splitlines()}
        assert line not in {each.strip() for each in before}
