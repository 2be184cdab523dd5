"""The registry: identifiers, records, and the exact texts of its errors."""

from __future__ import annotations

import sys
import threading
from importlib.metadata import EntryPoint
from typing import TYPE_CHECKING, Any

import pytest
from word_env import PlainEnv, WordEnv, message

import gem_core as gem
from gem_core.errors import ArgumentError, EntryPointError, MissingRequirementError, RegistrationError, UnknownEnvError
from gem_core.registry import lookup as registry
from gem_core.registry import plugins
from gem_core.registry.specs import EnvSpec, WrapperSpec
from gem_core.rollouts import load_agent

if TYPE_CHECKING:
    from pathlib import Path


pytestmark = pytest.mark.usefixtures("own_registry")


@pytest.fixture
def words(own_registry: registry.Registry) -> None:
    """Three environments in two namespaces."""
    gem.register("word:Guess-v0", WordEnv, summary="Guess it.")
    gem.register("word:Guess-v0-hard", WordEnv, word="abacus")
    gem.register("eval:word-list", WordEnv)


# Unknown ids.


@pytest.mark.usefixtures("words")
@pytest.mark.parametrize(
    ("wrong", "text"),
    [
        (
            "word:Gues-v0",
            "no environment 'word:Gues-v0'. Did you mean 'word:Guess-v0' or 'word:Guess-v0-hard'? Run 'gem list word'",
        ),
        (
            "WORD:guess-v0-HARD",
            "no environment 'WORD:guess-v0-HARD'. Did you mean 'word:Guess-v0-hard' or 'word:Guess-v0'? Run 'gem list'",
        ),
        (
            "word:Guess-V0-hard",
            "no environment 'word:Guess-V0-hard'. Did you mean 'word:Guess-v0-hard' or 'word:Guess-v0'? "
            "Run 'gem list word'",
        ),
        ("word:zzzzzzzzzzzz", "no environment 'word:zzzzzzzzzzzz'. Run 'gem list word'"),
        (
            "word:",
            "no environment 'word:'. Did you mean 'word:Guess-v0' or 'word:Guess-v0-hard'? Run 'gem list word'",
        ),
        ("", "no environment ''. Run 'gem list'"),
        (
            "math:GSM8K",
            "no environment 'math:GSM8K'. It comes with a plugin: try 'pip install gem-math'. Run 'gem list'",
        ),
        (
            "quux:One",
            "no environment 'quux:One'. Namespaces: eval, word. "
            "What gem.register adds is known to its own process alone. Run 'gem list'",
        ),
    ],
)
def test_unknown_id_says_what_to_do(wrong: str, text: str) -> None:
    """An unknown id names the nearest ones, the plugin to install, or the namespaces."""
    assert message(gem.make, wrong) == f"UnknownEnvError: {text}"


def test_id_that_is_no_text_is_refused() -> None:
    """A list where an id belongs is an unknown environment, not a TypeError from inside."""
    assert message(gem.make, ["word:Guess-v0"]) == (
        "UnknownEnvError: an environment id is a string such as 'game:Mastermind-v0', not ['word:Guess-v0']"
    )


def test_unknown_id_is_a_lookup_error_with_exit_code_2() -> None:
    """An unknown id can be handled as LookupError, and ends the command with 2."""
    with pytest.raises(LookupError) as caught:
        gem.spec("word:None")
    assert isinstance(caught.value, UnknownEnvError)
    assert caught.value.exit_code == 2


# Unknown names of other kinds.


def test_unknown_wrapper_names_the_nearest() -> None:
    """A misspelt wrapper gives the nearest and all that exist."""
    gem.register("word:Guess-v0", WordEnv)
    assert message(gem.make, "word:Guess-v0", wrappers="conct") == (
        "UnknownWrapperError: no wrapper or tool 'conct'. Did you mean 'concat' or 'concat_chat'? "
        "There are: concat, concat_chat, concat_with_action, episode_stats, latest, messages, tools, turn_limit."
    )


def test_unknown_tool_names_where_tools_come_from(own_registry: registry.Registry) -> None:
    """Without any tool the message names the distribution that has some."""
    assert message(own_registry.tool, "pyton") == (
        "UnknownToolError: no tool 'pyton'. None is installed: try 'pip install gem-tools'."
    )


def test_unknown_backend_and_agent(own_registry: registry.Registry) -> None:
    """Backends and agents have messages of the same form."""
    assert message(own_registry.backend, "snc") == (
        "UnknownBackendError: no vector backend 'snc'. Did you mean 'sync' or 'async'? "
        "There are: async, auto, process, sync."
    )
    assert message(own_registry.agent, "randm") == (
        "UnknownAgentError: no agent 'randm'. Did you mean 'random'? There are: human, random."
    )


CORE_WRAPPERS = "concat, concat_chat, concat_with_action, episode_stats, latest, messages, tools, turn_limit"


@pytest.mark.parametrize(
    ("look_up", "name", "wrong", "there_are"),
    [
        ("backend", "ray", "no vector backend 'ray'.", " There are: async, auto, process, sync."),
        ("agent", "openai", "no agent 'openai'.", " There are: human, random."),
        ("tool", "python", "no tool 'python'.", ""),
        ("wrapper", "python", "no wrapper or tool 'python'.", f" There are: {CORE_WRAPPERS}."),
        ("env", "python", "no environment 'python'.", " Run 'gem list'"),
        ("env", "openai:some-model", "no environment 'openai:some-model'.", " Run 'gem list'"),
    ],
)
def test_name_of_a_plugin_that_is_not_installed(
    own_registry: registry.Registry, look_up: str, name: str, wrong: str, there_are: str
) -> None:
    """The error says what to install, in one sentence for all kinds."""
    plugin = {"ray": "gem-ray", "python": "gem-tools"}.get(name, "gem-openai")
    text = message(getattr(own_registry, look_up), name).partition(": ")[2]
    assert text == f"{wrong} It comes with a plugin: try 'pip install {plugin}'.{there_are}"


@pytest.mark.parametrize("name", ["openai", "openai:", "openai:some-model"])
@pytest.mark.parametrize("module", ["", "def act(observation):\n    return 'a'\n"])
def test_agent_of_a_plugin_that_is_not_installed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, module: str
) -> None:
    """Though a module may have its name, as OpenAI's package; an agent in such a module is found."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.delitem(sys.modules, "openai", raising=False)
    (tmp_path / "openai.py").write_text(module, encoding="utf-8")
    assert message(load_agent, name) == (
        "UnknownAgentError: no agent 'openai'. It comes with a plugin: try 'pip install gem-openai'. "
        "There are: human, random."
    )
    if module:
        assert callable(load_agent("openai:act"))
    sys.modules.pop("openai", None)


def test_unknown_plugin(own_registry: registry.Registry) -> None:
    """An unknown plugin gives the installed ones."""
    assert message(own_registry.plugins_named, "cor") == (
        "UnknownPluginError: no plugin 'cor'. Did you mean 'core'? Installed: core. Run 'gem plugins'"
    )


# Arguments.


def test_unknown_keyword_names_those_that_exist() -> None:
    """A keyword that the environment does not have gives the nearest and all it has."""
    gem.register("word:Guess-v0", WordEnv)
    assert message(gem.make, "word:Guess-v0", wrod="x") == (
        "ArgumentError: environment 'word:Guess-v0': got an unexpected keyword argument 'wrod'. "
        "Did you mean 'word'? It accepts: word, tries"
    )


def test_unknown_keyword_of_an_environment_without_constructor() -> None:
    """An environment without __init__ accepts nothing, and make says so."""
    gem.register("word:Plain-v0", PlainEnv)
    assert message(gem.make, "word:Plain-v0", size=1) == (
        "ArgumentError: environment 'word:Plain-v0': got an unexpected keyword argument 'size'. "
        "It accepts: no arguments"
    )


def test_constructor_without_arguments_refuses_them() -> None:
    """A bare environment without __init__ refuses arguments, as any class of Python does."""
    with pytest.raises(TypeError, match=r"^PlainEnv\(\) takes no arguments$"):
        PlainEnv(size=1)


def test_unknown_option_of_a_wrapper() -> None:
    """A wrapper's options are checked as an environment's are."""
    gem.register("word:Guess-v0", WordEnv)
    assert message(gem.make, "word:Guess-v0", wrappers=[("turn_limit", {"max_turn": 3})]) == (
        "ArgumentError: wrapper 'turn_limit': missing a required argument: 'max_turns'. Did you mean 'max_turns'? "
        "It accepts: max_turns"
    )


def test_type_error_inside_a_constructor_is_not_disguised() -> None:
    """A TypeError that a constructor raises itself stays what it is."""

    class Broken(gem.Env):
        def __init__(self) -> None:
            raise TypeError("inside")

    gem.register("word:Broken-v0", Broken)
    with pytest.raises(TypeError, match=r"^inside$"):
        gem.make("word:Broken-v0")


@pytest.mark.parametrize("wrappers", [3, [3], [("concat",)], [("concat", 4)]])
def test_malformed_wrappers_are_refused(wrappers: Any) -> None:
    """Whatever is no list of names, callables and pairs is an ArgumentError."""
    gem.register("word:Guess-v0", WordEnv)
    with pytest.raises((ArgumentError, EntryPointError)):
        gem.make("word:Guess-v0", wrappers=wrappers)


def test_keywords_of_make_go_over_the_registered_ones() -> None:
    """A keyword given to make wins, and the record stays as it was."""
    gem.register("word:Guess-v0", WordEnv, word="one", tries=5)
    env = gem.make("word:Guess-v0", word="two")
    assert (env.unwrapped.word, env.unwrapped.tries) == ("two", 5)
    assert dict(gem.spec("word:Guess-v0").kwargs) == {"word": "one", "tries": 5}


def test_register_splits_keywords() -> None:
    """Description goes to the record, max_turns is its limit, every other keyword goes to the environment."""
    gem.register(
        "word:Guess-v0", WordEnv, summary="s", tags=["a"], requires=["network"], deterministic=False, max_turns=4
    )
    record = gem.spec("word:Guess-v0")
    assert (record.summary, record.tags, record.requires, record.deterministic) == ("s", ("a",), ("network",), False)
    assert (dict(record.kwargs), record.max_turns, record.turn_limit) == ({}, 4, 4)


# Registration.


@pytest.mark.parametrize(
    "bad", ["", "word", "word:", ":Guess", "a b:C", "word:Guess\n", "wörd:Guess", "word:Gu:ess", "-a:b", None, 3]
)
def test_bad_id_is_refused(bad: Any) -> None:
    """An id that is not namespace:Name in ASCII is refused with an example."""
    assert message(gem.register, bad, WordEnv) == (
        f"RegistrationError: environment id {bad!r} must look like 'namespace:Name-v0', "
        "with ASCII letters, digits and '._-'"
    )


@pytest.mark.parametrize("bad", ["", "module", "module:", ":Name", "a b:C", None, 3])
def test_bad_entry_point_is_refused(bad: Any) -> None:
    """An entry point is a callable or 'package.module:Name'."""
    assert message(gem.register, "word:Guess-v0", bad) == (
        f"RegistrationError: word:Guess-v0: entry_point must be 'package.module:Name' or a callable, not {bad!r}"
    )


@pytest.mark.parametrize(
    ("field", "value", "text"),
    [
        ("summary", "two\nlines", "summary must be one line of text, not 'two\\nlines'"),
        ("tags", "text", "tags must be a tuple of strings, not 'text'"),
        ("requires", (1,), "requires must be a tuple of strings, not (1,)"),
        ("max_turns", 0, "max_turns must be a positive whole number, not 0"),
        ("max_turns", True, "max_turns must be a positive whole number, not True"),
        ("deterministic", "no", "deterministic must be True or False, not 'no'"),
        ("kwargs", [("a", 1)], "kwargs must map keyword names to values, not [('a', 1)]"),
    ],
)
def test_bad_field_of_a_record_is_refused(field: str, value: Any, text: str) -> None:
    """Each field of a record is checked when the record is made."""
    fields = {"id": "word:Guess-v0", "entry_point": WordEnv, field: value}
    assert message(EnvSpec, **fields) == f"RegistrationError: word:Guess-v0: {text}"


def test_bad_name_of_a_record_is_refused() -> None:
    """Names of wrappers and their kin are lower case."""
    assert message(WrapperSpec, name="Shout", entry_point="a:B") == (
        "RegistrationError: wrapper name 'Shout' must be lower case ASCII letters, digits and '_.-', as in 'python'"
    )


def test_taken_id_is_refused() -> None:
    """Another class under a taken id is an error that names the owner."""
    gem.register("word:Guess-v0", WordEnv)
    assert message(gem.register, "word:Guess-v0", PlainEnv) == (
        "RegistrationError: environment 'word:Guess-v0' is registered already, by register(); "
        "choose another id or version"
    )


def test_same_class_may_be_registered_again() -> None:
    """Running a notebook cell twice works, and the newer arguments count."""
    gem.register("word:Guess-v0", WordEnv, word="one")
    gem.register("word:Guess-v0", WordEnv, word="two")
    assert gem.make("word:Guess-v0").unwrapped.word == "two"


def test_two_lambdas_are_not_the_same_class() -> None:
    """Functions without a name are told apart."""
    gem.register("word:Guess-v0", lambda: WordEnv("one"))
    with pytest.raises(RegistrationError, match="is registered already"):
        gem.register("word:Guess-v0", lambda: WordEnv("two"))


def test_record_of_a_plugin_is_not_overwritten(
    own_registry: registry.Registry, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A program cannot register over a plugin's id; the message names the plugin."""
    plugin = plugins.Plugin(
        EntryPoint("mine", "gem_mine", "gem.plugins"),
        "gem-mine",
        "2.0",
        records=[EnvSpec(id="word:Guess-v0", entry_point=WordEnv)],
    )
    monkeypatch.setattr(registry, "load_plugins", lambda: [plugin])
    assert message(gem.register, "word:Guess-v0", WordEnv) == (
        "RegistrationError: environment 'word:Guess-v0' is registered already, by plugin 'mine' (gem-mine 2.0); "
        "choose another id or version"
    )


def test_disabled_plugin_is_named_for_its_namespace(
    own_registry: registry.Registry, monkeypatch: pytest.MonkeyPatch
) -> None:
    """An id of a disabled plugin says that it is disabled, not that it should be installed."""
    plugin = plugins.Plugin(EntryPoint("math", "gem_math", "gem.plugins"), "gem-math", "1.0", disabled=True)
    monkeypatch.setattr(registry, "load_plugins", lambda: [plugin])
    assert message(gem.make, "math:GSM8K") == (
        "UnknownEnvError: no environment 'math:GSM8K'. It may belong to plugin 'math' (gem-math 1.0), "
        "which GEM_PLUGINS_DISABLE skips. Run 'gem list'"
    )


# Entry points and requirements.


@pytest.fixture
def modules(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder on the path with modules that fail in different ways."""
    (tmp_path / "gemt_needs.py").write_text("import gemt_not_installed.deep\n")
    (tmp_path / "gemt_inside.py").write_text("from gem_core import gemt_nothing\n")
    (tmp_path / "gemt_own").mkdir()
    (tmp_path / "gemt_own" / "env.py").write_text("from gemt_own.gone import WordEnv\n")
    (tmp_path / "gemt_value.py").write_text("raise ValueError('bad day')\n")
    (tmp_path / "gemt_fine.py").write_text("class WordEnv:\n    size = 3\n")
    monkeypatch.syspath_prepend(tmp_path)
    return tmp_path


@pytest.mark.usefixtures("modules")
@pytest.mark.parametrize(
    ("entry_point", "text"),
    [
        (
            "gemt_nowhere:WordEnv",
            "there is no module 'gemt_nowhere' (entry point 'gemt_nowhere:WordEnv'); "
            "correct the entry point, or install the distribution that has it",
        ),
        (
            "gemt_nowhere.deep:WordEnv",
            "there is no module 'gemt_nowhere' (entry point 'gemt_nowhere.deep:WordEnv'); "
            "correct the entry point, or install the distribution that has it",
        ),
        (
            "gemt_needs:WordEnv",
            "'gemt_needs' needs the module 'gemt_not_installed', which is not installed; "
            "try 'pip install gemt-not-installed'",
        ),
        (
            "gemt_own.env:WordEnv",
            "'gemt_own.env' needs the module 'gemt_own.gone', which is not there; correct the import, or add the "
            "module",
        ),
        ("gemt_value:WordEnv", "importing 'gemt_value' failed: ValueError: bad day"),
        (
            "gemt_fine:WorldEnv",
            "'gemt_fine' has no 'WorldEnv'. Did you mean 'WordEnv'? Correct the entry point 'gemt_fine:WorldEnv'",
        ),
        ("gemt_fine:WordEnv.size.x", "'gemt_fine' has no 'x'. Correct the entry point 'gemt_fine:WordEnv.size.x'"),
        ("gemt_fine:WordEnv.size", "'gemt_fine:WordEnv.size' is a int, which cannot be called"),
    ],
)
def test_entry_point_error_says_which_way_it_failed(entry_point: str, text: str) -> None:
    """A missing module, a missing dependency, a failing module and a missing name are told apart."""
    gem.register("word:Lost-v0", entry_point)
    found = message(gem.make, "word:Lost-v0").replace(". (entry", " (entry")
    assert found == f"EntryPointError: environment 'word:Lost-v0': {text}".replace(". (entry", " (entry")


@pytest.mark.usefixtures("modules")
def test_import_error_inside_is_not_called_not_installed() -> None:
    """An ImportError of another kind keeps its own text, and stays an ImportError."""
    gem.register("word:Inside-v0", "gemt_inside:WordEnv")
    with pytest.raises(ImportError) as caught:
        gem.make("word:Inside-v0")
    assert str(caught.value).startswith(
        "environment 'word:Inside-v0': importing 'gemt_inside' failed: "
        "ImportError: cannot import name 'gemt_nothing' from 'gem_core'"
    )


def test_entry_point_that_makes_no_environment() -> None:
    """What an entry point returns has to be an environment."""
    gem.register("word:Dict-v0", dict)
    assert message(gem.make, "word:Dict-v0") == (
        "RegistrationError: word:Dict-v0: the entry point returned dict, not an environment"
    )


def test_missing_requirement_says_what_to_set(monkeypatch: pytest.MonkeyPatch) -> None:
    """A missing key is named before anything is imported."""
    monkeypatch.delenv("GEMT_KEY", raising=False)
    gem.register("word:Key-v0", "gemt_nowhere:WordEnv", requires=("key:GEMT_KEY", "command:gemt-no-such-command"))
    with pytest.raises(MissingRequirementError) as caught:
        gem.make("word:Key-v0")
    assert str(caught.value) == (
        "word:Key-v0 cannot run here: it needs a key: set the environment variable GEMT_KEY; "
        "it needs the command 'gemt-no-such-command' on the PATH: install it"
    )


# Loading.


def test_first_use_loads_once_from_many_threads(
    own_registry: registry.Registry, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Sixteen threads that look up first load the plugins once and all see the same."""
    calls: list[int] = []
    together = threading.Barrier(16)

    def load_once() -> list[plugins.Plugin]:
        calls.append(1)
        return [
            plugins.Plugin(
                EntryPoint("mine", "gem_mine", "gem.plugins"),
                "gem-mine",
                "1",
                records=[EnvSpec(id="word:Guess-v0", entry_point="a:B")],
            )
        ]

    monkeypatch.setattr(registry, "load_plugins", load_once)
    seen: list[list[str]] = []

    def look() -> None:
        together.wait()
        seen.append(gem.list_envs())

    threads = [threading.Thread(target=look) for _ in range(16)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert calls == [1]
    assert seen == [["word:Guess-v0"]] * 16


@pytest.mark.parametrize("text", ["False", "no", ""])
def test_text_for_a_bool_is_refused(text: str) -> None:
    """Any text would be true without a word."""
    row = {"question": "What?", "answer": "That"}
    with pytest.raises(ArgumentError, match=f"drop_thinking must be True or False, not the text '{text}'"):
        gem.make(
            EnvSpec(id="word:Row-v0", entry_point=gem.DatasetEnv),
            rows=[row],
            wrappers=[("concat", {"drop_thinking": text})],
        )
