"""The other process: plays episodes that it is asked for, ``python -m gem_core.testing.other_process``.

Requests and answers are lines of JSON. Every request has a number, which every line of its answer repeats::

    {"number": 1, "path": […], "directory": "…", "recipe": {…}, "seed": 3, "state": null, "actions": ["…"]}

    {"number": 1, "ready": true, "resets": true}    the environment could be made, and a reset comes next
    {"number": 1, "record": {…}}                    one for the reset, and one for each step
    {"number": 1, "end": "done"}                    or "unavailable" or "failed", with a "message"

With ``"actions": null`` it is asked to survive the hostile actions of that seed: every step gives an empty record, and
whatever ends or breaks an episode is followed by the next.
"""

from __future__ import annotations

import json
import os
import sys
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from typing import IO, Any, cast

from gem_core.env.base import Env
from gem_core.env.wrapper import AnyEnv
from gem_core.testing.comparing import play
from gem_core.testing.contract import NotTriedError
from gem_core.testing.hostile import hostile_actions
from gem_core.testing.serialization import build, encoded

_GRACE_S = 5.0
"""How long an environment may take to close once nobody listens any more."""

Say = Callable[[Mapping[str, Any]], None]


def main() -> None:
    """Answer requests until standard input ends."""
    requests, answers = _private_streams()
    stopped = threading.Event()
    lines = _read_ahead(requests, stopped)

    def say(message: Mapping[str, Any]) -> None:
        answers.write(encoded(message))
        answers.flush()

    try:
        say({"ready": True})
        for line in lines:
            _answer(json.loads(line), say)
    except BrokenPipeError:
        pass
    finally:
        stopped.set()


def _private_streams() -> tuple[IO[str], IO[str]]:
    """Take standard input and output for the conversation, so that an environment can neither read nor print there."""
    requests = os.fdopen(os.dup(0), "r", encoding="ascii")
    answers = os.fdopen(os.dup(1), "w", encoding="ascii")
    nothing = os.open(os.devnull, os.O_RDWR)
    os.dup2(nothing, 0)
    os.dup2(nothing, 1)
    os.close(nothing)
    return requests, answers


def _read_ahead(requests: IO[str], stopped: threading.Event) -> Iterator[str]:
    """Give the lines as they come, and end the process when they end, even in the midst of a hanging environment."""
    import queue

    lines: queue.SimpleQueue[str | None] = queue.SimpleQueue()

    def read() -> None:
        for line in requests:
            lines.put(line)
        lines.put(None)
        if not stopped.wait(_GRACE_S):
            os._exit(1)

    threading.Thread(target=read, daemon=True).start()
    return iter(lines.get, None)


def _answer(request: Mapping[str, Any], say: Say) -> None:
    number = request["number"]

    def end(how: str, message: str = "") -> None:
        say({"number": number, "end": how, "message": message})

    sys.path[:] = request["path"]
    try:
        os.chdir(request["directory"])
        env = build(request["recipe"])
    except NotTriedError as error:
        return end("unavailable", str(error))
    except (Exception, SystemExit) as error:  # noqa: BLE001 - foreign code; the other side is told
        return end("unavailable", f"it cannot be made there: {type(error).__name__}: {error}")
    try:
        say({"number": number, "ready": True, "resets": request["state"] is None})
        for answer in _survived(env, request["seed"]) if request["actions"] is None else _played(env, request):
            say({"number": number, **answer})
    except (Exception, SystemExit) as error:  # noqa: BLE001 - foreign code; the other side is told
        return end("failed", f"{type(error).__name__}: {error}")
    finally:
        _close(env)
    return end("done")


def _played(env: AnyEnv, request: Mapping[str, Any]) -> Iterator[dict[str, Any]]:
    reset = None
    if request["state"] is None:
        reset = lambda: env.reset(seed=request["seed"])  # noqa: E731 - a name for one expression
    else:
        cast("Env", env).set_state(request["state"])
    for record in play(reset, env.step, request["actions"]):
        yield {"record": record}


def _survived(env: AnyEnv, seed: int) -> Iterator[dict[str, Any]]:
    env.reset(seed=seed)
    yield {"ready": True}
    for number, action in enumerate(hostile_actions(seed=seed)):
        try:
            result = env.step(action)
            over = bool(result[2] or result[3])
        except (Exception, SystemExit):  # noqa: BLE001 - foreign code; whoever asked tries the same and names it
            over = True
        yield {"record": {}, "resets": over}
        if over:
            env.reset(seed=number)
            yield {"ready": True}


def _close(env: Any) -> None:
    with suppress(Exception, SystemExit):  # a promise of its own tries and names it
        env.close()


if __name__ == "__main__":
    main()
