"""Every case gives what it gave: exact facts as stored, floats and bytes as the reference.

On a processor of which `known.json` has the reference's hashes the reference runs for those cases
alone whose facts have another.
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
    wrong = beside.differences(beside.stored(module)[name], beside.to_be_stored(module, now))
    # without bits all facts are stored
    same = not now["bits"] or beside.is_known(module, name, now)
    before = now if same else request.getfixturevalue("reference")(module, name)
    for kind in ("exact", "bits") if before is not None else ():
        wrong += beside.differences(before[kind], now[kind])
    assert not wrong, "\n".join(wrong[:20])
    if before is None:
        pytest.skip(f"the history lacks {beside.REFERENCE[:8]}: only what is stored was compared")


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
    stored, run = set(beside.stored(module)), set(beside.cases(module))
    assert stored - run <= set(getattr(beside.content_of(module), "REAL_CASES", ()))
    assert run <= stored
