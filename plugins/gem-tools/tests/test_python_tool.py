"""The tool ``python``: around a task, its options, and what the agent is told."""

from __future__ import annotations

import asyncio
import json
import pickle
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import pytest
from python_levels import until

import gem_core as gem
from gem_core.background import run_sync
from gem_core.data import DatasetEnv
from gem_core.errors import ArgumentError
from gem_core.testing import check_plugin, check_tool
from gem_core.tools import ToolEnv
from gem_tools.python import Limits, Pool, PythonTool, make_python
from gem_tools.python.tool import PACKAGES

ROWS = [{"question": "What is the 30th Fibonacci number?", "answer": "832040"}]


def env_with(**options: Any) -> ToolEnv:
    """Return a task with the tool, at its start."""
    env = ToolEnv(DatasetEnv(ROWS), [("python", options)], max_tool_uses=None)
    env.reset(seed=1)
    return env


def shown(env: ToolEnv, code: str) -> str:
    """Return what the agent reads of a call, without the title and what the environment adds."""
    observation = str(env.step(f"<python>{code}</python>")[0])
    return observation.partition("python:\n")[2].removesuffix("You may call a tool again, or give your answer.\n")


def failed(exception: str, line: int, source: str, piece: str = "<python>", place: str = "<module>") -> str:
    """Return what is shown of an exception."""
    return f'Traceback (most recent call last):\n  File "{piece}", line {line}, in {place}\n    {source}\n{exception}\n'


@pytest.mark.parametrize(
    "action",
    [
        "I compute it.\n<python>\nprint(6 * 7)\n</python>\nand more",
        "```python\nprint(6 * 7)\n```\nand more",
        "```py\nprint(6 * 7)\n```",
        '<tool_call>{"name": "python", "arguments": {"code": "print(6 * 7)"}}</tool_call>',
        gem.Response(
            "",
            tool_calls=[
                {
                    "id": "c1",
                    "type": "function",
                    "function": {"name": "python", "arguments": '{"code": "print(6 * 7)"}'},
                }
            ],
        ),
    ],
    ids=["tag", "fence", "short-fence", "json", "native"],
)
def test_the_forms_of_a_call_mean_the_same(action: str) -> None:
    """Tags, fenced blocks, JSON calls, and native calls of a chat server."""
    observation, _, terminated, _, info = env_with().step(action)
    assert str(observation).startswith("Output of python:\n42\n")
    assert not terminated
    assert info["tool"]["arguments"] == {"code": "print(6 * 7)"}
    assert info["tool"]["status"] == "ok"
    assert info["tool"]["sandbox"] in ("bubblewrap", "docker", "process")
    json.dumps(info["tool"], allow_nan=False)


def test_a_task_is_solved_in_two_turns() -> None:
    """The agent computes, reads, and answers."""
    env = env_with()
    text = shown(env, "a, b = 0, 1\nfor _ in range(30):\n    a, b = b, a + b\na")
    assert text == "832040\n"
    assert env.step(f"\\boxed{{{text.strip()}}}")[1] == 1.0


def test_it_shows_output_value_and_error() -> None:
    """Standard output, standard error, the value of a last expression, and how the code ended."""
    env = env_with()
    assert shown(env, "import sys\nprint('out')\nprint('err', file=sys.stderr)\n[1, 2]") == "out\nerr\n[1, 2]\n"
    assert shown(env, "x = 1") == "The code ran and printed nothing.\n"
    assert shown(env, "print('before')\n1 / 0") == "before\n" + failed(
        "ZeroDivisionError: division by zero", 2, "1 / 0"
    )
    assert shown(env, "import sys\nsys.exit(3)") == "The process ended with exit code 3.\n"
    assert shown(env, "import sys\nsys.exit('no luck')") == "no luck\n"
    assert shown(env, "exit()") == "The code ran and printed nothing.\n"
    assert shown(env, "  ") == "There is no code to run.\n"


def test_the_whole_traceback_on_demand() -> None:
    """With the lines of the code, and none of ours."""
    text = shown(env_with(traceback="full"), "def half(x):\n    return x / 0\nhalf(1)")
    assert text == (
        'Traceback (most recent call last):\n  File "<python>", line 3, in <module>\n    half(1)\n'
        '  File "<python>", line 2, in half\n    return x / 0\n           ~~^~~\nZeroDivisionError: division by zero\n'
    )


def test_each_call_starts_anew_unless_it_is_persistent() -> None:
    """Variables, imports and files are kept for an episode, and only there."""
    env = env_with()
    shown(env, "x = 1")
    assert shown(env, "x") == failed("NameError: name 'x' is not defined", 1, "x")

    env = env_with(persistent=True)
    shown(env, "import math\nx = 2\nopen('note', 'w').write('kept')")
    assert shown(env, "print(open('note').read(), math.sqrt(x * 8))") == "kept 4.0\n"
    shown(env, "def half(y):\n    return y / 0")
    third = failed("ZeroDivisionError: division by zero", 2, "return y / 0", "<python 3>", "half")
    assert shown(env, "\n# This is no line of the function.\nhalf(1)") == third
    assert shown(env, "import sys\nsys.exit(1)") == "The process ended with exit code 1.\n"
    assert shown(env, "x") == "2\n"
    env.reset(seed=2)
    assert shown(env, "x") == failed("NameError: name 'x' is not defined", 1, "x")
    env.close()


def test_a_session_that_is_ended_says_so() -> None:
    """The next call starts anew."""
    env = env_with(persistent=True, timeout_s=0.3)
    shown(env, "x = 1")
    lost = "The session has ended: its variables are lost, and the next call starts anew.\n"
    assert shown(env, "while True: pass") == f"The time limit of 0.3 s was reached.\n{lost}"
    assert shown(env, "x") == failed("NameError: name 'x' is not defined", 1, "x")
    env.close()


def test_long_output_is_cut_in_the_middle() -> None:
    """And says how much was left out."""
    text = shown(env_with(max_output_bytes=100), "for i in range(1000): print(i)")
    head, gap, tail = text.partition("\n[… 3790 bytes left out …]\n")
    assert gap
    assert head.startswith("0\n1\n2\n")
    assert tail.endswith("998\n999\n")
    assert len(head) + len(tail) == 100


def test_what_no_template_can_encode_is_shown_by_its_code() -> None:
    """NULs and lone surrogates, in the output and in the code."""
    env = env_with()
    assert shown(env, "print('a\\0b', '\\ud800')") == "a\\x00b \\ud800\n"
    assert "UnicodeEncodeError" in shown(env, "print('\ud800')")
    assert "null bytes" in shown(env, "x = '\0'")


@pytest.mark.parametrize("persistent", [False, True])
def test_a_failure_of_the_sandbox_is_no_fault_of_the_agent(persistent: bool) -> None:
    """It is told as such to the agent, and to trainers as an error, which truncates the episode."""
    tool = PythonTool(Pool(num_workers=1), Limits(wall_s=60), persistent=persistent)
    env = ToolEnv(DatasetEnv(ROWS), [tool])
    env.reset(seed=1)
    env.step("<python>x = 1</python>")
    (cell,) = tool.pool.cells
    assert cell.process is not None
    code = "import time\ntime.sleep(600)"
    with ThreadPoolExecutor(1) as thread:
        step = thread.submit(env.step, f"<python>{code}</python>")
        assert until(lambda: not tool.pool.idle)
        cell.process.kill()
        observation, reward, terminated, truncated, info = step.result()
    lost = " The session has ended: its variables are lost, and the next call starts anew." if persistent else ""
    assert f"The sandbox failed: the sandbox was lost. This is no fault of your code.{lost}\n" in str(observation)
    assert (reward, terminated, truncated) == (0.0, False, True)
    assert info["error"] == {"kind": "tool", "message": "the sandbox was lost"}
    assert info["tool"]["failed"]
    assert info["tool"]["fault"] == "the sandbox was lost"
    env.close()
    tool.pool.close()


def test_a_machine_without_the_sandbox_is_an_error_of_the_step(monkeypatch: pytest.MonkeyPatch) -> None:
    """And no wrong answer of the agent, who is told of no packages."""
    monkeypatch.setenv("DOCKER_HOST", "unix:///nowhere.sock")
    env = env_with(sandbox="docker", image="none:none")
    assert "standard library" not in env.tools["python"].description
    _, _, terminated, truncated, info = env.step("<python>1</python>")
    assert (terminated, truncated, info["error"]["kind"]) == (False, True, "tool")
    assert "'docker' cannot run here" in info["error"]["message"]


def test_it_works_in_async_code_and_in_threads() -> None:
    """Many environments at once share the sandboxes."""
    envs = [env_with() for _ in range(20)]
    assert {env.concurrency for env in envs} == {"async"}

    async def many() -> list[Any]:
        return await asyncio.gather(*(env.step_async(f"<python>{i} * 2</python>") for i, env in enumerate(envs)))

    assert [str(r[0]).splitlines()[1] for r in asyncio.run(many())] == [str(2 * i) for i in range(20)]
    with ThreadPoolExecutor(8) as threads:
        results = list(threads.map(lambda env: env.step("<python>7</python>"), envs))
    assert {result[4]["tool"]["failed"] for result in results} == {False}


@pytest.mark.parametrize("sandbox", ["auto", "process"])
def test_the_agent_is_told_what_can_be_imported(sandbox: str) -> None:
    """In the instructions and the schema: which Python, and of the well-known packages those that are there."""
    tool = make_python(sandbox=sandbox, timeout_s=30, memory_mb=2048, preload=("click",))
    told = tool.description
    assert told.startswith("Runs Python {}.{} code in a sandbox and shows what".format(*sys.version_info[:2]))
    assert told in tool.instructions()
    assert tool.schema()["function"]["description"] == told
    packages = told.partition(" It has the standard library and ")[2].partition(". ")[0].split(", ")
    assert {"numpy", "click"} <= set(packages)
    assert "gem_core" not in packages
    imports = "".join(f"import {name}\n" for name in packages)
    assert asyncio.run(tool.pool.arun(imports, limits=tool.limits)).error is None
    others = sorted(set(PACKAGES) - set(packages))
    absent = f"import importlib.util\n[name for name in {others} if importlib.util.find_spec(name)]"
    assert asyncio.run(tool.pool.arun(absent, limits=tool.limits, value=True)).value == "[]"


def test_what_the_agent_is_told_is_always_the_same() -> None:
    """At the first reset as at a later one, and in another process."""
    first = env_with().reset(seed=1)[0]
    code = (
        "from gem_core.data import DatasetEnv\nfrom gem_core.tools.env import ToolEnv\nimport sys\n"
        f"env = ToolEnv(DatasetEnv({ROWS!r}), ['python'], max_tool_uses=None)\nsys.stdout.write(env.reset(seed=1)[0])"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout == first == env_with().reset(seed=1)[0]


def test_it_can_be_made_on_the_librarys_own_loop() -> None:
    """As where a slot of a vector environment is made anew."""

    async def make() -> str:
        return make_python(sandbox="process", timeout_s=7).description

    assert run_sync(make()) == make_python(sandbox="process", timeout_s=7).description


def test_it_can_be_sent_to_another_process() -> None:
    """Where it is made again with the same options."""
    tool = pickle.loads(pickle.dumps(make_python(timeout_s=3, persistent=True)))
    assert (tool.limits.wall_s, tool.persistent) == (3, True)


@pytest.mark.parametrize(
    "options",
    [
        {"sandbox": "jail"},
        {"timeout_s": 0},
        {"memory_mb": 1.5},
        {"max_open_files": 3},
        {"traceback": "all"},
        {"num_workers": 0},
        {"preload": [""]},
        {"instructions": "a\nb"},
    ],
)
def test_options_that_cannot_be_right_are_refused(options: dict[str, Any]) -> None:
    """When the tool is made."""
    with pytest.raises(ArgumentError):
        make_python(**options)


def test_the_tool_keeps_its_promises() -> None:
    """Those of every tool, and of every plugin."""
    assert check_tool("python", {"code": "print(1)"})
    assert check_plugin("tools")
