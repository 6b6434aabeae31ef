"""The page of a study: what it says, what it refuses, and how it writes numbers."""

import re
import subprocess
import sys

import numpy as np
import pytest
from test_report import Wellformed, words_of

from deepfsi.errors import InputError
from deepfsi.report import (
    Claim,
    Picture,
    Section,
    Table,
    accuracy_figure,
    count_figure,
    masks_figure,
    values_figure,
    write_study,
)
from deepfsi.report.study_page import Shown, columns
from shared.results import make_results

SCRIPT = "<script>window.harmed = true</script>"
LONG = "Donaudampfschifffahrtsgesellschaftskapitänsmützenabzeichenverleihungsurkunde"


def accuracy_table() -> Table:
    """Sixty rows of words, numbers of every size, and values that are missing."""
    rng = np.random.default_rng(1)
    designs = ["DeepFSI", "PCA (FSI)", "truncated Hadamard", "raster scan", SCRIPT, LONG]
    rows = []
    for i in range(60):
        accuracy = float(rng.uniform(0.1, 0.97))
        rows.append(
            (
                designs[i % 6],
                "photon noise" if i % 2 else "Gaussian read noise",
                float(10 ** (2 + i % 5)),
                int(rng.integers(1, 1025)),
                None if i % 10 == 3 else accuracy,
                accuracy - 0.004,
                accuracy + 0.004,
                float(10.0 ** -rng.integers(2, 9)),
                12 + i,
                "chosen" if i % 7 == 0 else None,
            )
        )
    heads = (
        "design",
        "noise",
        "photons",
        "masks",
        "accuracy",
        "low",
        "high",
        "p",
        "seed",
        "choice",
    )
    return Table("Test accuracy of every design, budget and seed.", heads, tuple(rows))


def example(folder) -> list[Section]:
    """Two experiments with what a real study has, and with words that break careless pages."""
    one = make_results(folder / "one")
    two = make_results(folder / "two", noises=("poisson", "gaussian"), budgets=(1e2, 1e3, 1e5))
    matrix = np.random.default_rng(0).normal(size=(12, 256)) / 12
    spectra = np.random.default_rng(2).normal(size=(4, 30))
    facts = {
        "versions": {"deepfsi": "0.1.0", "torch": "2.13.0", "python": "3.11.2"},
        "device": {"name": "cpu", "threads": 2, "instructions": ["avx512f", "amx_bf16"]},
        "data": {
            "name": SCRIPT,
            "hash": "5f70bf18a086007016e948b04aed3b82103a36bea417",
        },
        "seeds": [0, 1, 2],
        "seconds": 5321.7,
    }
    learned = Claim(
        "Learned masks classify better than principal components at every photon budget tested.",
        True,
        "+0.084 (0.071 to 0.097) at 10⁴ photons; +0.012 (0.006 to 0.018) at 10⁶ photons",
        "All five intervals of the difference lie above 0.",
    )
    raster = Claim(
        "Raster scan is better than impulse imaging.",
        False,
        "−0.762 (−0.770 to −0.754)",
        "The interval lies below 0: with the same light, each pixel is seen for 1/N of the time.",
    )
    undecided = Claim(
        f"The {LONG} of {SCRIPT} needs fewer masks than truncated Hadamard.",
        None,
        "−1 mask (−6 to 4)",
    )
    photon = Section(
        name="photon-noise",
        title="Accuracy under photon noise",
        found="DeepFSI leads at every budget. At 10⁴ photons it reaches 0.924 (0.919 to 0.929) "
        "with ten masks, PCA 0.843 (0.836 to 0.850); above 10⁶ photons the designs differ by less "
        "than the spread between seeds. Impulse imaging, which has a detector for each pixel, is "
        "the bound that nothing passes.",
        paper="DeepFSI needs about a tenth of the photons that PCA needs for the same accuracy, "
        "and the advantage grows as light gets scarce. Raster scan and Hadamard fall to chance "
        "below 10⁴ photons.",
        pictures=(
            Picture(
                accuracy_figure(one),
                "Test accuracy against the photon budget, each design at its best number of masks. "
                "Bars are 95 % intervals over three seeds of training.",
                "Accuracy rises with photons; DeepFSI is above PCA.",
            ),
            Picture(
                count_figure(one),
                "Accuracy against the number of masks; filled markers were chosen on validation "
                "data.",
                "Accuracy falls slowly with the number of masks.",
            ),
            Picture(
                masks_figure(matrix, (16, 16), title="Learned at 10⁴ photons"),
                f"The twelve brightest masks learned on {SCRIPT}.",
                "Twelve images of masks.",
            ),
            Picture(values_figure(matrix), "How their values are distributed.", "A histogram."),
        ),
        claims=(learned, raster, undecided) * 3,
        tables=(
            accuracy_table(),
            Table("Photons needed for an accuracy of 0.8.", ("design", "photons"), ()),
        ),
        files=("photon-noise/accuracy.csv", "photon-noise/masks 10.csv"),
        command="deepfsi experiment photon-noise --data mnist --photons 1e2,1e3,1e4,1e5,1e6 "
        f"--trials 3 -o runs/paper/photon-noise # {LONG}",
        facts=facts,
    )
    read = Section(
        name="read-noise",
        title=f"Read noise on {SCRIPT}: Hadamard gains, and {LONG}",
        found="Hadamard gains over raster scan as theory says.",
        paper="Multiplexing helps when the noise does not grow with the light.",
        pictures=(
            Picture(
                accuracy_figure(two),
                "Accuracy under both noises. The budgets differ, so that both cover one axis.",
                "Two panels of accuracy against photons.",
            ),
            Picture(masks_figure(spectra, (30,)), "Masks for spectra.", "Four curves."),
        ),
        claims=(raster, undecided),
        tables=(accuracy_table(),),
        files=(),
        command="deepfsi experiment read-noise",
        facts={},
    )
    return [photon, read]


def page_of(folder, sections) -> str:
    return write_study(folder, "Deep feature-specific imaging", sections).read_text("utf-8")


def section(**changes) -> Section:
    nothing = dict.fromkeys(("pictures", "claims", "tables", "files"), ())
    words = dict.fromkeys(("title", "found", "paper", "command"), "words")
    return Section(**{"name": "one", "facts": {}, **nothing, **words, **changes})


def test_page_is_one_self_contained_document(tmp_path):
    page = page_of(tmp_path / "out", example(tmp_path))
    parser = Wellformed()
    parser.feed(page)
    assert parser.open == []
    assert len(parser.ids) == len(set(parser.ids)) > 100
    files = {"photon-noise/accuracy.csv", "photon-noise/masks%2010.csv"}
    for address in parser.addresses:
        assert address.startswith(("data:image/png;base64,", "#")) or address in files
        assert address[0] != "#" or address[1:] in parser.ids
    assert files <= set(parser.addresses)
    assert not re.search(r"https?:|//fonts|@import", page)
    assert [p.name for p in (tmp_path / "out").iterdir()] == ["report.html"]


def test_everything_given_is_on_the_page(tmp_path):
    sections = example(tmp_path)
    page = page_of(tmp_path, sections)
    text = words_of(page).replace("&lt;", "<").replace("&gt;", ">")
    for part in sections:
        for words in (part.title, part.found, part.paper, part.command):
            assert words in text
        for picture in part.pictures:
            assert picture.caption in text
            assert f'aria-label="{picture.words}"' in page
        for claim in part.claims:
            assert text.count(claim.text) >= 2
            assert text.count(claim.measured) >= 2
            assert text.count(claim.why) >= 2
        for table in part.tables:
            assert table.caption in text
    assert "versions.torch 2.13.0" in text
    assert "device.instructions avx512f, amx_bf16" in text


def test_claims_are_counted(tmp_path):
    text = words_of(page_of(tmp_path, example(tmp_path)))
    assert "2 experiments. Claims tested: 11; 3 hold, 4 do not, 4 open." in text
    assert "Accuracy under photon noise 3 hold, 3 do not, 3 open" in text
    assert "1 does not, 1 open" in text
    quiet = words_of(page_of(tmp_path, [section()]))
    assert "1 experiment. Each experiment" in quiet
    assert "claim" not in quiet.lower()


def test_markup_is_text(tmp_path):
    page = page_of(tmp_path, [*example(tmp_path), section(title=SCRIPT, command=SCRIPT)])
    assert SCRIPT not in page
    assert page.count("<script>") == 1
    bad = write_study(tmp_path, SCRIPT, [section()]).read_text("utf-8")
    assert SCRIPT not in bad


def test_a_file_cannot_be_an_address_of_another_kind(tmp_path):
    page = page_of(tmp_path, [section(files=("javascript:alert(1)", 'a".csv'))])
    assert 'href="javascript%3Aalert%281%29"' in page
    assert 'href="a%22.csv"' in page


def test_same_study_makes_the_same_page(tmp_path):
    pages = {page_of(tmp_path, example(tmp_path)) for _ in range(2)}
    assert len(pages) == 1


@pytest.mark.parametrize(
    ("column", "texts"),
    [
        ((0.9, 0.85, 1.0), ["0.900", "0.850", "1.000"]),
        ((0.0123, -0.0045, 0.0), ["0.0123", "−0.0045", "0.0000"]),
        ((1e2, 1e4, 3e5, 0.0), ["100", "10⁴", "3 × 10⁵", "0"]),
        ((5321.7, 12.0), ["5322", "12"]),
        ((12.34, 1.0), ["12.34", "1.00"]),
        ((20260101, -3), ["20260101", "−3"]),
        ((1.5e-7, -2e9, 9.999e-4), ["1.5 × 10⁻⁷", "−2 × 10⁹", "10⁻³"]),
        ((np.float32(0.5), np.int64(70000)), ["0.500", "70000"]),
        ((None, float("nan"), 0.5), ["–", "–", "0.500"]),
        ((float("inf"), float("-inf")), ["∞", "−∞"]),
        (("words", 3, None), ["words", "3", "–"]),
    ],
)
def test_numbers_are_written_as_people_do(column, texts):
    words, rows = columns(Table("", ("a",), tuple((cell,) for cell in column)))
    assert [cell.text for (cell,) in rows] == texts
    assert words == ["words" in column]


def test_cells_sort_by_their_whole_value():
    row = (0.123456789, 10**7, None, "words", float("inf"))
    _, [cells] = columns(Table("", ("a", "b", "c", "d", "e"), (row,)))
    assert [cell.value for cell in cells] == ["0.123456789", "10000000", None, None, "Infinity"]
    assert cells[2] == Shown("–")


@pytest.mark.parametrize(
    ("sections", "told"),
    [
        ([], "without sections"),
        ([section(name="a b")], "'a b': use letters"),
        ([section(name="")], "use letters"),
        ([section(), section()], "two sections named 'one'"),
        ([section(files=("/data/a.csv",))], "does not lie beside the page"),
        ([section(files=("../a.csv",))], "does not lie beside the page"),
        ([section(tables=(Table("t", ("a", "b"), ((1,),)),))], "do not fit its 2 heads"),
    ],
)
def test_studies_that_cannot_be_a_page_are_refused(tmp_path, sections, told):
    with pytest.raises(InputError, match=told):
        write_study(tmp_path, "title", sections)
    assert not list(tmp_path.iterdir())


def test_study_needs_no_torch(tmp_path):
    code = (
        "import sys; from deepfsi.report import Section, write_study; "
        "write_study(sys.argv[1], 't', [Section('a', *'bcd', (), (), (), (), 'e', {})]); "
        "assert not {'torch', 'matplotlib.pyplot'} & set(sys.modules)"
    )
    subprocess.run([sys.executable, "-c", code, str(tmp_path)], check=True)
    assert (tmp_path / "report.html").is_file()
