"""Pages of reports: a study to write, and what a reader and a parser see of a page."""

import itertools
import re
import subprocess
import sys
from html.parser import HTMLParser

import numpy as np

from deepfsi.report import masks, rendering
from deepfsi.report.accuracy import accuracy_figure, count_figure
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

    def handle_endtag(self, tag):  # also of an element that is closed where it opens
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
        accuracy, masks = float(rng.uniform(0.1, 0.97)), int(rng.integers(1, 1025))
        noise = ("Gaussian read noise", "photon noise")[i % 2]
        shown = (None if i % 10 == 3 else accuracy, accuracy - 0.004, accuracy + 0.004)
        chance = 10.0 ** -float(rng.integers(2, 9))
        numbers = (10.0 ** (2 + i % 5), masks, *shown, chance, 12 + i)
        rows.append((designs[i % 6], noise, *numbers, "chosen" if i % 7 == 0 else None))
    heads = (
        *("design", "noise", "photons", "masks", "accuracy"),
        *("low", "high", "p", "seed", "choice"),
    )
    return section.Table("Test accuracy of every design, budget and seed.", heads, tuple(rows))


def example(folder) -> list[section.Section]:
    """Two experiments with what a real study has, and with words that break careless pages."""
    one = make_results(folder / "one")
    two = make_results(folder / "two", noises=("poisson", "gaussian"), budgets=(1e2, 1e3, 1e5))
    matrix = np.random.default_rng(0).normal(size=(12, 256)) / 12
    best = one.with_points(point for point in one.points if point.photons == 1e4)
    raster = section.Claim(
        "Raster scan is better than impulse imaging.",
        False,
        "−0.762 (−0.770 to −0.754)",
        "The interval lies below 0: with the same light, each pixel is seen for 1/N of the time.",
    )
    claims = (
        section.Claim("Learned masks are better.", True, "+0.084 (0.071 to 0.097) at 10⁴ photons"),
        raster,
        section.Claim(f"The {LONG} of {SCRIPT} needs fewer masks.", None, "−1 mask (−6 to 4)"),
    )
    needed = section.Table("Photons needed for an accuracy of 0.8.", ("design", "photons"), ())
    drawings = {
        "Test accuracy against the photon budget. Bars are 95 % intervals.": accuracy_figure(one),
        "Accuracy against the number of masks; filled markers were chosen.": count_figure(best),
        f"The masks learned on {SCRIPT}.": masks.masks_figure(matrix, (16, 16), title="Learned"),
        "How their values are distributed.": masks.values_figure(matrix),
    }
    photon = section.Section(
        name="photon-noise",
        title="Accuracy under photon noise",
        found="DeepFSI leads at every budget. At 10⁴ photons it reaches 0.924 (0.919 to 0.929) "
        "with ten masks, PCA 0.843 (0.836 to 0.850). Impulse imaging is the bound.",
        paper="DeepFSI needs about a tenth of the photons that PCA needs for the same accuracy. "
        "Raster scan and Hadamard fall to chance below 10⁴ photons.",
        pictures=tuple(section.Picture(drawn, words, words) for words, drawn in drawings.items()),
        claims=claims * 3,
        tables=(accuracy_table(), needed),
        files=("photon-noise/accuracy.csv", "photon-noise/masks 10.csv"),
        command=f"deepfsi experiment photon-noise --data mnist -o runs/paper/photon-noise # {LONG}",
        facts={
            "versions": {"deepfsi": "0.1.0", "torch": "2.13.0", "python": "3.11.2"},
            "device": {"name": "cpu", "threads": 2, "instructions": ["avx512f", "amx_bf16"]},
            "data": {"name": SCRIPT, "hash": "5f70bf18a086007016e948b04aed3b82103a36bea417"},
            "seeds": [0, 1, 2],
            "seconds": 5321.7,
        },
    )
    spectra = masks.masks_figure(np.random.default_rng(2).normal(size=(4, 30)), (30,))
    read = section.Section(
        name="read-noise",
        title=f"Read noise on {SCRIPT}: Hadamard gains, and {LONG}",
        found="Hadamard gains over raster scan as theory says.",
        paper="Multiplexing helps when the noise does not grow with the light.",
        pictures=(
            section.Picture(accuracy_figure(two), "Accuracy under both noises.", "Two panels."),
            section.Picture(spectra, "Masks for spectra.", "Four curves."),
        ),
        claims=claims[1:],
        tables=(accuracy_table(),),
        files=(),
        command="deepfsi experiment read-noise",
        facts={},
    )
    return [photon, read]
