"""Records and names: what is listed, what an id says, and what the package shows."""

from __future__ import annotations

import pytest
from word_env import WordEnv

import gem_core as gem
from gem_core import errors
from gem_core.registry import lookup as registry

pytestmark = pytest.mark.usefixtures("own_registry")


@pytest.fixture
def words(own_registry: registry.Registry) -> None:
    """Three environments in two namespaces."""
    gem.register("word:Guess-v0", WordEnv, summary="Guess it.")
    gem.register("word:Guess-v0-hard", WordEnv, word="abacus")
    gem.register("eval:word-list", WordEnv)


# Listing.


@pytest.mark.usefixtures("words")
@pytest.mark.parametrize(
    ("pattern", "ids"),
    [
        (None, ["eval:word-list", "word:Guess-v0", "word:Guess-v0-hard"]),
        ("word", ["word:Guess-v0", "word:Guess-v0-hard"]),
        ("WORD:", ["word:Guess-v0", "word:Guess-v0-hard"]),
        ("hard", ["word:Guess-v0-hard"]),
        ("*:*word*", ["eval:word-list"]),
        ("word:*-v0", ["word:Guess-v0"]),
        ("nothing", []),
    ],
)
def test_list_envs_takes_a_namespace_a_part_or_a_glob(pattern: str | None, ids: list[str]) -> None:
    """A namespace gives its ids alone; other text any id that has it; a glob what it matches."""
    assert gem.list_envs(pattern) == ids


@pytest.mark.usefixtures("words")
def test_print_envs_writes_ids_with_summaries(capsys: pytest.CaptureFixture[str]) -> None:
    """One line for each id, summaries in a column, no spaces at the end."""
    gem.print_envs("word")
    assert capsys.readouterr().out == "word:Guess-v0       Guess it.\nword:Guess-v0-hard\n"


# Records.


def test_drawing_of_errors_is_the_hierarchy() -> None:
    """The tree at the top of errors.py has every class under its real base."""
    drawn: dict[str, str] = {}
    path: list[str] = []
    for line in (errors.__doc__ or "").splitlines():
        name = next((word for word in line.replace("├──", " ").replace("└──", " ").replace("│", " ").split()), "")
        if name in vars(errors) and "``" not in line:
            depth = (len(line) - len(line.lstrip(" │├└─"))) // 4 - 1
            path[depth:] = [name]
            drawn[name] = path[depth - 1] if depth else "Exception"
    real = {name: value.__bases__[0].__name__ for name, value in vars(errors).items() if isinstance(value, type)}
    assert drawn == real
