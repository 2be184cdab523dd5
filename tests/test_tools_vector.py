"""Tools of each kind in vector environments of each backend: the same episodes, and no session left open."""

from __future__ import annotations

import asyncio
import signal
from collections import Counter
from pathlib import Path
from typing import Any

import pytest
from distributions import python

import gem_core as gem
from gem_core.tools.tool import Tool

TESTS = Path(__file__).parent


class Logged(Tool):
    """Counts the calls of an episode; what it opens and closes stands in a file, whichever process it runs in."""

    name = "count"
    description = "Counts the calls of this episode."
    fences = ("count",)
    kind = "inline"

    class Parameters(gem.Tool.Parameters):
        """Any text."""

        text: str

    def __init__(self, log: str) -> None:
        self.log = log
        self.concurrency = self.kind  # type: ignore[assignment]  # one of the kinds

    def open(self) -> Any:
        self.write("open")
        return []

    def call(self, arguments: Any, session: Any) -> Any:
        session.append(arguments.text)
        return f"{len(session)}: {session[-1]}"

    def close(self, session: Any) -> Any:
        self.write("close")

    def write(self, event: str) -> None:
        with Path(self.log).open("a") as file:
            file.write(f"{event}\n")


class Threaded(Logged):
    """The same, in threads."""

    kind = "thread"


class Awaited(Logged):
    """The same, as coroutines."""

    async def open(self) -> Any:
        await asyncio.sleep(0)
        return super().open()

    async def call(self, arguments: Any, session: Any) -> Any:
        await asyncio.sleep(0)
        return super().call(arguments, session)

    async def close(self, session: Any) -> Any:
        for _ in range(1000):  # so that whoever does not wait for it is sure to miss it
            await asyncio.sleep(0)
        super().close(session)


KINDS = {"inline": Logged, "thread": Threaded, "async": Awaited}
BACKENDS = ["sync", "async", ("process", {"workers": 2})]


def events(log: Path) -> Counter[str]:
    """Return how often sessions were opened and closed."""
    return Counter(log.read_text().split()) if log.exists() else Counter()


def caller(observation: Any, context: Any) -> str:
    """Call the tool in every other turn."""
    return "7" if context.turn % 2 else f"<count>{context.turn}</count>"


def episodes_of(tool: Any, backend: Any, **options: Any) -> list[dict[str, Any]]:
    """Run some episodes and return what matters of each."""
    vector = gem.make_vec("toy:Countdown-v0", 3, backend=backend, wrappers=[tool, "concat"], **options)
    try:
        done = sorted(gem.rollout(vector, caller, episodes=6, seed=5), key=lambda episode: int(episode.key))
    finally:
        vector.close()
    return [
        {
            "final": episode.final_observation,
            "return": episode.episode_return,
            "turns": [
                (str(turn.action), turn.info.get("tool"), turn.info.get("error")) for turn in episode.transitions
            ],
        }
        for episode in done
    ]


@pytest.mark.parametrize("backend", BACKENDS, ids=["sync", "async", "process"])
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.few(4)
def test_episodes_are_the_same_and_every_session_is_closed(kind: str, backend: Any, tmp_path: Path) -> None:
    """Whatever the kind of tool and the backend; a new episode has a new session."""
    expected = episodes_of((Logged, {"log": str(tmp_path / "expected")}), "sync")
    found = episodes_of((KINDS[kind], {"log": str(tmp_path / "log")}), backend)
    assert found == expected
    assert all(turn[1] is None or turn[1]["failed"] is False for episode in found for turn in episode["turns"])
    assert events(tmp_path / "log") == {"open": 6, "close": 6} == events(tmp_path / "expected")


@pytest.mark.parametrize(("kind", "backend"), [("inline", "process"), ("thread", "sync"), ("async", "async")])
def test_sessions_are_closed_when_the_task_fails(kind: str, backend: Any, tmp_path: Path) -> None:
    """An environment that raises is replaced, and what it had open is closed."""
    vector = gem.make_vec(
        "toy:Countdown-v0",
        2,
        backend=backend,
        fail="step",
        wrappers=[(KINDS[kind], {"log": str(tmp_path / "log")})],
    )
    done = list(gem.rollout(vector, caller, episodes=3, seed=1))
    vector.close()
    assert all(episode.error is not None for episode in done)
    assert events(tmp_path / "log") == {"open": 3, "close": 3}


SCRIPT = """
import os, signal, sys
sys.path.insert(0, {tests!r})
import gem_core as gem, toys, test_tools_vector as tools
toys.register_toys()
tool = (tools.KINDS[{kind!r}], {{"log": {log!r}}})
if __name__ == "__main__":
    if {backend!r} is None:
        env = gem.make("toy:Countdown-v0", wrappers=[tool])
        env.reset(seed=1, options={{"left": 9}})
        env.step("<count>1</count>")
    else:
        vector = gem.make_vec("toy:Countdown-v0", 2, backend={backend!r}, wrappers=[tool])
        vector.reset()
        vector.step(["<count>1</count>"] * 2)
    print("open", flush=True)
    if {end!r} == "interrupt":
        os.kill(os.getpid(), signal.SIGINT)
    elif {end!r} == "error":
        raise RuntimeError("the script fails")
    elif {end!r} == "exit":
        sys.exit(4)
"""


@pytest.mark.parametrize("end", ["interrupt", "error", "exit", "end"])
@pytest.mark.parametrize("backend", [None, *BACKENDS], ids=["one", "sync", "async", "process"])
@pytest.mark.parametrize("kind", ["inline", "async"])
@pytest.mark.few(3)
def test_sessions_are_closed_when_the_program_ends(kind: str, backend: Any, end: str, tmp_path: Path) -> None:
    """By its end, an error, an exit or Ctrl-C, without a word to close them."""
    log = tmp_path / "log"
    script = SCRIPT.format(tests=str(TESTS), kind=kind, backend=backend, end=end, log=str(log))
    done = python(script, [TESTS])
    assert done.stdout == "open\n", done.stderr
    expected = {"interrupt": -signal.SIGINT, "error": 1, "exit": 4, "end": 0}[end]
    assert done.returncode in (expected, 128 + signal.SIGINT if end == "interrupt" else expected)
    count = 1 if backend is None else 2
    assert events(log) == {"open": count, "close": count}, done.stderr
