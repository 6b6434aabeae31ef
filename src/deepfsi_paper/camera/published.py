"""Numbers that the paper published of its camera."""

PAPER = (
    "With 92 masks (1024 for RS and HB) trained for one assumed budget, DeepFSI clearly "
    "outperforms the other designs in all digits when there are photons enough, and varies less "
    "between digits. The tests are of ten digits, each exposed ten times or more."
)
"""Finding of the paper."""

PUBLISHED: dict[str, dict[float, tuple[float, float, float]]] = {
    "deepfsi": {
        1e-1: (0.970, 0.940, 1.000), 1e-2: (0.860, 0.720, 0.960),
        1e-3: (0.670, 0.520, 0.810), 1e-4: (0.327, 0.258, 0.405),
    },
    "pca": {
        1e-1: (0.610, 0.420, 0.800), 1e-2: (0.430, 0.300, 0.560),
        1e-3: (0.270, 0.150, 0.410), 1e-4: (0.160, 0.117, 0.213),
    },
    "truncated-hadamard": {
        1e-1: (0.550, 0.350, 0.740), 1e-2: (0.370, 0.200, 0.560),
        1e-3: (0.400, 0.260, 0.540), 1e-4: (0.310, 0.190, 0.430),
    },
    "raster": {
        1e-1: (0.280, 0.000, 0.560), 1e-2: (0.210, 0.030, 0.420),
        1e-3: (0.140, 0.050, 0.260), 1e-4: (0.107, 0.057, 0.168),
    },
    "hadamard": {
        1e-1: (0.250, 0.090, 0.440), 1e-2: (0.250, 0.080, 0.440),
        1e-3: (0.230, 0.110, 0.360), 1e-4: (0.130, 0.010, 0.300),
    },
}  # fmt: skip
"""Mean and cluster-bootstrap interval, the paper's first table of its hardware experiment."""


STUDENTISED: dict[str, dict[float, tuple[float, float]]] = {
    "deepfsi": {
        1e-1: (0.939, 0.998), 1e-2: (0.515, 0.960), 1e-3: (0.477, 0.823), 1e-4: (0.253, 0.434),
    },
    "pca": {
        1e-1: (0.337, 0.830), 1e-2: (0.278, 0.597), 1e-3: (0.151, 0.509), 1e-4: (0.115, 0.291),
    },
    "truncated-hadamard": {
        1e-1: (0.295, 0.785), 1e-2: (0.192, 0.705), 1e-3: (0.252, 0.595), 1e-4: (0.156, 0.446),
    },
    "raster": {
        1e-1: (0.018, 0.582), 1e-2: (0.027, 0.725), 1e-3: (0.041, 0.358), 1e-4: (0.054, 0.233),
    },
    "hadamard": {
        1e-1: (0.088, 0.737), 1e-2: (0.055, 0.559), 1e-3: (0.091, 0.402), 1e-4: (0.012, 0.793),
    },
}  # fmt: skip
"""Its second table, studentised bootstrap."""

WILCOXON: dict[str, dict[float, tuple[float, float, float]]] = {
    "pca": {
        1e-1: (1.0, 0.017, 0.944), 1e-2: (0.0, 0.002, 1.0),
        1e-3: (3.0, 0.010, 0.891), 1e-4: (2.0, 0.006, 0.927),
    },
    "truncated-hadamard": {
        1e-1: (0.0, 0.012, 1.0), 1e-2: (0.0, 0.012, 1.0),
        1e-3: (5.5, 0.027, 0.800), 1e-4: (24.0, 0.770, 0.127),
    },
    "raster": {
        1e-1: (1.5, 0.010, 0.933), 1e-2: (1.0, 0.004, 0.964),
        1e-3: (0.0, 0.008, 1.0), 1e-4: (0.0, 0.002, 1.0),
    },
    "hadamard": {
        1e-1: (0.0, 0.002, 1.0), 1e-2: (0.0, 0.002, 1.0),
        1e-3: (2.5, 0.010, 0.909), 1e-4: (9.0, 0.064, 0.673),
    },
}  # fmt: skip
"""Its third table: statistic, p and rank-biserial against DeepFSI."""
