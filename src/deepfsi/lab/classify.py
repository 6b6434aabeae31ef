"""From counts to classes: the counts of a run, or of a table of any counter.

Counts of an exposure, less the dark counts, and its budget go to the classifier of the design as it
was shown. Before, all counts together are tested for what the design was trained for. A live run
is decided again, from its own counts, as it was.
"""

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

import numpy as np

from deepfsi.base import InputError, hash_file, require_torch
from deepfsi.base.numeric import read_table
from deepfsi.camera import LIGHT_LAWS, NO_DEAD_TIME, check_budget
from deepfsi.design.readouts import classify_readouts
from deepfsi.designfile import (
    READOUTS,
    SceneReadouts,
    ViewResult,
    ViewTest,
    scene_hashes,
    was_trained_on,
)
from deepfsi.hardware.counting import (
    Counts,
    Scene,
    TableSettings,
    Verdict,
    count_table,
    read_counts,
    read_run,
)
from deepfsi.hardware.live import LiveAnswers, LiveCounts, is_live, replay_run
from deepfsi.hardware.patterns import Manifest, Patterns, read_patterns
from deepfsi.lab.camera import camera_of, dead_time_of
from deepfsi.lab.light import dim_scenes
from deepfsi.lab.looks import open_looks
from deepfsi.lab.results import ClassifiedRun, ClassifiedScene

if TYPE_CHECKING:  # they import torch, which a live run does without
    from deepfsi.design.artifact import Design
    from deepfsi.designfile import ConsistencyResult

UNTESTED = (
    "these counts were not compared with those of the training, which takes 50 training scenes of "
    "each class: a scene of something else gets a class, too"
)
"""Remark on counts of a design without a distribution."""


NO_VIEW = (
    "not tested for how the camera sees the scenes (mirrored, blurred, with stray light), which "
    "takes a design of this version with 100 training scenes, 20 of each class: record the "
    "reference target and use `deepfsi camera check`"
)
"""Remark on a run of a design without a model of its scenes."""


CLICKS = (
    "these clicks were not compared with those of the training: the test is of photon counts. "
    "They are read for the stated budget: this is {:.3g} photons, that of the training was {:.3g}"
)
"""Remark on clicks, with their budget and that of the training."""


def classify_run(
    design: str | os.PathLike[str],
    folder: str | os.PathLike[str],
    *,
    photons: float | None = None,
    force: bool = False,
    trust: bool = False,
) -> ClassifiedRun | LiveAnswers:
    """Classify each exposure of an acquisition that was counted.

    A live run, of a design of several looks, is decided again from its own counts.

    Parameters
    ----------
    design : str or path
        Design file whose patterns were shown, or the folder of its patterns.
    folder : str or path
        Of the acquisition, with its counts.
    photons : float, optional
        Budget Φ of an exposure, counts; that of each scene's all-ON frames unless given.
    force : bool
        Classify even if the counts do not look like those of the training.
    trust : bool
        As of `Design.load`: run the factory of a classifier of one's own, if there is one.

    Returns
    -------
    ClassifiedRun or LiveAnswers
        The second of a live run. Both have `scenes`, each with its `predicted` class.

    Raises
    ------
    InputError
        If files are missing, damaged or do not fit, no exposure is sound, or the counts do not look
        like those of the training.

    Examples
    --------
    >>> import deepfsi
    >>> found = deepfsi.classify_run("small-dmd.safetensors", "run_0001")  # doctest: +SKIP
    >>> [scene.predicted for scene in found.scenes]  # doctest: +SKIP
    ['0', '1']
    """
    path = Path(folder)
    verdict = None if force else Verdict.of(path)
    if verdict is not None and not verdict.fits:
        raise InputError(
            "{words}; {force} classifies them all the same", setting="force", words=verdict.words
        )
    if is_live(path, photons):
        live = LiveCounts.read(path)
        _check_design(design, live.manifest)
        return replay_run(live, open_looks(path / "patterns")).answers
    if photons is not None:
        check_budget(photons)
    recorded = read_run(path)
    counts = read_counts(recorded)
    made = _opened(design, recorded.patterns, trust)
    scenes = recorded.acquisition.scenes
    run = _CountedScenes(counts, scenes, str(folder)).classify(made, photons, force)
    return run if verdict is None else replace(run, remarks=(*run.remarks, verdict.words))


def classify_table(
    design: str | os.PathLike[str],
    table: str | os.PathLike[str],
    settings: TableSettings | None = None,
    *,
    camera: Mapping[str, Any] | None = None,
    force: bool = False,
    trust: bool = False,
) -> ClassifiedRun:
    """Classify each exposure in a table of counts, of any counter.

    Parameters
    ----------
    design : str or path
        Folder of the patterns that were shown, or the design file, which knows no times of frames.
    table : str or path
        A value for each frame, in the order of the patterns: .csv, .parquet, .npy, .mat or .h5
        (``FILE:VARIABLE``), an exposure a row or a column.
    settings : TableSettings, optional
        Budget and background in counts, times in seconds, and the like.
    camera : mapping, optional
        Fields of the camera that counted, and another as ``camera``, whose dead time is corrected.
    force, trust
        As for `classify_run`.

    Returns
    -------
    ClassifiedRun

    Raises
    ------
    InputError
        If the file is no table of these patterns, or its counts are not like the training's.

    Examples
    --------
    >>> import deepfsi, numpy, tempfile, torch
    >>> from deepfsi.hardware.counting import TableSettings
    >>> digits = deepfsi.load_dataset("digits")
    >>> few = deepfsi.Training(epochs=1)
    >>> design = deepfsi.learn(digits, camera="dmd", photons=1e4, masks=6, training=few)
    >>> rates = design.rates(design.scanner(), torch.from_numpy(digits.x_test[:5]))
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     file, table = design.save(f"{folder}/one.safetensors"), f"{folder}/counts.npy"
    ...     numpy.save(table, numpy.random.default_rng(0).poisson(1e4 * rates[:, 0].detach()))
    ...     found = deepfsi.classify_table(file, table, TableSettings(photons=1e4))
    >>> len(found.scenes), found.scenes[0].photons
    (5, 10000.0)
    """
    patterns = read_patterns(design) if Path(design).is_dir() else None
    made = _opened(design, patterns, trust)
    if READOUTS in made.info:
        return _classified_readouts(made, str(table), settings, camera)
    settings = replace(settings or TableSettings(), clicks=made.gates)
    if camera:
        dead = dead_time_of(camera_of(made.camera, **camera), camera)
        settings = replace(settings, dead_time=dead or NO_DEAD_TIME)
    manifest = _nominal(design, settings) if patterns is None else patterns.manifest
    counts, scenes = count_table(
        read_table(Path(table), TableSettings.WORDS), manifest, settings, str(table)
    )
    return _CountedScenes(counts, scenes, str(table)).classify(made, settings.photons, force)


def _classified_readouts(
    design: "Design",
    source: str,
    settings: TableSettings | None,
    camera: Mapping[str, Any] | None,
) -> ClassifiedRun:
    """Class of each recording in a table of measured readouts, a row or a column for each."""
    along = settings.exposures if settings else None
    if camera or settings not in (None, TableSettings(exposures=along)):
        raise InputError(
            "measured readouts are classified as they are: leave out all options of a table but "
            "{exposures}",
            setting="exposures",
        )
    table = read_table(source, TableSettings.WORDS)
    rows, columns = table.values.shape
    turned = along == "columns" or (along is None and columns != design.masks == rows)
    answers = classify_readouts(design, table.values.T if turned else table.values)
    count = len(answers.chances)
    names = table.words.get(TableSettings.SCENE, tuple(str(row + 1) for row in range(count)))
    labels = table.words.get(TableSettings.LABEL, ("",) * count)
    hashes = scene_hashes(answers.scenes, design.image_shape)
    scenes = tuple(
        ClassifiedScene(
            name=name,
            label=label or None,
            predicted=(best := design.classes[own.argmax()]),
            probability=float(own.max()),
            exposures=1,
            guesses=(best,),
            photons=None,
            faults=(),
            consistency=None,
            unsure=None,
            trained_on=trained,
        )
        for name, label, own, trained in zip(
            names,
            labels,
            answers.chances,
            was_trained_on(design.training_scenes, hashes),
            strict=True,
        )
    )
    remark = (
        f"{answers.outside:.1%} of the readouts of {source} lie outside of the span of those of "
        "the training's table; nothing else was tested"
    )
    return ClassifiedRun(design.name, design.masks, design.classes, scenes, (), None, (remark,))


def _nominal(file: str | os.PathLike[str], settings: TableSettings) -> Manifest:
    """Frames of a design file without patterns, or `InputError` if settings need their times."""
    if settings.settle_s or settings.dead_time.seconds:
        raise InputError(
            "{settle} and {dead_time} need the times of the frames, and {file} has none: give the "
            "folder of its patterns",
            setting=("settle", "dead_time"),
            file=file,
        )
    from deepfsi.lab.rails import design_rails

    return Manifest.from_design(design_rails(Path(file)))


def _opened(design: str | os.PathLike[str], patterns: Patterns | None, trust: bool) -> "Design":
    """Design of a file or a folder of patterns, of fixed dwells, as its patterns realise it."""
    with require_torch():
        from deepfsi.design.artifact import Design
        from deepfsi.design.values import check_classes

    file = Path(design) if patterns is None else _check_design(design, patterns.manifest)
    made = Design.load(file, trust=trust)
    check_classes(made.values, "a classified run")
    if made.exposure.chooses:
        raise InputError(f"{design} chooses dwells while the exposure runs: give a live run of it")
    return made if patterns is None else made.as_shown(*patterns.realised)


def _check_design(design: str | os.PathLike[str], manifest: Manifest) -> Path:
    """Design file, or that in a folder of patterns; `InputError` if other patterns were shown."""
    path = Path(design)
    file, known = path / Patterns.DESIGN if path.is_dir() else path, manifest.design_sha256
    if (known or manifest.looks) and hash_file(file) != known:
        raise InputError(
            f"{file} is not the design whose patterns were shown: give the file that "
            "`deepfsi dmd export` was given"
        )
    return file


@dataclass(frozen=True)
class _CountedScenes:
    """Scenes of a run or a table, and their counts."""

    counts: Counts
    scenes: Sequence[Scene]
    source: str  # run or table, as errors name it

    def classify(self, design: "Design", photons: float | None, force: bool) -> ClassifiedRun:
        """Classes of the scenes by a design as it was shown, at a budget if one is stated."""
        _check_clicks(design, self, photons)
        exposures = _SoundExposures.find(design, self, photons, force)
        consistency = exposures.compare(design)
        view = exposures.test_view(design)
        for test in (consistency, view):
            if test is not None and test.refused and not force:
                raise InputError(
                    "{refusal}; {force} classifies them all the same",
                    setting="force",
                    refusal=test.refusal,
                )
        counts = exposures.counts
        chances = design.classify(design.readouts(counts.signal()), exposures.budgets[:, None])
        trained = was_trained_on(design.training_scenes, [scene.hash for scene in self.scenes])
        some = exposures.often > 0
        chance = np.full(len(some), np.nan)
        unsure = np.zeros(len(some), bool)
        if consistency is not None:
            chance[some] = consistency.exposures
            unsure[some] = consistency.unsure
        scenes = []
        for index, scene in enumerate(self.scenes):
            sound = chances[index][exposures.usable[index]]
            mean = sound.mean(axis=0) if len(sound) else None
            scenes.append(
                ClassifiedScene(
                    name=scene.name,
                    label=scene.label,
                    predicted=None if mean is None else design.classes[mean.argmax()],
                    probability=None if mean is None else float(mean.max()),
                    exposures=len(sound),
                    guesses=tuple(design.classes[best] for best in sound.argmax(axis=-1)),
                    photons=None if mean is None else float(exposures.budgets[index]),
                    faults=counts.faults_of(index),
                    consistency=None if np.isnan(chance[index]) else float(chance[index]),
                    unsure=None if consistency is None else bool(unsure[index]),
                    trained_on=trained[index],
                )
            )
        return ClassifiedRun(
            design=design.name,
            masks=design.masks,
            classes=design.classes,
            scenes=tuple(scenes),
            faults=counts.faults,
            consistency=consistency,
            remarks=exposures.remarks(design, consistency, view),
            view=view,
        )


@dataclass(frozen=True)
class _SoundExposures:
    """Exposures of a run that can be classified, and the light of its scenes.

    Shapes: S scenes, R exposures of each.
    """

    counts: Counts  # (S, R, ...), with the faults of scenes too dim for the design
    usable: np.ndarray  # (S, R)
    budgets: np.ndarray  # (S,): Counts of an exposure; 1 where it is not known

    @classmethod
    def find(
        cls, design: "Design", counted: _CountedScenes, photons: float | None, force: bool
    ) -> Self:
        """Exposures without faults, or `InputError` if there are none."""
        counts = counted.counts
        known = np.isfinite(counts.photons) if photons is None else counts.valid.any(axis=1)
        budgets = np.where(known, counts.photons if photons is None else photons, 1.0)
        dim = () if force else dim_scenes(design, np.where(known, budgets, np.nan))
        counts = replace(counts, faults=(*dim, *counts.faults))
        usable = counts.valid & ~counts.spoilt[:, None]
        if not usable.any():
            raise InputError(
                "{source} has no exposure that can be classified ({fault}): record again"
                + "; {force} classifies them all the same" * bool(dim),
                setting="force",
                source=counted.source,
                fault=counts.faults[0],
            )
        return cls(counts, usable, budgets)

    @property
    def often(self) -> np.ndarray:
        """Number of sound exposures of each scene, (S,)."""
        return self.usable.sum(axis=1)

    @cached_property
    def sums(self) -> tuple[np.ndarray, np.ndarray]:
        """Counts of the sound exposures of each scene, and their noise beyond Poisson's."""
        counts = self.counts
        exposures = counts.by_readout(self.usable)
        number = exposures.sum(axis=1)
        noise = counts.background.clip(min=0) * number + counts.ambient_variance * number**2
        noise = noise + counts.excess.sum(axis=1, where=exposures)
        return counts.signal().sum(axis=1, where=exposures), noise

    def compare(self, design: "Design") -> "ConsistencyResult | None":
        """Comparison with the training; the exposures of a scene count as one."""
        if design.distribution is None:
            return None
        some = self.often > 0
        signal, noise = self.sums
        budget = (self.budgets * self.often)[some]
        return design.consistency(
            design.readouts(signal[some]), budget, design.readouts(noise[some])
        )

    def test_view(self, design: "Design") -> ViewResult | None:
        """Test of how the camera saw the scenes; None where it cannot be made."""
        if design.scene_model is None or self.counts.gates is not None:
            return None
        rails = design.rails.stacked.cpu().numpy().astype(float)[..., None, :]
        labels = design.detection.labels
        if labels is not None:
            rails = rails * (labels.cpu().numpy() == np.arange(design.detection.count)[:, None])
        shape = rails.shape[:-1]  # (rails, m, D)
        two_arms = LIGHT_LAWS[design.light].arms == 2
        arms = np.arange(shape[0]) if two_arms else np.zeros(shape[0], int)
        inputs = np.broadcast_to(arms[:, None, None] * shape[2] + np.arange(shape[2]), shape)
        signal, noise = self.sums
        test = ViewTest(design.scene_model, design.image_shape)
        for scene in np.flatnonzero(self.often).tolist():
            gain = self.budgets[scene] * self.often[scene] / design.summed_reflectance
            readouts = SceneReadouts(
                masks=gain * rails.reshape(-1, rails.shape[-1]),
                counts=signal[scene].ravel(),
                noise=noise[scene].ravel(),
                inputs=inputs.ravel(),
            )
            test.add(readouts)
        return test.result

    def remarks(
        self, design: "Design", consistency: "ConsistencyResult | None", view: ViewResult | None
    ) -> tuple[str, ...]:
        """Lines for a reader on the tests of the counts."""
        if self.counts.gates is not None:
            return self._remarks_on_clicks(design, self.counts.gates)
        lines = (UNTESTED,) if consistency is None else tuple(consistency.remarks)
        if view is None:
            return *lines, NO_VIEW
        return (*lines, view.remark) if view.remark else lines

    def _remarks_on_clicks(self, design: "Design", gates: int) -> tuple[str, ...]:
        from deepfsi.design.clicks import full_gates

        photons = float(self.budgets[self.often > 0].mean())
        clicks = design.readouts(self.counts.signal())[self.usable]
        full = full_gates(float(clicks.mean()) / gates, photons)
        return CLICKS.format(photons, design.info["job"]["photons"]), *filter(None, [full])


def _check_clicks(design: "Design", counted: _CountedScenes, photons: float | None) -> None:
    """Raise `InputError` unless counts are of the kind that a design reads, and of some budget."""
    counts = counted.counts
    if counts.gates != design.gates:
        words = [
            "photons" if gates is None else f"clicks of {gates} gates a frame"
            for gates in (counts.gates, design.gates)
        ]
        raise InputError(
            f"{counted.source} was counted in {words[0]}, and this design reads {words[1]}: count "
            "again with `deepfsi camera count`"
        )
    if counts.gates is not None and photons is None:
        counts.check_budget(counted.source)
