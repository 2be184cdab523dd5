"""Curves, figures and pages: data in, files out that hold them and escape what others wrote."""

from __future__ import annotations

import json
import re
import struct
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

from gem_train.reporting import (
    Bar,
    Curve,
    MetricsLog,
    bars_with_intervals,
    curves_with_bands,
    first_guesses,
    plot_run,
    write_page,
    write_study_page,
)
from gem_train.reporting.figures import bisection_guesses

HOSTILE = "</pre><script>alert(1)</script>\x1b[31m\u202e\ud800 {$title} $x"


class Tags(HTMLParser):
    """Collects the tags of a page, and its text."""

    def __init__(self) -> None:
        super().__init__()
        self.tags: list[str] = []
        self.attributes: list[str] = []
        self.text = ""

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.attributes += [name for name, _ in attrs]

    def handle_data(self, data: str) -> None:
        self.text += data


def parsed(page: Path) -> Tags:
    tags = Tags()
    tags.feed(page.read_text(encoding="utf-8"))
    return tags


def svgs(markup: str) -> list[str]:
    """Return the figures in a piece of a page; each is well-formed."""
    found = re.findall(r"<svg .*?</svg>", markup, re.DOTALL)
    for svg in found:
        ElementTree.fromstring(svg.replace("xlink:href", "href"))
    return found


def png_size(path: Path) -> tuple[int, int]:
    data = path.read_bytes()
    assert data.startswith(b"\x89PNG")
    width, height = struct.unpack(">II", data[16:24])
    return width, height


@pytest.fixture
def run(tmp_path: Path) -> Path:
    """A run of 100 updates with evaluations, options and a sample whose text is hostile."""
    folder = tmp_path / "run <1>"
    log = MetricsLog(folder)
    for update in range(1, 101):
        metrics = {"return": update / 100, "success": update / 200, "loss": float("nan"), "tokens_per_second": 9000.0}
        log.write(update, metrics | ({"eval/Sudoku/return": 0.25} if update % 50 == 0 else {}))
    log.close()
    (folder / "options.json").write_text(json.dumps({"env_id": "game:GuessTheNumber-v0", "note": HOSTILE}))
    turns = [
        {"observation": HOSTILE, "response": HOSTILE, "reward": 0.0},
        {"observation": [{"role": "user", "content": "higher"}], "response": "y" * 20_000, "reward": 1.0},
    ]
    lines = [{"update": update, "return": 1.0, "episode": turns} for update in (50, 100)]
    (folder / "samples.jsonl").write_text("".join(json.dumps(line) + "\n" for line in lines))
    return folder


def test_run_page_holds_curves_metrics_samples_and_options(run: Path):
    """The page has a figure for each metric that has a panel, and in its text all that the run left behind."""
    page = parsed(write_page(run))
    assert page.tags.count("svg") == 3
    for held in ("run <1>", "Sudoku", "tokens_per_second", "9,000", "game:GuessTheNumber-v0", "higher", "Update 100"):
        assert held in page.text
    assert page.text.index("Update 100: 2 turns, return 1") < page.text.index("Update 50")
    assert "… 10,000 more characters" in page.text


def test_run_page_escapes_what_a_model_wrote(run: Path):
    """No tag, control character or mark of direction of a model's text reaches the browser."""
    page = parsed(write_page(run))
    assert "script" not in page.tags
    assert r"</pre><script>alert(1)</script>\x1b[31m\u202e\ud800 {$title} $x" in page.text
    assert not [name for name in page.attributes if name.startswith("on")]


def test_pages_load_nothing(run: Path):
    """A page is one file: it names nothing that a browser would fetch."""
    text = write_page(run).read_text(encoding="utf-8")
    assert not re.search(r"""(src|href)=["'](?!#)|@import|url\((?!#)""", text)


def test_figures_in_a_page_do_not_share_ids(run: Path):
    """What a figure refers to is there; where two figures define it, they define the same."""
    text = write_page(run).read_text(encoding="utf-8")
    referred = {*re.findall(r"url\(#([^)]+)\)", text), *re.findall(r'href="#([^"]+)"', text)}
    assert referred
    for name in referred:
        assert len(set(re.findall(rf'id="{name}"(.*?/>)', text, re.DOTALL))) == 1


def test_plot_of_a_run_is_a_png(run: Path):
    width, height = png_size(plot_run(run))
    assert width > 1000
    assert 300 < height < 1000


@pytest.mark.parametrize(
    "metrics",
    [[], [{"return": 0.5}], [{"return": float("nan")}] * 2, [{"other": 1.0}], [{"eval/return": 1.0}]],
    ids=["none", "one update", "no finite one", "an unknown one", "only an evaluation"],
)
def test_little_is_drawn_too(tmp_path: Path, metrics: list[dict[str, float]]):
    """A run that has only begun has a page and a plot."""
    log = MetricsLog(tmp_path)
    for update, values in enumerate(metrics):
        log.write(update, values)
    log.close()
    assert png_size(plot_run(tmp_path))[0] > 300
    assert f"{len(metrics)} updates" in parsed(write_page(tmp_path)).text


def test_bars_show_labels_means_and_the_optimum(tmp_path: Path):
    """A mean without an interval is drawn; text of a label is only text."""
    rows = [Bar("$\\nonsense{$", 4.92, 4.88, 4.96), Bar("one <seed>", 5.4)]
    markup = bars_with_intervals(rows, tmp_path / "bars.png", unit="mean turns", optimum=4.86)
    [svg] = svgs(markup)
    shown = "".join(ElementTree.fromstring(svg.replace("xlink:href", "href")).itertext())
    for held in ("$\\nonsense{$", "one <seed>", "4.92", "5.4", "optimum", "mean turns"):
        assert held in shown
    assert png_size(tmp_path / "bars.png")[0] > 500


def test_curves_have_a_panel_a_task_and_one_legend(tmp_path: Path):
    """A name has one colour in all panels, and stands once in the legend; a band may be unknown at a step."""
    first = Curve([0, 10, 20], [0.1, 0.5, 0.9], [0.0, None, 0.8], [0.2, None, 1.0])
    series = {"Sudoku": {"PPO": first, "GRPO": Curve([0, 20], [0.1, 0.4])}, "Hanoi": {"GRPO": Curve([0], [0.3])}}
    options = {"unit": "success", "optimum": {"Sudoku": 1.0}, "percent": True}
    markup = curves_with_bands(series, tmp_path / "curves.png", **options)
    ppo_and_grpo, grpo = svgs(markup)
    assert markup.count("PPO") == markup.count("GRPO") == 1
    assert "var(--s0)" in ppo_and_grpo
    assert "var(--s0)" not in grpo
    assert "var(--s1)" in grpo
    assert "100 %" in ppo_and_grpo
    assert png_size(tmp_path / "curves.png")[0] > 1000


def test_first_guesses_mark_those_of_bisection(tmp_path: Path):
    """Bisection's guesses of 1 to 7 are 4, then 2 or 6, then the odd numbers; a turn nobody reached is drawn."""
    assert [bisection_guesses(7, turn) for turn in (1, 2, 3)] == [[4], [2, 6], [1, 3, 5, 7]]
    table = np.zeros((3, 7))
    table[0, 3], table[1, 1], table[1, 5] = 512, 250, 200
    assert len(svgs(first_guesses(table.tolist(), tmp_path / "guesses.png"))) == 3
    assert png_size(tmp_path / "guesses.png")[0] > 1000


def test_study_page_holds_text_figures_and_table(tmp_path: Path):
    """Paragraphs, captions and names are escaped; an unknown number is a dash."""
    rows = [
        {"algorithm": "<b>ReBN", "mean_turns": 4.92, "low": None},
        {"algorithm": "PPO", "mean_turns": 5, "low": 4.9},
    ]
    figure = bars_with_intervals([Bar("ReBN", 4.92)], tmp_path / "bars.png", unit="mean turns")
    text = "First <i>paragraph.\n\nSecond."
    page = parsed(
        write_study_page(tmp_path / "index.html", "γ & more", text, figures=[("A <caption>", figure)], table=rows)
    )
    assert page.tags.count("p") == 2
    assert page.tags.count("svg") == 1
    assert not {"i", "b", "caption"} & set(page.tags)
    for held in ("γ & more", "First <i>paragraph.", "A <caption>", "<b>ReBN", "mean turns", "4.92"):
        assert held in page.text


def test_the_same_figure_is_the_same_file(tmp_path: Path):
    """A page that is written again without new data does not differ."""
    rows = [Bar("ReBN", 4.92, 4.9, 4.95)]
    drawn = [bars_with_intervals(rows, tmp_path / f"{number}.png", unit="mean turns") for number in range(2)]
    assert drawn[0] == drawn[1]
    assert (tmp_path / "0.png").read_bytes() == (tmp_path / "1.png").read_bytes()


def test_logging_does_not_load_matplotlib():
    """Neither `import gem_train` nor its log of metrics waits for matplotlib."""
    code = "import gem_train, sys; from gem_train.reporting import MetricsLog; print('matplotlib' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=60)
    assert done.stdout.strip() == "False"
