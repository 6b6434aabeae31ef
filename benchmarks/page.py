"""Time of the page that `deepfsi page` writes, in headless Chromium, and its size.

    python benchmarks/page.py                 # 96 masks of 32x32 and a 512-256 network, untrained
    python benchmarks/page.py digits.html     # a page of yours

The design has signed masks on one device, both rails read, and random weights: they do not
matter to the time, and are the hardest to deflate. Milliseconds, medians: one classification, or
on a page of adaptive masks one look, and a new exposure with all that is drawn of it. Needs
chromium and chromedriver.
"""

import argparse
import shutil
import tempfile
import time
from pathlib import Path

import numpy as np
import torch
from selenium import webdriver
from selenium.webdriver.chrome.service import Service

from deepfsi.datasets.arrays import from_arrays
from deepfsi.design.design import Design
from deepfsi.design.networks import Mlp
from deepfsi.evaluation.page_data import playable
from deepfsi.exposure.kind import MaskExposure
from deepfsi.jobs.exposures import FixedEntry
from deepfsi.physics.detection import Detection, Rails
from deepfsi.physics.laws import light_law
from deepfsi.report.demo import write_page

MEASURE = """
const { page, model } = window.playground;
const median = (act, count) => {
  const times = Array.from({ length: count }, () => {
    const began = performance.now();
    act();
    return performance.now() - began;
  });
  return times.sort((a, b) => a - b)[Math.floor(count / 2)];
};
if (model.prior) {
  const exposed = page.view.expose(page.scene, page.photons, 1);
  let looks = 0;
  const look = median(() => exposed.reach(++looks), model.looks);
  return [look, median(() => page.renew(), 20)];
}
const { exposure } = page;
const { counts, dwell } = exposure.after(exposure.frames.length);
const classify = () => model.classify(counts, exposure.photons, model.masks, dwell);
const twenty = () => { for (let i = 0; i < 20; i++) classify(); };
return [median(twenty, 20) / 20, median(() => page.renew(), 20)];
"""


def large_page(path: Path) -> Path:
    """Page of a design of 96 masks with both rails read and a 512-256 network."""
    generator = torch.Generator().manual_seed(0)
    rng = np.random.default_rng(0)
    scenes = from_arrays(rng.random((100, 32, 32)), np.arange(100) % 10, name="noise")
    signs = torch.randn(96, 1024, generator=generator)
    exposure = MaskExposure(
        entry=FixedEntry(),
        rails=Rails.of(light_law("free-dwell").fit(signs)),
        light="free-dwell",
        image_shape=(32, 32),
        detection=Detection("both"),
        summed_reflectance=float(scenes.x_train.sum(axis=1).mean()),
        mean=torch.zeros(192),
        std=torch.ones(192),
        shares=torch.ones(192) / 192,
    )
    classifier = Mlp(192, 10, (512, 256), generator=generator)
    design = Design("deepfsi", scenes.classes, exposure, classifier)
    return write_page(path, playable(design, scenes))


def measure(page: Path) -> tuple[float, float]:
    """Milliseconds of a classification, or of an adaptive look, and of a new exposure."""
    options = webdriver.ChromeOptions()
    options.binary_location = shutil.which("chromium") or ""
    service = Service(executable_path=shutil.which("chromedriver"))
    with tempfile.TemporaryDirectory() as profile:
        for flag in ("--headless=new", "--no-sandbox", f"--user-data-dir={profile}"):
            options.add_argument(flag)
        with webdriver.Chrome(options=options, service=service) as browser:
            browser.get(page.resolve().as_uri())
            while not browser.execute_script("return window.playground !== undefined"):
                time.sleep(0.1)
            classification, renewal = browser.execute_script(MEASURE)
    return classification, renewal


def main(words: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("page", type=Path, nargs="?")
    given = parser.parse_args(words).page
    if given and not given.is_file():
        parser.error(f"no page at {given}")
    with tempfile.TemporaryDirectory() as folder:
        page = given or large_page(Path(folder) / "page.html")
        classification, renewal = measure(page)
        print(f"size: {page.stat().st_size / 1e6:.2f} MB")
    print(f"one classification, or one adaptive look: {classification:.2f} ms")
    print(f"a new exposure, drawn: {renewal:.1f} ms")


if __name__ == "__main__":
    main()
