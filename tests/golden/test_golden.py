"""Every case gives what it gave: exact facts as stored, floats and bytes as the reference."""

import ast
from pathlib import Path

import pytest

import deepfsi
from golden import beside

CASES = [
    pytest.param(module, name, id=f"{module}-{name}")
    for module in beside.MODULES
    for name in beside.cases(module)
]

MOST_NAMES = 45
"""Names of the package that all cases use at most, so that these outlast its modules."""

COMMAND_LINE = {"cli"}
PLANS = {"Recipe", "only", "plan", "plan_trials"}
"""Of the room of sweeps: keys of trials have no other way out."""


@pytest.fixture(scope="session")
def reference():
    made = beside.Reference()
    yield made
    made.close()


@pytest.mark.parametrize(("module", "name"), CASES)
def test_a_case_gives_what_it_gave(module, name, reference, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    now = beside.facts(module, name)
    before = reference.facts(module, name)
    wrong = []
    if before is not None:
        wrong = [
            *beside.differences(before["exact"], now["exact"]),
            *beside.differences(before["bits"], now["bits"]),
        ]
        assert not wrong, "\n".join(wrong[:20])
    stored, given = beside.stored(module)[name], beside.to_be_stored(module, now)
    wrong = beside.differences(beside.hashes_only(stored), beside.hashes_only(given))
    if beside.is_hashed(module):
        wrong += beside.far_sizes(stored, given)
    assert not wrong, "\n".join(wrong[:20])
    if before is None:
        pytest.skip(f"the history lacks {beside.REFERENCE[:8]}: only what is stored was compared")


def test_cases_use_few_names_of_the_package_and_only_public_ones():
    names = set()
    for path in Path(__file__).parent.glob("*.py"):
        if path.stem not in beside.APART:
            names |= package_names(ast.parse(path.read_text()))
    assert names - {*deepfsi.__all__, *COMMAND_LINE, *PLANS} == set()
    assert len(names) <= MOST_NAMES


def package_names(tree):
    """Names that a module takes from the package."""
    names = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] == "deepfsi":
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.Import):
            names |= {one.name for one in node.names if one.name.startswith("deepfsi.")}
        elif isinstance(node, ast.Attribute) and getattr(node.value, "id", "") == "deepfsi":
            names.add(node.attr)
    return names - {"__file__", "__all__", "__version__"}
