"""Programs that are used by keys: what they show, and how commands and keys take turns."""
# ruff: noqa: F811 - the fixtures come from shell_machines

from __future__ import annotations

import shutil
from typing import TYPE_CHECKING

import pytest
from host_machine import HostMachine
from shell_machines import backend, has_bash, machine, shell  # noqa: F401 - fixtures

if TYPE_CHECKING:
    from gem_terminal.backends.interface import Machine
    from gem_terminal.shell import ScreenResult, Shell

LONG = 30.0
CURSES = """
import curses
def main(screen):
    screen.keypad(True)
    curses.curs_set(0)
    said = []
    while True:
        screen.erase()
        screen.border()
        screen.addstr(2, 4, "pressed " + " ".join(said))
        screen.refresh()
        key = curses.keyname(screen.getch()).decode()
        if key == "q":
            return
        said.append(key)
curses.wrapper(main)
print("left")
"""


def until(shell: Shell, wanted: str, keys: str = "", tries: int = 40) -> ScreenResult:
    """Press keys, and look at the screen until it shows something."""
    seen = shell.press(keys, 2.0)
    for _ in range(tries):
        if wanted in seen.screen:
            return seen
        seen = shell.press("", 0.5)
    raise AssertionError(f"{wanted!r} is not on the screen:\n{seen.screen}")


def at_prompt(shell: Shell, keys: str = "", tries: int = 40) -> ScreenResult:
    """Press keys, and look at the screen until the shell has the terminal again."""
    seen = shell.press(keys, 2.0)
    for _ in range(tries):
        if not seen.running:
            return seen
        seen = shell.press("", 0.5)
    raise AssertionError(f"a program still runs:\n{seen.screen}")


def needs(machine: Machine, program: str) -> None:
    """Skip where a program is missing."""
    there = shutil.which(program) if isinstance(machine, HostMachine) else None
    if there is None and machine.run(["sh", "-c", f"command -v {program}"], timeout_s=20).exit_code != 0:
        pytest.skip(f"there is no {program}")


def test_press_uses_a_program_that_asks(shell: Shell) -> None:
    """A Python prompt answers what is typed; the shell's prompt comes back at its end."""
    shell.run("x=here", LONG)
    assert until(shell, ">>>", "python3 -q<Enter>").running
    assert until(shell, "42", "6*7<Enter>").running
    at_prompt(shell, "exit()<Enter>")
    assert until(shell, "here", "echo $x<Enter>").text().endswith("[the shell is at its prompt]")
    assert shell.run("echo $x", LONG).output == "here\n"


def test_press_uses_a_program_that_draws(shell: Shell) -> None:
    """A curses program shows its picture and gets special keys; the screen is as before when it ends."""
    shell.run(f"cat > draws.py <<'E'{CURSES}E", LONG)
    seen = until(shell, "pressed", "python3 draws.py<Enter>")
    assert seen.running
    assert set("┌┐└┘│─") <= set(seen.screen)
    assert "pressed a KEY_UP KEY_F(5) ^X" in until(shell, "^X", "a<Up><F5><C-x>").screen
    seen = until(shell, "left", "q")
    assert "pressed" not in seen.screen
    assert "python3 draws.py" in seen.screen


def test_press_answers_a_question_without_echo(shell: Shell) -> None:
    """A password is typed and not shown."""
    shell.run(
        "cat > asks.sh <<'E'\nprintf 'password: '; stty -echo; read p; stty echo; echo; echo \"got ${#p}\"\nE", LONG
    )
    assert until(shell, "password:", "sh asks.sh<Enter>").running
    seen = until(shell, "got 6", "secret<Enter>")
    assert "secret" not in seen.screen


def test_press_pages_with_less(machine: Machine, shell: Shell) -> None:
    """A pager is walked through and left."""
    needs(machine, "less")
    seen = until(shell, ":", "seq 1 500 | less<Enter>")
    assert "39" in seen.screen
    assert "500" in until(shell, "500", "G").screen
    assert "499" not in at_prompt(shell, "q").screen


def test_press_edits_with_vim(machine: Machine, shell: Shell) -> None:
    """A file is written with an editor."""
    needs(machine, "vim")
    until(shell, "new.txt", "vim --clean new.txt<Enter>")
    until(shell, "hello world", "ihello world<Esc>")
    at_prompt(shell, ":wq<Enter>")
    assert shell.run("cat new.txt", LONG).output == "hello world\n"


def test_press_interrupts(shell: Shell) -> None:
    """A program that floods the terminal is interrupted by a key, and the shell is there."""
    assert until(shell, "y\ny\ny", "yes<Enter>").running
    assert at_prompt(shell, "<C-c>").exit_code == 130
    assert shell.run("echo here", LONG).output.endswith("here\n")


def test_run_does_not_type_into_a_program(shell: Shell) -> None:
    """While a program holds the terminal, a command is not run, and the agent is told how to leave."""
    until(shell, "started", "echo start''ed; cat > got<Enter>")
    result = shell.run("echo typed", LONG)
    assert (result.waiting, result.exit_code, result.output) == (True, None, "")
    assert result.note.startswith(
        "A program that was started with keys holds the terminal, so the command was not run."
    )
    at_prompt(shell, "<C-d>")
    assert shell.run("wc -c < got", LONG).output.strip() == "0"


def test_run_leaves_a_half_typed_line(shell: Shell) -> None:
    """What stands at the prompt is not run with the next command."""
    until(shell, "half a line", "touch half a line")
    assert shell.run("ls", LONG).output == ""


def test_press_says_when_the_shell_has_ended(shell: Shell) -> None:
    """The end of the shell by keys is told, with its exit code, and a new one has its prompt."""
    shell.press("", 0.1)
    seen = shell.press("exit 5<Enter>", 5.0)
    for _ in range(20):
        if seen.restarted:
            break
        seen = shell.press("", 0.5)
    assert (seen.restarted, seen.running, seen.exit_code) == (True, False, 5)
    assert seen.note == "the shell had ended, and a new one was started"
    assert shell.run("echo here", LONG).output == "here\n"


def test_press_reports_the_exit_code_at_the_prompt(shell: Shell) -> None:
    """At the prompt, the exit code of what keys have run is known."""
    until(shell, "said", "echo sa''id; (exit 7)<Enter>")
    seen = at_prompt(shell)
    assert seen.exit_code == 7
    assert "[the shell is at its prompt]" in seen.text()


def test_commands_see_a_program_that_needs_a_key_end_with_its_time(shell: Shell) -> None:
    """An interactive program that was started as a command is killed with its time."""
    assert shell.run("python3 -q", 1.0).timed_out
    assert shell.run("echo here", LONG).output == "here\n"


def test_terminal_answers_no_questions(shell: Shell) -> None:
    """A program that asks the terminal what it is gets no answer, which the shell would read as a command."""
    shell.run("printf '\\033[c\\033[6n\\033[>c\\033]10;?\\007'", LONG)
    at_prompt(shell, "printf '\\033[c\\033[6n'<Enter>")
    assert shell.run("echo here", LONG).output == "here\n"
