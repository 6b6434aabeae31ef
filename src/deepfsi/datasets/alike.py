"""Pictures that are alike: copies of one, turned, cut, scaled, moved or compressed again.

A picture is compared with the small deformations of another: its thumbnail is explained by the
other's brightness, contrast and the change of each pixel under a shift, turn, scale and shear.
"""

import numpy as np
import numpy.typing as npt

ALIKE = 0.94, 0.97
"""Shares of a thumbnail's variance that the deformations of another explain: of pictures that are
alike, and of copies that show a set to have some.

Of 1000 different pictures of MNIST, digits and chest X-rays groups at 0.97 are 88, 97 and 100 %.
"""

MOST_COMPARED = 8192
"""Pictures that are compared with each other, at most: it takes their square in time."""

Groups = npt.NDArray[np.int64]


def thumbnail_places(shape: tuple[int, ...]) -> tuple[range, ...]:
    """Pixels along each axis that a thumbnail has, of a picture of a shape."""
    steps = (max(1, round(side / 14)) for side in shape)
    return tuple(range(step // 2, side, step) for side, step in zip(shape, steps, strict=True))


def thumbnails(pictures: npt.NDArray[np.floating]) -> npt.NDArray[np.uint8]:
    """Blurred pictures of about 14 pixels a side, uint8, of pictures (n, H, W) in [0, 1]."""
    from scipy import ndimage

    height, width = pictures.shape[1:]
    blur = 0, height / 28, width / 28
    blurred = ndimage.gaussian_filter(np.asarray(pictures, np.float32), blur)
    rows, columns = thumbnail_places((height, width))
    small = blurred[:, rows][:, :, columns]
    return np.rint(small * 255).clip(0, 255).astype(np.uint8)


def likeness(
    pictures: npt.NDArray[np.uint8], others: npt.NDArray[np.uint8]
) -> npt.NDArray[np.float32]:
    """Share (n, k) of the variance of thumbnails (n, h, w) that each of k others explains."""
    k, height, width = others.shape
    x = others.astype(np.float32)
    down, across = np.gradient(x, axis=(1, 2))
    row, column = np.meshgrid(
        *(np.linspace(-1, 1, side, dtype=np.float32) for side in (height, width)), indexing="ij"
    )
    affine = (row * down, column * down, row * across, column * across)
    terms = np.stack([np.ones_like(x), x, down, across, *affine], axis=-1)
    basis = np.linalg.qr(terms.reshape(k, height * width, -1))[0][..., 1:]
    flat = pictures.reshape(len(pictures), -1).astype(np.float32)
    flat -= flat.mean(axis=1, keepdims=True)
    flat /= np.maximum(np.linalg.norm(flat, axis=1, keepdims=True), 1e-6)
    spans = np.moveaxis(basis, 0, 1).reshape(flat.shape[1], -1)
    blocks = np.array_split(flat, -(-len(flat) // 256))  # products of all would fill the memory
    shares = [np.square(block @ spans).reshape(len(block), k, -1).sum(axis=-1) for block in blocks]
    return np.concatenate(shares)


def groups_of_alike(pictures: npt.NDArray[np.floating], labels: npt.NDArray[np.integer]) -> Groups:
    """Number of the group (n,) of each of pictures (n, H, W): those alike, and alike to these.

    Pictures of other classes (n,) are no copies: those that are alike all the same raise the limit.
    Each picture is its own group where they are spectra, of one class, too many to compare, or
    hardly copies: where groups are more than three quarters of the pictures.
    """
    from scipy import sparse

    n = len(pictures)
    apart = np.arange(n)
    flat = pictures.ndim != 3 or min(pictures.shape) < 2
    if flat or n > MOST_COMPARED or (labels == labels[0]).all():
        return apart
    small = thumbnails(pictures)
    edges = [np.empty((3, 0))]
    strange = np.zeros(n)  # likeness to the nearest of another class
    # In random order, as the first block says whether there are copies at all
    order = np.random.default_rng(0).permutation(n)
    for rows in np.array_split(order, -(-n // 256)):
        alike = likeness(small, small[rows])
        alike[rows, np.arange(len(rows))] = 0
        other_class = labels[:, None] != labels[rows]
        strange[rows] = alike.max(axis=0, initial=0, where=other_class)
        alike[other_class] = 0
        one, other = np.nonzero(alike > ALIKE[0])
        edges.append(np.stack([one, rows[other], alike[one, other]]))
        if len(edges) == 2 and (alike > ALIKE[1]).any(axis=0).mean() < 0.2:
            return apart
    one, other, level = np.concatenate(edges, axis=1)
    least = np.quantile(strange, 0.98)
    for limit in sorted(ALIKE, reverse=True):
        kept = level > max(least, limit)
        ends = one[kept].astype(int), other[kept].astype(int)
        graph = sparse.coo_array((np.ones(kept.sum()), ends), shape=(n, n))
        count, groups = sparse.csgraph.connected_components(graph, directed=False)
        if count > 0.75 * n:
            return apart
    return groups.astype(np.int64)


def deal(groups: Groups, labels: npt.NDArray[np.integer], parts: int, seed: int) -> Groups:
    """Part (n,) of each scene, 0 .. parts - 1: those of a group together, of a class its share.

    The only group of a class gets no part, -1. Part 0 has fewest of each class.
    """
    order = np.random.default_rng(seed).permutation(len(groups))
    names, first, sizes = np.unique(groups[order], return_index=True, return_counts=True)
    kinds = labels[order[first]]
    part = np.full(len(names), -1)
    for kind in np.unique(kinds):
        own = np.flatnonzero(kinds == kind)
        # Large ones first, as the small ones then make parts even
        own = own[np.lexsort((first[own], -sizes[own]))]
        held = np.zeros(min(parts, len(own)))
        if len(held) > 1:
            for group in own:
                part[group] = held.argmin()
                held[part[group]] += sizes[group]
            part[own] = np.argsort(np.argsort(held, kind="stable"))[part[own]]
    return part[np.searchsorted(names, groups)]
