"""From counts to classes: the counts of a run, or of a table of any counter.

The classifier of the design, as it was shown, takes the counts of an exposure less the dark counts,
and its budget. Before that, all counts together are compared with those of the training.
"""

import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from deepfsi.base.errors import InputError
from deepfsi.base.tables import read_table
from deepfsi.camera.camera import Camera
from deepfsi.camera.dead_time import NO_DEAD_TIME
from deepfsi.camera.light import check_budget
from deepfsi.counting.acquisition import Scene
from deepfsi.counting.checks import Fault, find_late
from deepfsi.counting.counts import Counts
from deepfsi.counting.recording import Recording
from deepfsi.counting.tables import TableSettings, count_table
from deepfsi.designfile.misfit import FALSE_ALARM
from deepfsi.designfile.provenance import was_trained_on
from deepfsi.lab.count_test import CountTest
from deepfsi.lab.design_data import design_rails, open_design, shown_design
from deepfsi.lab.results import (
    LOG,
    ClassifiedRun,
    ClassifiedScene,
    lag_remarks,
    mark_early,
    read_log,
)
from deepfsi.patterns.folder import Patterns

if TYPE_CHECKING:  # they import torch, which the command line loads late
    from deepfsi.design.design import Design


def classify_run(
    design: str | os.PathLike[str],
    folder: str | os.PathLike[str],
    *,
    photons: float | None = None,
    force: bool = False,
    trust: bool = False,
) -> ClassifiedRun:
    """Classify each exposure of an acquisition that was counted.

    Parameters
    ----------
    design : str or path
        Design file whose patterns were shown, or the folder of its patterns.
    folder : str or path
        Folder of the acquisition, with its counts.
    photons : float, optional
        Budget Φ of an exposure, counts. Default: from each scene's all-ON frames.
    force : bool
        Classify even if the counts do not look like those of the training.
    trust : bool
        Run the factory of a custom classifier in the design file.

    Returns
    -------
    ClassifiedRun
        `scenes`, each with its `predicted` class: for a live run those that were decided while it
        was recorded.

    Raises
    ------
    InputError
        If files are missing, damaged or do not fit, no exposure is sound, or the counts do not look
        like those of the training.

    Examples
    --------
    >>> import deepfsi
    >>> run = deepfsi.classify_run("small-dmd.safetensors", "run_0001")  # doctest: +SKIP
    >>> [scene.predicted for scene in run.scenes]  # doctest: +SKIP
    ['0', '1']
    """
    path = Path(folder)
    recorded = Recording.read(path)
    if recorded.acquisition.live and photons is None:
        return _live_answers(shown_design(Path(design), recorded.manifest), recorded, trust)
    if photons is not None:
        check_budget(photons)
    counts = recorded.read_counts()
    return _classify_counts(
        open_design(Path(design), recorded.patterns, trust=trust, static=True),
        counts,
        recorded.acquisition.scenes,
        source=str(folder),
        photons=photons,
        force=force,
    )


def _live_answers(design: Path, run: Recording, trust: bool) -> ClassifiedRun:
    """Classes of a live run by its log, which must be of the design's classes."""
    opened = open_design(design, trust=trust)
    log = read_log(run.folder)
    scenes = run.acquisition.scenes[: len(log)]
    sizes = {len(logged.chances) for logged in log}
    if len(scenes) < len(log) or not sizes <= {0, len(opened.classes)}:
        raise InputError(f"{run.folder / LOG} does not fit the run's settings: it was changed")
    trained = was_trained_on(opened.training_scenes, [scene.hash for scene in scenes])
    tested = CountTest(opened).usual is not None
    answers = [
        logged.answer(scene, opened.classes, known, tested)
        for scene, logged, known in zip(scenes, log, trained, strict=True)
    ]
    return ClassifiedRun(
        title="a live run, as it was decided",
        noun="scene",
        classes=opened.classes,
        scenes=mark_early(answers),
        remarks=lag_remarks(scenes),
        faults=tuple(fault for logged in log for fault in logged.faults),
    )


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
        A row for each exposure with a value for each frame, in the order of the patterns: .csv,
        .parquet, .npy or .mat (``FILE:VARIABLE``).
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
    >>> from deepfsi.counting.tables import TableSettings
    >>> digits = deepfsi.load_dataset("digits")
    >>> few = deepfsi.Training(epochs=1)
    >>> design = deepfsi.learn(digits, camera="dmd", photons=1e4, masks=6, training=few)
    >>> rates = design.exposure.rates(design.scanner(), torch.from_numpy(digits.x_test[:5]))
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     file, table = design.save(f"{folder}/one.safetensors"), f"{folder}/counts.npy"
    ...     numpy.save(table, numpy.random.default_rng(0).poisson(1e4 * rates[:, 0].detach()))
    ...     run = deepfsi.classify_table(file, table, TableSettings(photons=1e4))
    >>> len(run.scenes), run.scenes[0].photons
    (5, 10000.0)
    """
    patterns = Patterns.read(design) if Path(design).is_dir() else None
    opened = open_design(Path(design), patterns, trust=trust, static=True)
    settings = (settings or TableSettings()).model_copy(update={"clicks": opened.camera.clicks})
    if camera:
        dead_time = Camera.of_run(opened.camera, **camera).counter_dead_time
        settings = settings.model_copy(update={"dead_time": dead_time or NO_DEAD_TIME})
    if patterns is not None:
        manifest = patterns.manifest
    elif settings.settle_s or settings.dead_time.seconds:
        raise InputError(
            f"`settle` and `dead_time` need the times of the frames, and {design} has none: give "
            "the folder of its patterns"
        )
    else:
        manifest = design_rails(design).without_device()
    counts, scenes = count_table(
        read_table(Path(table), TableSettings.WORDS), manifest, settings, str(table)
    )
    return _classify_counts(
        opened, counts, scenes, source=str(table), photons=settings.photons, force=force
    )


def _classify_counts(
    design: "Design",
    counts: Counts,
    scenes: Sequence[Scene],
    *,
    source: str,
    photons: float | None,
    force: bool,
) -> ClassifiedRun:
    """Classes of the scenes of a source, at a budget if one is stated.

    `InputError` if none can be classified, or the counts do not look like the training's. Shapes: S
    scenes, R exposures of each.
    """
    from deepfsi.exposure.training_set import check_classes

    check_classes(design.values, "a classified run")
    if counts.gates != design.camera.clicks:
        counted, wanted = (
            "photons" if gates is None else f"clicks of {gates} gates a frame"
            for gates in (counts.gates, design.camera.clicks)
        )
        raise InputError(
            f"{source} was counted in {counted}, and this design reads {wanted}: count again with "
            "`deepfsi camera count`"
        )
    if photons is None:
        counts.check_budget(source)
    stated = counts.photons if photons is None else np.full(len(scenes), photons)
    lit = stated > 0  # dark counts that are stated may be more than all
    budgets = np.where(lit, stated, 1.0)
    test = CountTest(design)
    to_be_dark = test.to_be_dark(scenes)
    seen = counts.signal().reshape(len(scenes), -1).sum(axis=1)
    seen /= counts.valid.sum(axis=1).clip(min=1)
    dim = [] if force else test.find_dim(stated)
    wrong = [*dim, *find_late(to_be_dark, seen), *test.find_repeated(counts)]
    counts = replace(counts, faults=(*wrong, *counts.faults))
    usable = counts.valid & (lit & ~counts.spoilt & ~to_be_dark)[:, None]  # (S, R)
    if not usable.any():
        forced = "; `force` classifies them all the same" if dim else ""
        reason = f" ({counts.faults[0]})" if counts.faults else ""
        raise InputError(
            f"{source} has no exposure that can be classified{reason}: record again{forced}"
        )
    # The tests take scenes for independent, which exposures of one scene are not
    exposures = counts.expand_to_counts(usable)
    number = exposures.sum(axis=1)
    sums = design.readouts(counts.signal().sum(axis=1, where=exposures))
    noise = counts.background.clip(min=0) * number + counts.excess.sum(axis=1, where=exposures)
    noise = design.readouts(noise)
    light = budgets * usable.sum(axis=1)
    tested = test.usual is not None
    unlike: list[bool | None] = [None] * len(scenes)
    view = None
    for scene in np.flatnonzero(light).tolist():
        budget = float(light[scene])
        if tested:
            p_value = float(design.consistency(sums[scene], budget, noise[scene]))
            faults, refused = test.find_unlike(scene, len(scenes), p_value)
            if refused and not force:
                raise InputError(f"{faults[0].detail}; `force` classifies them all the same")
            unlike[scene] = p_value < FALSE_ALARM
        if design.exposure.comparable:
            readouts = design.mask_exposure.scene_readouts(sums[scene][None], budget, noise[scene])
            view = test.see(readouts)
    if view is not None and view.refused and not force:
        raise InputError(f"{view.refusal}; `force` classifies them all the same")
    if view is not None and view.named:  # classes that are given all the same are marked
        doubt = Fault(kind="view", detail=f"the picture may be {view.likeliest}, as said below")
        counts = replace(counts, faults=(doubt, *counts.faults))
    if counts.gates is not None:
        mean = budgets[usable.any(axis=1)].mean()
        remarks = [
            "these clicks were not compared with those of the training: the test is of photon "
            f"counts. They are read for the stated budget: this is {mean:.3g} photons, that of "
            f"the training was {design.info['job']['photons']:.3g}"
        ]
    else:
        remarks = [] if tested else [NOT_COMPARED]
        remarks.append(NOT_VIEWED if view is None else view.remark or "")
    return ClassifiedRun(
        title=f"{design.name}, {design.masks} masks",
        classes=design.classes,
        scenes=tuple(_answers(design, counts, scenes, usable, budgets, unlike)),
        remarks=(*filter(None, remarks), *lag_remarks(scenes)),
        faults=counts.faults,
        view=view,
    )


NOT_COMPARED = (
    "these counts were not compared with those of the training, which takes steady light and a "
    "design of this version with 20 training scenes of each class: a scene of something else gets "
    "a class, too"
)
NOT_VIEWED = (
    "not tested for how the camera sees the scenes (mirrored, blurred, with stray light), which "
    "takes a design of this version with 100 training scenes, 20 of each class: record the "
    "reference target and use `deepfsi camera check`"
)


def _answers(
    design: "Design",
    counts: Counts,
    scenes: Sequence[Scene],
    usable: np.ndarray,
    budgets: np.ndarray,
    unlike: Sequence[bool | None],
) -> Iterator[ClassifiedScene]:
    """Class of each scene, by the mean probabilities of its usable exposures (S, R)."""
    probabilities = design.classify(design.readouts(counts.signal()), budgets[:, None])
    trained = was_trained_on(design.training_scenes, [scene.hash for scene in scenes])
    for index, scene in enumerate(scenes):
        sound = probabilities[index][usable[index]]
        answer = ClassifiedScene(
            name=scene.name,
            label=scene.label,
            trained_on=trained[index],
            faults=tuple(fault for fault in counts.faults if fault.scene in (index, None)),
            guesses=tuple(design.classes[best] for best in sound.argmax(axis=-1)),
            unlike=unlike[index],
        )
        if len(sound):
            mean = sound.mean(axis=0)
            answer = replace(
                answer,
                predicted=design.classes[mean.argmax()],
                probability=float(mean.max()),
                photons=float(budgets[index]),
            )
        yield answer
