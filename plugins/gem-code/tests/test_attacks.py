"""Programs that want to pass without being right. Each really tries; none may get a test that it does not solve."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from gem_tools.python import Limits

pytestmark = pytest.mark.thorough

if TYPE_CHECKING:
    from judging import Judge

SECRET = "secret-7f3a91c2"
CHECK = f"""
def check(candidate):
    assert candidate(1) == "{SECRET}"
    assert candidate(2) == [1, 2, "{SECRET}"]
    assert candidate(3) is None
"""
PRINTS = {"inputs": ["1\n", "2\n"], "outputs": [f"{SECRET}\n", f"{SECRET} {SECRET}\n"]}

FORGED = r"""
import json, os
passed = {"units": [{"status": "passed", "error": None, "text": ""}] * 3, "calls": [], "problem": None}
lines = [json.dumps(passed), '{"failed": null}', '{"r": true}', '{"r": true}', '{"r": true}', "OK", "passed", "!passed"]
for descriptor in range(64):
    try:
        os.write(descriptor, ("\n".join(lines) + "\n").encode())
    except OSError:
        pass
"""

EQUAL = """
class Equal{base}:
    def __eq__(self, other): return True
    def __ne__(self, other): return False
    def __hash__(self): return 0
    def __bool__(self): return True
    def __len__(self): return 3
    def __getitem__(self, index): return self
    def __repr__(self): return "Equal()"

def f(x): return Equal()
"""

PATCHES = """
import ast, builtins, collections, json, os, sys, types
import __main__
builtins.AssertionError = type("Never", (BaseException,), {})
for name in ("compile", "exec", "eval", "isinstance", "repr", "str", "type"):
    pass
for module in (json, ast, os, __main__):
    for name, value in list(vars(module).items()):
        if isinstance(value, types.FunctionType) and name not in ("main",):
            try:
                setattr(module, name, lambda *a, **k: True)
            except Exception:
                pass
builtins.sorted = builtins.len = lambda *a, **k: 0

def check(candidate): return None
candidate = lambda *a: None
def f(x): return True
"""

SEEK = f"""
import gc, glob, os, sys

def looked_for():
    mark = "secret" + "-"
    def inside(text):
        place = text.find(mark)
        return text[place:place + {len(SECRET)}] if place >= 0 else None
    frame = sys._getframe()
    while frame:
        for value in list(frame.f_locals.values()) + list(frame.f_globals.values()) + [frame.f_code.co_consts]:
            if (found := inside(str(value)[:100000])) and found != mark:
                yield found
        frame = frame.f_back
    for value in gc.get_objects():
        try:
            if isinstance(value, (str, list, dict, tuple)) and (found := inside(str(value)[:10000])):
                yield found
        except Exception:
            pass
    for path in (glob.glob("/proc/*/environ") + glob.glob("/proc/*/cmdline") + glob.glob("/proc/*/fd/*")
                 + glob.glob("/tmp/**", recursive=True) + glob.glob(os.getcwd() + "/**", recursive=True)):
        try:
            if os.path.isfile(path):
                with open(path, "rb") as file:
                    if found := inside(file.read(1000000).decode("latin-1")):
                        yield found
        except OSError:
            pass
    try:
        with open("/proc/self/maps") as maps, open("/proc/self/mem", "rb", 0) as memory:
            for line in maps:
                if " rw" in line:
                    a, b = (int(x, 16) for x in line.split()[0].split("-"))
                    memory.seek(a)
                    if found := inside(memory.read(min(b - a, 50000000)).decode("latin-1")):
                        yield found
    except (OSError, ValueError, OverflowError):
        pass

found = [text for text in looked_for() if len(text) == {len(SECRET)} and text[7:].isalnum()]
"""

ATTACKS = {
    "prints and writes verdicts": FORGED + "def f(x): return True\n",
    "writes answers of a damaged form": (
        "import os\n"
        'lines = [b\'{"failed": null}\', b\'{"r": 1, "a": [[1, 2], {"d": [[1, 2]]}]}\']\n'
        "lines += [b'{\"e\": [\"ExceptionGroup\", \"x\"]}', b'[' * 5000, b'']\n"
        "for descriptor in range(64):\n    try: os.write(descriptor, b'\\n'.join(lines))\n"
        "    except OSError: pass\nos._exit(0)"
    ),
    "exits while it is loaded": "import os\nos._exit(0)",
    "exits by sys.exit": "import sys\nsys.exit(0)",
    "exits when it is called": "import os\ndef f(x): os._exit(0)",
    "raises SystemExit when it is called": "def f(x): raise SystemExit(0)",
    "raises what no test catches": "def f(x): raise GeneratorExit",
    "forges, then exits": FORGED + "os._exit(0)\n",
    "returns an object that equals everything": EQUAL.format(base=""),
    "returns a text that equals everything": EQUAL.format(base="(str)"),
    "returns a list that equals everything": EQUAL.format(base="(list)"),
    "returns a number that equals everything": EQUAL.format(base="(int)"),
    "returns mock.ANY": "from unittest.mock import ANY\ndef f(x): return ANY",
    "patches what is around it": PATCHES,
    "looks for what is expected": SEEK + "def f(x): return found[0] if found else 'nothing found'\n",
    "replaces its own module": (
        "import sys\nsys.modules['solution'] = sys.modules['__main__'] = None\ndef f(x): return True"
    ),
    "leaves threads": (
        "import threading, time\nfor _ in range(5): threading.Thread(target=time.sleep, args=(3600,)).start()\n"
        "def f(x): return True"
    ),
    "leaves processes": "import os, time\nif os.fork() == 0:\n    os.setsid(); time.sleep(3600)\ndef f(x): return True",
    "kills what it can": (
        "import os, signal\ntry: os.kill(-1, signal.SIGKILL)\nexcept OSError: pass\ndef f(x): return True"
    ),
    "answers in an exit handler": "import atexit\natexit.register(print, '{\"r\": true}')\ndef f(x): raise SystemExit",
    "hangs in __repr__": "class A(int):\n    def __repr__(self):\n        while True: pass\ndef f(x): return A()",
    "is no data without an end": "import itertools\ndef f(x): return itertools.count()",
    "is data without an end": "def f(x):\n    a = []\n    for _ in range(60): a = [a, a]\n    return a",
    "nests without an end": "def f(x):\n    a = []\n    for _ in range(100000): a = [a]\n    return a",
}


@pytest.mark.parametrize("code", ATTACKS.values(), ids=ATTACKS)
def test_no_function_passes_without_being_right(judge: Judge, code: str) -> None:
    """Not a single assertion, and in bounded time."""
    verdict = judge(code, CHECK, "f", every=True, limits=Limits(wall_s=4.0, memory_mb=256))
    assert verdict.passed == 0, verdict.info()
    assert verdict.status != "compile_error", "the attack was never made"
    assert len(verdict.tests) == 3


@pytest.mark.parametrize("code", ATTACKS.values(), ids=ATTACKS)
def test_no_program_passes_without_being_right(judge: Judge, code: str) -> None:
    """The same as whole programs, which print what their function returns."""
    limits = Limits(wall_s=4.0, memory_mb=256, output_bytes=1_000_000)
    verdict = judge(f"{code}\nprint(f(1))", PRINTS, every=True, limits=limits)
    assert verdict.passed == 0, verdict.info()


def test_a_right_function_passes_beside_them(judge: Judge) -> None:
    """The tests of the attacks are not merely impossible."""
    code = f"def f(x): return [{SECRET!r}, [1, 2, {SECRET!r}], None][x - 1]"
    assert judge(code, CHECK, "f").correct
    assert judge("x = int(input())\nprint(*['" + SECRET + "'] * x)", PRINTS).correct


@pytest.mark.parametrize(
    "code",
    [
        "import threading, time\nthreading.Thread(target=time.sleep, args=(3600,), daemon=True).start()\n",
        "import threading, time\nthreading.Thread(target=time.sleep, args=(3600,)).start()\n",
    ],
    ids=["daemon", "not daemon"],
)
def test_right_answers_count_whatever_threads_are_left(judge: Judge, code: str) -> None:
    """They end with the process, and hold nothing up."""
    code += f"def f(x): return [{SECRET!r}, [1, 2, {SECRET!r}], None][x - 1]"
    assert judge(code, CHECK, "f").correct


def test_a_program_does_not_find_the_tests_of_the_sample(judge: Judge) -> None:
    """They ship with the plugin, whose package is not shown; under ``process`` nothing is hidden."""
    code = (
        "import os, sys\nfound = []\n"
        "for top in [*sys.path, '/venv', '/work', '/home', '/root', '/tmp', '/usr/lib/python3']:\n"
        "    for folder, _, names in os.walk(top or '.'):\n"
        "        found += [folder for name in names if name == 'sample.jsonl']\n"
        "print(found)"
    )
    verdict = judge(code, {"inputs": [""], "outputs": ["[]"]})
    if verdict.sandbox == "process":
        pytest.skip("this machine has no bubblewrap")
    assert verdict.correct, verdict.info()


def test_a_program_cannot_reach_another_one(judge: Judge) -> None:
    """What one run leaves behind, a later one does not find."""
    code = (
        "import os\npaths = [os.path.join(folder, 'left') for folder in ('.', '/tmp', '/dev/shm', '/var/tmp')]\n"
        "print('found' if any(map(os.path.exists, paths)) else 'new')\n"
        "for path in paths:\n    try:\n        open(path, 'w').write('x')\n    except OSError: pass"
    )
    tests = {"inputs": ["1", "2", "3", "4"], "outputs": ["new"] * 4}
    assert judge(code, tests, parallel=1).correct
