"""``Settings``: the keywords of ``TerminalEnv``, checked."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from gem_core.errors import ArgumentError
from gem_terminal.backends.interface import Limits
from gem_terminal.verifying.verdict import RewardRule  # noqa: TC001 - pydantic evaluates annotations
from gem_terminal.verifying.verify import Where  # noqa: TC001

_Number = Annotated[float, Field(allow_inf_nan=False)]
_Seconds = Annotated[float, Field(gt=0, le=10 * 365 * 86_400)]
_Count = Annotated[int, Field(ge=1, le=2**40)]
_Path = Annotated[str, Field(pattern=r"(?s)^/.*[^/]")]
"""An absolute one below the root."""


class Settings(BaseModel):
    """How episodes run; what each means is told in ``TerminalEnv``.

    Raises:
        ArgumentError: A value that is not accepted.
    """

    model_config = ConfigDict(strict=True, frozen=True, extra="forbid")

    reward: RewardRule
    weights: Mapping[str, Annotated[_Number, Field(ge=0)]] | None
    command_timeout_s: _Seconds
    most_command_timeout_s: _Seconds
    agent_timeout_s: _Seconds | Literal["task"] | None
    episode_timeout_s: _Seconds | None
    max_turns: _Count | None
    malformed_penalty: _Number
    max_malformed: _Count | None
    max_output: Annotated[int, Field(ge=100, le=2**40)]
    columns: Annotated[int, Field(ge=20, le=1000)]
    lines: Annotated[int, Field(ge=5, le=1000)]
    show_time: bool
    cpus: Annotated[_Number, Field(ge=0.01)] | None
    memory_mb: Annotated[int, Field(ge=16, le=2**40)] | None
    processes: Annotated[int, Field(ge=16, le=2**40)]
    storage_mb: _Count | None
    network: Literal["task", "none", "public"]
    verify_in: Where
    artifacts: tuple[_Path, ...]
    pool_size: Annotated[int, Field(ge=0, le=1000)]

    def __init__(self, **values: Any) -> None:
        try:
            super().__init__(**values)
        except ValidationError as error:
            first = error.errors(include_url=False)[0]
            name = str(first["loc"][0])
            raise ArgumentError(f"{name} is {values.get(name)!r:.200}: {first['msg']}") from None

    @property
    def limits(self) -> Limits:
        """What each container may take."""
        return Limits(self.cpus, self.memory_mb, self.processes, self.storage_mb, self.network)

    @property
    def longest_command_s(self) -> float:
        """Seconds that a command may ask for."""
        return max(self.command_timeout_s, self.most_command_timeout_s)

    @property
    def return_range(self) -> tuple[float, float] | None:
        """The lowest and the highest return; None if a task's own reward file or the number of turns leaves it open."""
        penalty = self.malformed_penalty
        if self.reward != "all" or (penalty and self.max_turns is None):
            return None
        of_malformed = penalty * (self.max_turns or 0)
        return min(0.0, of_malformed), 1.0 + max(0.0, of_malformed)
