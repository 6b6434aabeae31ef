"""Decisions of a live run, from counts alone: the class of each scene, and what to show next.

Each scene begins and ends with an all-ON and an all-OFF frame. Without light its first all-ON frame
is no brighter than the all-OFF ones, and it gets no class. All-ON frames of all lit scenes since
the lamp changed give the budget, since scenes differ in brightness; all-OFF frames that agree give
the dark counts. After the last look `LightMonitor` tests the scene's light as it does for recorded
scenes, and the counts are compared with the training. A scene that fails has faults and no class.

Counts are corrected for dead time frame by frame. An all-ON frame beyond the rate up to which the
correction is sure ends the run; a short gate beyond it, by chance, is corrected as at that rate.
"""

from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from deepfsi.base.errors import InputError
from deepfsi.camera.light import TOO_DIM
from deepfsi.counting.acquisition import Acquisition
from deepfsi.counting.checks import SPOILING, Fault, LightMonitor
from deepfsi.counting.counts import Corrections
from deepfsi.counting.flux import Arrivals
from deepfsi.designfile.distribution import REFUSED, UNSURE
from deepfsi.designfile.view_test import SceneReadouts, ViewResult, ViewTest
from deepfsi.lab.results import FrameList
from deepfsi.patterns.manifest import Manifest

if TYPE_CHECKING:  # it imports torch
    from deepfsi.lab.adaptive_looks import AdaptiveLooks


MARGIN_NS = 2000
"""Time by which a picture outlasts its gate at least, so that markers may be off, ns."""


def margin_ns(gate_ns: np.ndarray) -> np.ndarray:
    """Time by which pictures outlast their gates, ns."""
    # Share of its gate by which a picture outlasts it at least, so that clocks may differ
    return np.maximum(MARGIN_NS, 2e-4 * gate_ns)


ON = 0
"""Place of the all-ON frame among the frames of a manifest."""

OFF = 1
"""Place of the all-OFF frame there."""

SCENE_ENDS = -1
"""Number, in place of a look's, of the lists of frames that begin and end each scene."""


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


class SceneObserver:
    """Decisions on scene after scene of a live run, in which a design's patterns are shown."""

    def __init__(
        self, looks: "AdaptiveLooks", manifest: Manifest, acquisition: Acquisition
    ) -> None:
        assert acquisition.live is not None
        self.looks = looks
        self._manifest = manifest
        self._settings = acquisition.live
        self._exposure_ns = round(acquisition.exposure_s * 1e9)
        self._light = LightMonitor(manifest, acquisition.inputs, len(acquisition.scenes))
        self._checks = _SceneChecks(looks.photons, acquisition)
        model = looks.scene_model
        self._view = ViewTest(model, manifest.image_shape) if model else None
        self._ends = _scene_ends(manifest, acquisition.settle_s)

    def observe(self, scene: int, count: Callable[[FrameList], np.ndarray]) -> Iterator[Decision]:
        """Decisions after each look at the next scene, the last with its faults; none in the dark.

        `count` shows a list of frames and counts them.
        """
        begin = self._arrivals(count, self._ends)
        lit, changes = self._light.begin(begin)
        if not lit:
            return
        measured = self._light.flux * self._exposure_ns * 1e-9
        photons = float(self._settings.photons or measured)
        exposure = self.looks.expose(scene, photons, self._exposure_ns, self._light.dark)
        asked: list[FrameList] = []
        arrivals: list[Arrivals] = []
        light_ns = 0
        last = len(self.looks.shares) - 1
        rule = self._settings.rule
        for look in range(last + 1):
            asked.append(exposure.ask(look))
            arrivals.append(self._arrivals(count, asked[-1]))
            chances = exposure.take(asked[-1], arrivals[-1])
            light_ns += int(asked[-1].gate_ns.sum())
            decision = Decision(
                scene=scene,
                look=look,
                chances=chances,
                photons=photons,
                light_s=light_ns * 1e-9,
                final=False,
            )
            confidence = float(chances.max())
            sure = rule is not None and confidence > rule.threshold
            if sure or look == last:
                break
            yield decision
        end = self._arrivals(count, self._ends)
        faults = self._light.end([begin, *arrivals, end])
        doubts = [
            *self._checks.check_budget(scene, measured, self._light),
            *self._checks.check_counts(scene, exposure.compare(), self._on_rate([begin, end])),
        ]
        view = None
        # With other faults the counts tell nothing of how the camera sees scenes
        kinds = {fault.kind for fault in (*faults, *doubts)} - {"unsure", "unlike"}
        if self._view and not kinds & set(SPOILING):
            self._view.add(self._readouts(photons, asked, arrivals))
            view = self._view.result
        if view is not None and view.refused:
            faults += (Fault(kind="view", scene=scene, detail=view.refusal),)
        yield replace(decision, final=True, faults=(*changes, *faults, *doubts), view=view)

    def _arrivals(self, count: Callable[[FrameList], np.ndarray], asked: FrameList) -> Arrivals:
        """Photons that arrived in the gates of a list, of those that were counted."""
        counts = count(asked)
        frames = tuple(self._manifest.frames[index] for index in asked.frames)
        gate_s = asked.gate_ns * 1e-9
        corrections = Corrections.of(self._settings.dead_time, self._manifest)
        rates = counts / gate_s[:, None]
        if asked.look == SCENE_ENDS:
            corrections.check(rates[None], frames, range(self._manifest.inputs), "a scene")
        factors = corrections.factors(rates)
        return Arrivals(frames, counts * factors.arrivals, counts * factors.variance, gate_s)

    def _on_rate(self, ends: list[Arrivals]) -> float:
        """Counts/s of a scene's all-ON frames, less dark counts."""
        arm = self._manifest.arm
        counts = sum(float(end.photons[ON, arm].sum()) for end in ends)
        seconds = sum(float(end.seconds[ON]) for end in ends)
        return (counts - float(self._light.dark[arm].sum()) * seconds) / seconds

    def _readouts(
        self, photons: float, asked: list[FrameList], arrivals: list[Arrivals]
    ) -> SceneReadouts:
        """Counts of a scene, and what each of its looks showed."""
        manifest = self._manifest
        cells = manifest.detectors and manifest.detectors.cells
        of_detector = np.equal.outer(np.arange(manifest.detector_count), np.array(cells or 0))
        lit = np.concatenate([self.looks.lit(look) for look in asked])
        gate_ns = np.concatenate([look.gate_ns for look in asked])
        arms = np.stack([lit, 1 - lit][: manifest.arms], axis=1)
        masks = (arms[:, :, None] * of_detector).reshape(len(lit), manifest.inputs, -1)
        gain = photons * (gate_ns / self._exposure_ns) / manifest.summed_reflectance
        counts = np.concatenate([arrived.photons for arrived in arrivals])
        variance = np.concatenate([arrived.variance for arrived in arrivals])
        dark = self._light.dark * (gate_ns * 1e-9)[:, None]
        return SceneReadouts(
            masks=(gain[:, None, None] * masks).reshape(-1, lit.shape[-1]),
            counts=(counts - dark).ravel(),
            noise=(dark.clip(min=0) + (variance - counts).clip(min=0)).ravel(),
            inputs=np.tile(np.arange(manifest.inputs), len(lit)),
        )


def _scene_ends(manifest: Manifest, settle_s: float) -> FrameList:
    """All-ON and all-OFF frame that begin and end a scene, counted while they last."""
    rest_ns = round((settle_s + manifest.usual_tolerance_s) * 1e9) + MARGIN_NS
    pictures_us = [manifest.frames[index].picture_us for index in (ON, OFF)]
    gates = np.array([us * 1000 - rest_ns for us in pictures_us])
    if gates.min() < 1:
        raise InputError(
            f"all-ON and all-OFF frames of {manifest.frames[ON].picture_us} µs are too short "
            "to be counted: export with a longer --exposure"
        )
    return FrameList(SCENE_ENDS, np.array([ON, OFF]), gates)


class _SceneChecks:
    """Checks of scene after scene: its budget, and its counts beside the training's."""

    def __init__(self, trained: float | None, acquisition: Acquisition) -> None:
        assert acquisition.live is not None
        self._trained = trained
        self._exposure_s = acquisition.exposure_s
        self._live = acquisition.live
        self._scenes = len(acquisition.scenes)
        # Scenes up to the present one among which the unsure ones are counted
        self._unsure: deque[bool] = deque(maxlen=20)

    def check_budget(self, scene: int, measured: float, monitor: LightMonitor) -> list[Fault]:
        """Fault of a budget that is not the stated one, or too small for the design."""
        stated = self._live.photons
        trained = self._trained
        if stated is not None and monitor.contradicts(stated / self._exposure_s):
            since = monitor.since
            some = f"scenes {since} to {scene}" if since < scene else "this scene"
            detail: str = (
                f"`photons` says {stated:.4g} counts an exposure, and the all-ON frames of {some} "
                f"{measured:.4g}, further off than scenes differ: leave it out, or give that number"
            )
        elif trained is not None and measured * TOO_DIM < trained:
            detail = (
                f"all-ON frames give {measured:.4g} counts an exposure, and the design was "
                f"trained at {trained:.4g}: too little light for it; expose for longer"
            )
        else:
            return []
        return [Fault(kind="budget", scene=scene, detail=detail)]

    def check_counts(
        self, scene: int, comparison: tuple[float, str] | None, on_rate: float
    ) -> list[Fault]:
        """Faults of counts that do not look like the training's, by a chance and a text."""
        if comparison is None:
            return []
        from scipy.special import bdtrc

        chance, words = comparison
        hint = self._saturation(on_rate)
        self._unsure.append(chance < UNSURE)
        faults = []
        looked_at = len(self._unsure)
        if chance < UNSURE:
            detail = (
                f"its counts do not look like what this design was trained for (p = "
                f"{chance:.1g}; {words}){hint}"
            )
            faults.append(Fault(kind="unsure", scene=scene, detail=detail))
        unsure = sum(self._unsure)
        if bdtrc(unsure - 1, looked_at, 2 * UNSURE) * self._scenes < REFUSED:
            detail = (
                f"{unsure} of the last {looked_at} scenes do not look like those of the training: "
                "look at the light, the design, the scenes and their scale, `photons` and "
                f"`dead_time`{hint}"
            )
            faults.append(Fault(kind="unlike", scene=scene, detail=detail))
        return faults

    def _saturation(self, rate: float) -> str:
        """Words on a counter that loses photons to a dead time that was not told, at counts/s."""
        blind = 3e-8 * rate  # as many counters with their detectors are
        if self._live.dead_time.seconds or blind < 0.05:
            return ""
        return (
            f"; at {rate:.3g} counts/s a counter with a dead time of 30 ns is blind {blind:.0%} of "
            "the time: give `dead_time`, or dim the light"
        )
