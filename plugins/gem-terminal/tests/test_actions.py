"""Reading what a response does: every form, what is wrong in words, and any text at all."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gem_core.types import Response
from gem_terminal.acting import tool_schemas
from gem_terminal.actions import Bash, Finish, Keys, Malformed, read_action

QWEN = (
    "<tool_call>\n<function=bash>\n<parameter=command>\n{}\n</parameter>\n<parameter=timeout>9</parameter>\n"
    "</function>\n</tool_call>"
)
TERMINUS_JSON = """{
  "analysis": "I see {nothing}.", "plan": "Look.",
  "commands": [{"keystrokes": "cat <x\\n", "duration": 1.5}, {"keystrokes": "C-c"}],
  "task_complete": false
}"""
TERMINUS_XML = """<response><analysis>I see <nothing>.</analysis>
<commands><keystrokes duration="0.5">cat <x
</keystrokes><keystrokes duration="1">C-c</keystrokes></commands>
<task_complete>false</task_complete></response>"""


@pytest.mark.parametrize(
    ("response", "command", "timeout_s"),
    [
        ("<bash>ls -l</bash>", "ls -l", None),
        ("I look.\n<bash>\nls\npwd\n</bash>\nAnd then?", "ls\npwd", None),
        ('<bash timeout="30">make</bash>', "make", 30.0),
        ("<bash timeout=2.5s >make</bash>", "make", 2.5),
        ("text\n```sh\nls\n```\nmore", "ls", None),
        ("~~~shell\necho '```'\n~~~", "echo '```'", None),
        ("<bash>\n```bash\nls\n```\n</bash>", "ls", None),
        ("```bash\n<bash>ls</bash>\n```", "ls", None),
        ("<bash>cmd: ls -l\ntimeout_secs: 3</bash>", "ls -l", 3.0),
        ("<bash>\ncmd: |\n  cat <<E\n  a\n  E\n</bash>", "cat <<E\na\nE", None),
        ('<tool_call>{"name": "bash", "arguments": {"command": "ls", "timeout": 9}}</tool_call>', "ls", 9.0),
        ('<tool_call>{"name": "bash", "arguments": {"cmd": "echo </bash>"}}</tool_call>', "echo </bash>", None),
        ('{"name": "bash", "arguments": {"command": "ls", "timeout": 9}}', "ls", 9.0),
        ('```json\n{"name": "bash",\n "parameters": {"command": "ls\n-l"}}\n```\nThen?', "ls\n-l", None),
        ('<think>{"name": "finish"}</think>{"name": "bash", "arguments": "{\\"command\\": \\"ls\\"}"}', "ls", None),
        ('{"name": "bash", "arguments": {"command": "echo \'<bash>x</bash>\'"}}', "echo '<bash>x</bash>'", None),
        ('The file has\n{"name": "bash", "version": 5}\n<bash>ls</bash>', "ls", None),
        ('<bash>cat >x <<E\n{"name": "finish"}\nE</bash>', 'cat >x <<E\n{"name": "finish"}\nE', None),
        ("<think><bash>rm x</bash></think><bash>ls</bash>", "ls", None),
        ("thought <bash>rm x</bash></think><bash>ls</bash>", "ls", None),
        ("<think>never closed <bash>ls</bash>", "ls", None),
        ("<bash>echo '</think>'</bash>", "echo '</think>'", None),
        ('I use `<bash>` and <bash>echo "<bash>"</bash>', 'echo "<bash>"', None),
        ("<keys>never closed <bash>ls</bash>", "ls", None),
        ("I look.\n```\nls -l\n```", "ls -l", None),
        ("```bash\nls\n```\n```\nits output\n```", "ls", None),
    ],
)
def test_read_action_finds_commands(response: str, command: str, timeout_s: float | None) -> None:
    """Each form of a command is read, with its time limit."""
    read = read_action(response)
    assert isinstance(read, Bash), read
    assert (read.command, read.timeout_s) == (command, timeout_s)


@pytest.mark.parametrize(
    ("response", "command", "timeout_s"),
    [
        (f"I look. {QWEN.format('ls</parameter>')}", "ls</parameter>", 9.0),
        (QWEN.format("ls").removeprefix("<tool_call>").removesuffix("</tool_call>"), "ls", 9.0),
        (f"<think>{QWEN.format('rm x')}</think>{QWEN.format('ls')}", "ls", 9.0),
        ("<tool_call>bash\n<arg_key>command</arg_key>\n<arg_value>ls</arg_value>\n</tool_call>", "ls", None),
        (QWEN.format("ls") + QWEN.format("pwd"), "ls", 9.0),
    ],
)
def test_read_action_finds_commands_of_model_families(response: str, command: str, timeout_s: float | None) -> None:
    """In the forms that gem-tools reads."""
    pytest.importorskip("gem_tools")
    test_read_action_finds_commands(response, command, timeout_s)


@pytest.mark.parametrize(
    ("response", "keys", "wait_s"),
    [
        ("<keys>:wq<Enter></keys>", ":wq<Enter>", None),
        ('<keys wait="2"></keys>', "", 2.0),
        ("<keys>\ty\n</keys>", "\ty\n", None),
        ('<tool_call>{"name": "keys", "arguments": {"keys": ["a", "<C-c>"], "wait": 1}}</tool_call>', "a<C-c>", 1.0),
        (TERMINUS_JSON, "cat <lt>x\n<C-c>", 2.5),
        (f"```json\n{TERMINUS_JSON}\n```", "cat <lt>x\n<C-c>", 2.5),
        ('{"commands": [{"keystrokes": "ls\\n", "is_blocking": true, "timeout_sec": 4}]}', "ls\n", 4),
        (TERMINUS_XML, "cat <lt>x\n<C-c>", 1.5),
    ],
)
def test_read_action_finds_keys(response: str, keys: str, wait_s: float | None) -> None:
    """Keys are taken as they are written, white space included."""
    read = read_action(response)
    assert isinstance(read, Keys), read
    assert (read.keys, read.wait_s) == (keys, wait_s)


FINISHES = ["<finish/>", "<finish />", "<finish>", "<finish></finish>", '<tool_call>{"name": "finish"}</tool_call>']
FINISHES += ['\n{"name": "finish"}', '{"analysis": "All is done.", "commands": [], "task_complete": true}']
FINISHES += ["<response><commands></commands><task_complete>true</task_complete></response>"]


@pytest.mark.parametrize("response", FINISHES)
def test_read_action_finds_the_end(response: str) -> None:
    """All ways to write the end are read."""
    assert isinstance(read_action(f"Done. {response} Bye."), Finish)


@pytest.mark.parametrize(
    ("response", "ignored"),
    [
        ("<bash>ls</bash> and <bash>pwd</bash>, then\n```bash\nid\n```\n<finish/>", 3),
        ("<bash>echo '<finish/>'</bash> I use `<bash>`, <bash>", 0),
        ("<bash>ls</bash>" * 100, 20),
        (TERMINUS_JSON, 0),
        (TERMINUS_XML, 0),
    ],
)
def test_read_action_counts_what_it_ignores(response: str, ignored: int) -> None:
    """Only complete actions, and no more than twenty of them."""
    assert read_action(response).ignored == ignored


def test_read_action_takes_native_calls_before_text() -> None:
    """The first native call is the action; the others are named, so that they can be answered."""
    functions = [
        {"name": "bash", "arguments": '{"command": "ls", "timeout": 5}'},
        {"name": "finish", "arguments": "{}"},
    ]
    calls = [{"id": f"call-{at}", "type": "function", "function": one} for at, one in enumerate(functions)]
    read = read_action(Response("I call.", tool_calls=calls))
    assert read == Bash("ls", 5.0, text="I call.", call_id="call-0", other_call_ids=("call-1",), ignored=1)
    assert isinstance(read_action(Response("<bash>ls</bash>", tool_calls=[])), Bash)


@pytest.mark.parametrize(
    ("response", "reason"),
    [
        ("", "is empty"),
        ("I am not sure.", "no action"),
        ("```python\nprint(1)\n```", "no action"),
        ("```\nls\n```\nor\n```\npwd\n```", "no action"),
        ('{"analysis": "x", "commands": []}', "no action"),
        ("<shell>ls</shell>", "no <shell>"),
        ("<think><bash>ls</bash></think>", "behind </think>"),
        ("<bash>ls", "Write </bash>"),
        ('{"name": "bash", "arguments": {"command": "ls', "no valid JSON"),
        ("```bash\nls", "fenced block is never closed"),
        ("<bash> \n</bash>", "command is empty"),
        ("I use <bash> now. <bash>ls</bash>", "opened twice"),
        ("<bash time='3'>ls</bash>", "no attribute 'time'"),
        ("<bash timeout='soon'>ls</bash>", "number of seconds"),
        ("<keys wait='x'>a</keys>", "number of seconds"),
        ("<bash>cmd: [</bash>", "no valid YAML"),
        ("<bash>timeout_secs: 3</bash>", "under cmd"),
        ("<bash>cmd: ls\nblock: 1</bash>", "no 'block'"),
        ("<bash>cmd: " + "[" * 10_000 + "</bash>", "nested too deeply"),
        ("<bash>cmd: &a [x]\n" + "b: [" + "*a, " * 600 + "]</bash>", "more than"),
        ('<tool_call>{"name": "bsh", "arguments": {}}</tool_call>', "No tool 'bsh'"),
        ('<tool_call>{"name": "bash", "arguments": {"command": "ls", "cwd": "/"}}</tool_call>', "no argument 'cwd'"),
        ('<tool_call>{"name": "bash"}</tool_call>', "must be text"),
        ('<tool_call>{"name": "bash"', "never closed by </tool_call>"),
    ],
)
def test_read_action_says_what_is_wrong(response: str, reason: str) -> None:
    """What cannot be read is answered with how to write it."""
    read = read_action(response)
    assert isinstance(read, Malformed), read
    assert reason in read.reason


def test_read_action_does_not_pass_over_what_was_meant() -> None:
    """An action that is empty is not replaced by a later one, and its text ends with it."""
    read = read_action("<bash></bash> or <finish/>")
    assert isinstance(read, Malformed)
    assert read.text == "<bash></bash>"


PIECES = [
    "<bash>", "</bash>", "<bash timeout='3'>", "<bash a=", "<keys>", "</keys>", "<finish", "/>", ">",
    "<think>", "</think>", "<tool_call>", "</tool_call>", '{"name": "bash", "arguments": {"command": "ls"}}',
    "```bash\n", "\n```\n", "cmd: x\n", "`", '"', "ls",
    "\x00", "\ud800", "é", "{",
]  # fmt: skip


@given(st.lists(st.sampled_from(PIECES) | st.text(max_size=5)).map("".join))
def test_read_action_takes_any_text(response: str) -> None:
    """Whatever is written, there is one action, and its text is a beginning of the response."""
    read = read_action(response)
    assert response.startswith(read.text)
    if isinstance(read, Bash):
        assert read.command.strip()
        assert "<think>" in response or read.command in response or "cmd" in response or "command" in response


OPENINGS = ["<bash>", "<bash ", "</think>", "```bash\n", "<tool_call>{", "<finish ", "<commands>", '{"plan": [']


@pytest.mark.parametrize("piece", OPENINGS)
def test_read_action_reads_megabytes(piece: str) -> None:
    """A response of openings alone is read once, not again from each of them; it would take hours otherwise."""
    assert isinstance(read_action(piece * 100_000), Malformed)


def test_tool_schemas_are_functions_of_the_chat_api() -> None:
    """The actions are described as functions, and what the caller changes in them stays with it."""
    schemas = tool_schemas()
    assert [schema["function"]["name"] for schema in schemas] == ["bash", "keys", "finish"]
    assert schemas[0]["function"]["parameters"]["required"] == ["command"]
    schemas[0]["function"]["parameters"]["properties"].clear()
    assert "command" in tool_schemas()[0]["function"]["parameters"]["properties"]
