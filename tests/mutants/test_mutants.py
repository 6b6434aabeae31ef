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
        return (
            self.size
            ** 3
        )


def volume() -> int:
    return 2
"""


def test_there_are_fifty_and_each_says_another_fault() -> None:
    assert len({mutant.wrong for mutant in MUTANTS}) == len(MUTANTS) >= 50


@pytest.mark.parametrize("mutant", MUTANTS, ids=lambda mutant: mutant.wrong)
def test_a_mutant_fits_the_code_at_one_place_and_is_code(mutant: Mutant) -> None:
    path = mutant.file(ROOT)
    source = path.read_text()
    changed = mutant.apply(source)
    assert changed != ast.unparse(ast.parse(source))
    compile(changed, str(path), "exec")
    assert mutant.tests
    assert all((ROOT / "tests" / each).exists() for each in mutant.tests)


def applied(at: str, old: str, new: str) -> str:
    return Mutant("wrong", f"box:{at}", old, new, []).apply(SOURCE)


@pytest.mark.parametrize(
    ("at", "old", "new", "line"),
    [
        ("Box.volume", "self.size**3", "self.size", "return self.size"),
        ("Box.volume", "return self.size ** 3", "return 1", "return 1"),
        ("Box.volume", "print(side)\nprint('size')", "", "pass"),
        ("Box.volume", "range(3)", "range(2)", "for side in range(2):"),
        ("Box.size", "3", "4", "size = 4"),
        ("volume", "2", "1", "return 1"),
    ],
)
def test_a_mutant_is_found_by_its_code_however_that_is_formatted(
    at: str, old: str, new: str, line: str
) -> None:
    before = [each.strip() for each in ast.unparse(ast.parse(SOURCE)).splitlines()]
    after = [each.strip() for each in applied(at, old, new).splitlines()]
    assert line in after
    assert line not in before


@pytest.mark.parametrize(
    ("at", "old"), [("Box.area", "3"), ("Box.volume", "2"), ("Box", "3"), ("volume", "self.size")]
)
def test_a_mutant_that_fits_at_no_place_or_at_two_is_refused(at: str, old: str) -> None:
    with pytest.raises(ValueError, match=r"is not there|holds"):
        applied(at, old, "7")
