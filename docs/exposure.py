"""Draw the moving picture of the README: one exposure with adaptive masks, from look to look.

    python docs/exposure.py -o docs/figures/exposure.svg

The training images of MNIST are all that is known before. Then one test image is exposed: counts
of each look are one Poisson draw, and the next mask is made from all counts so far. The exposure
ends when the probability of a digit is high enough. Everything moves by CSS within the file.
"""

import argparse
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

import deepfsi
from deepfsi.adaptive.posterior import AdaptivePosterior
from deepfsi.base.files import write_atomically

PHOTONS, LOOKS = 1e4, 16
"""Budget of a whole exposure, and its looks."""

THRESHOLD = 0.95
"""Probability of a digit at which an exposure ends."""

SCENE, SEED = 129, 0
"""Test image of MNIST that is shown, and the seed of its noise."""

GREYS = 16
"""Greys of a scene."""

BEGIN, SHOW, LOOP = 0.8, 9.0, 14.0
"""Seconds before the exposure, of the exposure, and of the whole picture."""

STYLE = """
svg{--paper:#fff;--ink:#1b1f24;--muted:#57606a;--faint:#e4e8ec;--lead:#c24e00;--off:#24292f}
@media(prefers-color-scheme:dark){svg{--paper:#15191e;--ink:#e8ecf0;--muted:#a5afba;--faint:#30363d;
--lead:#ff8a4c;--off:#000}}
text{font:14px system-ui,sans-serif;fill:var(--ink)}.m{fill:var(--muted)}.e{text-anchor:end}
.b{font-weight:600}.h{font:600 22px system-ui,sans-serif;fill:var(--lead)}
.bar{fill:var(--muted)}.lead{fill:var(--lead)}.faint{fill:var(--faint)}.px{shape-rendering:crispEdges}
.off{fill:var(--off)}.on{fill:#fff}.n{font-size:13px;text-anchor:middle}
.line{stroke:var(--muted);stroke-dasharray:3 3}
"""


@dataclass(frozen=True)
class Run:
    """One exposure that was stopped, and what was known on its way.

    Attributes
    ----------
    scene : array, shape (h, w)
        Reflectance.
    label : str
    masks : array of bool, shape (k, h, w)
        Mirrors ON in each look that was shown.
    counts : array, shape (k,)
    known : array, shape (k + 1, h, w)
        Mean scene before the exposure and after each look.
    chances : array, shape (k + 1, C)
        Probabilities of the digits, likewise.
    """

    scene: np.ndarray
    label: str
    masks: np.ndarray
    counts: np.ndarray
    known: np.ndarray
    chances: np.ndarray


@torch.no_grad()
def expose(scene: int, seed: int) -> Run:
    """Expose one test image until a digit is likely enough."""
    data = deepfsi.load_dataset("mnist")
    design = deepfsi.learn(data, camera="dmd", design="adaptive", masks=LOOKS, photons=PHOTONS)
    x = torch.from_numpy(data.x_test[scene])[None]
    state = AdaptivePosterior(
        design.prior_exposure.prior, 1, design.prior_exposure.optics_at(PHOTONS)
    )
    generator = torch.Generator().manual_seed(seed)
    masks, counts, known, chances = [], [], [state.scene], [state.probabilities]
    for share in design.prior_exposure.settings.shares:
        shown, counted, _ = state.look_at(x, share, generator)
        state.update(shown, counted, share)
        masks.append(shown)
        counts.append(counted)
        known.append(state.scene)
        chances.append(state.probabilities)
        if float(state.probabilities.max()) > THRESHOLD:
            break
    return Run(
        x.numpy().reshape(data.image_shape),
        data.classes[data.y_test[scene]],
        torch.cat(masks).numpy().reshape(-1, *data.image_shape) > 0,
        torch.cat(counts).numpy()[:, 0].astype(int),
        torch.cat(known).numpy().reshape(-1, *data.image_shape),
        torch.cat(chances).numpy(),
    )


class Film:
    """Elements of an SVG and their CSS animations, which all last `LOOP` seconds.

    Without animation every element stands as it does at the end.
    """

    def __init__(self) -> None:
        self.parts: list[str] = []
        self.rules: list[str] = []

    def add(self, part: str) -> None:
        """Add an element."""
        self.parts.append(part)

    def moving(
        self, part: str, prop: str, values: list[tuple[float, str]], steps: bool = False
    ) -> None:
        """Add an element, ``<tag …>``, one of whose properties moves.

        Parameters
        ----------
        part : str
            With ``@`` where its class goes.
        prop : str
            CSS property.
        values : list of (float, str)
            Seconds and the value from then on, or reached then if it moves evenly.
        steps : bool
            If it changes at once.
        """
        name = f"a{len(self.rules)}"
        frames = "".join(f"{100 * at / LOOP:.2f}%{{{prop}:{value}}}" for at, value in values)
        last = f"100%{{{prop}:{values[-1][1]}}}"
        self.rules.append(
            f"@keyframes {name}{{{frames}{last}}}.{name}{{{prop}:{values[-1][1]};"
            f"animation:{name} {LOOP:g}s {'step-end' if steps else 'linear'} infinite}}"
        )
        self.add(part.replace("@", name))

    def between(self, part: str, since: float, until: float | None = None) -> None:
        """Add an element that is seen for a time, or from a time to the end."""
        values = [(0.0, "0"), (since, "1")] if since > 0 else [(0.0, "1")]
        self.moving(part, "opacity", values + ([(until, "0")] if until else []), steps=True)

    def svg(self, width: int, height: int, words: str) -> bytes:
        """Content of the file, with what a reader who cannot see it is told."""
        still = "@media(prefers-reduced-motion:reduce){*{animation:none!important}}"
        return (
            f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" '
            f'width="{width}" height="{height}" role="img" aria-label="{words}">'
            f"<style>{STYLE}{''.join(self.rules)}{still}</style>"
            f'<rect class="paper" width="{width}" height="{height}" rx="8" '
            f'style="fill:var(--paper)"/>{"".join(self.parts)}</svg>\n'
        ).encode()


def cells(lit: np.ndarray) -> str:
    """Path of the cells of a picture that are lit, each row's runs as rectangles of height 1."""
    path = []
    for row, line in enumerate(lit):
        edges = np.flatnonzero(np.diff(np.r_[0, line.astype(np.int8), 0]))
        for left, right in zip(edges[::2], edges[1::2], strict=True):
            path.append(f"M{left} {row}h{right - left}v1h{left - right}z")
    return "".join(path)


def grey_picture(picture: np.ndarray, greys: int) -> str:
    """Paths of the cells of each grey of a picture, black left out."""
    grey = np.rint((greys - 1) * picture.clip(0, 1)).astype(int)
    shades = {level: 3 * f"{255 * level // (greys - 1):02x}" for level in np.unique(grey) if level}
    return "".join(
        f'<path fill="#{shade}" d="{cells(grey == level)}"/>' for level, shade in shades.items()
    )


def draw_scene(film: Film, scene: np.ndarray) -> None:
    """Draw the scene that is exposed."""
    film.add('<text class="b" x="16" y="28">Scene</text>')
    film.add('<rect class="off" x="16" y="40" width="160" height="160"/>')
    film.add('<g class="px" transform="translate(16 40) scale(5)">')
    film.add(f"{grey_picture(scene, GREYS)}</g>")


def draw_known(film: Film, run: Run, times: np.ndarray) -> None:
    """Draw the scene as it is known from the counts so far."""
    film.add('<text class="b" x="16" y="236">The scene as it</text>')
    film.add('<text class="b" x="16" y="254">is known by then</text>')
    film.add('<rect class="off" x="16" y="264" width="160" height="160"/>')
    starts, ends = np.r_[0.0, times], [*times, None]
    for picture, since, until in zip(run.known, starts, ends, strict=True):
        film.between(
            '<g class="px @" transform="translate(16 264) scale(5)">'
            f"{grey_picture(picture, GREYS)}</g>",
            float(since),
            until,
        )


def draw_masks(film: Film, run: Run, times: np.ndarray) -> None:
    """Draw the masks one after another, and the counts behind each as they arrive."""
    step, foot, tall = 504 / LOOKS, 408, 120 / run.counts.max()
    starts = np.r_[BEGIN, times[:-1]]
    film.add('<rect class="off" x="200" y="40" width="160" height="160"/>')
    film.add('<text class="b" x="200" y="248">Photons counted in each look</text>')
    film.add(f'<rect class="faint" x="200" y="{foot}" width="504" height="1.5"/>')
    for place, (since, until, count) in enumerate(zip(starts, times, run.counts, strict=True)):
        last = place == len(times) - 1
        end = None if last else until
        film.between(
            f'<g class="@"><text class="b" x="200" y="28">Mask {place + 1} of {LOOKS}</text>'
            f'<path class="px on" transform="translate(200 40) scale(5)" '
            f'd="{cells(run.masks[place])}"/></g>',
            since if place else 0.0,
            end,
        )
        film.moving(
            f'<rect class="lead @" x="{200 + step * place + 2:.1f}" y="{foot - tall * count:.1f}" '
            f'width="{step - 4:.1f}" height="{tall * count:.1f}" '
            f'style="transform-origin:0 {foot}px"/>',
            "transform",
            [(0, "scaleY(0)"), (since, "scaleY(0)"), (until, "scaleY(1)")],
        )
        film.between(
            f'<text class="n @" x="{step * (place + 0.5) + 200:.1f}" '
            f'y="{foot - tall * count - 4:.1f}">{count}</text>',
            until,
        )
        film.between(
            f'<text class="m e @" x="704" y="248">{run.counts[: place + 1].sum():,} so far</text>',
            until,
            None if last else times[place + 1],
        )


def draw_chances(film: Film, run: Run, times: np.ndarray) -> None:
    """Draw the probability of each digit after each look."""
    wide = 250
    film.add('<text class="b" x="392" y="28">Probability of each digit</text>')
    for digit, line in enumerate(run.chances.T):
        y = 40 + 16 * digit
        if digit == run.chances[-1].argmax():
            colours = [(0.0, "var(--muted)"), (BEGIN + SHOW, "var(--lead)")]
            film.moving('<g class="@">', "fill", colours, steps=True)
        else:
            film.add('<g class="bar">')
        film.add(f'<text class="m" x="392" y="{y + 13}">{digit}</text>')
        moves = [(0.0, line[0])]
        for at, before, after in zip(times, line[:-1], line[1:], strict=True):
            moves += [(at, before), (at + 0.15, after)]
        film.moving(
            f'<rect class="@" x="410" y="{y + 2}" width="{wide}" height="12" '
            'style="transform-origin:410px 0"/></g>',
            "transform",
            [(at, f"scaleX({chance:.3f})") for at, chance in moves],
        )
    x = 410 + wide * THRESHOLD
    film.add(f'<line class="line" x1="{x:.0f}" x2="{x:.0f}" y1="38" y2="202"/>')
    film.add(f'<text class="m" x="{x + 5:.0f}" y="53">{THRESHOLD:.0%}:</text>')
    film.add(f'<text class="m" x="{x + 5:.0f}" y="71">stop</text>')


def draw_light(film: Film, run: Run) -> None:
    """Draw how much of the light is used, and the answer."""
    end, used = BEGIN + SHOW, len(run.masks) / LOOKS
    film.add('<text class="b" x="16" y="455">Light used</text>')
    film.add('<rect class="faint" x="110" y="443" width="594" height="14" rx="3"/>')
    film.moving(
        f'<rect class="lead @" x="110" y="443" width="{594 * used:.0f}" height="14" rx="3" '
        'style="transform-origin:110px 0"/>',
        "transform",
        [(0, "scaleX(0)"), (BEGIN, "scaleX(0)"), (end, "scaleX(1)")],
    )
    answer, sure = run.chances[-1].argmax(), run.chances[-1].max()
    lines = (f"{sure:.0%} sure after", f"{len(run.masks)} looks and", f"{run.counts.sum()} photons")
    x = 220 + 504 * used
    words = "".join(
        f'<text x="{x:.0f}" y="{336 + 20 * place}">{line}</text>'
        for place, line in enumerate(lines)
    )
    answer = f'<text class="h" x="{x:.0f}" y="308">It is a {answer}.</text>'
    film.between(f'<g class="@">{answer}{words}</g>', end + 0.2)


def main() -> None:
    """Write the picture, and print what its caption says."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("-o", "--out", type=Path, default=Path("docs/figures/exposure.svg"))
    out = parser.parse_args().out
    run = expose(SCENE, SEED)
    times = BEGIN + SHOW * np.arange(1, len(run.masks) + 1) / len(run.masks)
    film = Film()
    draw_scene(film, run.scene)
    draw_masks(film, run, times)
    draw_chances(film, run, times)
    draw_known(film, run, times)
    draw_light(film, run)
    words = (
        f"One exposure: {len(run.masks)} masks, each made from the counts so far, are shown one "
        f"after another, and the probability of the digit {run.chances[-1].argmax()} rises until "
        "the exposure stops."
    )
    write_atomically(out, film.svg(720, 472, words))
    print(f"label {run.label}, {len(run.masks)} looks, {run.counts.sum()} photons counted")


if __name__ == "__main__":
    main()
