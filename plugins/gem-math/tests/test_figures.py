"""Problems with figures: images in observations, from any form that a column has, through runs and files."""

from __future__ import annotations

import base64
import io
import json
import subprocess
import sys
from importlib.resources import files
from pathlib import Path
from typing import Any

import pytest
from PIL import Image

import gem_core as gem
from gem_core.errors import DatasetError
from gem_core.testing import check_env
from gem_math.figures.env import FigureEnv
from gem_math.figures.images import images_of

SCRIPTS = Path(__file__).resolve().parents[3] / "scripts"
GEOMETRY = [json.loads(line) for line in (files("gem_math") / "data" / "geometry.jsonl").read_text().splitlines()]
FIGURES = [images_of(row["images"], 0, "images")[0] for row in GEOMETRY]
SQUARE = Image.new("RGB", (8, 6), (200, 30, 30))


def png(image: Image.Image = SQUARE) -> bytes:
    """Return an image as the bytes of a file."""
    buffer = io.BytesIO()
    image.save(buffer, format="PNG")
    return buffer.getvalue()


def row(images: Any, problem: str = "What is it?") -> dict[str, Any]:
    """Return a row with the columns of ``math:Geometry3K``."""
    return {"problem": problem, "answer": "4", "images": images}


def kinds_of(observation: Any) -> list[str]:
    """Return which parts there are, in order."""
    return [part["type"] for part in observation]


def test_an_observation_holds_the_image_and_the_problem() -> None:
    """The image comes first where the text has no place for it."""
    observation, info = gem.make("math:GeometrySample").reset(options={"index": 0})
    image, text = observation
    assert isinstance(image["image"], Image.Image)
    assert text["text"].startswith("How long is the side BC of the right triangle in the figure")
    assert text["text"].endswith("Write your final answer in \\boxed{}.")
    assert info["index"] == 0


def test_the_gold_answer_is_right_and_another_is_not() -> None:
    """Of every figure."""
    env = gem.make("math:GeometrySample")
    for index, each in enumerate(GEOMETRY):
        for answer, reward in ((each["answer"], 1.0), ("-999", 0.0)):
            env.reset(options={"index": index})
            assert env.step(f"It is \\boxed{{{answer}}}.")[1] == reward


def test_the_numbers_stand_in_the_figure_alone() -> None:
    """Without it nobody knows the answer: each problem of a kind reads alike, or asks something else."""
    for each in GEOMETRY:
        assert not any(letter.isdigit() for letter in each["problem"]), each["problem"]
    for kind in {each["kind"] for each in GEOMETRY}:
        assert len({each["answer"] for each in GEOMETRY if each["kind"] == kind}) > 1, kind


@pytest.mark.thorough
def test_the_script_draws_the_figures() -> None:
    """With this version of Pillow they are the same to the pixel, and the answers in any."""
    if not SCRIPTS.is_dir():
        pytest.skip("the scripts are not beside the plugin")
    code = "import json, math_sample\nprint(json.dumps(list(math_sample.figure_rows())))"
    done = subprocess.run([sys.executable, "-c", code], cwd=SCRIPTS, capture_output=True, text=True, check=True)
    assert json.loads(done.stdout) == GEOMETRY


def test_answers_are_graded_as_those_of_other_problems() -> None:
    """By value, not letter by letter; and with the same keywords."""
    env = FigureEnv([{**row(SQUARE), "answer": "7.5"}], format_error_reward=-0.1)
    for action, reward in ((r"\boxed{\frac{15}{2}}", 1.0), (r"\boxed{7.50}", 1.0), (r"\boxed{7}", 0.0), ("so", -0.1)):
        env.reset(seed=0)
        assert env.step(action)[1] == reward


def test_images_come_in_any_form(tmp_path: Path) -> None:
    """As a PIL image, a path, bytes, or the mapping of ``datasets``; alone, in a list, or not at all."""
    path = tmp_path / "figure.png"
    path.write_bytes(png())
    address = f"data:image/png;base64,{base64.b64encode(png()).decode()}"
    forms = [
        SQUARE,
        path,
        str(path),
        address,
        png(),
        {"bytes": png(), "path": None},
        {"bytes": None, "path": str(path)},
    ]
    env = FigureEnv([row(form) for form in forms] + [row([form]) for form in forms])
    for index in range(2 * len(forms)):
        observation, _ = env.reset(options={"index": index})
        assert kinds_of(observation) == ["image", "text"]
        assert observation[0]["image"].tobytes() == SQUARE.tobytes()
    for nothing in (None, []):
        assert kinds_of(FigureEnv([row(nothing)]).reset(seed=1)[0]) == ["text"]


def test_images_stand_where_the_text_has_a_place() -> None:
    """Those without a place come first."""
    env = FigureEnv([row([SQUARE] * 3, "From <image> to <image>: what?")], prompt_template="{question}")
    observation, _ = env.reset(seed=0)
    assert kinds_of(observation) == ["image", "text", "image", "text", "image", "text"]
    assert [part.get("text") for part in observation][1::2] == ["From ", " to ", ": what?"]
    lone = FigureEnv([row([SQUARE], "<image>Find x.")], prompt_template="{question}").reset(seed=0)[0]
    assert kinds_of(lone) == ["image", "text"]


def test_other_modes_are_shown_in_their_colours() -> None:
    """A palette, CMYK and 16 bits become RGB; transparency and grey stay."""
    for mode, expected in (("P", "RGB"), ("CMYK", "RGB"), ("1", "RGB"), ("RGBA", "RGBA"), ("L", "L")):
        observation, _ = FigureEnv([row(SQUARE.convert(mode))]).reset(seed=0)
        assert observation[0]["image"].mode == expected


@pytest.mark.parametrize(
    ("images", "message"),
    [
        (["/nowhere/figure.png"], "row 1, column 'images', image 0 cannot be read (FileNotFoundError: "),
        ([SQUARE, b"no image"], "row 1, column 'images', image 1 cannot be read (UnidentifiedImageError: "),
        ([png()[:-30]], "row 1, column 'images', image 0 cannot be read ("),
        ([{"bytes": None}], "row 1, column 'images', image 0: it has neither 'bytes' nor 'path'"),
        (
            [7],
            "row 1, column 'images', image 0: an image must be a PIL image, a path, bytes or a mapping with 'bytes' or "
            "'path', not int",
        ),
    ],
)
def test_a_malformed_image_names_its_row(images: Any, message: str) -> None:
    """And what is wrong with it."""
    env = FigureEnv([row(SQUARE), row(images)])
    env.reset(options={"index": 0})
    with pytest.raises(DatasetError) as caught:
        env.reset(options={"index": 1})
    assert str(caught.value).startswith(message)


def test_an_image_that_unpacks_to_gigabytes_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """Before it is unpacked."""
    monkeypatch.setattr(Image, "MAX_IMAGE_PIXELS", 20)
    with pytest.raises(DatasetError, match=r"row 0, column 'images', image 0 cannot be read \(DecompressionBomb"):
        FigureEnv([row(png())]).reset(seed=0)


def test_wrong_columns_are_told() -> None:
    """With those that there are; and a text that has places for more images than there are."""
    with pytest.raises(DatasetError) as caught:
        FigureEnv([row(SQUARE)], image_key="image")
    assert str(caught.value) == (
        "no column 'image' in the data set. Did you mean 'images'? Columns: 'problem', 'answer', 'images'"
    )
    with pytest.raises(DatasetError, match="row 0 has 2 places for images in its text, and 1 in 'images'"):
        FigureEnv([row(SQUARE, "<image><image>")]).reset(seed=0)


def test_the_contract_is_kept() -> None:
    """With all its promises."""
    check_env("math:GeometrySample")
