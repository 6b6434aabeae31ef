"""Decisions of a live run, from counts alone: the class of each scene, and what to show next.

One code serves a run and its replay. It asks for the counts of a list of frames; devices show and
count them, or a recording is looked up. So a replay that is given the same counts comes to the same
decisions, bit by bit.

Each scene begins and ends with an all-ON and an all-OFF frame. A scene whose first all-ON frame is
no brighter than the all-OFF ones has no light, and gets no class. The budget is the flux of the
all-ON frames of all lit scenes since the lamp changed, as scenes differ in brightness and a dim one
is to stay dim; the dark counts are those of the all-OFF frames that agree. After the last look the
light of the scene is tested as that of a recorded one (`LightMonitor`), and its counts against the
training (`trust`); a scene that fails has faults, and gets no class.

Where the masks' own background was measured first, with the scenes dark, it is subtracted as the
dark counts are, and what all-ON frames hold of it from the budget.

Counts are corrected for dead time frame by frame, at the rate of each. An all-ON frame beyond the
rate up to which that is sure ends the run; a short gate that is, by chance, is corrected as there.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from deepfsi.base import InputError
from deepfsi.camera import MARGIN_NS
from deepfsi.designfile import SceneReadouts, ViewResult, ViewTest
from deepfsi.hardware.counting import Acquisition
from deepfsi.hardware.light import SPOILING, Arrivals, Fault, LightMonitor
from deepfsi.hardware.live.looks import AllOn, Conditions, Count, FrameList, LiveLooks
from deepfsi.hardware.live.trust import Trust
from deepfsi.hardware.patterns.sequence import Manifest
from deepfsi.hardware.patterns.timing import usual_tolerance

ON, OFF = 0, 1
"""Places of the all-ON and the all-OFF frame among the frames of a manifest."""

WITHOUT_VIEW = set(SPOILING) - {"unsure", "unlike"}
"""Faults of a scene whose counts tell nothing of how the camera sees scenes."""

SENTINELS = -1
"""Number of the lists of frames that begin and end each scene."""


@dataclass(frozen=True)
class Decision:
    """Answer after a look at a scene."""

    scene: int  # from 0
    look: int
    chances: np.ndarray  # (C,): Probabilities of the classes
    photons: float  # budget of a whole exposure, in counts
    light_s: float  # exposure so far, seconds
    final: bool  # true if no look follows
    faults: tuple[Fault, ...] = ()  # of the scene, after its last look
    view: ViewResult | None = None  # of all scenes so far, likewise; none where it is not tested


class Observer:
    """Decisions on scene after scene of a live run."""

    def __init__(self, looks: LiveLooks, manifest: Manifest, acquisition: Acquisition) -> None:
        if acquisition.live is None or manifest.looks is None:
            raise InputError("this acquisition is no live run: make one with `deepfsi camera live`")
        self.looks, self._manifest = looks, manifest
        self._settings, self._exposure_ns = acquisition.live, round(acquisition.exposure_s * 1e9)
        self._light = LightMonitor(manifest, acquisition.inputs, len(acquisition.scenes))
        self._trust = Trust(looks.photons, acquisition)
        loaded = 0 if manifest.looks.adaptive else len(manifest.shown)
        known, shape = looks.scene_model, manifest.image_shape
        self._view = None if known is None else ViewTest(known, shape, loaded)
        self.rows: SceneReadouts | None = None  # counts of the last scene, behind its masks
        self._settle_s = acquisition.settle_s
        first = (manifest.frames[place].picture_us * 1000 for place in (ON, OFF))
        settle = acquisition.settle_s + usual_tolerance(manifest)
        gates = np.array([us - round(settle * 1e9) - MARGIN_NS for us in first])
        if gates.min() < 1:
            raise InputError(
                f"all-ON and all-OFF frames of {manifest.frames[ON].picture_us} µs are too short "
                "to be counted: export with a longer --exposure"
            )
        self._sentinels = FrameList(SENTINELS, np.array([ON, OFF]), gates)
        # Counts/s of each input in each frame of the masks that are no scene's, and their variance
        self._ambient = np.zeros((2, len(manifest.shown), manifest.inputs))

    def measure_background(self, count: Count) -> None:
        """Measure what frames count beyond the dark counts while the scenes are dark."""
        frames = np.concatenate([[ON, OFF], self._manifest.shown])
        gate = self._exposure_ns // len(self.looks.shares)
        found = self._arrivals(count, FrameList(0, frames, np.full(len(frames), gate)))
        rates = found.photons.sum(axis=1) / (gate * 1e-9)
        noise = found.variance.sum(axis=1) / (gate * 1e-9) ** 2
        count_of_arm = self._manifest.detector_count
        dark, dark_noise = (
            self._manifest.dark_inputs(each[ON], each[OFF]) for each in (rates, noise)
        )
        self._ambient = np.stack([rates - dark, noise + dark_noise])[:, 2:]
        self._light.ambient = float((rates[ON] - dark)[:count_of_arm].sum())

    def observe(self, scene: int, count: Count) -> Iterator[Decision]:
        """Decisions after each look at the next scene; none if there is no light."""
        ends = [self._arrivals(count, self._sentinels)]
        lit, changes = self._light.begin(ends[0])
        if not lit:
            return
        measured = self._light.flux * self._exposure_ns * 1e-9
        photons, rule = self._settings.photons or measured, self._settings.rule
        exposure = self.looks.expose(scene, Conditions(
            photons, self._exposure_ns, self._settings.shortest_ns, self._light.dark, self._ambient
        ))  # fmt: skip
        looks: list[Arrivals] = []
        shown: list[FrameList] = []
        light_ns = 0
        last = len(self.looks.shares) - 1
        for look in range(last + 1):
            asked = exposure.ask(look)
            shown.append(asked)
            looks.append(self._arrivals(count, asked))
            chances = exposure.take(asked, looks[-1])
            light_ns += int(asked.gate_ns.sum())
            enough = rule is not None and rule.stops(float(chances.max()), photons)
            decision = scene, look, chances, float(photons), light_ns * 1e-9
            if enough or look == last:
                break
            yield Decision(*decision, final=False)
        ends.append(self._arrivals(count, self._sentinels))
        faults = self._light.end([ends[0], *looks, ends[1]])
        on = self._all_on(ends)
        doubts = self._trust.find_faults(
            scene, exposure.compare(on), on, self._light, photons, measured
        )
        view = None
        self.rows, test = self._rows(photons, shown, looks), self._view
        if test and not any(each.kind in WITHOUT_VIEW for each in (*faults, *doubts)):
            test.add(self.rows)
            view = test.result
        if view is not None and view.refused:
            faults += (Fault(kind="view", scene=scene, detail=view.refusal),)
        faults += doubts
        yield Decision(*decision, final=True, faults=changes + faults, view=view)

    def _rows(self, photons: float, shown: list[FrameList], looks: list[Arrivals]) -> SceneReadouts:
        """Counts of a scene, and what each of its looks showed."""
        manifest, arms = self._manifest, self._manifest.inputs // self._manifest.detector_count
        cells = manifest.detectors and manifest.detectors.cells
        seen = np.equal.outer(np.arange(manifest.detector_count), np.array(cells or 0))
        inputs = np.arange(manifest.inputs)
        parts = []
        for asked, found in zip(shown, looks, strict=True):
            share = asked.gate_ns / self._exposure_ns
            lit = self.looks.lit(asked)
            both = np.stack([lit, 1 - lit][:arms], axis=1)[:, :, None] * seen  # (F, arms, D, N)
            gain = photons * share / manifest.summed_reflectance
            masks = gain[:, None] * both.reshape(-1, lit.shape[-1]).reshape(len(lit), -1)
            rows = np.searchsorted(manifest.shown, asked.frames)
            ambient, its_noise = self._ambient[:, rows]
            counts, variance = found.photons.sum(axis=1), found.variance.sum(axis=1)
            seconds = (asked.gate_ns * 1e-9)[:, None]
            dark = (self._light.dark + ambient) * seconds
            noise = dark.clip(min=0) + its_noise * seconds**2 + (variance - counts).clip(min=0)
            parts.append(
                SceneReadouts(
                    masks.reshape(-1, lit.shape[-1]),
                    (counts - dark).ravel(),
                    noise.ravel(),
                    np.tile(inputs, len(lit)),
                    np.repeat(rows, len(inputs)),
                    np.repeat(share, len(inputs)),
                )
            )
        return SceneReadouts.join(parts)

    def _arrivals(self, count: Count, asked: FrameList) -> Arrivals:
        """Photons that arrived in the gates of a list, of those that were counted."""
        found, dead = count(asked), self._settings.dead_time
        rates, most = found.counts / (asked.gate_ns * 1e-9)[:, None], dead.most_registered
        if asked.look == SENTINELS and rates.max() > most:
            raise InputError(
                f"an all-ON frame has {rates.max():.3g} counts/s, and a dead time of {dead}, is "
                f"corrected up to {most:.3g}: dim the light, or give the counter's own dead time"
            )
        factors, parts = dead.correction(np.minimum(rates, most)), found.parts.shape[1]
        each_s = np.repeat((asked.gate_ns * 1e-9 / parts)[:, None], parts, axis=1)
        opens_s = found.starts_s[:, None] + self._settle_s
        return Arrivals(
            tuple(self._manifest.frames[place] for place in asked.frames),
            found.parts * factors.arrivals[:, None],
            found.parts * factors.variance[:, None],
            each_s,
            opens_s + each_s * (np.arange(parts) + 0.5),
        )

    def _all_on(self, ends: list[Arrivals]) -> AllOn:
        """Counts of a scene's all-ON frames."""
        arm = slice(0, self._manifest.detector_count)
        counts, variance = (
            sum(float(held[ON, :, arm].sum()) for held in each)
            for each in ([one.photons for one in ends], [one.variance for one in ends])
        )
        seconds = sum(float(each.seconds[ON].sum()) for each in ends)
        dark = (float(self._light.dark[arm].sum()) + self._light.ambient) * seconds
        return AllOn(counts - dark, dark + max(variance - counts, 0.0), seconds)
