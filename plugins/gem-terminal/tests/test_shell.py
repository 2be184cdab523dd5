"""Commands in a persistent shell: what it keeps, what it answers, and what it survives."""

# ruff: noqa: F811 - the fixtures come from shell_machines

from __future__ import annotations

import hashlib

import pytest
from host_machine import HostMachine
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from shell_machines import backend, has_bash, machine, shell  # noqa: F401 - fixtures

from gem_terminal.backends.interface import Machine  # noqa: TC001 - hypothesis reads the hints
from gem_terminal.errors import MachineLostError
from gem_terminal.shell import CommandResult, Shell

LONG = 30.0
bash_only = pytest.mark.usefixtures("has_bash")


def answer(shell: Shell, command: str) -> tuple[str, int | None]:
    """Return output and exit code of a command that ends by itself, in the shell that is there."""
    result = shell.run(command, LONG)
    assert not result.restarted, result
    assert not result.timed_out, result
    return result.output, result.exit_code


ANSWERS = [
    ("printf abc", "abc", 0),
    ("(exit 77)", "", 77),
    ("echo out; echo err >&2", "out\nerr\n", 0),
    ("cat <<E\na $((1+1))\nE", "a 2\n", 0),
    ("for i in 1 2 3\ndo\n  echo $i\ndone", "1\n2\n3\n", 0),
    ("printf '%s|' \"it's\" 'say \"x\"' '\\' '$HOME'", 'it\'s|say "x"|\\|$HOME|', 0),
    ("echo é漢字😀", "é漢字😀\n", 0),
    ("echo a\x00b", "ab\n", 0),
    ("printf '%s' '\x03\x04\x15\x1a\x7f' | od -An -c | tr -d ' \\n'", "003004025032177", 0),
    ("printf '\\377\\n'", "\ufffd\n", 0),
    ("true # a comment", "", 0),
    ("sh -c 'kill -9 $$'", "Killed\n", 137),
    ("test -t 0 && test -t 1 && echo terminal", "terminal\n", 0),
    ("echo \ud800", "?\n", 0),
]


def test_run_answers_with_output_and_exit_code(shell: Shell) -> None:
    """A command is run as it is written; its output has no echo, no prompt and no mark in it."""
    for command, output, exit_code in ANSWERS:
        assert answer(shell, command) == (output, exit_code), command


def test_run_keeps_the_state_of_the_shell(shell: Shell) -> None:
    """Working directory, variables, functions, jobs and the last exit code live on; there is no history."""
    answer(shell, 'mkdir sub; cd sub; x=5; export y="a b"; f() { echo "f $1"; }')
    result = shell.run('echo $x; sh -c \'echo "$y"\'; f 3; basename "$PWD"; false', LONG)
    assert (result.output, result.exit_code) == ("5\na b\nf 3\nsub\n", 1)
    assert result.workdir.endswith("/sub")
    assert answer(shell, "echo $?") == ("1\n", 0)
    answer(shell, "(until test -e go; do sleep 0.05; done; echo done > said) & job=$!")
    assert answer(shell, "kill -0 $job && touch go && wait $job; cat said")[0].endswith("done\n")
    assert "touch" not in answer(shell, "fc -l -5 2>/dev/null; cat ~/.bash_history 2>/dev/null; true")[0]


def test_run_answers_what_is_no_command(shell: Shell) -> None:
    """A command that is not complete is an error at once, and the shell is as it was."""
    answer(shell, "x=here")
    for command in ("echo 'unbalanced", "echo $(", "if true; then", "cat <<'E'\nnever ended", "fi", "("):
        shell.run(command, LONG)
        assert answer(shell, "echo $x") == ("here\n", 0), command


SETTINGS = [
    "unset PROMPT_COMMAND PS1; PS0=x",
    "PROMPT_COMMAND='echo prompt'; PS1='> '; PS2='>> '",
    "stty raw echo",
    "stty -icanon -isig min 0",
    "s=tty; s=s${s%?}y; set -- st; ${1}ty sane 2>/dev/null",
    "set -u -f",
    "trap 'x=trapped' USR1 INT EXIT",
    "alias echo='echo aliased' printf=false eval=false",
    "export LC_ALL=C TERM=dumb IFS=:",
    "unset HOME PATH_; readonly z=3",
    "exec 3>&1 </dev/tty 2>/dev/null",
]


@pytest.mark.few(5)
@pytest.mark.parametrize("command", SETTINGS)
def test_run_outlives_settings(shell: Shell, command: str) -> None:
    """Whatever an agent sets, the next command is answered in the same shell."""
    assert not shell.run(f"x=here; {command}", LONG).restarted
    assert answer(shell, "command echo $x") == ("here\n", 0)
    assert answer(shell, "command echo $x") == ("here\n", 0)


@bash_only
def test_run_outlives_redefined_builtins(shell: Shell) -> None:
    """Functions by the names of what the shell itself is run with change nothing; a lost one is made anew."""
    answer(
        shell, "x=here; printf() { :; }; eval() { :; }; read() { :; }; local() { :; }; test() { false; }; stty() { :; }"
    )
    assert answer(shell, "echo $x") == ("here\n", 0)
    for command in ("unset -f __gem_prompt __gem_keep __gem_begin", "builtin() { :; }"):
        shell.run(command, 1.0)
        shell.run("true", 1.0)
        assert answer(shell, "echo here") == ("here\n", 0)


@bash_only
def test_run_says_what_a_trace_says(shell: Shell) -> None:
    """With ``set -x`` the trace is of the command, and not of what the shell is run with."""
    answer(shell, "set -x")
    output = answer(shell, "echo traced")[0]
    assert output.endswith("++ echo traced\ntraced\n")
    assert "__gem" not in output


ENDS = [("exit 3", 3), ("kill -9 $$", 137), ("set -e; false", 1), ("exec sh -c 'exit 4'", 4)]


@pytest.mark.parametrize(("command", "exit_code"), ENDS)
def test_run_starts_a_new_shell(shell: Shell, command: str, exit_code: int) -> None:
    """A shell that ends is replaced by one in the same directory, and the agent is told."""
    answer(shell, "mkdir sub; cd sub; x=here")
    result = shell.run(f"echo before; {command}", LONG)
    assert result.output.startswith("before\n")
    assert (result.exit_code, result.restarted, result.timed_out) == (exit_code, True, False)
    assert result.workdir.endswith("/sub")
    assert result.note.startswith("The shell has ended")
    assert answer(shell, 'echo "${x-}"; basename "$PWD"') == ("\nsub\n", 0)


def test_run_starts_a_new_shell_when_a_job_has_killed_it(shell: Shell) -> None:
    """A shell that ended between two commands is replaced before the next, which is told of."""
    shell.run("(sleep 0.2; kill -9 $$) & cat", 2.0)
    assert shell.run("echo here", LONG).output.endswith("here\n")


@bash_only
@pytest.mark.parametrize("command", ["exec bash", "exec sh", "exec env ENV= sh", "exec bash --norc"])
def test_run_follows_a_shell_into_another(shell: Shell, command: str) -> None:
    """One of another kind has none of the first one's functions, and may not read what bash does."""
    answer(shell, "export x=kept; cd /")
    assert not shell.run(command, LONG).timed_out
    for _ in range(2):
        result = shell.run("echo $x $PWD; false", LONG)
        assert (result.output, result.exit_code, result.timed_out) == ("kept /\n", 1, False)


@bash_only
def test_open_outlives_a_startup_file_that_ends_the_shell(machine: Machine, shell: Shell) -> None:
    """An agent that puts ``exit`` where shells begin does not lock itself out."""
    answer(shell, 'cp ~/.bashrc kept 2>/dev/null; echo "exit 9" > ~/.bashrc')
    second = Shell(machine, workdir="/")
    assert second.run("echo here", LONG).output == "here\n"
    second.close()
    answer(shell, "mv kept ~/.bashrc 2>/dev/null || rm ~/.bashrc")


def test_run_hides_output_that_is_sent_away(shell: Shell) -> None:
    """After ``exec >/dev/null`` nothing is shown, as the agent wished, until it comes back."""
    answer(shell, "exec >/dev/null 2>&1")
    assert answer(shell, "echo lost; exec >/dev/tty 2>&1; echo back") == ("back\n", 0)


def test_run_is_not_fooled_by_marks(shell: Shell) -> None:
    """A program that prints what the shell says of itself, with any word it can find, ends nothing early."""
    forged = (
        'for w in \'\' "${__gem_word-}" "${__gem_keys-}" 0123456789abcdef; do '
        'printf \'\\033]7701;P;%s;0;0;%s;/forged;%s\\007\' "$w" $$ "$w" >/dev/tty; done; '
        "tr '\\0' '\\n' </proc/$PPID/cmdline | grep -E '^[0-9a-f]{16}$' >word; "
        "printf '\\033]7701;X;%s;0\\007' \"$(cat word)\"; sleep 0.3; echo end; (exit 5)"
    )
    assert answer(shell, forged) == ("end\n", 5)
    assert answer(shell, "echo next") == ("next\n", 0)


def test_run_outlives_the_loss_of_devices(machine: Machine, shell: Shell) -> None:
    """An agent that is root may remove what a terminal is reached by; its shell goes on."""
    if isinstance(machine, HostMachine):
        pytest.skip("these devices are everyone's")
    assert answer(shell, "mv /dev/tty /dev/kept; touch /dev/tty; echo gone") == ("gone\n", 0)
    assert answer(shell, "rm -f /dev/tty; echo here") == ("here\n", 0)
    shell.close()
    assert answer(shell, "mv /dev/kept /dev/tty; echo here") == ("here\n", 0)


def test_run_takes_a_command_of_half_a_megabyte(shell: Shell) -> None:
    """A terminal cuts lines at 4096 bytes; a long command arrives to the letter all the same."""
    content = "é'\\ \x01\t$x`\n" * 40_000
    expected = hashlib.md5(content.encode()).hexdigest()
    assert answer(shell, f"cat > big <<'END'\n{content}END\nmd5sum < big") == (f"{expected}  -\n", 0)


def test_run_cuts_output_in_the_middle(machine: Machine) -> None:
    """Of much output the beginning and the end are shown, and the program is not held up."""
    shell = Shell(machine, most_output=1000)
    result = shell.run("seq 1 300000; echo last", LONG)
    shell.close()
    assert result.output.startswith("1\n2\n3\n")
    assert result.output.endswith("300000\nlast\n")
    assert result.dropped > 1_900_000
    assert len(result.output) < 1100


def test_run_shows_what_a_job_wrote_meanwhile(shell: Shell) -> None:
    """What background jobs write between two commands comes with the next."""
    answer(shell, "(until test -e go; do sleep 0.02; done; echo from a job; touch said) &")
    commands = ["touch go", "until test -e said; do sleep 0.02; done", "true"]
    assert "from a job\n" in "".join(answer(shell, command)[0] for command in commands)


def test_run_raises_when_the_machine_is_gone(machine: Machine, shell: Shell, monkeypatch: pytest.MonkeyPatch) -> None:
    """A machine that is lost is not taken for a shell that has ended."""
    lost = MachineLostError("the container was removed", by_agent=False)
    monkeypatch.setattr(machine, "why_lost", lambda: lost)
    with pytest.raises(MachineLostError, match=r"^the container was removed$"):
        shell.run("kill -9 $PPID; kill -9 $$", LONG)


def test_a_shell_that_no_longer_starts_is_the_agents_doing(machine: Machine, monkeypatch: pytest.MonkeyPatch) -> None:
    """One that has never started is nobody's that is known: the image may have none."""
    shell = Shell(machine)
    shell.open()
    shell.close()
    opens = machine.open_terminal
    monkeypatch.setattr(machine, "open_terminal", lambda _, **how: opens(["true"], **how))
    for broken, by_agent in ((shell, True), (Shell(machine), None), (Shell(machine, again=True), True)):
        with pytest.raises(MachineLostError) as caught:
            broken.open()
        assert caught.value.by_agent is by_agent


def test_close_may_be_called_again(shell: Shell) -> None:
    """A closed shell begins anew with the next command, where it was."""
    answer(shell, "cd /tmp; x=here")
    shell.close()
    shell.close()
    assert answer(shell, 'echo "${x-}$PWD"') == ("/tmp\n", 0)


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(text=st.text(st.characters(exclude_characters="\x00", exclude_categories=["Cs"]), max_size=200))
def test_run_passes_any_text_to_programs(shell: Shell, text: str) -> None:
    """Any text in single quotes arrives at a program as it is."""
    quoted = "'" + text.replace("'", "'\\''") + "'"
    result = shell.run(f"printf %s {quoted} | od -An -v -tx1 | tr -d ' \\n'", LONG)
    assert result == CommandResult(text.encode().hex(), 0, workdir=result.workdir)
