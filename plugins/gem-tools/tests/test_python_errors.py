"""The tool ``python``: what an agent reads of code that fails, and of code that is not quite plain Python."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

from gem_tools.python import PythonTool, make_python


@pytest.fixture(scope="module")
def tool() -> PythonTool:
    """The tool as it is by default."""
    return make_python(timeout_s=20)


def shown(tool: PythonTool, code: str) -> str:
    """Return what the agent reads of a call."""
    return str(asyncio.run(tool.call(tool.Parameters(code=code), None)).content)


def failed(line: int, source: str, exception: str, place: str = "<module>") -> str:
    """Return what is shown of an exception."""
    return (
        f'Traceback (most recent call last):\n  File "<python>", line {line}, in {place}\n    {source}\n{exception}\n'
    )


BY_ZERO = "ZeroDivisionError: division by zero"
OWN_TEXT = "class E(Exception):\n    def __str__(self): raise ValueError\nraise E()"
NOT_JSON = "json.decoder.JSONDecodeError: Expecting property name enclosed in double quotes: line 1 column 2 (char 1)"
CAUSE = "try:\n    {}['x']\nexcept KeyError as error:\n    raise ValueError('bad') from error"
VALUE = "class R:\n    def __repr__(self): return 1 / 0\nR()"


@pytest.mark.parametrize(
    ("code", "expected"),
    [
        ("raise ValueError('multi\\nline')", failed(1, r"raise ValueError('multi\nline')", "ValueError: multi\nline")),
        ("x = 1\n\ny = x / 0", failed(3, "y = x / 0", BY_ZERO)),
        ("def half(x):\n    return x / 0\nhalf(1)", failed(2, "return x / 0", BY_ZERO, "half")),
        ("import json\n\njson.loads('{')", failed(3, "json.loads('{')", NOT_JSON)),
        ("exec('a = 1\\n1 / 0')", failed(1, r"exec('a = 1\n1 / 0')", BY_ZERO)),
        ("max([1], [2],\n    key=lambda x: x / 0)", failed(2, "key=lambda x: x / 0)", "TypeError: ", "<lambda>")),
        ("raise KeyboardInterrupt", failed(1, "raise KeyboardInterrupt", "KeyboardInterrupt")),
        ("class E(Exception): pass\nraise E", failed(2, "raise E", "E")),
        (OWN_TEXT, failed(3, "raise E()", "E: <exception str() failed>")),
        ("e = OSError('a')\ne.add_note('b')\nraise e", failed(3, "raise e", "OSError: a\nb")),
        (
            CAUSE.replace("from e", "from None #"),
            failed(4, "raise ValueError('bad') from None #rror", "ValueError: bad"),
        ),
        (VALUE, failed(2, "def __repr__(self): return 1 / 0", BY_ZERO, "__repr__")),
        ("x = '\x0c'\ny = '\u2028'\n1 / 0\n", failed(3, "1 / 0", BY_ZERO)),
    ],
    ids=repr,
)
def test_an_exception_is_shown_with_the_line_of_the_agents_code(tool: PythonTool, code: str, expected: str) -> None:
    """Its type, its whole message, and number and text of the line; no frame of a library."""
    assert shown(tool, code).startswith(expected.removesuffix(" \n"))


def test_a_cause_and_a_group_are_shown_with_their_lines(tool: PythonTool) -> None:
    """As Python shows them."""
    both = "\nThe above exception was the direct cause of the following exception:\n\n"
    second = failed(4, "raise ValueError('bad') from error", "ValueError: bad")
    assert shown(tool, CAUSE) == failed(2, "{}['x']", "KeyError: 'x'") + both + second
    text = shown(tool, "x = 1\nraise ExceptionGroup('two', [ValueError('a'), TypeError('b')])")
    assert '  |   File "<python>", line 2, in <module>\n' in text
    assert "ValueError: a\n" in text
    assert "TypeError: b\n" in text


@pytest.mark.parametrize(
    ("code", "line", "source", "exception"),
    [
        ("x = 1\ndef f(:", 2, "def f(:", "SyntaxError: invalid syntax\n"),
        ("if 1:\nx", 2, "x", "IndentationError: expected an indented block after 'if' statement on line 1\n"),
        ("x = 1\n\nreturn x", 3, "return x", "SyntaxError: 'return' outside function\n"),
        ("    x = 1\n    y = (", 2, "y = (", "SyntaxError: '(' was never closed\n"),
    ],
)
def test_a_syntax_error_is_shown_with_its_line(
    tool: PythonTool, code: str, line: int, source: str, exception: str
) -> None:
    """Whether the parser finds it or the compiler, and with code that is indented as a whole."""
    text = shown(tool, code)
    assert text.startswith(f'  File "<python>", line {line}\n    {source}\n')
    assert text.endswith(f"^\n{exception}")


@pytest.mark.parametrize(
    ("code", "line", "end"),
    [
        ("def f(): g()\ndef g(): f()\nf()", (1, 2), "RecursionError: maximum recursion depth exceeded\n"),
        ("\n10 ** 5000", (2,), "use sys.set_int_max_str_digits() to increase the limit\n"),
        ("eval('1 +')", (1,), "SyntaxError: invalid syntax\n"),
        ("raise ValueError('x' * 100000)", (1,), "xxx\n"),
        ("x = [" + "1, " * 5000 + "] / 2", (1,), "\nTypeError: unsupported operand type(s) for /: 'list' and 'int'\n"),
        ("x = [0] * 10**10", (1,), "MemoryError\nThe limit of 512 MB of memory was reached.\n"),
    ],
    ids=lambda value: repr(value)[:30],
)
def test_what_is_long_or_deep_is_shown_with_one_line(tool: PythonTool, code: str, line: tuple[int], end: str) -> None:
    """However many lines the exception passed, and no more of it than can be read."""
    text = shown(tool, code)
    assert text.startswith(tuple(f'Traceback (most recent call last):\n  File "<python>", line {n}, in ' for n in line))
    assert text.endswith(end)
    assert text.count('File "<python>"') == 1
    assert len(text) < 11_000


def test_an_exit_is_told_as_such(tool: PythonTool) -> None:
    """It is no exception."""
    assert shown(tool, "import sys\nsys.exit(3)") == "The process ended with exit code 3.\n"
    assert shown(tool, "raise SystemExit('no luck')") == "no luck\n"


@pytest.mark.parametrize("code", ["n = int(input())", "def ask():\n    return input('n: ')\nask()"])
@pytest.mark.parametrize("traceback", ["last_line", "full"])
def test_input_says_that_there_is_none(code: str, traceback: str) -> None:
    """And what to do about it."""
    assert shown(make_python(traceback=traceback), code).endswith(
        "EOFError: EOF when reading a line\n"
        "There is no input: nobody answers input(). Write the values into the code.\n"
    )


def test_standard_input_is_empty(tool: PythonTool) -> None:
    """Code that puts another in its place can read that."""
    assert shown(tool, "import sys\nsys.stdin.read()") == "''\n"
    assert shown(tool, "import io, sys\nsys.stdin = io.StringIO('5')\ninput()") == "'5'\n"


@pytest.mark.parametrize(
    ("code", "expected"),
    [
        ("    x = 1\n    x + 1", "2\n"),
        ("\tfor i in range(2):\n\t\tprint(i)\n\n", "0\n1\n"),
        ("# not indented\n    x = '''\n  a\nb'''\n    x", "'\\n  a\\nb'\n"),
        ("    from __future__ import annotations\n    x: Any = 1\n    x", "1\n"),
        ("    x = 1\n    x / 0", failed(2, "x / 0", BY_ZERO)),
        ("```python\nprint(1)\n```", "1\n"),
    ],
)
def test_code_that_is_indented_or_fenced_as_a_whole_runs(tool: PythonTool, code: str, expected: str) -> None:
    """With its own line numbers, and texts in it as they are."""
    assert shown(tool, code) == expected


@pytest.mark.parametrize(
    "line", ["!pip install numpy", "    !ls -l", "%matplotlib inline", "%%time", ">>> x = 1", "pip install numpy"]
)
def test_lines_of_notebooks_and_shells_get_a_sentence(tool: PythonTool, line: str) -> None:
    """It says what to do in their place."""
    indent = " " * (len(line) - len(line.lstrip()))
    text = shown(tool, f"{indent}x = 1\n{line}")
    assert text.startswith('  File "<python>", line 2\n')
    assert text.endswith(
        "SyntaxError: invalid syntax\nLines that begin with !, %, >>> or pip are for notebooks and shells: write plain "
        "Python instead. Nothing can be installed, as there is no network.\n"
    )


@pytest.mark.parametrize("code", ["x = 5 %% 2", "if !x: pass"])
def test_other_syntax_errors_get_none(tool: PythonTool, code: str) -> None:
    """The marks stand within a line."""
    text = shown(tool, code)
    assert "SyntaxError" in text
    assert "notebooks" not in text


@pytest.mark.few(1)
@pytest.mark.parametrize("preload", [(), ("matplotlib.pyplot",)])
def test_matplotlib_says_nothing_of_fonts(preload: Any) -> None:
    """Imported by the code or ahead of it."""
    pytest.importorskip("matplotlib")
    tool = make_python(timeout_s=60, preload=preload, num_workers=1)
    code = "import matplotlib.pyplot as plt\nplt.title('x', family='Nosuch')\nplt.savefig('a.png')\nprint('done')"
    assert shown(tool, code) == "done\n"
