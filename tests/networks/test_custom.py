"""Anyone's module as the classifier: learned, tested, saved, loaded only with trust, exported."""

import functools
import sys

import numpy as np
import pytest
import torch
from torch import nn

import deepfsi
from conftest import PHOTONS, RECIPE, generator, light_on, same
from deepfsi import Design, evaluate
from deepfsi.base import InputError
from deepfsi.camera import DetectorMap
from deepfsi.design import to_onnx
from deepfsi.networks import custom as own
from deepfsi.physics import Detection, LearnedMasks
from shared.design_files import header_of
from shared.jobs import learn
from shared.networks import Cnn, Tied, linear

BRIEF = {name: value for name, value in RECIPE.items() if name != "hidden"}


def learned(digits, classifier, **settings) -> Design:
    given = {"photons": PHOTONS, "masks": 6, "device": "cpu", **BRIEF, **settings}
    return learn(digits, classifier=classifier, **given)


@pytest.fixture(scope="module")
def cnn(digits) -> Design:
    return learned(digits, Cnn, classifier_arguments={"width": 5})


KINDS = {
    "class": (Cnn, "shared.networks:Cnn"),
    "function": (linear, "shared.networks:linear"),
    "import path": ("shared.networks:Cnn", "shared.networks:Cnn"),
    "partial": (functools.partial(Cnn, width=3), "shared.networks:Cnn"),
    "one number": (Tied, "shared.networks:Tied"),
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
    assert torch.equal(before.logits(features, PHOTONS), after.logits(features, PHOTONS))
    assert same(before, after)


@pytest.mark.parametrize(
    "settings",
    [
        {"span": 10.0, "nested": 3},
        {"looks": 2, "noise": "poisson", "light": "free-dwell", "rails": "single"},
    ],
    ids=["nested", "looks"],
)
def test_conditioned_designs_and_several_looks_take_one(digits, settings):
    one = learned(digits, Cnn, masks=8, **settings)
    assert evaluate(one, digits, 1e4, draws=1)[0].accuracy > 0.05
    if "nested" in settings:
        assert evaluate(one.first(3), digits, 1e4, draws=1)[0].images == len(digits.x_test)


def leaving(inputs, classes):
    raise SystemExit(7)


class Small(nn.Linear):
    """Fails at more rows than it is tried on, with its error."""

    error: type[BaseException] = ValueError

    def forward(self, rows):
        if len(rows) > 3:
            raise self.error("too many\nrows")
        return super().forward(rows)


@pytest.mark.parametrize("error", [ValueError, AssertionError, SystemExit])
def test_a_classifier_that_fails_at_work_is_named_in_one_line(digits, error):
    given = Small(6, 10)
    given.error = error
    with pytest.raises(InputError, match=r"classifier Small fails at .* too many rows") as told:
        learned(digits, given)
    assert isinstance(told.value.__cause__, error)


@pytest.mark.parametrize(
    ("given", "match"),
    [
        (nn.Linear(7, 10), "cannot be used: mat1 and mat2"),
        (nn.Linear(6, 9), r"logits of shape \(3, 9\)"),
        (nn.Flatten(0), r"logits of shape \(18,\)"),
        (lambda inputs, classes: 3, "int is no torch.nn.Module"),
        (lambda: nn.Linear(6, 10), "positional argument"),
        ("shared.networks:Rnn", "has no Rnn"),
        ("no_such_module:Cnn", "No module named"),
        ("Cnn", "classifier = 'Cnn': give mlp, or module:factory"),
        (leaving, "cannot be used: 7"),
        ("own", "cannot be imported"),
        (functools.partial(Cnn, 3), "give them as keywords"),
        (nn.Sequential(nn.Linear(6, 10)).requires_grad_(False), "no parameter that learns"),
        (nn.Identity(), r"logits of shape \(3, 6\)"),
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


def test_loading_runs_no_code_unless_told_to(foreign, tmp_path, made):
    locked = Design.load(foreign)
    assert not (tmp_path / "ran").exists()
    assert "foreign_nets" not in sys.modules
    assert locked.matrix.shape == (6, 64)  # masks may be shown without trust
    assert locked.save(tmp_path / "again.safetensors").read_bytes() == foreign.read_bytes()
    assert "foreign_nets:make" in repr(locked)
    for use in (lambda: locked.classify(np.ones((2, 6)), 1e4), lambda: to_onnx(locked)):
        with pytest.raises(InputError, match="foreign_nets:make, whose code was not run"):
            use()
    assert not (tmp_path / "ran").exists()
    assert Design.load(foreign, classifier=nn.Linear(6, 10)).classify(np.ones((2, 6)), 1e4).any()
    assert not (tmp_path / "ran").exists()
    assert Design.load(foreign, trust=True).classify(np.ones((2, 6)), 1e4).any()
    assert (tmp_path / "ran").exists()
    with pytest.raises(InputError, match="package's own"):
        made("deepfsi", "column", "dual").with_classifier(nn.Linear(7, 10))


def test_a_classifier_that_is_not_the_one_is_refused(cnn, digits, tmp_path):
    file = cnn.save(tmp_path / "cnn.safetensors")
    assert Design.load(file, trust=True).classifier.module.width == 5
    with pytest.raises(InputError, match="not the one of this design"):
        Design.load(file, classifier=nn.Linear(6, 10))
    unnamed = learned(digits, nn.Linear(6, 10)).save(tmp_path / "unnamed.safetensors")
    with pytest.raises(InputError, match="does not say where its classifier is imported from"):
        Design.load(unnamed, trust=True)


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
    x, y = torch.from_numpy(digits.x_train), torch.from_numpy(digits.y_train)
    s = float(x.sum(dim=1).mean())
    photons = deepfsi.photons_per_pixel(x, 1e5, s)
    with own.seeded(0):
        scanner = deepfsi.Scanner(LearnedMasks(torch.randn(12, 64), "free-dwell"), noise="ml_gauss")
        network = nn.Sequential(nn.BatchNorm1d(12), nn.Linear(12, 40), nn.ReLU(), nn.Linear(40, 10))
        camera = nn.Sequential(scanner, network)
        optimiser = torch.optim.Adam(camera.parameters(), lr=1e-2)
        for _ in range(150):
            nn.functional.cross_entropy(camera(photons), y).backward()
            optimiser.step()
            optimiser.zero_grad()
    design = deepfsi.design_of(scanner, network, digits, 1e5)
    network.eval()
    counts = design.scanner().counts(
        deepfsi.photons_per_pixel(torch.from_numpy(digits.x_test), 1e5, s)
    )
    features = counts[:, 0] - counts[:, 1]
    mine = network(features).softmax(dim=-1).detach().numpy()
    assert np.allclose(design.classify(counts, 1e5), mine, atol=1e-5)
    brighter = design.classify(counts * 10, 1e6)  # counts are brought to the training's budget
    assert np.allclose(brighter, mine, atol=1e-5)
    [result] = evaluate(design, digits, 1e5)
    assert result.accuracy > 0.7
    counted = design.scanner("none").counts(light_on(design, digits.x_train, 1.0).float())
    assert result.throughput == pytest.approx(float(counted.sum(dim=(1, 2)).mean()), rel=1e-5)
    assert design.light == "free-dwell"
    assert design.info["data"]["hash"] == digits.hash
    again = Design.load(design.save(tmp_path / "mine.safetensors"), classifier=network)
    assert np.allclose(again.classify(counts, 1e5), mine, atol=1e-5)
    assert not again.consistency(counts[:40], 1e5).refused
    assert again.consistency(counts[:40].flip(1), 1e5).refused


def test_a_loop_of_ones_own_is_checked(digits):
    rails = torch.full((1, 3, 64), 0.2)
    scanner = deepfsi.Scanner.from_rails(rails)
    with pytest.raises(InputError, match=r"logits of shape \(3, 9\)"):
        deepfsi.design_of(scanner, nn.Linear(3, 9), digits, 1e4)
    with pytest.raises(InputError, match="breaks the column constraint"):
        deepfsi.design_of(deepfsi.Scanner.from_rails(rails * 2), nn.Linear(3, 10), digits, 1e4)
    dark = deepfsi.Scanner.from_rails(rails, "camera", sigma=-1.0)
    with pytest.raises(InputError, match="sigma"):
        deepfsi.design_of(dark, nn.Linear(3, 10), digits, 1e4)
    apart = Detection.by(DetectorMap.of("2x2", (8, 8)))
    with pytest.raises(InputError, match="column is other optics: give light equal-dwell"):
        deepfsi.design_of(
            deepfsi.Scanner.from_rails(rails, detection=apart), nn.Linear(12, 10), digits, 1e4
        )
    with pytest.raises(InputError, match="do not fit digits"):
        deepfsi.design_of(
            deepfsi.Scanner.from_rails(rails[..., :60]), nn.Linear(3, 10), digits, 1e4
        )
