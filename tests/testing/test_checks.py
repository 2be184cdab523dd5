"""``check_tool``, ``check_wrapper`` and ``check_plugin``: what they let pass, and what they name."""

from __future__ import annotations

import pydantic
import pytest

import gem_core as gem
from gem_core.testing import CheckError, ContractError, check_plugin, check_tool, check_wrapper
from gem_core.wrappers.turn_limit import TurnLimit
from gem_core.wrappers.views import ConcatWithAction


class Notes(gem.Tool):
    """A tool that keeps all promises."""

    name = "notes"
    description = "Keeps notes."
    concurrency = "inline"

    class Parameters(pydantic.BaseModel):
        """One text."""

        text: str

    def call(self, arguments, session):
        session.append(arguments.text)
        return " ".join(session)

    def open(self):
        return []


class Shared(Notes):
    """Keeps one session for all episodes."""

    everything: list[str] = []  # noqa: RUF012 - the mistake under test

    def open(self):
        return self.everything


class Nameless(Notes):
    """Has a name that servers refuse."""

    name = "two words"
    description = ""


class Failing(Notes):
    """Never succeeds."""

    def call(self, arguments, session):
        raise ValueError("out of order")


class Session(list):
    """Has forks that go on with it."""

    def __deepcopy__(self, memo):
        return self


class SharingForks(Notes):
    """Gives a fork the session of the first one."""

    def open(self):
        return Session()


@pytest.mark.parametrize("tool", [Notes, Notes()])
@pytest.mark.few(1)
def test_good_tool_passes(tool) -> None:
    """A class or an instance."""
    assert "A call succeeds." in check_tool(tool, {"text": "x"})


@pytest.mark.parametrize(
    ("tool", "line"),
    [
        (Shared, "A new episode has a new session. Seen: it remembers"),
        (Nameless, "Its name is one that model servers take. Seen: 'two words'"),
        (Nameless, "It has a description. Seen: an empty one"),
        (Failing, "A call succeeds. Seen: Error from notes: The tool failed: ValueError: out of order"),
        (SharingForks, "A fork has its own session. Seen: calls of the first one changed it"),
    ],
)
@pytest.mark.few(2)
def test_broken_promise_of_a_tool_is_named(tool, line: str) -> None:
    """In one line each, with what was seen."""
    with pytest.raises(CheckError) as caught:
        check_tool(tool, {"text": "x"})
    assert f"\n  {line}" in str(caught.value)


@pytest.mark.parametrize(
    "make_wrapper", [ConcatWithAction, lambda env: TurnLimit(env, max_turns=2), lambda env: gem.ToolEnv(env, [Notes()])]
)
def test_good_wrapper_passes(make_wrapper) -> None:
    """A view, a limit, and tools."""
    assert check_wrapper(make_wrapper).broken == {}


class Hiding(gem.Wrapper):
    """Has an attribute of its own."""

    answer = "its own"


class OnlyPlain(gem.Wrapper):
    """Says something else to coroutines."""

    def reset_async(self, seed=None, options=None):
        return self.env.reset_async(seed)

    def after_reset(self, result):
        return "plain", result[1]


class Counting(gem.Wrapper):
    """Counts in its class, for all stacks at once."""

    turns = 0

    def before_reset(self, seed, options):
        Counting.turns = 0

    def after_step(self, action, result):
        Counting.turns += 1
        observation, _, *rest = result
        return observation, float(self.turns), *rest


@pytest.mark.parametrize(
    ("wrapper", "error", "part"),
    [
        (Hiding, CheckError, "Attributes of the task are read through it. Seen: 'its own'"),
        (OnlyPlain, CheckError, "Its coroutines give what its plain methods give. Seen: "),
        (Counting, ContractError, "interleaving"),
        (lambda env: env, CheckError, "It derives from gem_core.Wrapper. Seen: a SmallTask"),
    ],
)
def test_broken_promise_of_a_wrapper_is_named(wrapper, error: type[Exception], part: str) -> None:
    """Its own, and those of environments that it breaks around one."""
    with pytest.raises(error) as caught:
        check_wrapper(wrapper)
    assert part in str(caught.value)


def test_good_plugin_passes() -> None:
    """The games declare only, and all that they declare is there."""
    pytest.importorskip("gem_games")
    assert len(check_plugin("games")) == 6
