"""Programs that are used by keys: what they show, and how commands and keys take turns."""
# ruff: noqa: F811 - the fixtures come from shell_machines

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from shell_machines import backend, has_bash, machine, shell  # noqa: F401 - fixtures

if TYPE_CHECKING:
    from gem_terminal.shell import ScreenResult, Shell

LONG = 30.0
CURSES = """
import curses
def main(screen):
    screen.border()
    said = ["pressed"]
    while said[-1] != "q":
        screen.addstr(2, 4, " ".join(said))
        screen.refresh()
        said.append(curses.keyname(screen.getch()).decode())
curses.wrapper(main)
print("left")
"""


def until(shell: Shell, wanted: str | Callable[[ScreenResult], bool], keys: str = "") -> ScreenResult:
    """Press keys, and look until the screen shows something, or has become as wanted."""
    seen = shell.press(keys, 2.0)
    for _ in range(40):
        if wanted in seen.screen if isinstance(wanted, str) else wanted(seen):
            return seen
        seen = shell.press("", 0.5)
    raise AssertionError(f"{wanted!r} is not on the screen:\n{seen.screen}")


def at_prompt(seen: ScreenResult) -> bool:
    """Whether the shell has the terminal again."""
    return not seen.running


def test_press_uses_a_program_that_asks(shell: Shell) -> None:
    """A Python prompt answers what is typed; the shell's prompt comes back at its end, with the exit code."""
    shell.run("x=here", LONG)
    assert until(shell, ">>>", "python3 -q<Enter>").running
    assert until(shell, "42", "6*7<Enter>").running
    assert until(shell, at_prompt, "exit(7)<Enter>").exit_code == 7
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
    asks = "printf 'password: '; stty -echo; read p; stty echo; echo; echo \"got ${#p}\""
    shell.run(f"cat > asks.sh <<'E'\n{asks}\nE", LONG)
    assert until(shell, "password:", "sh asks.sh<Enter>").running
    assert "secret" not in until(shell, "got 6", "secret<Enter>").screen


def test_press_interrupts(shell: Shell) -> None:
    """A program that floods the terminal is interrupted by a key, and the shell is there."""
    assert until(shell, "y\ny\ny", "yes<Enter>").running
    assert until(shell, at_prompt, "<C-c>").exit_code == 130
    assert shell.run("echo here", LONG).output.endswith("here\n")


def test_run_types_into_no_program_and_behind_no_half_line(shell: Shell) -> None:
    """While a program holds the terminal, a command is not run, and the agent is told how to leave."""
    until(shell, "started", "echo start''ed; cat > got<Enter>")
    result = shell.run("echo typed", LONG)
    assert (result.waiting, result.exit_code, result.output) == (True, None, "")
    assert "holds the terminal" in result.note
    until(shell, at_prompt, "<C-d>")
    assert shell.run("wc -c < got", LONG).output.strip() == "0"
    until(shell, "half a line", "touch half a line")
    assert shell.run("ls", LONG).output == "got\n"


def test_press_says_when_the_shell_has_ended(shell: Shell) -> None:
    """The end of the shell by keys is told, with its exit code, and a new one has its prompt."""
    shell.press("", 0.1)
    seen = until(shell, lambda seen: seen.restarted, "exit 5<Enter>")
    assert (seen.running, seen.exit_code) == (False, 5)
    assert shell.run("echo here", LONG).output == "here\n"


def test_terminal_answers_no_questions(shell: Shell) -> None:
    """A program that asks the terminal what it is gets no answer, which the shell would read as a command."""
    shell.run("printf '\\033[c\\033[6n\\033[>c\\033]10;?\\007'", LONG)
    until(shell, at_prompt, "printf '\\033[c\\033[6n'<Enter>")
    assert shell.run("echo here", LONG).output == "here\n"
