"""Decisions of a live run, from counts alone: the class of each scene, and what to show next.

Each scene begins and ends with an all-ON and an all-OFF frame. A scene whose first all-ON frame is
no brighter than the all-OFF ones has no light, and gets no class. The budget is the flux of the
all-ON frames of all lit scenes since the lamp changed, as scenes differ in brightness and a dim one
is to stay dim; the dark counts are those of the all-OFF frames that agree. After the last look the
light of the scene is tested as that of a recorded one (`LightMonitor`), and its counts against the
training; a scene that fails has faults, and gets no class.

Counts are corrected for dead time frame by frame, at the rate of each. An all-ON frame beyond the
rate up to which that is sure ends the run; a short gate that is, by chance, is corrected as there.
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
from deepfsi.counting.flux import Arrivals
from deepfsi.counting.streaming import FrameCounts
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

WITHOUT_VIEW = set(SPOILING) - {"unsure", "unlike"}
"""Faults of a scene whose counts tell nothing of how the camera sees scenes."""

USUAL_DEAD_S = 3e-8
"""Dead time that a counter with its detector may well have, seconds."""


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
    """Decisions on scene after scene of a live run.

    Parameters
    ----------
    looks : AdaptiveLooks
        Of the design whose patterns are shown.
    manifest : Manifest
        Patterns that are shown.
    acquisition : Acquisition
        Settings of the run.

    Raises
    ------
    InputError
        If the acquisition is no live run, or all-ON and all-OFF frames are too short to be counted.
    """

    def __init__(
        self, looks: "AdaptiveLooks", manifest: Manifest, acquisition: Acquisition
    ) -> None:
        if acquisition.live is None or manifest.looks is None:
            raise InputError("this acquisition is no live run: make one with `deepfsi camera live`")
        self.looks = looks
        self._manifest = manifest
        self._settings = acquisition.live
        self._exposure_ns = round(acquisition.exposure_s * 1e9)
        self._light = LightMonitor(manifest, acquisition.inputs, len(acquisition.scenes))
        self._checks = _SceneChecks(looks.photons, acquisition)
        model = looks.scene_model
        self._view = ViewTest(model, manifest.image_shape) if model else None
        self._ends = _scene_ends(manifest, acquisition.settle_s)

    def observe(self, scene: int, count: Callable[[FrameList], FrameCounts]) -> Iterator[Decision]:
        """Decisions after each look at the next scene; none of one without light.

        The last one has the faults of the scene. `count` shows a list of frames and counts them.
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
        kinds = {fault.kind for fault in (*faults, *doubts)}
        if self._view and not kinds & WITHOUT_VIEW:
            self._view.add(self._readouts(photons, asked, arrivals))
            view = self._view.result
        if view is not None and view.refused:
            faults += (Fault(kind="view", scene=scene, detail=view.refusal),)
        yield replace(decision, final=True, faults=(*changes, *faults, *doubts), view=view)

    def _arrivals(self, count: Callable[[FrameList], FrameCounts], asked: FrameList) -> Arrivals:
        """Photons that arrived in the gates of a list, of those that were counted."""
        counts = count(asked)
        frames = tuple(self._manifest.frames[index] for index in asked.frames)
        gate_s = asked.gate_ns * 1e-9
        ends = frames if asked.look == SCENE_ENDS else None
        factors = counts.correct(self._settings.dead_time, self._manifest, gate_s, ends=ends)
        parts = counts.parts.shape[1]
        seconds = np.repeat((gate_s / parts)[:, None], parts, axis=1)
        return Arrivals(
            frames=frames,
            photons=counts.parts * factors.arrivals[:, None],
            variance=counts.parts * factors.variance[:, None],
            seconds=seconds,
        )

    def _on_rate(self, ends: list[Arrivals]) -> float:
        """Counts/s of a scene's all-ON frames, less dark counts."""
        arm = self._manifest.arm
        counts = sum(float(end.photons[ON, :, arm].sum()) for end in ends)
        seconds = sum(float(end.seconds[ON].sum()) for end in ends)
        return (counts - float(self._light.dark[arm].sum()) * seconds) / seconds

    def _readouts(
        self, photons: float, asked: list[FrameList], arrivals: list[Arrivals]
    ) -> SceneReadouts:
        """Counts of a scene, and what each of its looks showed."""
        manifest = self._manifest
        cells = manifest.detectors and manifest.detectors.cells
        of_detector = np.equal.outer(np.arange(manifest.detector_count), np.array(cells or 0))
        inputs = np.arange(manifest.inputs)
        readouts = []
        for look, arrived in zip(asked, arrivals, strict=True):
            share = look.gate_ns / self._exposure_ns
            lit = self.looks.lit(look)
            both = (
                np.stack([lit, 1 - lit][: manifest.arms], axis=1)[:, :, None] * of_detector
            )  # F, arms, D, N
            gain = photons * share / manifest.summed_reflectance
            masks = gain[:, None] * both.reshape(-1, lit.shape[-1]).reshape(len(lit), -1)
            counts = arrived.photons.sum(axis=1)
            dark = self._light.dark * (look.gate_ns * 1e-9)[:, None]
            excess = (arrived.variance.sum(axis=1) - counts).clip(min=0)
            readouts.append(
                SceneReadouts(
                    masks=masks.reshape(-1, lit.shape[-1]),
                    counts=(counts - dark).ravel(),
                    noise=(dark.clip(min=0) + excess).ravel(),
                    inputs=np.tile(inputs, len(lit)),
                )
            )
        return SceneReadouts.join(readouts)


def _scene_ends(manifest: Manifest, settle_s: float) -> FrameList:
    """The all-ON and the all-OFF frame that begin and end a scene, counted as long as they last."""
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
    """Checks of scene after scene: its budget, and its counts against those of the training."""

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
        """Faults of counts that do not look like those of the training, by a chance and words."""
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
        # Share of the photons lost to it from which on saturation is named
        if self._live.dead_time.seconds or rate * USUAL_DEAD_S < 0.05:
            return ""
        return (
            f"; at {rate:.3g} counts/s a counter with a dead time of {USUAL_DEAD_S * 1e9:.0f} ns "
            f"is blind {rate * USUAL_DEAD_S:.0%} of the time: give `dead_time`, or dim the light"
        )
