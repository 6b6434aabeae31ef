"""Losses of light: they multiply to what the virtual laboratory counts, each cause by itself."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from deepfsi import learn
from deepfsi.base.errors import InputError
from deepfsi.camera.camera import Camera
from deepfsi.camera.device import Device, find_device
from deepfsi.hardware.counting.count import count_run
from deepfsi.hardware.live import losses
from deepfsi.hardware.live.losses import LightLosses
from deepfsi.hardware.live.run import plan_live, run_live
from deepfsi.hardware.patterns.folder import FrameSettings, export_patterns
from deepfsi.hardware.patterns.manifest import DesignRails, LookPlan
from deepfsi.hardware.virtual.camera import RecordingSettings, VirtualCamera, record_scenes
from deepfsi.hardware.virtual.setup import Latencies, virtual_setup
from deepfsi.lab.looks import design_rails, open_looks
from deepfsi.physics.laws import light_law
from shared.live_samples import scenes_of

DEVICE = Device(name="small", columns=36, rows=26, shortest_us=20, settle_us=5, load_us=400)
SHAPE = (3, 4)
EXPOSURE_S = 8e-3
OPTICS = [("equal-dwell", "dual"), ("free-dwell", "single"), ("two-arm", "dual")]
every_optics = pytest.mark.parametrize(("light", "rails"), OPTICS)


def design_of(light: str, rails: str, masks: int = 5, seed: int = 3) -> DesignRails:
    """Random masks of a light law."""
    wild = np.random.default_rng(seed).random((masks, 12)) - (0.5 if rails == "dual" else 0)
    fitted = light_law(light).fit(torch.from_numpy(wild), rails).numpy()
    return DesignRails(fitted, light, SHAPE, summed_reflectance=12.0)


def losses_of(light="free-dwell", rails="single", device=DEVICE, efficiency=1.0, **camera):
    """Losses of random masks on a camera."""
    described = Camera(**{"light": light, "rails": rails, "exposure": EXPOSURE_S, **camera})
    described = Camera.load(described, device=device)
    return LightLosses.of(design_of(light, rails), described, efficiency=efficiency)


@pytest.mark.parametrize(("efficiency", "dead_s"), [(1.0, 0.0), (0.3, 1e-7)])
@every_optics
def test_losses_multiply_to_what_the_virtual_laboratory_counts(
    tmp_path, light, rails, efficiency, dead_s
):
    """Photons of the mean scene arrive by the clock, and the counter has these left."""
    flux = 4e6
    found = losses_of(light, rails, efficiency=efficiency, flux=flux * efficiency, dead_time=dead_s)
    design = design_of(light, rails)
    picture_s = design.picture_s(DEVICE, EXPOSURE_S * (1 + design.two_arm))
    frames = FrameSettings(DEVICE, picture_s)
    shown = export_patterns(design, frames, tmp_path / "p").manifest
    assert shown.pass_s == pytest.approx(found.clock_s)
    scenes = 12
    camera = VirtualCamera(efficiency=efficiency, dead_time_s=dead_s)
    settings = RecordingSettings(camera, flux, EXPOSURE_S, seed=1)
    names = [str(place) for place in range(scenes)]
    record_scenes(tmp_path / "p", np.ones((scenes, *SHAPE)), names, None, tmp_path / "r", settings)
    counted = count_run(tmp_path / "r").counts.sum()
    expected = found.counted * flux * scenes * shown.pass_s
    assert found.arriving * scenes == pytest.approx(flux * scenes * shown.pass_s)
    # grey cells are whole mirrors; counts under a dead time vary less than Poisson's
    assert abs(counted - expected) <= 5 * np.sqrt(expected)
    assert np.sqrt(expected) < 0.01 * expected


def test_a_pass_holds_as_many_exposures_of_few_photons_as_fit(tmp_path):
    """Masks that take a tenth of the exposure: pictures last as long, and gates follow others."""
    design = replace(design_of("free-dwell", "single"), summed_reflectance=12.0)
    short = replace(design, rails=design.rails / 10)
    camera = Camera(device=DEVICE, exposure=EXPOSURE_S, flux=1e6)
    whole, parts = LightLosses.of(design, camera), LightLosses.of(short, camera, counted=0.04)
    assert (whole.exposures, parts.exposures) == (1, 10)
    assert parts.counted == pytest.approx(whole.counted * 0.4 / whole.throughput, rel=0.02)
    clicks = Camera(device=DEVICE, exposure=EXPOSURE_S, flux=1e6, noise="click", gates=50)
    few = LightLosses.of(short, clicks)
    arrivals = clicks.flux * few.lit[0] * few.gates_s * few.dwell / 10
    fired = 50 * (1 - np.exp(-arrivals / 50))
    assert few.registered == pytest.approx(fired.sum() / arrivals.sum())


def test_a_live_run_takes_the_time_that_is_planned(digits, tmp_path):
    """Of adaptive masks: what devices without delays of their own need, scene by scene."""
    looks = 3
    device = find_device("64x48").model_copy(update={"load_us": 700})
    design = learn(digits, design="adaptive", masks=looks, photons=1e5, camera="dmd")
    design.save(tmp_path / "a.safetensors")
    rails = design_rails(tmp_path / "a.safetensors")
    camera = Camera(device=device, exposure=EXPOSURE_S, flux=1e7)
    decision_s = 2e-3
    found = LightLosses.of(rails, camera, decision_s=decision_s)
    frames = FrameSettings(device, rails.picture_s(device, EXPOSURE_S))
    export_patterns(rails, frames, tmp_path / "p")
    (x, scenes), chooser = scenes_of(digits, 2), open_looks(tmp_path / "p")
    told = {"flux": 1e7, "camera": VirtualCamera().model_dump(mode="json"), "seed": 0}
    acquisition = plan_live(tmp_path / "p", scenes, EXPOSURE_S, looks=chooser, **told)
    delays = Latencies(display=0, command=0, block=1e-6, transfer=0)
    setup = virtual_setup(tmp_path / "p", x, acquisition, delays, decision_s=decision_s)
    steps = run_live(tmp_path / "run", tmp_path / "p", acquisition, setup, chooser)
    clocks = [step.answer.clock_s for step in steps if step.answer]
    assert len(clocks) == 2
    # virtual devices take a decision after the first and the last frames, too, which are no looks
    planned = found.clock_s + 2 * decision_s
    assert clocks == pytest.approx([planned] * 2, abs=1e-6 * (looks + 2))  # a block of the counter


LOOKS = DesignRails(
    (np.arange(12) % 2)[None, None] / 4,
    "free-dwell",
    SHAPE,
    12.0,
    looks=LookPlan(count=4, each_rail=False, first=(0.25,), shortest=0, loop_sha256=None),
)
"""One of four looks with adaptive masks."""


@pytest.mark.parametrize(
    ("rails", "change", "cause"),
    [
        (LOOKS, {"load_us": 100}, "loading"),
        (LOOKS, {"settle_us": 1}, "settling"),
        (design_of("free-dwell", "single"), {"settle_us": 1}, "settling"),
        (design_of("equal-dwell", "dual"), {"settle_us": 1}, "settling"),
    ],
)
def test_a_faster_device_changes_only_its_own_row(rails, change, cause):
    camera = Camera(light=rails.light, device=DEVICE, exposure=EXPOSURE_S, flux=1e6)
    camera = Camera.load(camera, dead_time="50ns")
    before = LightLosses.of(rails, camera, efficiency=0.5, decision_s=1e-3)
    faster = Camera.load(camera, device=DEVICE.model_copy(update=change))
    after = LightLosses.of(rails, faster, efficiency=0.5, decision_s=1e-3)
    assert after.waits_s.keys() == before.waits_s.keys()
    differ = {
        name
        for name, wait_s in before.waits_s.items()
        if after.waits_s[name] != pytest.approx(wait_s, abs=1e-12)
    }
    assert differ == {cause}
    assert after.waits_s[cause] < before.waits_s[cause]
    own = {loss.cause: loss.share for loss in after.losses if loss.cause not in after.waits_s}
    assert own == {
        loss.cause: loss.share for loss in before.losses if loss.cause not in before.waits_s
    }


@settings(max_examples=60, deadline=None)
@given(
    optics=st.sampled_from(OPTICS),
    efficiency=st.floats(0.01, 1),
    flux=st.floats(1, 1e8),
    dead_s=st.floats(0, 1e-6),
    paralysable=st.booleans(),
    share=st.floats(1e-3, 1),
)
def test_shares_are_shares_and_all_light_is_somewhere(
    optics, efficiency, flux, dead_s, paralysable, share
):
    light, rails = optics
    model = "paralysable" if paralysable else "non-paralysable"
    camera = Camera(
        light=light, rails=rails, device=DEVICE, exposure=EXPOSURE_S, flux=flux,
        dead_time=dead_s, dead_time_model=model,
    )  # fmt: skip
    found = LightLosses.of(design_of(light, rails), camera, counted=share, efficiency=efficiency)
    every = found.losses
    assert [loss.cause for loss in every] == [name for name in losses.LOSS_CAUSES if name in {
        loss.cause for loss in every
    }]  # fmt: skip
    for loss in every:
        assert -1e-12 <= loss.share <= 1
        assert -1e-12 <= loss.total <= loss.share + 1e-12
        assert loss.factor >= 1 - 1e-12
    assert sum(loss.total for loss in every) + found.counted == pytest.approx(1)
    waits = sum(loss.share for loss in every if loss.cause in found.waits_s)
    kept = [1 - loss.share for loss in every if loss.cause not in found.waits_s]
    assert found.counted == pytest.approx((1 - waits) * np.prod(kept))


def test_counts_without_a_loss_are_those_of_a_camera_that_has_none_of_it():
    dim = losses_of(efficiency=0.25, flux=1e5, dead_time="1us")
    whole = losses_of(efficiency=1.0, flux=1e5, dead_time="1us")  # flux is of counts
    live = losses_of(efficiency=0.25, flux=1e5)
    gain = {loss.cause: loss.factor for loss in dim.losses}
    assert gain["efficiency"] * dim.counted == pytest.approx(whole.counted)
    assert gain["dead_time"] * dim.counted == pytest.approx(live.counted)


def test_a_second_arm_counts_the_rest_and_tells_as_much_more_as_is_said():
    """Of two scenes of one brightness: (difference)² / mean, summed over both readouts."""
    rng = np.random.default_rng(0)
    mask = rng.random(200) < 0.2
    scene = np.ones(200)
    differ = rng.normal(size=200)
    differ -= differ.mean()
    seen = float(mask @ scene / scene.sum())
    one = (mask @ differ) ** 2 / (mask @ scene)
    both = one + (~mask @ differ) ** 2 / (~mask @ scene)
    assert both / one == pytest.approx(1 / (1 - seen))
    found = losses_of(flux=1e6)
    change = next(each for each in found.changes if "arm" in each.change)
    assert change.factor == pytest.approx(1 / found.throughput)
    assert f"{1 / (1 - found.throughput):.3g} times" in change.words
    assert not any("second arm" in each.change for each in losses_of("two-arm", "dual").changes)


def test_more_detectors_gain_only_what_dead_time_took():
    without, with_dead = losses_of(flux=1e7), losses_of(flux=1e7, dead_time="200ns")
    gain = {
        name: next(each.factor for each in found.changes if "detectors" in each.change)
        for name, found in (("none", without), ("dead", with_dead))
    }
    assert gain["none"] == pytest.approx(1)
    assert 1 < gain["dead"] < 1 / with_dead.registered


def test_clicks_lose_what_a_gate_cannot_register():
    """Of r arrivals in G gates G (1 - exp(-r / G)) fire; many gates lose nothing."""
    few, many = (losses_of(flux=1e5, noise="click", gates=gates) for gates in (10, 1_000_000))
    arrivals = few.camera.flux * few.lit[0] * few.gates_s * few.dwell
    assert few.registered == pytest.approx(
        (10 * (1 - np.exp(-arrivals / 10))).sum() / arrivals.sum()
    )
    assert many.registered == pytest.approx(1, abs=1e-3)


@pytest.mark.parametrize(
    ("camera", "message"),
    [
        ({"light": "column"}, "column is no mirror device"),
        ({"exposure": EXPOSURE_S}, "losses need"),
        ({"device": DEVICE}, "losses need"),
    ],
)
def test_a_camera_without_what_it_takes_is_refused(camera, message):
    with pytest.raises(InputError, match=message):
        LightLosses.of(design_of("free-dwell", "single"), Camera(**camera))


@pytest.mark.parametrize("efficiency", [0.0, -1.0, 1.1, float("nan")])
def test_an_efficiency_that_is_no_share_is_refused(efficiency):
    with pytest.raises(InputError, match="is not allowed: give a share above 0"):
        losses_of(efficiency=efficiency)


def test_a_faster_device_counts_more_in_the_same_time():
    found = losses_of(flux=1e6)
    change = next(each for each in found.changes if "twice" in each.change)
    saved = found.waits_s["settling"] / 2
    shorter = {**found.waits_s, "settling": saved}
    sooner = replace(found, gates_s=found.gates_s + saved, waits_s=shorter)
    assert sooner.clock_s == pytest.approx(found.clock_s)
    assert change.factor == pytest.approx(sooner.gates_s / found.gates_s)
