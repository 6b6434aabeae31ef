"""A headless Chromium for pages, and checks that run in it.

Needs Chromium and its driver. `.ci/run` sets `DEEPFSI_BROWSER=required`: there, a missing browser
is a failure and no reason to skip.
"""

import json
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from selenium import webdriver
from selenium.webdriver.chrome.service import Service

FLAGS = (
    "--headless=new",
    "--no-sandbox",
    "--disable-gpu",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--disable-quic",
)

OVERFLOW = "const e = document.documentElement; return e.scrollWidth - e.clientWidth"

# Elements that reach over an edge of the page, and boxes that hide a part of what they hold. What
# lies in a box that scrolls can be reached: of it, the box is looked at.
CUT = """
const page = document.documentElement.clientWidth;
const outside = box => box.left < -0.5 || box.right > page + 0.5;
const name = e => `${e.tagName} ${e.className.baseVal ?? e.className} ${e.textContent.trim()}`;
const inside = getComputedStyle(document.body).maxWidth === "none"
  ? ".scroll table" : ".scroll table, .drawing img";  // on paper nothing scrolls
const cut = [...document.querySelectorAll("body *")].filter(e => {
  const box = e.getBoundingClientRect(), style = getComputedStyle(e);
  if (!box.width || !box.height) return false;
  const hides = ["hidden", "clip"].includes(style.overflowX) && e.scrollWidth > e.clientWidth;
  return !(e instanceof SVGElement) && hides
    || (e.matches("svg, text") || !(e instanceof SVGElement)) && !e.closest(inside) && outside(box);
});
return cut.map(name).map(text => text.slice(0, 80));
"""

# Sizes of every text as it is shown, pixels, the smallest first.
SIZES = """
const written = e => [...e.childNodes].some(n => n.nodeType === 3 && n.data.trim());
const shown = e => e.getClientRects().length && written(e);
return [...document.querySelectorAll("body *:not(script)")].filter(shown).map(e => {
  const scale = e instanceof SVGElement ? Math.hypot(e.getScreenCTM().a, e.getScreenCTM().b) : 1;
  return [scale * parseFloat(getComputedStyle(e).fontSize), e.tagName, e.textContent.trim()];
}).sort((a, b) => a[0] - b[0]);
"""

# The contrast of every text with what lies behind it (WCAG 2), the lowest first. Markers that stand
# in a table as they do in a figure are no text.
CONTRASTS = """
const context = document.createElement("canvas").getContext("2d", { willReadFrequently: true });
const rgba = colour => {
  context.clearRect(0, 0, 1, 1);
  context.fillStyle = colour;
  context.fillRect(0, 0, 1, 1);
  return [...context.getImageData(0, 0, 1, 1).data];
};
const light = colour => {
  const [r, g, b] = rgba(colour).slice(0, 3).map(v => v / 255)
    .map(v => v <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4);
  return 0.2126 * r + 0.7152 * g + 0.0722 * b;
};
const behind = e => {
  while (rgba(getComputedStyle(e).backgroundColor)[3] === 0) e = e.parentElement;
  return getComputedStyle(e).backgroundColor;
};
const written = e => [...e.childNodes].some(n => n.nodeType === 3 && /[^\\s●■]/.test(n.data));
const found = [...document.querySelectorAll("body *:not(script)")].filter(written).map(e => {
  const style = getComputedStyle(e);
  const drawn = e instanceof SVGElement ? style.fill : style.color;
  const [dark, bright] = [light(drawn), light(behind(e))].sort((a, b) => a - b);
  return [(bright + 0.05) / (dark + 0.05), e.tagName, e.textContent.trim().slice(0, 40)];
});
return found.sort((a, b) => a[0] - b[0]);
"""


@contextmanager
def chromium(profile: Path) -> Iterator[webdriver.Chrome]:
    """Headless Chromium with a profile of its own; skips the test where there is none."""
    browser, driver = shutil.which("chromium"), shutil.which("chromedriver")
    if browser is None or driver is None:
        told = "needs chromium and chromedriver (Debian: apt-get install chromium chromium-driver)"
        if os.environ.get("DEEPFSI_BROWSER") == "required":
            pytest.fail(told)
        pytest.skip(told)
    options = webdriver.ChromeOptions()
    options.binary_location = browser
    for flag in (*FLAGS, f"--user-data-dir={profile}"):
        options.add_argument(flag)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
    with webdriver.Chrome(options=options, service=Service(executable_path=driver)) as chrome:
        yield chrome


def look(browser, width=1280, media="screen", height=900, still=False):
    """Set the size, the medium and the motion of a browser."""
    screen = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": False}
    motion = "reduce" if still else "no-preference"
    features = [{"name": "prefers-reduced-motion", "value": motion}]
    browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", screen)
    browser.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": media, "features": features})


def requests_of(browser: webdriver.Chrome) -> list[str]:
    """Addresses that the browser asked for since its log was last read."""
    told = [json.loads(entry["message"])["message"] for entry in browser.get_log("performance")]
    sent = [each["params"] for each in told if each["method"] == "Network.requestWillBeSent"]
    return [each["request"]["url"] for each in sent]
