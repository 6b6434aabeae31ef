"""Pages of reports: a study to write, and what a reader and a parser see of a page."""

import itertools
import re
import subprocess
import sys
from html.parser import HTMLParser

import numpy as np

from deepfsi.report import accuracy_figure, masks, rendering
from deepfsi.report.accuracy import count_figure
from deepfsi_paper.report import section
from shared.results import make_results

SCRIPT = "<script>window.harmed = true</script>"
LONG = "Donaudampfschifffahrtsgesellschaftskapitänsmützenabzeichenverleihungsurkunde"


def words_of(page):
    """Text that a reader sees, without styles and scripts."""
    bare = re.sub(r"<(style|script).*?</\1>", "", page, flags=re.DOTALL)
    return re.sub(r"\s+", " ", re.sub(r"<[^>]*>", " ", bare))


class Wellformed(HTMLParser):
    """Collects ids and addresses, and checks that elements close in order."""

    VOID = frozenset(("meta", "path", "use", "image", "circle", "rect", "br"))

    def __init__(self):
        super().__init__()
        self.open, self.ids, self.addresses = [], [], []

    def handle_starttag(self, tag, attrs):
        self.ids += [value for name, value in attrs if name == "id"]
        self.addresses += [v for name, v in attrs if name in ("src", "href", "xlink:href")]
        self.addresses += re.findall(r"url\(([^)]*)\)", " ".join(v or "" for _, v in attrs))
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attrs):
        self.handle_starttag(tag, attrs)
        if tag not in self.VOID:
            self.open.pop()

    def handle_endtag(self, tag):
        if tag not in self.VOID:
            assert self.open.pop() == tag


def assert_whole(page, home, files=frozenset()):
    """Elements close, ids differ, and addresses are of the page, of its figures, or of files."""
    parser = Wellformed()
    parser.feed(page)
    assert parser.open == []
    assert len(parser.ids) == len(set(parser.ids)) > 100
    for address in parser.addresses:
        drawn = address == "figures/" and (home / address).is_dir()
        assert drawn or address.startswith(("data:image/png;base64,", "#")) or address in files
        assert address[0] != "#" or address[1:] in parser.ids
    assert files <= set(parser.addresses)
    assert not re.search(r"https?:|//fonts|@import", page)


def assert_headed(page):
    """One h1, and no heading more than one level below the one before it."""
    levels = [int(level) for level in re.findall(r"<h([1-6])\b", page)]
    assert levels[0] == 1
    assert levels.count(1) == 1
    assert all(below <= above + 1 for above, below in itertools.pairwise(levels)), levels


def assert_explained(page):
    """Abbreviations are marked in words, and listed also where only a figure has them."""
    body = page[page.index("<body") :]
    words = re.sub(r"<(svg|script|abbr|pre|dl|select)\b.*?</\1>", " ", body, flags=re.DOTALL)
    bare = set(re.findall(r"(?<![\w-])[A-Z]{2,}(?!\w)", re.sub(r"<[^>]*>", " ", words)))
    assert not bare & set(rendering.ABBREVIATIONS), bare
    figures = " ".join(re.findall(r"<text[^>]*>([^<]*)<", body))
    drawn = {name for name in rendering.ABBREVIATIONS if re.search(rf"\b{name}\b", figures)}
    marked = set(re.findall(r'<abbr title="[^"]{9,}">([^<]*)</abbr>', body))
    assert marked <= set(rendering.ABBREVIATIONS)
    for name in drawn | marked:
        assert body.count(f'id="term-{name}"') == 1
    for name in marked:
        assert f'href="#term-{name}"' in body


def run_without_torch(code, folder):
    """Run a line of Python with a folder, which may import neither torch nor pyplot."""
    code += "; assert not {'torch', 'matplotlib.pyplot'} & set(sys.modules)"
    subprocess.run([sys.executable, "-c", f"import sys; {code}", str(folder)], check=True)


def accuracy_table() -> section.Table:
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
        "design", "noise", "photons", "masks", "accuracy", "low", "high", "p", "seed", "choice",
    )  # fmt: skip
    return section.Table("Test accuracy of every design, budget and seed.", heads, tuple(rows))


def example(folder) -> list[section.Section]:
    """Two experiments with what a real study has, and with words that break careless pages."""
    one = make_results(folder / "one")
    two = make_results(folder / "two", noises=("poisson", "gaussian"), budgets=(1e2, 1e3, 1e5))
    matrix = np.random.default_rng(0).normal(size=(12, 256)) / 12
    spectra = np.random.default_rng(2).normal(size=(4, 30))
    facts = {
        "versions": {"deepfsi": "0.1.0", "torch": "2.13.0", "python": "3.11.2"},
        "device": {"name": "cpu", "threads": 2, "instructions": ["avx512f", "amx_bf16"]},
        "data": {"name": SCRIPT, "hash": "5f70bf18a086007016e948b04aed3b82103a36bea417"},
        "seeds": [0, 1, 2],
        "seconds": 5321.7,
    }
    learned = section.Claim(
        "Learned masks classify better than principal components at every photon budget tested.",
        True,
        "+0.084 (0.071 to 0.097) at 10⁴ photons; +0.012 (0.006 to 0.018) at 10⁶ photons",
        "All five intervals of the difference lie above 0.",
    )
    raster = section.Claim(
        "Raster scan is better than impulse imaging.",
        False,
        "−0.762 (−0.770 to −0.754)",
        "The interval lies below 0: with the same light, each pixel is seen for 1/N of the time.",
    )
    undecided = section.Claim(
        f"The {LONG} of {SCRIPT} needs fewer masks than truncated Hadamard.",
        None,
        "−1 mask (−6 to 4)",
    )
    photon = section.Section(
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
            section.Picture(
                accuracy_figure(one),
                "Test accuracy against the photon budget, each design at its best number of masks. "
                "Bars are 95 % intervals over three seeds of training.",
                "Accuracy rises with photons; DeepFSI is above PCA.",
            ),
            section.Picture(
                count_figure(one.with_points(p for p in one.points if p.photons == 1e4)),
                "Accuracy against the number of masks; filled markers were chosen on validation "
                "data.",
                "Accuracy falls slowly with the number of masks.",
            ),
            section.Picture(
                masks.masks_figure(matrix, (16, 16), title="Learned at 10⁴ photons"),
                f"The twelve brightest masks learned on {SCRIPT}.",
                "Twelve images of masks.",
            ),
            section.Picture(
                masks.values_figure(matrix), "How their values are distributed.", "A histogram."
            ),
        ),
        claims=(learned, raster, undecided) * 3,
        tables=(
            accuracy_table(),
            section.Table("Photons needed for an accuracy of 0.8.", ("design", "photons"), ()),
        ),
        files=("photon-noise/accuracy.csv", "photon-noise/masks 10.csv"),
        command="deepfsi experiment photon-noise --data mnist --photons 1e2,1e3,1e4,1e5,1e6 "
        f"--trials 3 -o runs/paper/photon-noise # {LONG}",
        facts=facts,
    )
    read = section.Section(
        name="read-noise",
        title=f"Read noise on {SCRIPT}: Hadamard gains, and {LONG}",
        found="Hadamard gains over raster scan as theory says.",
        paper="Multiplexing helps when the noise does not grow with the light.",
        pictures=(
            section.Picture(
                accuracy_figure(two),
                "Accuracy under both noises. The budgets differ, so that both cover one axis.",
                "Two panels of accuracy against photons.",
            ),
            section.Picture(
                masks.masks_figure(spectra, (30,)), "Masks for spectra.", "Four curves."
            ),
        ),
        claims=(raster, undecided),
        tables=(accuracy_table(),),
        files=(),
        command="deepfsi experiment read-noise",
        facts={},
    )
    return [photon, read]
