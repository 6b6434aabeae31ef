"""Words of the field and abbreviations that the pages use, each with what it means."""

import re

from markupsafe import Markup, escape

DESIGNS = {
    "impulse": "a detector for each pixel, exposed all the time, and no masks: the most that the "
    "photons allow under photon noise, but no single-pixel camera",
    "raster": "one pixel after the other is shown, each for 1/N of the time",
    "hadamard": "all patterns of the Hadamard basis, of ±1, half of the pixels lit in each",
    "truncated-hadamard": "the Hadamard patterns of lowest spatial frequency",
    "pca": "the leading principal components of the training scenes as masks "
    "(feature-specific imaging)",
    "deepfsi": "masks learned together with the network that classifies their counts",
    "control": "the control group: DeepFSI's masks learned under read noise, with a network "
    "trained for photon noise",
    "random": "masks of random ±1",
    "lda": "linear discriminants of the classes as masks",
    "class-pairs": "differences of the classes' mean scenes as masks",
    "s-matrix": "the non-negative Hadamard patterns of spectroscopy, one rail",
    "custom": "masks of a user's own",
}
"""What each design is."""

LAWS = {
    "column": "optics split the light of each pixel among all masks at once, with a detector for "
    "each readout, which no single mirror device does",
    "equal-dwell": "one device shows one pattern after another, all for the same time",
    "free-dwell": "one device shows one pattern after another, each for a time of its own",
    "two-arm": "one device shows one mask after another; each mirror sends its light in one of two "
    "directions, both with detectors, so that none is lost",
}
"""What each light law allows, and with which optics."""

ONE_DETECTOR = ("equal-dwell", "free-dwell")
"""Light laws of one device and one detector, or one for each part of the device."""

WORDS = {
    "photon budget Φ": "mean number of photons that reach the coding device in one exposure, over "
    "the training scenes; a brighter scene sends more",
    "mask": "a pattern on the coding device: the share of each pixel's photons that is counted",
    "dwell": "share of the exposure for which a pattern is shown",
    "rail": "the counts of one sign of a mask: a mask with negative entries has two rails, whose "
    "counts are subtracted unless it is said that both are read",
    "light law": "what masks may do with the photons, which depends on the optics",
    "counts": "photons that the detectors count, in the mean over test scenes",
    "balanced accuracy": "mean of the classes' accuracies, each counting alike",
    "95 % interval": "range that holds the mean in 95 of 100 repetitions of what it covers",
}
"""Words of the field."""

ABBREVIATIONS = {
    "II": f"impulse imaging: {DESIGNS['impulse']}",
    "RS": f"raster scan: {DESIGNS['raster']}",
    "HB": f"Hadamard basis: {DESIGNS['hadamard']}",
    "TH": f"truncated Hadamard: {DESIGNS['truncated-hadamard']}",
    "FSI": f"feature-specific imaging: {DESIGNS['pca']}",
    "PCA": "principal component analysis",
    "DFSI": f"DeepFSI: {DESIGNS['deepfsi']}",
    "CG": DESIGNS["control"],
    "RND": DESIGNS["random"],
    "LDA": f"linear discriminant analysis: {DESIGNS['lda']}",
    "CP": DESIGNS["class-pairs"],
    "USER": DESIGNS["custom"],
    "AGN": "additive Gaussian noise: read noise, the same for every readout",
    "PN": "photon noise: exact Poisson counts",
    "DMD": "digital micromirror device, which shows the masks",
    "RMSE": "root-mean-square error",
    "MNIST": "handwritten digits, a common test of classifiers",
    "CIFAR": "small colour photographs of ten classes, a common test of classifiers",
    "JPEG": "a lossy format of pictures",
}
"""Abbreviations in words and figures of the pages."""

_KNOWN = re.compile(rf"(?<![\w&-])({'|'.join(ABBREVIATIONS)})(?![\w])")


class Terms:
    """Abbreviations of one page, explained where they stand and listed at its end."""

    def __init__(self) -> None:
        self._used: set[str] = set()

    @property
    def used(self) -> dict[str, str]:
        """Abbreviations so far, with what they mean."""
        return {name: words for name, words in ABBREVIATIONS.items() if name in self._used}

    def explain(self, text: object) -> Markup:
        """Text with its abbreviations marked; the first of each leads to the list."""
        return Markup(_KNOWN.sub(lambda found: self._marked(found[0]), str(escape(text))))

    def noted(self, drawn: Markup) -> Markup:
        """A figure as it is, the abbreviations of its words to be listed."""
        for text in re.findall(r"<text[^>]*>([^<]*)<", drawn):
            self._used.update(_KNOWN.findall(text))
        return drawn

    def _marked(self, name: str) -> str:
        marked = f'<abbr title="{escape(ABBREVIATIONS[name])}">{name}</abbr>'
        if name in self._used:
            return marked
        self._used.add(name)
        return f'<a class="term" href="#term-{name}">{marked}</a>'
