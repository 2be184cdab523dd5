"""The public names, which are imported on first use."""

from .completion import AGENTS as AGENTS, ENVS as ENVS, Words as Words, env_ids as env_ids
from .layout import (
    Column as Column,
    counted as counted,
    echo_line as echo_line,
    output_width as output_width,
    print_table as print_table,
    shown as shown,
    shown_count as shown_count,
    table_lines as table_lines,
    wrapped as wrapped,
)
from .list_command import matching as matching
from .model_options import agent_options as agent_options, given as given
from .play_session import PlaySession as PlaySession
from .program import INTERRUPTED as INTERRUPTED, cli as cli, main as main
from .targets import find_env as find_env, find_envs as find_envs
from .tool_options import (
    AtLeast as AtLeast,
    arguments_option as arguments_option,
    env_arguments as env_arguments,
    parsed_choices as parsed_choices,
    stack_options as stack_options,
    typed_command as typed_command,
    wrapper_stack as wrapper_stack,
)
