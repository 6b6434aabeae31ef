"""Golden tests: what this package gives is compared with what a stored one gave.

A case is a function that works in the current folder, empty and its own, and stands in `CASES` of a
module `…_cases.py`. It uses the command line in this process and public names only, so that it
stays as it is while modules are moved and rewritten, and gives a dict of facts: numbers, words,
lists, arrays, bytes. Whole numbers, words, keys and exit codes are compared with those in `exact/`
(of a module that says `HASHED`, their hashes), and floats and bytes, bit for bit, with what the
package of `beside.REFERENCE` gives on this machine, as their last bits differ between processors.
Whole numbers that follow such bits are given as floats. The reference runs the cases in a process
of its own, once a machine; where its source is not at hand, sizes of floats are compared with
stored ones. After a new case: `python tests/golden/beside.py store MODULE`.

`inputs/` holds designs, recordings, tables and pictures, so that a change of training or of the
virtual camera does not change what is counted. Command lines made them; photons and markers of some
recordings were changed afterwards: `git show 6950fc48:tests/golden/make_inputs.py`, and the `JOBS`
of `file_cases.py` of that commit for `inputs/files`.
"""
