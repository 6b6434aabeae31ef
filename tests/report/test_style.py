"""What all figures share: settings, colours of the page, and words."""

import pytest

from deepfsi.report.accuracy import accuracy_figure
from deepfsi.report.style import photons_text, svg
from shared.figures import assert_sound
from shared.results import make_results


def test_figures_leave_matplotlib_as_it_was(tmp_path):
    results = make_results(tmp_path)
    assert_sound(lambda: accuracy_figure(results))


def test_svg_colours_follow_the_page(tmp_path):
    text = svg(accuracy_figure(make_results(tmp_path)), "a", 'quoted "words"')
    assert "var(--deepfsi)" in text
    assert "var(--ink)" in text
    assert "#d55e00" not in text
    assert 'aria-label="quoted &quot;words&quot;"' in text
    assert "<metadata" not in text


@pytest.mark.parametrize(
    ("photons", "text"),
    [
        (30.0, "30"),
        (1e3, "1000"),
        (1e4, "10⁴"),
        (3e5, "3 × 10⁵"),
        (2.5e10, "2.5 × 10¹⁰"),
        (0.5, "0.5"),
    ],
)
def test_budgets_are_written_as_people_do(photons, text):
    assert photons_text(photons) == text
