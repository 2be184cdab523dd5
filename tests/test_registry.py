"""The registry: records, ids and names, and errors that say what to do."""

from __future__ import annotations

import sys
from concurrent.futures import ThreadPoolExecutor
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import Any

import pytest
from word_env import PlainEnv, WordEnv, message

import gem_core as gem
from gem_core.errors import ArgumentError, EntryPointError, UnknownEnvError
from gem_core.registry import lookup as registry
from gem_core.registry import plugins
from gem_core.registry.specs import EnvSpec, WrapperSpec
from gem_core.rollouts import load_agent


@pytest.fixture(autouse=True)
def words(own_registry: registry.Registry) -> None:
    """Three environments in two namespaces."""
    gem.register("word:Guess-v0", WordEnv, summary="Guess it.")
    gem.register("word:Guess-v0-hard", WordEnv, word="abacus")
    gem.register("eval:word-list", WordEnv)


# Unknown ids and names.


@pytest.mark.parametrize(
    ("wrong", "advice"),
    [
        ("word:Gues-v0", "'word:Guess-v0' or 'word:Guess-v0-hard'? Run 'gem list word'"),
        ("WORD:guess-v0-HARD", "'word:Guess-v0-hard' or 'word:Guess-v0'? Run 'gem list'"),
        ("word:zzzzzzzzzzzz", "'gem list word'"),
        ("math:GSM8K", "'pip install gem-math'"),
        ("python", "'pip install gem-tools'"),
        ("concta", "'concat'"),
        ("quux:One", "Namespaces: eval, word."),
    ],
)
def test_unknown_id_says_what_to_do(wrong: str, advice: str) -> None:
    """An unknown id names the nearest ones, the plugin to install, or the namespaces."""
    told = message(gem.make, wrong)
    assert told.startswith(f"UnknownEnvError: no environment {wrong!r}.")
    assert advice in told


def test_id_that_is_no_text_is_refused() -> None:
    """A list where an id belongs is an unknown environment, which is a LookupError and ends the command with 2."""
    with pytest.raises(LookupError) as caught:
        gem.make(["word:Guess-v0"])  # type: ignore[arg-type]
    assert isinstance(caught.value, UnknownEnvError)
    assert caught.value.exit_code == 2


CORE_WRAPPERS = "concat, concat_chat, concat_with_action, episode_stats, latest, messages, tools, turn_limit"


@pytest.mark.parametrize(
    ("kind", "wrong", "text"),
    [
        ("wrapper", "conct", f"'concat' or 'concat_chat'? There are: {CORE_WRAPPERS}."),
        ("wrapper", "typos", "'pip install gem-eval'"),
        ("tool", "concat", "'pip install gem-tools'"),
        ("backend", "snc", "'sync' or 'async'? There are: async, auto, process, sync."),
        ("agent", "randm", "'random'? There are: human, random."),
    ],
)
def test_unknown_name_says_what_to_do(own_registry: registry.Registry, kind: str, wrong: str, text: str) -> None:
    """The nearest, or the plugin to install, and all that there are."""
    told = message(getattr(own_registry, kind), wrong)
    assert told.startswith(f"Unknown{kind.title()}Error: ")
    assert text in told
    assert "'core'" in message(own_registry.plugins_named, "cor")


@pytest.mark.parametrize("module", ["", "def act(observation):\n    return 'a'\n"])
def test_agent_of_a_plugin_that_is_not_installed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, module: str) -> None:
    """Though a module may have its name, as OpenAI's package; an agent in such a module is found."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.delitem(sys.modules, "openai", raising=False)
    (tmp_path / "openai.py").write_text(module, encoding="utf-8")
    for name in "openai", "openai:", "openai:some-model":
        assert "'pip install gem-openai'" in message(load_agent, name)
    if module:
        assert callable(load_agent("openai:act"))
    sys.modules.pop("openai", None)


def plugin(name: str, *env_ids: str, **facts: Any) -> plugins.Plugin:
    """Return a loaded plugin with some environments."""
    point = EntryPoint(name, f"gem_{name}", "gem.plugins")
    records: list[Any] = [EnvSpec(id=env_id, entry_point=WordEnv) for env_id in env_ids]
    return plugins.Plugin(point, f"gem-{name}", "1.0", records=records, **facts)


def test_plugins_that_are_disabled_or_own_an_id(monkeypatch: pytest.MonkeyPatch) -> None:
    """A disabled one is named for its namespace; an id of another's cannot be registered."""
    fresh = registry.Registry()
    monkeypatch.setattr(registry, "_registry", fresh)
    monkeypatch.setattr(registry, "load_plugins", lambda: [plugin("math", disabled=True), plugin("mine", "word:A-v0")])
    assert "plugin 'math' (gem-math 1.0)" in message(gem.make, "math:GSM8K")
    assert "plugin 'mine' (gem-mine 1.0)" in message(gem.register, "word:A-v0", WordEnv)


# Arguments.


@pytest.mark.parametrize(
    ("make", "text"),
    [
        (lambda: gem.make("word:Guess-v0", wrod="x"), "'wrod'. Did you mean 'word'? It accepts: word, tries"),
        (lambda: gem.make(EnvSpec(id="word:Plain-v0", entry_point=PlainEnv), size=1), "'size'"),
        (lambda: gem.make("word:Guess-v0", wrappers=[("turn_limit", {"max_turn": 3})]), "'max_turns'"),
        (lambda: gem.make("word:Guess-v0", wrappers=[("concat", {"drop_thinking": "False"})]), "'False'"),
    ],
)
def test_wrong_argument_names_those_that_exist(make: Any, text: str) -> None:
    """Of an environment and of a wrapper; any text for a bool would be true without a word."""
    told = message(make)
    assert told.startswith("ArgumentError: ")
    assert text in told


def test_type_errors_of_python_stay() -> None:
    """Of a class without a constructor, and of one whose constructor raises."""

    def broken() -> None:
        raise TypeError("inside")

    with pytest.raises(TypeError, match=r"^PlainEnv\(\) takes no arguments$"):
        PlainEnv(size=1)
    with pytest.raises(TypeError, match=r"^inside$"):
        gem.make(EnvSpec(id="word:Broken-v0", entry_point=broken))


@pytest.mark.parametrize("wrappers", [3, [3], [("concat",)], [("concat", 4)]])
def test_malformed_wrappers_are_refused(wrappers: Any) -> None:
    """Whatever is no list of names, callables and pairs is an ArgumentError."""
    with pytest.raises((ArgumentError, EntryPointError)):
        gem.make("word:Guess-v0", wrappers=wrappers)


# Registration.


def test_register_splits_keywords() -> None:
    """Description goes to the record; every other keyword goes to the environment, where those of make win."""
    described: dict[str, Any] = {"summary": "s", "tags": ["a"], "requires": ["network"], "deterministic": False}
    gem.register("word:New-v0", WordEnv, **described, max_turns=4, word="one", tries=5)
    record = gem.spec("word:New-v0")
    assert (record.summary, record.tags, record.requires, record.deterministic) == ("s", ("a",), ("network",), False)
    assert (record.max_turns, record.turn_limit) == (4, 4)
    env = gem.make("word:New-v0", word="two")
    assert (env.unwrapped.word, env.unwrapped.tries) == ("two", 5)
    assert dict(record.kwargs) == {"word": "one", "tries": 5}


@pytest.mark.parametrize(
    "bad", ["word", "word:", ":Guess", "a b:C", "word:Guess\n", "wörd:Guess", "word:Gu:ess", "-a:b", None]
)
def test_bad_id_is_refused(bad: Any) -> None:
    """An id that is not namespace:Name in ASCII is refused with an example."""
    assert message(gem.register, bad, WordEnv).startswith(f"RegistrationError: environment id {bad!r} ")


@pytest.mark.parametrize(
    ("field", "value"),
    [
        *(("entry_point", bad) for bad in ["module", "module:", ":Name", "a b:C", None]),
        ("summary", "two\nlines"),
        ("tags", "text"),
        ("requires", (1,)),
        ("max_turns", 0),
        ("max_turns", True),
        ("deterministic", "no"),
        ("kwargs", [("a", 1)]),
        ("folder_markers", ("a/b",)),
        ("folder_keyword", "a b"),
    ],
)
def test_bad_field_of_a_record_is_refused(field: str, value: Any) -> None:
    """Each field of a record is checked when the record is made; the error names it with its value."""
    text = message(EnvSpec, **{"id": "word:Guess-v0", "entry_point": WordEnv, field: value})
    assert text.startswith(f"RegistrationError: word:Guess-v0: {field} must ")
    assert repr(value) in text
    assert "'Shout'" in message(WrapperSpec, name="Shout", entry_point="a:B")  # names are lower case


def test_taken_id_is_refused() -> None:
    """Another class under a taken id is an error; a notebook cell may run twice."""
    gem.register("word:Guess-v0", WordEnv, word="two")
    assert gem.make("word:Guess-v0").unwrapped.word == "two"
    assert message(gem.register, "word:Guess-v0", PlainEnv).startswith("RegistrationError: ")


# Entry points and requirements.

MODULES = {
    "gemt_needs": "import gemt_not_installed.deep\n",
    "gemt_inside": "from gem_core import gemt_nothing\n",
    "gemt_value": "raise ValueError('bad day')\n",
    "gemt_fine": "class WordEnv:\n    size = 3\n",
}


@pytest.mark.parametrize(
    ("entry_point", "text"),
    [
        ("gemt_nowhere.deep:WordEnv", "no module 'gemt_nowhere' (entry point 'gemt_nowhere.deep:WordEnv')"),
        ("gemt_needs:WordEnv", "'pip install gemt-not-installed'"),
        ("gemt_own.env:WordEnv", "'gemt_own.gone', which is not there"),
        ("gemt_value:WordEnv", "ValueError: bad day"),
        ("gemt_inside:WordEnv", "ImportError: cannot import name 'gemt_nothing'"),
        ("gemt_fine:WorldEnv", "'WorldEnv'. Did you mean 'WordEnv'?"),
        ("gemt_fine:WordEnv.size", "a int"),
    ],
)
def test_entry_point_error_says_which_way_it_failed(
    entry_point: str, text: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A missing module, a missing dependency, a failing module and a missing name are told apart; all ImportErrors."""
    for name, code in MODULES.items():
        (tmp_path / f"{name}.py").write_text(code)
    (tmp_path / "gemt_own").mkdir()
    (tmp_path / "gemt_own" / "env.py").write_text("from gemt_own.gone import WordEnv\n")
    monkeypatch.syspath_prepend(tmp_path)
    gem.register("word:Lost-v0", entry_point)
    with pytest.raises(ImportError, match=r"^environment 'word:Lost-v0': ") as caught:
        gem.make("word:Lost-v0")
    assert isinstance(caught.value, EntryPointError)
    assert text in str(caught.value)


def test_entry_point_that_makes_no_environment() -> None:
    """What an entry point returns has to be an environment."""
    gem.register("word:Dict-v0", dict)
    assert message(gem.make, "word:Dict-v0").startswith("RegistrationError: word:Dict-v0: ")


def test_missing_requirement_says_what_to_set(monkeypatch: pytest.MonkeyPatch) -> None:
    """All that is missing is named, before anything is imported."""
    monkeypatch.delenv("GEMT_KEY", raising=False)
    gem.register("word:Key-v0", "gemt_nowhere:WordEnv", requires=("key:GEMT_KEY", "command:gemt-no-such-command"))
    told = message(gem.make, "word:Key-v0")
    assert told.startswith("MissingRequirementError: word:Key-v0 ")
    assert "GEMT_KEY" in told
    assert "'gemt-no-such-command'" in told


def test_first_use_loads_once_from_many_threads(monkeypatch: pytest.MonkeyPatch) -> None:
    """Threads that look up first load the plugins once and all see the same."""
    calls: list[int] = []

    def load_once() -> list[plugins.Plugin]:
        calls.append(1)
        return [plugin("mine", "word:A-v0")]

    monkeypatch.setattr(registry, "load_plugins", load_once)
    monkeypatch.setattr(registry, "_registry", registry.Registry())
    with ThreadPoolExecutor(16) as pool:
        assert list(pool.map(lambda _: gem.list_envs(), range(64))) == [["word:A-v0"]] * 64
    assert calls == [1]
