"""Every error that the library raises on purpose, in one hierarchy.

::

    GemError
    ├── UsageError                 what was asked for cannot be right (exit code 2)
    │   ├── UnknownNameError       no such name; the nearest ones are given
    │   │   ├── UnknownEnvError
    │   │   ├── UnknownToolError
    │   │   ├── UnknownWrapperError
    │   │   ├── UnknownBackendError
    │   │   ├── UnknownAgentError
    │   │   ├── UnknownModelError
    │   │   └── UnknownPluginError
    │   └── ArgumentError          a keyword, value or option that is not accepted
    ├── RegistrationError          a record that cannot be taken, or a name taken twice
    ├── PluginError                a plugin failed and GEM_PLUGINS_STRICT is set
    ├── EntryPointError            what a record points to cannot be imported
    ├── MissingRequirementError    something has to be installed, started or set first
    ├── ResetNeededError           step before the first reset, or after the end
    ├── ClosedError                a vector environment was used after it had been closed
    ├── NotSupportedError          an optional ability that this environment does not have
    │   ├── StateNotSupported      fork()
    │   └── SamplingNotSupported   sample_random_action
    ├── BridgeError                synchronous call from the library's own event loop
    ├── EnvFaultError              an environment failed, at its reset or with on_error="raise"
    │   └── WorkerLostError        a worker died before it answered
    ├── FaultBudgetError           replacements fail again and again
    ├── RequestError               a model server did not answer, whatever the answer would have been
    │   └── EpisodeLimitError      a limit of the episode is reached: truncated, and scored
    │       └── ContextOverflowError   the history is longer than the model takes
    ├── AgentError                 an agent that cannot be called, or did not return text
    ├── GradingError               a verdict could not be reached; never a reward of 0
    ├── DatasetError               rows that are missing, empty or without a needed column
    └── EpisodeFileError           a file of episodes that cannot be read at all

``gem_core.testing.ContractError`` is an ``AssertionError`` as well, so that it stays with the checks.
"""

from __future__ import annotations

import sys
from typing import ClassVar


class GemError(Exception):
    """Base of all errors that the library raises on purpose."""

    exit_code: ClassVar[int] = 1
    """Exit code of the ``gem`` command when this error ends it."""


class UsageError(GemError):
    """The request itself is wrong: a name, an argument or an option."""

    exit_code = 2


class UnknownNameError(UsageError, LookupError):
    """No record has this name; the message gives the nearest ones."""


class UnknownEnvError(UnknownNameError):
    """No environment has this id."""


class UnknownToolError(UnknownNameError):
    """No tool has this name."""


class UnknownWrapperError(UnknownNameError):
    """No wrapper and no tool has this name."""


class UnknownBackendError(UnknownNameError):
    """No vector backend has this name."""


class UnknownAgentError(UnknownNameError):
    """No agent and no importable module has this name."""


class UnknownModelError(UnknownNameError):
    """The model server has no model of this name."""


class UnknownPluginError(UnknownNameError):
    """No installed plugin has this name."""


class ArgumentError(UsageError, TypeError):
    """A keyword, a value or an option that is not accepted."""


class RegistrationError(GemError, ValueError):
    """A record that cannot be taken, or a name that is taken already."""


class PluginError(GemError):
    """A plugin failed while ``GEM_PLUGINS_STRICT`` is set."""


class EntryPointError(GemError, ImportError):
    """The entry point of a record cannot be imported."""


class MissingRequirementError(GemError):
    """Something has to be installed, started or set before this can run."""


class ResetNeededError(GemError):
    """``step`` was called before the first ``reset``, or after the episode had ended."""


class ClosedError(GemError):
    """A vector environment was used after ``close()``; make another."""


class NotSupportedError(GemError):
    """An optional ability that this environment does not have."""


class StateNotSupported(NotSupportedError):
    """The environment holds something that ``fork`` cannot copy, such as a container or a connection."""


class SamplingNotSupported(NotSupportedError):
    """The environment cannot draw a valid random action."""


class BridgeError(GemError, RuntimeError):
    """A synchronous call was made on the library's own event loop, where it could never finish."""


class EnvFaultError(GemError):
    """An environment failed: at its reset, or in a vector environment made with ``on_error="raise"``."""


class WorkerLostError(EnvFaultError):
    """A worker died before it answered a question; its environments go on in another."""


class FaultBudgetError(GemError):
    """Environments fail again and again without finishing an episode."""


class RequestError(GemError):
    """A model server did not answer a request: the episode ends in an error.

    Args:
        message: The error in words.
        cause: Its kind in a word, as ``"timeout"`` or ``"rate_limit"``, which records keep.
    """

    def __init__(self, message: str = "", *, cause: str | None = None) -> None:
        super().__init__(message)
        self.cause = cause


class EpisodeLimitError(RequestError):
    """An agent is not asked again, since a limit is reached: the episode is truncated and scored, and is no error.

    Args:
        message: The error in words.
        limit: Name of the limit, as ``"time"`` or ``"cost"``, which ``Episode.cut_off`` tells.
    """

    def __init__(self, message: str = "", *, limit: str = "limit") -> None:
        super().__init__(message)
        self.limit = limit


class ContextOverflowError(EpisodeLimitError):
    """The history has grown beyond what the model takes: the episode is truncated and scored, and is no error."""

    def __init__(self, message: str = "") -> None:
        super().__init__(message, limit="tokens")


class AgentError(GemError, TypeError):
    """An agent that cannot be called, or that did not return text."""


class GradingError(GemError):
    """A verdict could not be reached, whatever the answer was. It is never a reward of 0."""


class DatasetError(GemError, ValueError):
    """Rows that are missing, empty, or without a needed column."""


class EpisodeFileError(GemError):
    """A file of episodes that cannot be read at all."""


def refuse_windows(what: str) -> None:
    """Raise on Windows; called first by modules that need processes, signals and files as Linux and macOS have them.

    Raises:
        MissingRequirementError: This is Windows.
    """
    if sys.platform == "win32":
        raise MissingRequirementError(f"{what} cannot run on Windows: it needs Linux or macOS; use WSL")
