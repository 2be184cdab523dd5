"""``gem play``: a person is the agent."""

from __future__ import annotations

import shlex
from collections.abc import Callable
from contextlib import ExitStack, closing

import click

from gem_core.api import make
from gem_core.cli import INTERRUPTED
from gem_core.cli.completion import complete_env_ids, complete_wrappers
from gem_core.cli.play_session import PlaySession, was_not_played
from gem_core.cli.play_view import PlayView, in_one_line
from gem_core.cli.run_command import free_path
from gem_core.cli.tool_options import options_again, tool_options, wrapper_stack
from gem_core.env.wrapper import AnyEnv
from gem_core.errors import ArgumentError, NotSupportedError
from gem_core.records.episode import Episode
from gem_core.records.files import EpisodeWriter
from gem_core.records.plain_json import ImageFolder
from gem_core.registry.lookup import registry
from gem_core.suggestions import did_you_mean
from gem_core.terminal import EndOfInput, Terminal

_COMMANDS = ("help", "undo", "random", "restart", "next", "quit")


@click.command(
    "play",
    epilog="""\b
Examples:
  gem play game:GuessTheNumber-v0
  gem play game:Mastermind-v0-hard --seed 7 --out runs/mine.jsonl
  gem play game:TowerofHanoi-v0-easy --wrappers concat_with_action
  gem play game:Sudoku-v0-easy --tools python
  printf '25\\n12\\n' | gem play game:GuessTheNumber-v0 --seed 1

\b
Answers:
  25           is sent as \\boxed{25} where the environment expects a box; likewise a tag or a fenced
               block. What is in its form already, or calls a tool, is sent as it is; so is
               everything with --raw.
  two lines    End a line with a backslash, or write a block between two lines of triple quotes.
  (nothing)    An empty line is passed over. Six quotes in a row are the empty answer.
  a typo       What the environment could not read does not end an episode, but for --raw: answer again.

\b
Commands, which may be cut short as in !u:
  ?            the keys, the rules, and an example of a valid action
  !undo        take the last turn back, where the environment can save its state; also behind the end
  !random      play a random valid action
  !restart     begin this episode again from the same start
  !next        leave this episode, and begin the next
  !quit        end, as Ctrl-D does
  !!text       is no command but the answer '!text'

\b
Without a terminal, the input is played line by line: one episode, or as many as --episodes says.
Colours are left out without a terminal, and where NO_COLOR is set.
Exit code: 0 at the end or at the end of input, 2 for a wrong argument, 130 after Ctrl-C.
""",
)
@click.argument("env_id", metavar="ID", shell_complete=complete_env_ids)
@click.option("-s", "--seed", type=click.IntRange(min=0), help="The same episodes as 'gem run' with this seed.")
@click.option(
    "-n",
    "--episodes",
    type=click.IntRange(min=1),
    help="Play so many without asking.  [default: ask after each; 1 when piped]",
)
@click.option("-t", "--max-turns", type=click.IntRange(min=1), help="Truncate an episode after so many turns.")
@click.option(
    "-w",
    "--wrappers",
    multiple=True,
    metavar="NAMES",
    shell_complete=complete_wrappers,
    help="Wrappers and tools, innermost first, as in 'concat:max_turns=2'; each observation is then shown exactly as a "
    "model gets it. With '' it is that of the bare environment.",
)
@tool_options
@click.option("-r", "--raw", is_flag=True, help="Send answers as they are typed, without the expected form.")
@click.option("-o", "--out", type=click.Path(dir_okay=False), help="Record the finished episodes in this file.")
@click.option("--overwrite", is_flag=True, help="Write the file anew if it is there.")
@click.pass_context
def command(
    ctx: click.Context,
    env_id: str,
    seed: int | None,
    episodes: int | None,
    max_turns: int | None,
    wrappers: tuple[str, ...],
    tools: tuple[str, ...],
    max_tool_uses: int | str | None,
    raw: bool,
    out: str | None,
    overwrite: bool,
) -> None:
    """Play an environment yourself: you are the agent.

    Shows each observation and reads your answer, with the reward of each turn.
    """
    record = registry().env(env_id)
    stack = wrapper_stack(wrappers, tools, max_tool_uses, max_turns)
    path = None if out is None else free_path(out, overwrite)
    with closing(make(record, wrappers=stack)) as env, ExitStack() as files:
        if not wrappers:
            _draw_boards(env)
        terminal, session = Terminal(), PlaySession(env, seed)
        writer = None if path is None else files.enter_context(EpisodeWriter(path))
        images = None if path is None else ImageFolder.beside(path)
        view = PlayView(session, terminal, exact=bool(wrappers), raw=raw, images=images)
        player = _Player(session, view, terminal, writer, raw)
        interrupted = False
        try:
            player.play(episodes, record.summary)
        except EndOfInput:
            pass
        except KeyboardInterrupt:
            interrupted = True
        finally:
            if writer is not None and not writer.count:
                writer.discard()
            if session.started:
                view.farewell(
                    player.finished, out, _again(max_turns, wrappers, raw, options_again(tools, max_tool_uses))
                )
    if interrupted:
        click.echo("gem: interrupted", err=True)
        ctx.exit(INTERRUPTED)


class _Player:
    """Reads answers and commands until there is nothing more to play."""

    def __init__(
        self, session: PlaySession, view: PlayView, terminal: Terminal, writer: EpisodeWriter | None, raw: bool
    ) -> None:
        self.finished: list[Episode] = []
        self._session = session
        self._view = view
        self._terminal = terminal
        self._writer = writer
        self._raw = raw

    def play(self, episodes: int | None, summary: str) -> None:
        """Play so many episodes; without a number, as long as the person wants, or one without a person.

        Raises:
            EndOfInput: There was nothing more to read.
        """
        while True:
            self._session.begin()
            self._view.opening(summary)
            goes_on = self._play_out(asks=episodes is None and self._terminal.interactive)
            if not goes_on and (episodes is None or len(self.finished) >= episodes):
                return

    def _play_out(self, *, asks: bool) -> bool:
        """Play the present episode to its end, and record it; return whether another is wanted, if that is asked."""
        while True:
            while not self._session.over:
                self._next_input()
            self._view.ending()
            another: bool | None = False
            try:
                if asks:
                    another = self._terminal.confirm("Play another?", other="!undo")
            finally:
                if another is not None:
                    self._record(self._session.episode)
            if another is not None:
                return another
            self._try(self._undo)

    def _record(self, episode: Episode) -> None:
        if self._writer is not None:
            self._writer.write(episode)
        self.finished.append(episode)

    def _next_input(self) -> None:
        typed = self._terminal.ask(f"turn {self._session.episode.turns + 1}> ")
        if typed.is_command:
            self._try(lambda: self._obey(typed.text))
        else:
            self._try(lambda: self._act(typed.text if self._raw else self._session.formed(typed.text)))

    def _try(self, action: Callable[[], None]) -> None:
        try:
            action()
        except (NotSupportedError, ArgumentError) as error:
            self._terminal.show(f"{error}.", fg="yellow")

    def _act(self, answer: str) -> None:
        turn = self._session.act(answer)
        if not self._raw and self._session.over and self._session.can_undo and was_not_played(turn):
            self._session.undo()
            # Why is left out: the last words of a task may give its solution away.
            self._terminal.show(
                f"{in_one_line(answer)} was not played: it cannot be read, or breaks the rules. That would end the "
                "episode, so it does not count: answer again, or type ? for help.",
                fg="yellow",
            )
            return
        self._view.turn(turn)

    def _obey(self, typed: str) -> None:
        found = [name for name in _COMMANDS if name.startswith(typed.casefold())] if typed else []
        if len(found) != 1:
            listed = ", ".join(f"!{name}" for name in found or _COMMANDS)
            raise ArgumentError(f"no command '!{typed}'.{did_you_mean(typed, _COMMANDS)} There are: {listed}, and ?")
        getattr(self, f"_{found[0]}")()

    def _help(self) -> None:
        self._view.help()

    def _undo(self) -> None:
        turn = self._session.undo()
        self._terminal.show(f"Taken back: {in_one_line(turn.action)}", dim=True)
        self._view.situation()

    def _random(self) -> None:
        self._act(self._session.random_action())

    def _restart(self) -> None:
        self._session.restart()
        self._view.opening()

    def _next(self) -> None:
        self._session.begin()
        self._view.opening()

    def _quit(self) -> None:
        raise EndOfInput


def _again(max_turns: int | None, wrappers: tuple[str, ...], raw: bool, tools: list[str]) -> str:
    """Return the options without which the same seed would look different."""
    turns = [] if max_turns is None else ["--max-turns", str(max_turns)]
    around = [word for text in wrappers for word in ("--wrappers", text)]
    return "".join(f" {shlex.quote(word)}" for word in [*turns, *around, *tools, *["--raw"] * raw])


def _draw_boards(env: AnyEnv) -> None:
    # Set on what was made, so that a record holds the arguments that a run without a board would have.
    task = env.unwrapped
    if "ansi" in task.metadata.get("render_modes", []):
        task.render_mode = "ansi"
