"""Jobs that are refused, and the precision that they get."""

import math

import numpy as np
import pytest
import torch

from deepfsi import Camera, InputError
from deepfsi.base.progress import Progress
from deepfsi.exposure import training_set
from deepfsi.jobs.designs import sensing_matrix
from deepfsi.jobs.job import Job
from deepfsi.jobs.job import job_of as asked
from deepfsi.jobs.training import Training
from deepfsi.physics.detection import Rails
from deepfsi.physics.laws import light_law
from shared.jobs import job as job_of
from shared.jobs import learn
from shared.networks import Cnn
from shared.noises import photons, saturating

NOT_FINITE = (math.nan, math.inf)
BAD = {
    "photons": (0, -1, "abc", None, *NOT_FINITE),
    "masks": (0, 65, 10.5, math.nan, "ten"),
    "design": ("deepfsy",),
    "light": ("colum",),
    "sigma": (-0.1, *NOT_FINITE),
    "epochs": (0,),
    "batch": (1,),
    "lr": (0, *NOT_FINITE),
    "dropout": (-0.1, 1.0, math.nan),
    "dictionary": (1,),
    "hidden": ((0,), (8, 0), (1.5,)),
    "start": ("pcaa", "deepfsi", "control", "custom", "hadamard"),
    "levels": (1, -1, 2.5, 2**25),
    "seed": (1.5, 2**70),
    "device": ("tpu",),
}
TOGETHER = [
    {"light": "two-arm", "rails": "single"},
    {"design": "hadamard", "masks": 64, "rails": "single"},
    {"design": "raster", "masks": 64, "light": "two-arm"},
    {"design": "lda", "masks": 10},
    {"noise": "gaussian", "sigma": 0},
    {"design": "control", "dark": 5.0},  # its masks learn under gaussian noise
    {"design": "random", "seed": -1},
]


@pytest.mark.parametrize(
    "settings", [*({name: bad} for name, every in BAD.items() for bad in every), *TOGETHER], ids=str
)
def test_a_setting_that_is_not_allowed_is_refused(digits, settings):
    with pytest.raises(InputError):
        learn(digits, **{"photons": 1e4, "masks": 7, "epochs": 1, "device": "cpu", **settings})


@pytest.mark.parametrize(
    ("matrix", "match"),
    [
        (np.ones((6, 64)), "shape"),
        (np.full((7, 64), np.nan), "finite"),
        (np.zeros((7, 64)), "not all zero"),
        (np.full((7, 64), 0.2), "breaks the column constraint"),
        (None, "a matrix goes with"),
    ],
)
def test_a_bad_matrix_is_refused_before_training(digits, matrix, match):
    report = Progress(lambda share, what: pytest.fail("it was trained"))
    with pytest.raises(InputError, match=match):
        learn(digits, design="custom", matrix=matrix, report=report, photons=1e4, masks=7)


PHOTON_LIMIT = training_set.BFLOAT16_COUNTS


@pytest.mark.parametrize(
    ("limit", "settings"),
    [
        (20 * PHOTON_LIMIT, {}),
        (20 * PHOTON_LIMIT, {"noise": "poisson"}),
        (10 * PHOTON_LIMIT, {"rails": "single"}),
        (20 * 128, {"noise": "gaussian"}),
        (20 * 128 * 5, {"noise": "gaussian", "sigma": 5.0}),
    ],
)
def test_bfloat16_only_where_rounding_stays_under_the_noise(monkeypatch, limit, settings):
    monkeypatch.setattr(torch.cpu, "get_capabilities", lambda: {"avx512_bf16": True})
    for budget, dtype in ((limit, torch.bfloat16), (limit * 1.01, torch.float32)):
        job = job_of(masks=10, photons=budget, **settings)
        assert training_set.product_dtype(job, torch.device("cpu")) == dtype


def rounding(digits, masks: int, photons: float) -> float:
    """RMS error of bfloat16 products over photon noise, for the worst mask."""
    matrix = torch.from_numpy(sensing_matrix("pca", masks, digits)).float()
    rails = Rails.of(light_law("column").fit(matrix))
    difference, total = rails.difference, rails.total
    x = torch.from_numpy(digits.x_train)
    light = photons * x.double() / x.double().sum(dim=1).mean()
    exact, noise = light @ difference.double().T, (light @ total.double().T).sqrt()
    half = (x.bfloat16() @ difference.bfloat16().T).double() * photons / x.double().sum(1).mean()
    return float(((half - exact) / noise).square().mean(dim=0).sqrt().max())


def test_bfloat16_error_is_under_the_photon_noise_where_allowed(digits):
    assert rounding(digits, 10, 20 * PHOTON_LIMIT) < 0.5
    assert rounding(digits, 2, 1e8) > 1  # and would not be here


def test_a_job_comes_back_from_json():
    """So do the settings that were tuned, though they may be tuned otherwise by then."""
    job = job_of(
        design="raster", masks=6, photons=1e3, light="two-arm", span=10, dark=5.0, device=None,
        hidden=(8, 9), seed=4, noise="camera",
    )  # fmt: skip
    assert Job.model_validate_json(job.model_dump_json()) == job
    mine = Job(
        masks=6, photons=1e3, camera=Camera(noise=saturating), training=Training(classifier=Cnn)
    )
    written = Job.model_validate_json(mine.model_dump_json())
    assert written.camera.noise == "shared.noises:saturating"
    assert written.training.classifier == "shared.networks:Cnn"
    assert mine == mine.model_copy() != written


@pytest.mark.parametrize(
    ("settings", "match"),
    [
        ({"epochs": 3}, "epochs = 3: there is no such setting"),
        ({"exposure": {"spam": 3}}, "did you mean 'span'"),
        ({"exposure": "span"}, "exposure = 'span'"),
        ({"training": 3}, "training = 3"),
        ({"design": "pca", "training": {"start": "lda"}}, "PCA has no use for"),
        ({"photons": None}, "told once: .*or a camera with its flux"),
        ({"counts": -1.0}, "counts = -1.0: give more than 0"),
        ({"masks": None}, "masks: it is missing"),
    ],
    ids=str,
)
def test_what_is_no_job_is_refused(digits, settings, match):
    given = {"masks": 6, "photons": 1e3, **settings}
    counts = given.pop("counts", None)
    with pytest.raises(InputError, match=match):
        asked(given, digits, counts=counts)


ONE_ARM = ("column", "single", "difference", "1x1")


@pytest.mark.parametrize(
    ("settings", "optics"),
    [
        ({"camera": "dmd-2x2"}, ("free-dwell", "single", "difference", "2x2")),
        ({"camera": "two-arm"}, ("two-arm", "dual", "both", "1x1")),
        ({"camera": "dmd-2x2", "design": "impulse"}, ONE_ARM),
        ({"camera": "two-arm", "dmd": "dlp7000", "design": "impulse"}, ONE_ARM),
        ({"camera": "paper", "design": "raster"}, ONE_ARM),
        ({"camera": "dmd", "readout": "both"}, ("free-dwell", "single", "difference", "1x1")),
    ],
    ids=str,
)
def test_a_design_has_the_optics_that_it_needs(settings, optics):
    """The job keeps the camera that was given; in force is what the design has of it."""
    job = job_of(masks=6, photons=1e3, **settings)
    found = job.optics
    assert (found.light, found.rails, found.readout, found.detectors) == optics
    assert job.model_copy(update={"camera": found}).optics == found
    assert job.camera == job_of(masks=6, photons=1e3, **{**settings, "design": "deepfsi"}).camera


@pytest.mark.parametrize(
    ("camera", "others", "noise"),
    [
        ({}, {}, "ml_gauss"),
        ({"dark": 5.0}, {}, "camera"),
        ({"noise": "gaussian"}, {}, "gaussian"),
        ({"dark": 5.0}, {"training": {"noise": "none"}}, "none"),
        ({"noise": photons}, {}, "shared.noises:photons"),
    ],
)
def test_a_job_trains_under_its_cameras_noise_unless_told(camera, others, noise):
    job = Job(masks=6, photons=1e3, camera=camera, **others)
    assert job.noise == noise
    assert job.mask_job() is job
    masks = job.model_copy(update={"design": "control"}).mask_job()
    assert (masks.noise, masks.design) == ("gaussian", "deepfsi")


def test_a_device_that_cannot_show_the_scenes_is_a_fault_of_the_job(digits):
    job = Job(masks=6, photons=1e3, camera={"device": "4x4"})
    [fault] = job.faults(digits)
    assert "use a larger device or region, or fewer pixels" in fault
    assert not Job(masks=6, photons=1e3, camera={"device": "dlp7000"}).faults(digits)
