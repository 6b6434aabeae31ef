"""Every case gives what the reference gave, bit for bit.

The reference runs for those cases alone whose facts have none of the hashes in `known.json`.
"""

import pytest

from golden import beside

CASES = [
    pytest.param(module, name, id=f"{module}-{name}")
    for module in beside.MODULES
    for name in beside.cases(module)
]


@pytest.fixture(scope="session")
def reference():
    with beside.reference() as ask:
        yield ask


@pytest.mark.parametrize(("module", "name"), CASES)
def test_a_case_gives_what_it_gave(module, name, request, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    now = beside.facts(module, name)
    if not beside.is_known(module, name, now):
        before = request.getfixturevalue("reference")(module, name)
        if before is None:
            pytest.skip(f"neither a known hash nor a history that has {beside.REFERENCE[:8]}")
        wrong = beside.differences(before, now)
        assert not wrong, "\n".join(wrong[:20])


def test_facts_are_known_only_as_they_were():
    module = "file_cases"
    name = min(beside.cases(module))
    now = beside.facts(module, name)
    assert now["bits"]
    for kind in ("exact", "bits"):
        assert not beside.is_known(module, name, {**now, kind: [now[kind], "more"]})


@pytest.mark.parametrize("module", beside.MODULES)
def test_every_stored_case_runs(module):
    """So none vanishes with a neighbour; some run only beside real files."""
    stored, run = set(beside.known()[module]), set(beside.cases(module))
    assert stored - run <= set(getattr(beside.content_of(module), "REAL_CASES", ()))
    assert run <= stored
