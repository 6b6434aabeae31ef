"""Files of pictures that tests read."""

import numpy as np
from PIL import Image
from scipy.ndimage import affine_transform


def save_images(folder, images, suffix=".png"):
    folder.mkdir(parents=True, exist_ok=True)
    for i, image in enumerate(images):
        Image.fromarray(image).save(folder / f"{i:03}{suffix}")


def copies_of(pictures, count, seed):
    """Each of pictures (n, H, W), and copies turned, scaled, sheared and shifted a little."""
    rng = np.random.default_rng(seed)
    side = pictures.shape[1]
    middle = np.full(2, (side - 1) / 2)
    out = []
    for picture in pictures:
        out.append(picture)
        for _ in range(count - 1):
            turn, shear, scale = rng.uniform(-1, 1, 3) * (0.14, 0.14, 0.08)
            cos, sin = np.cos(turn), np.sin(turn)
            matrix = (1 + scale) * np.array([[cos, -sin], [sin, cos]]) @ [[1, shear], [0, 1]]
            start = middle + rng.uniform(-0.05, 0.05, 2) * side - matrix @ middle
            out.append(affine_transform(picture, matrix, start, order=1, mode="nearest"))
    return np.array(out)
