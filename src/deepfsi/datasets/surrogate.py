"""A simulated Indian Pines: plausible spectra on the real label map. It is not the real scene.

Reflectance of a pixel is a linear mixture of endmembers: green vegetation, crop residue, soil,
stone, metal and shade. Shares and leaf chemistry differ by class, by field, smoothly within a
field, and from pixel to pixel; the class means follow agronomy in June, when corn and soybeans
have just emerged and most of what a row-crop pixel shows is soil and residue. The scene is blurred
by the optics, so that pixels at field borders mix. What the sensor then reads is radiance,

    L = E0 cos(zenith) / pi · (T rho + path),   DN = 1000 + 500 L,

with the sun as a black body of 5778 K, T the transmittance of the air with its water bands, L in
µW/(cm² nm sr) and DN the public file's unit. Absorption profiles are Gaussians and sigmoids at the
known wavelengths. Shares and variances were chosen by hand, so that classifiers confuse the classes
that they are reported to confuse in the real scene; no number here was measured there.
"""

import numpy as np
import numpy.typing as npt
from scipy.ndimage import distance_transform_edt, gaussian_filter, label

Floats = npt.NDArray[np.float64]

ENDMEMBERS = ("vegetation", "residue", "soil", "stone", "metal", "shade")
"""Covers of the ground, of which a pixel is a mixture."""

CLASSES: dict[str, tuple[float, ...]] = {
    "Alfalfa": (0.78, 0.03, 0.12, 0.002, 0.001, 0.07, 1.15, 1.10),
    "Corn-notill": (0.20, 0.40, 0.36, 0.002, 0.001, 0.04, 0.82, 0.80),
    "Corn-mintill": (0.20, 0.22, 0.54, 0.002, 0.001, 0.04, 0.82, 0.80),
    "Corn": (0.24, 0.10, 0.62, 0.002, 0.001, 0.04, 0.82, 0.80),
    "Grass-pasture": (0.58, 0.16, 0.18, 0.002, 0.001, 0.07, 0.95, 0.80),
    "Grass-trees": (0.68, 0.06, 0.10, 0.002, 0.001, 0.15, 1.02, 0.95),
    "Grass-pasture-mowed": (0.42, 0.32, 0.22, 0.002, 0.001, 0.03, 0.80, 0.60),
    "Hay-windrowed": (0.44, 0.46, 0.07, 0.002, 0.001, 0.02, 0.62, 0.42),
    "Oats": (0.58, 0.10, 0.24, 0.002, 0.001, 0.06, 0.88, 0.95),
    "Soybean-notill": (0.14, 0.42, 0.40, 0.002, 0.001, 0.03, 1.00, 1.00),
    "Soybean-mintill": (0.14, 0.23, 0.59, 0.002, 0.001, 0.03, 1.00, 1.00),
    "Soybean-clean": (0.15, 0.08, 0.73, 0.002, 0.001, 0.03, 1.00, 1.00),
    "Wheat": (0.46, 0.38, 0.10, 0.002, 0.001, 0.04, 0.52, 0.50),
    "Woods": (0.62, 0.03, 0.02, 0.002, 0.001, 0.32, 1.20, 1.15),
    "Buildings-Grass-Trees-Drives": (0.46, 0.08, 0.14, 0.08, 0.05, 0.18, 1.05, 0.98),
    "Stone-Steel-Towers": (0.08, 0.10, 0.20, 0.36, 0.20, 0.05, 0.80, 0.70),
}

FIELD = 0.35
"""Standard deviation of the logarithm of a share between fields of one class."""

WITHIN = 0.33
"""Standard deviation of the logarithm of a share within a field, varying smoothly."""

SCATTER = 0.17
"""Standard deviation of the logarithm of a share from pixel to pixel."""

LEAF = 0.5
"""Variation of leaf chemistry, as a share of the three above."""

SMOOTH = 5.0
"""Standard deviation of the kernel of the smooth variation, pixels."""

SOIL_PATCH = 12.0
"""Standard deviation of the kernel of soil brightness, which heeds no fields, pixels."""

OPTICS = 0.5
"""Standard deviation of the point spread, pixels."""


@np.errstate(under="ignore")
def simulate(
    labels: npt.NDArray[np.integer], wavelengths: Floats, seed: int
) -> npt.NDArray[np.uint16]:
    """Simulate the readings of an imaging spectrometer over a label map."""
    # labels (H, W); wavelengths (B,)
    rng = np.random.default_rng(seed)
    shares, chlorophyll, water = _cover(labels, rng)
    soil_light = np.exp(0.25 * _smooth(rng, labels.shape, SOIL_PATCH))
    moisture = np.exp(0.4 * _smooth(rng, labels.shape, SOIL_PATCH))
    rho = _mixture(wavelengths, shares, chlorophyll, water, soil_light, moisture)
    slope = _smooth(rng, labels.shape, SOIL_PATCH)[..., None]
    rho *= 1 + 0.03 * slope + 0.02 * rng.standard_normal((*labels.shape, 1))
    rho = gaussian_filter(rho, (OPTICS, OPTICS, 0), mode="nearest")

    sun, air = _sunlight(wavelengths), _transmittance(wavelengths)
    radiance = sun / np.pi * (air * rho + _path(wavelengths) * np.sqrt(air))
    noise = 0.012 + 0.03 * np.exp(-((wavelengths - 400) / 500)) + 0.006 * radiance
    radiance += noise * rng.standard_normal(rho.shape)
    return np.clip(np.rint(1000 + 500 * radiance), 0, 2**16 - 1).astype(np.uint16)


# ---------------------------------------------------------------- on the ground


def _cover(
    labels: npt.NDArray[np.integer], rng: np.random.Generator
) -> tuple[Floats, Floats, Floats]:
    """Shares of the endmembers, (H, W, 6), and chlorophyll and leaf water, (H, W)."""
    nearest = distance_transform_edt(labels == 0, return_distances=False, return_indices=True)
    kinds = labels[tuple(nearest)] - 1
    means = np.log(np.array(list(CLASSES.values())))
    logs = means[kinds]
    width = np.array([1.0] * len(ENDMEMBERS) + [LEAF] * 2)
    for part in (labels > 0, labels == 0):
        for kind in range(len(CLASSES)):
            fields, count = label(part & (kinds == kind))
            offsets = rng.standard_normal((count + 1, len(width)))
            offsets[0] = 0
            logs += FIELD * width * offsets[fields]
    smooth = np.stack([_smooth(rng, labels.shape, SMOOTH) for _ in width], axis=-1)
    scatter = rng.standard_normal(logs.shape) * np.where(labels == 0, 1.5, 1)[..., None]
    logs += width * (WITHIN * smooth + SCATTER * scatter)
    values = np.exp(logs)
    shares = values[..., : len(ENDMEMBERS)]
    return shares / shares.sum(axis=-1, keepdims=True), values[..., -2], values[..., -1]


def _smooth(rng: np.random.Generator, shape: tuple[int, ...], width: float) -> Floats:
    """Gaussian random field of mean 0 and variance 1."""
    field = gaussian_filter(rng.standard_normal(shape), width, mode="wrap")
    return (field - field.mean()) / field.std()


def _mixture(
    nm: Floats,
    shares: Floats,
    chlorophyll: Floats,
    water: Floats,
    soil_light: Floats,
    moisture: Floats,
) -> Floats:
    """Reflectance, (H, W, B)."""
    leaf = _leaf(nm, chlorophyll[..., None], water[..., None])
    residue = 0.42 * (1 - np.exp(-(nm - 320) / 480))
    residue = residue * np.exp(
        -0.13 * _peak(nm, 2100, 70)
        - 0.07 * _peak(nm, 1730, 40)
        - 0.12 * _peak(nm, 2310, 60)
        - 0.10 * _peak(nm, 1450, 60)
        - 0.15 * _peak(nm, 1930, 70)
    )
    soil = 0.27 * (1 - np.exp(-(nm - 300) / 750)) * np.exp(-0.06 * _peak(nm, 880, 90))
    wet = (
        0.06 * _peak(nm, 1410, 30)
        + 0.14 * _peak(nm, 1920, 50)
        + 0.07 * _peak(nm, 2205, 30)
        + 0.08 * _step(nm, 1500, 250)
    )
    soil = soil_light[..., None] * soil * np.exp(-wet * moisture[..., None])
    stone = 0.36 * (1 - np.exp(-(nm - 250) / 260)) * np.exp(-0.15 * _peak(nm, 2335, 45))
    metal = 0.26 + 0.05 * (nm - 400) / 2100
    fixed = np.stack([residue, stone, metal, np.full_like(nm, 0.012)])
    mixed: Floats = shares[..., [1, 3, 4, 5]] @ fixed
    mixed += shares[..., 0, None] * leaf
    mixed += shares[..., 2, None] * soil
    return mixed


def _leaf(nm: Floats, chlorophyll: Floats, water: Floats) -> Floats:
    """Reflectance of a canopy: a bright plateau, eaten away by pigments and water."""
    edge = 703 + 12 * np.log(chlorophyll)
    pigment = 2.3 * _step(-nm, -edge, 13) * (1 - 0.38 * _peak(nm, 552, 38))
    pigment = pigment + 0.35 * _peak(nm, 672, 18) + 0.4 * _step(-nm, -500, 20)
    wet = (
        0.07 * _peak(nm, 975, 28)
        + 0.17 * _peak(nm, 1195, 45)
        + 0.30 * _step(nm, 1320, 35)
        + 0.80 * _peak(nm, 1450, 65)
        + 0.55 * _step(nm, 1860, 35)
        + 1.00 * _peak(nm, 1945, 80)
        + 0.60 * _step(nm, 2320, 80)
    )
    dry = 0.10 * _step(nm, 1500, 300)
    return 0.50 * np.exp(-(chlorophyll**0.6) * pigment - water * wet - dry)


def _peak(nm: Floats, centre: float, width: float) -> Floats:
    return np.exp(-(((nm - centre) / width) ** 2) / 2)


def _step(nm: Floats, centre: float | Floats, width: float) -> Floats:
    return 1 / (1 + np.exp(-(nm - centre) / width))


# ---------------------------------------------------------------- in the air


def _sunlight(nm: Floats) -> Floats:
    """Irradiance on the ground above the air, µW/(cm² nm), the sun 25 degrees from the zenith."""
    metres = nm * 1e-9
    planck = 1.191e-16 / metres**5 / np.expm1(1.4388e-2 / metres / 5778)  # W/(m² m sr)
    return planck * 6.8e-5 * 1e-7 * np.cos(np.radians(25))


def _transmittance(nm: Floats) -> Floats:
    """Share of light that passes the air down and up again."""
    depth = (
        0.10 * _peak(nm, 600, 50)  # ozone
        + 0.35 * _peak(nm, 762, 5)  # oxygen
        + 0.08 * _peak(nm, 724, 10)  # water vapour from here
        + 0.10 * _peak(nm, 822, 10)
        + 0.75 * _peak(nm, 942, 20)
        + 0.90 * _peak(nm, 1135, 25)
        + 7.0 * _peak(nm, 1385, 32)
        + 0.5 * _peak(nm, 1465, 30)
        + 8.0 * _peak(nm, 1880, 40)
        + 1.2 * _step(nm, 2480, 25)
        + 0.55 * _peak(nm, 2010, 12)  # carbon dioxide
        + 0.35 * _peak(nm, 2060, 12)
        + 0.20 * _peak(nm, 2350, 40)  # methane
    )
    return np.exp(-depth - 0.1 * (550 / nm) ** 1.3 - 0.15 * (450 / nm) ** 4)


def _path(nm: Floats) -> Floats:
    """Light that the air itself scatters into the sensor, as reflectance."""
    return 0.055 * (450 / nm) ** 4 + 0.022 * (450 / nm) ** 1.3
