"""The public names, which are imported on first use."""

from .checks import (
    check_agent as check_agent,
    check_backend as check_backend,
    check_command as check_command,
    check_wrapper as check_wrapper,
)
from .env_check import ContractError as ContractError, Report as Report, check_env as check_env
from .findings import CheckError as CheckError
from .hostile import hostile_actions as hostile_actions
from .plugin_check import check_plugin as check_plugin
from .tool_check import check_tool as check_tool
