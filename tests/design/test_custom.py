"""The paper's classifier, and anyone's module: learned, tested, saved, exported, run with trust."""

import functools
import math
import sys

import numpy as np
import pytest
import torch
from torch import nn

import deepfsi
from conftest import PHOTONS, RECIPE, generator, light_on, same
from deepfsi import Design, InputError, Mlp, design_of
from deepfsi.camera.detectors import DetectorMap
from deepfsi.design import networks as own
from deepfsi.design.onnx import to_onnx
from deepfsi.physics.detection import Detection
from deepfsi.physics.laws import LearnedMasks
from shared.design_files import header_of
from shared.jobs import learn
from shared.networks import Cnn, Tied, linear


def learned(digits, classifier, **settings) -> Design:
    brief = {name: value for name, value in RECIPE.items() if name != "hidden"}
    given = {"photons": PHOTONS, "masks": 6, "device": "cpu", **brief, **settings}
    return learn(digits, classifier=classifier, **given)


KINDS = {
    "class": (Cnn, "shared.networks:Cnn"),
    "function": (linear, "shared.networks:linear"),
    "import path": ("shared.networks:Cnn", "shared.networks:Cnn"),
    "partial": (functools.partial(Cnn, width=3), ""),
    "tied": (Tied, "shared.networks:Tied"),
    "lambda": (lambda inputs, classes: nn.Linear(inputs, classes), ""),
    "module": (nn.Linear(6, 10), ""),
    "of torch": (nn.LazyLinear(10), ""),
}


@pytest.mark.parametrize("kind", KINDS)
def test_any_module_or_factory_learns_and_survives_its_file(digits, tmp_path, kind):
    given, factory = KINDS[kind]
    before = learned(digits, given)
    header = header_of(before.save(tmp_path / "own.safetensors"))["classifier"]
    assert (header["kind"], header["factory"]) == ("own", factory)
    assert before.info["job"]["training"]["classifier"] == (factory or "own")
    said = {"trust": True} if factory else {"classifier": given}
    after = Design.load(tmp_path / "own.safetensors", **said)
    features = before.scanner()(light_on(before, digits.x_test), generator()).float()
    answers = [each.answer(features / PHOTONS, PHOTONS).logits for each in (before, after)]
    assert torch.equal(*answers)
    assert same(before, after)


def leaving(inputs, classes):
    raise SystemExit(7)


@pytest.mark.parametrize(
    ("given", "match"),
    [
        (nn.Linear(7, 10), "cannot be used: mat1 and mat2"),
        (nn.Linear(6, 9), r"logits of shape \(3, 9\)"),
        (lambda inputs, classes: 3, "cannot be used: 'int' object"),
        ("shared.networks:Rnn", "has no attribute 'Rnn'"),
        ("no_such_module:Cnn", "No module named"),
        (leaving, "cannot be used: 7"),
        (nn.Sequential(nn.Linear(6, 10)).requires_grad_(False), "no parameter that learns"),
    ],
)
def test_what_is_no_classifier_is_refused_in_one_line(digits, given, match):
    with pytest.raises(InputError, match=match) as error:
        learned(digits, given)
    assert "\n" not in str(error.value)


@pytest.fixture
def foreign(digits, tmp_path, monkeypatch):
    """A design file whose classifier's module says that it was imported; and that module's name."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "foreign_nets.py").write_text(
        "from pathlib import Path\nfrom torch.nn import Linear\nPath('ran').touch()\n"
        "def make(inputs, classes): return Linear(inputs, classes)\n"
    )
    file = learned(digits, "foreign_nets:make").save(tmp_path / "foreign.safetensors")
    assert (tmp_path / "ran").exists()
    sys.modules.pop("foreign_nets")
    (tmp_path / "ran").unlink()
    yield file
    sys.modules.pop("foreign_nets", None)


def test_a_classifier_is_given_to_a_design_without_its_own_alone(made, tmp_path):
    file = made("deepfsi", "column", "dual").save(tmp_path / "own.safetensors")
    with pytest.raises(InputError, match="holds its classifier: leave"):
        Design.load(file, classifier=nn.Linear(7, 10))


def test_loading_runs_no_code_unless_told_to(foreign, tmp_path):
    locked = Design.load(foreign)
    assert not (tmp_path / "ran").exists()
    assert "foreign_nets" not in sys.modules
    assert locked.matrix.shape == (6, 64)  # masks may be shown without trust
    assert locked.save(tmp_path / "again.safetensors").read_bytes() == foreign.read_bytes()
    assert "foreign_nets:make" in repr(locked)
    for use in (
        lambda: locked.classify(np.ones((2, 6)), 1e4),
        lambda: to_onnx(locked),
        lambda: design_of(locked.scanner(), locked.classifier, "digits", 1e4),
    ):
        with pytest.raises(InputError, match="foreign_nets:make, whose code was not run"):
            use()
    assert not (tmp_path / "ran").exists()
    assert Design.load(foreign, classifier=nn.Linear(6, 10)).classify(np.ones((2, 6)), 1e4).any()
    assert not (tmp_path / "ran").exists()
    assert Design.load(foreign, trust=True).classify(np.ones((2, 6)), 1e4).any()
    assert (tmp_path / "ran").exists()


@pytest.mark.parametrize("rails", ["dual", "single"])
@pytest.mark.parametrize("kind", [Cnn, Tied])
def test_the_graph_gives_what_torch_gives(digits, kind, rails):
    onnxruntime = pytest.importorskip("onnxruntime")
    one = learned(digits, kind, rails=rails, light="free-dwell")
    session = onnxruntime.InferenceSession(to_onnx(one), providers=["CPUExecutionProvider"])
    budgets = np.geomspace(10, 1e6, 40).astype(np.float32)
    scenes = light_on(one, digits.x_test[:40], 1.0) * torch.from_numpy(budgets)[:, None]
    counts = one.readouts(one.scanner().counts(scenes.float(), generator()).numpy())
    [found] = session.run(None, {"counts": counts, "photons": budgets})
    # a hundred sums of tens of float32 terms, in standardised features up to some hundreds
    assert np.abs(found - one.classify(counts, budgets)).max() < 1e-3
    assert session.get_modelmeta().custom_metadata_map["name"] == '"deepfsi"'


def test_a_loop_of_ones_own_makes_a_design(digits, tmp_path):
    """Counts are brought to the training's budget, and tested for what it was trained for."""
    s = float(digits.x_train.sum(axis=1).mean())
    with own.seeded(0):
        scanner = deepfsi.Scanner(LearnedMasks(torch.randn(12, 64), "free-dwell"), noise="ml_gauss")
        network = nn.Sequential(nn.BatchNorm1d(12), nn.Linear(12, 10))
    design = deepfsi.design_of(scanner, network, digits, 1e5)
    again = Design.load(design.save(tmp_path / "mine.safetensors"), classifier=network)
    light = deepfsi.photons_per_pixel(torch.from_numpy(digits.x_test), 1e5, s)
    counts = design.scanner().counts(light)
    mine = network.eval()(counts[:, 0] - counts[:, 1]).softmax(dim=-1).detach().numpy()
    for each, brighter in ((design, 1), (design, 10), (again, 1)):
        answers = each.classify(counts * brighter, 1e5 * brighter)
        assert (answers.argmax(axis=1) == mine.argmax(axis=1)).mean() > 0.99
    assert np.median(again.consistency(counts[:40], 1e5)) > 0.1
    assert np.median(again.consistency(counts[:40].flip(1), 1e5)) < 0.005


RAILS = torch.full((1, 3, 64), 0.2)
APART = Detection.by(DetectorMap.of("2x2", (8, 8)))


@pytest.mark.parametrize(
    ("rails", "numbers", "outputs", "match"),
    [
        (RAILS, {}, (3, 9), r"logits of shape \(3, 9\)"),
        (RAILS * 2, {}, (3, 10), "breaks the column constraint"),
        (RAILS, {"detection": APART}, (12, 10), "is not of one device"),
        (RAILS[..., :60], {}, (3, 10), "do not fit digits"),
    ],
)
def test_a_loop_of_ones_own_is_checked(digits, rails, numbers, outputs, match):
    scanner = deepfsi.Scanner.from_rails(rails, **numbers)
    with pytest.raises(InputError, match=match):
        deepfsi.design_of(scanner, nn.Linear(*outputs), digits, 1e4)


@pytest.mark.parametrize("dropout", [0.1, 0.25, 0.5, 0.9])
def test_dropout_drops_its_share_and_keeps_the_mean(dropout):
    """Logits are the units of the one hidden layer, all 1 before dropout."""
    net = Mlp(3, 20, (20,), dropout, generator()).train()
    with torch.no_grad():
        net.layers[0].weight.zero_()
        net.layers[0].bias.fill_(1)
        net.layers[1].weight.copy_(torch.eye(20))
        net.layers[1].bias.zero_()
    units = net(torch.zeros(5000, 3))
    assert units.unique().tolist() == pytest.approx([0.0, 1 / (1 - dropout)])
    dropped = (units == 0).double()
    one = math.sqrt(dropout * (1 - dropout))
    assert abs(dropped.mean() - dropout) <= 5 * one / math.sqrt(units.numel()) + 2**-16
    assert ((dropped.mean(dim=0) - dropout).abs() <= 5 * one / math.sqrt(5000)).all()
