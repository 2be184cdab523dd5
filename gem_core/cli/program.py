"""The command ``gem`` itself: finds a subcommand, runs it, and says in one line what went wrong."""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from typing import Any, NoReturn

import click
from click.shell_completion import CompletionItem

from gem_core import __version__
from gem_core._plugin import gem_add_commands
from gem_core.cli.documented import Documented
from gem_core.cli.layout import echo_line
from gem_core.errors import GemError
from gem_core.registry.entry_points import load_entry_point
from gem_core.registry.lookup import registry
from gem_core.registry.specs import CommandSpec
from gem_core.suggestions import did_you_mean

_OWN = {record.name: record for record in gem_add_commands()}

INTERRUPTED = 130


class _Commands(Documented, click.Group):
    """Finds subcommands by name: the core's, which load no plugin, then those of plugins."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        ctx.obj = list(args)  # for ``typed_command``
        return super().parse_args(ctx, args)

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(_all_commands())

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        record = _OWN.get(cmd_name)
        if record is None:
            registry().raise_if_ambiguous("command", cmd_name)
            record = _all_commands().get(cmd_name)
        if record is None:
            return None
        loaded = load_entry_point(record.entry_point, f"command {cmd_name!r}")
        if not isinstance(loaded, click.Command):
            raise click.ClickException(f"the command {cmd_name!r} of a plugin is a {type(loaded).__name__}")
        return loaded

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        if args and not args[0].startswith("-") and self.get_command(ctx, args[0]) is None:
            names = self.list_commands(ctx)
            hint = registry().install_hint(args[0], "command") or did_you_mean(args[0], names)
            raise click.UsageError(f"no command {args[0]!r}.{hint} There are: {', '.join(names)}")
        return super().resolve_command(ctx, args)

    def shell_complete(self, ctx: click.Context, incomplete: str) -> list[CompletionItem]:
        """Complete the names of commands from the table, where click would import every one of them."""
        items = [CompletionItem(name, help=record.summary) for name, record in _all_commands().items()]
        begun = [item for item in items if item.value.startswith(incomplete)]
        return [*begun, *click.Command.shell_complete(self, ctx, incomplete)]

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        with formatter.section("Commands"):
            formatter.write_dl([(name, record.summary) for name, record in _all_commands().items()])


@click.command(cls=_Commands, context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100})
@click.version_option(__version__, prog_name="gem-core", message="%(prog)s %(version)s")
@click.option("--traceback", is_flag=True, help="Show the whole traceback of an error.")
@click.pass_context
def cli(ctx: click.Context, traceback: bool) -> None:
    """GEM: a gym for language-model agents.

    Examples:
      gem list 'game:*-easy'
      gem info game:Mastermind-v0-hard
      gem play game:GuessTheNumber-v0
      gem run game:GuessTheNumber-v0 --agent bisect --episodes 50
      gem run ./my_env.py:MyEnv --agent my_module:my_agent --num-envs 16 --out runs/mine.jsonl

    A shell completes commands, options, ids, agents, wrappers and files after one of these lines:
      bash  eval "$(_GEM_COMPLETE=bash_source gem)"
      zsh   eval "$(_GEM_COMPLETE=zsh_source gem)"
      fish  _GEM_COMPLETE=fish_source gem | source
    """
    if os.environ.get("NO_COLOR"):  # see no-color.org; rich heeds it by itself
        ctx.color = False


def main(arguments: Sequence[str] | None = None) -> NoReturn:
    """Run the command and exit: 0 on success, 2 for what was asked wrongly, 130 after Ctrl-C, 1 for the rest."""
    arguments = sys.argv[1:] if arguments is None else arguments
    with_traceback = "--traceback" in arguments
    arguments = [argument for argument in arguments if argument != "--traceback"]
    if os.environ.get("_GEM_COMPLETE"):
        from gem_core.cli import completion  # noqa: F401 - it adds the scripts of shells

        cli.main(prog_name="gem")  # answers the shell, and exits
    code: Any = 0
    try:
        # Without cli.main, which would exit with 1 for a closed pipe, and take an agent's EOFError for Ctrl-D.
        with cli.make_context("gem", list(arguments)) as ctx:
            code = cli.invoke(ctx)
        sys.stdout.flush()
    except click.exceptions.Exit as error:
        code = error.exit_code
    except click.exceptions.NoArgsIsHelpError as error:
        click.echo(error.format_message(), err=True)
        code = error.exit_code
    except click.ClickException as error:
        _complain(_click_message(error))
        code = error.exit_code
    except (KeyboardInterrupt, click.Abort):
        click.echo(err=True)  # what follows does not stand behind ^C
        _complain("interrupted")
        code = INTERRUPTED
    except BrokenPipeError:
        # The reader has seen enough, as with `gem list | head`; what is buffered must not be written at exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        code = 0
    except Exception as error:
        if with_traceback:
            raise
        _complain(_line_of(error))
        code = error.exit_code if isinstance(error, GemError) else 1
    sys.exit(code if isinstance(code, int) else 0)


def _complain(message: str) -> None:
    echo_line(f"gem: {' '.join(message.split())}", err=True)


def _line_of(error: Exception) -> str:
    if isinstance(error, GemError):
        return str(error)
    from gem_core.failures import author_frames

    where = "".join(f" ({frame})" for frame in author_frames(error)[-1:])
    return f"{type(error).__name__}: {error}{where}. Run 'gem --traceback …' for the whole"


def _click_message(error: click.ClickException) -> str:
    message = error.format_message()
    if not isinstance(error, click.UsageError):
        return message
    path = error.ctx.command_path if error.ctx else "gem"
    return f"{message.rstrip('.')}{'' if message.endswith('?') else '.'} Run '{path} --help'"


def _all_commands() -> dict[str, CommandSpec]:
    return _OWN | {record.name: record for record in registry().specs(CommandSpec) if record.name not in _OWN}
