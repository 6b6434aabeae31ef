"""The graph gives what torch gives."""

import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch

from conftest import PHOTONS, generator
from deepfsi import Design, photons_per_pixel
from deepfsi.design.onnx import to_onnx

onnxruntime = pytest.importorskip("onnxruntime")

DEPLOY = (Path(__file__).parents[2] / "docs/do/deploy.md").read_text()


def opened(graph: bytes) -> onnxruntime.InferenceSession:
    return onnxruntime.InferenceSession(graph, providers=["CPUExecutionProvider"])


def counted(design: Design, x: np.ndarray, photons: np.ndarray) -> np.ndarray:
    """Counts of scenes as the graph takes them, each at its own budget."""
    light = photons_per_pixel(torch.from_numpy(x), 1.0, design.summed_reflectance)
    scenes = light * torch.from_numpy(photons)[:, None]
    counts = design.scanner().counts(scenes, generator(1)).numpy()
    return counts.reshape(len(counts), *design.counts_shape)


def test_the_example_in_the_docs(good, digits, tmp_path):
    """Run by itself, where torch cannot be imported."""
    [block] = re.findall(r"```python\n(.*?)```", DEPLOY, flags=re.DOTALL)
    photons = np.full(20, PHOTONS, dtype=np.float32)
    counts = counted(good, digits.x_test[:20], photons)
    (tmp_path / "digits.onnx").write_bytes(to_onnx(good))
    np.save(tmp_path / "counts.npy", counts.astype(int))
    torchless = "import sys\nsys.modules.update(torch=None, deepfsi=None)\n"
    done = subprocess.run(
        [sys.executable, "-c", torchless + block], cwd=tmp_path, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    said = [line.split() for line in done.stdout.splitlines()]
    wanted = good.classify(counts, photons)
    assert [word for word, _ in said] == [good.classes[k] for k in wanted.argmax(axis=1)]
    assert [float(chance) for _, chance in said] == pytest.approx(
        wanted.max(axis=1).tolist(), abs=0.001
    )
