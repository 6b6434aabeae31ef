"""Golden tests: what this package gives is compared with what a stored one gave.

A case is a function that works in the current folder, empty and its own, and stands in `CASES` of a
module `…_cases.py`. It uses the command line in this process and public names only, so that it
stays as it is while modules are moved and rewritten, and gives a dict of facts: numbers, words,
lists, arrays, bytes. They are compared, bit for bit, with what the package of `beside.REFERENCE`
gives on this machine, as the last bits of floats differ between processors. The reference runs the
cases in a process of its own, once a machine, and not where `known.json` has the hash of their
facts. After a new case: `python tests/golden/beside.py MODULE`.

`inputs/` holds designs, recordings, tables and pictures, so that a change of training or of the
virtual camera does not change what is counted. Command lines made them; photons and markers of some
recordings were changed afterwards: `git show 6950fc48:tests/golden/make_inputs.py`, and the `JOBS`
of `file_cases.py` of that commit for `inputs/files`.
"""
