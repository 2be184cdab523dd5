"""``task.toml`` of Harbor, as models; keys of older versions are renamed as Harbor does.

Source: the package ``harbor`` 0.25.0, schema version 1.4.
"""

from __future__ import annotations

import math
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, field_validator, model_validator

from gem_terminal.tasks.reading import Section
from gem_terminal.tasks.units import megabytes


def _name(value: Any) -> Any:
    return str(value) if isinstance(value, int) and not isinstance(value, bool) else value


def _words(value: Any) -> Any:
    return {key: str(one) for key, one in value.items()} if isinstance(value, dict) else value


Seconds = Annotated[float, Field(gt=0, le=1e7, allow_inf_nan=False)]
User = Annotated[str | None, BeforeValidator(_name)]
Megabytes = Annotated[int, Field(gt=0, le=2**40)]
Variables = Annotated[dict[str, str], BeforeValidator(_words)]
Mode = Literal["public", "no-network", "allowlist"]


class Phase(Section):
    """The network of a part."""

    network_mode: Mode | None = None
    allowed_hosts: list[str] | None = None

    @field_validator("allowed_hosts")
    @classmethod
    def _hosts(cls, hosts: list[str] | None) -> list[str] | None:
        for host in hosts or []:
            if not host.strip() or len(host) > 255 or any(one in host for one in "\0 \t\n@?#"):
                raise ValueError(f"{host[:60]!r} is no host; expected a name, an address or a range of addresses")
        return hosts

    @model_validator(mode="after")
    def _hosts_need_mode(self) -> Phase:
        if self.allowed_hosts and self.network_mode != "allowlist":
            raise ValueError("'allowed_hosts' is given; expected network_mode = 'allowlist' with it")
        return self


class Check(Section):
    """A healthcheck."""

    command: str
    interval_sec: Annotated[float, Field(ge=0, le=1e6)] = 5.0
    timeout_sec: Seconds = 30.0
    start_period_sec: Annotated[float, Field(ge=0, le=1e6)] = 0.0
    start_interval_sec: Annotated[float, Field(ge=0, le=1e6)] = 5.0
    retries: Annotated[int, Field(ge=1, le=100_000)] = 3


class EnvironmentSection(Phase):
    """``[environment]``."""

    build_timeout_sec: Seconds = 600.0
    docker_image: Annotated[str, Field(min_length=1, max_length=1000)] | None = None
    os: str = "linux"
    cpus: Annotated[float, Field(gt=0, le=100_000, allow_inf_nan=False)] | None = None
    memory_mb: Megabytes | None = None
    storage_mb: Megabytes | None = None
    gpus: int | None = None
    gpu_types: list[str] | None = None
    tpu: Any = None
    mcp_servers: list[Any] = Field(default_factory=list)
    env: Variables = Field(default_factory=dict)
    skills_dir: str | None = None
    healthcheck: Check | None = None
    workdir: str | None = None
    allow_internet: bool | None = None

    @model_validator(mode="before")
    @classmethod
    def _rename(cls, data: Any) -> Any:
        """Take ``memory = "2G"`` for ``memory_mb``, and the same of ``storage``; where both are there, they agree."""
        if not isinstance(data, dict):
            return data
        data = dict(data)
        for old in ("memory", "storage"):
            if old not in data:
                continue
            written = data.pop(old)
            size = written if isinstance(written, int) else megabytes(str(written))
            if data.setdefault(f"{old}_mb", size) != size:
                raise ValueError(f"'{old}' is {written!r} and '{old}_mb' {data[f'{old}_mb']!r}; expected one of them")
        return data

    @field_validator("gpus")
    @classmethod
    def _at_least_none(cls, gpus: int | None) -> int | None:
        if gpus is not None and gpus < 0:
            raise ValueError("expected a number of graphics cards")
        return gpus


class Agent(Phase):
    """``[agent]``."""

    timeout_sec: Seconds | None = None
    user: User = None


class Collect(Section):
    """``[[verifier.collect]]``."""

    command: str
    service: str = "main"
    timeout_sec: Seconds = 60.0
    user: User = None


class VerifierSection(Phase):
    """``[verifier]``."""

    timeout_sec: Seconds = 600.0
    env: Variables = Field(default_factory=dict)
    user: User = None
    environment_mode: Literal["shared", "separate"] | None = None
    environment: EnvironmentSection | None = None
    collect: list[Collect] = Field(default_factory=list)

    @model_validator(mode="after")
    def _mode_fits(self) -> VerifierSection:
        if self.environment_mode == "shared" and self.environment is not None:
            raise ValueError("'environment' is given with environment_mode = 'shared'; expected one of them")
        return self

    @property
    def separate(self) -> bool | None:
        """Whether it runs in an environment of its own; None where it does not say."""
        if self.environment_mode is None:
            return True if self.environment is not None else None
        return self.environment_mode == "separate"


class Artifact(Section):
    """A path that is kept of the agent's container."""

    source: str
    destination: str | None = None
    exclude: list[str] = Field(default_factory=list)
    service: str | None = None


class SolutionSection(Section):
    """``[solution]``."""

    env: Variables = Field(default_factory=dict)


class StepSection(Section):
    """``[[steps]]``."""

    name: str
    agent: Agent = Agent()
    verifier: VerifierSection = VerifierSection()
    min_reward: float | dict[str, float] | None = None
    healthcheck: Check | None = None
    artifacts: list[str | Artifact] = Field(default_factory=list)

    @field_validator("name")
    @classmethod
    def _one_folder(cls, name: str) -> str:
        if not name.strip() or name in (".", "..") or len(name) > 200 or any(one in name for one in "/\\\0\n"):
            raise ValueError("expected the name of a folder in 'steps'")
        return name

    @field_validator("min_reward")
    @classmethod
    def _finite(cls, reward: float | dict[str, float] | None) -> float | dict[str, float] | None:
        numbers = reward.values() if isinstance(reward, dict) else [reward or 0.0]
        if not all(math.isfinite(number) for number in numbers):
            raise ValueError("expected a finite number")
        return reward


class Package(Section):
    """``[task]``."""

    name: Any = None
    version: Any = None
    description: Any = None
    authors: Any = None
    keywords: Any = None


class TaskFile(Section):
    """``task.toml``."""

    schema_version: Any = None
    version: Any = None
    source: Any = None
    task: Package | None = None
    metadata: dict[str, Any] = Field(default_factory=dict)
    agent: Agent = Agent()
    verifier: VerifierSection = VerifierSection()
    environment: EnvironmentSection = EnvironmentSection()
    solution: SolutionSection = SolutionSection()
    multi_step_reward_strategy: Literal["mean", "final"] | None = None
    artifacts: list[str | Artifact] = Field(default_factory=list)
    steps: list[StepSection] = Field(default_factory=list)
