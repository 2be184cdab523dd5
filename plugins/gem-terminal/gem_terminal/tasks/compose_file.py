"""The part of a Compose file that task formats use, as models; scalars arrive as they are written.

Source: the Compose specification.
"""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import BeforeValidator, ConfigDict, Field

from gem_terminal.tasks.reading import Section
from gem_terminal.tasks.units import megabytes, seconds


def _empty_is_list(value: Any) -> Any:
    return [] if value is None else value


def _empty_is_dict(value: Any) -> Any:
    return {} if value is None else value


def _seconds(value: Any) -> Any:
    return seconds(value) if isinstance(value, str) else value


def _megabytes(value: Any) -> Any:
    return megabytes(value) if isinstance(value, str) else value


Words = str | list[str] | None
Pairs = Annotated[list[str] | dict[str, str | None], BeforeValidator(_empty_is_dict)]
Strings = Annotated[list[str], BeforeValidator(_empty_is_list)]
Duration = Annotated[float, BeforeValidator(_seconds), Field(ge=0, le=1e6)]
Size = Annotated[int, BeforeValidator(_megabytes)]
Processors = Annotated[float, Field(ge=0, le=100_000, allow_inf_nan=False)]


class Build(Section):
    """How an image is built; what stands in ``refused`` of ``compose.py`` is looked at there."""

    context: str = "."
    dockerfile: str | None = None
    args: Pairs = Field(default_factory=dict)
    target: str | None = None


class Check(Section):
    """A healthcheck; the defaults are the specification's."""

    test: Words = None
    interval: Duration = 30.0
    timeout: Duration = 30.0
    retries: Annotated[int, Field(ge=1, le=100_000)] = 3
    start_period: Duration = 0.0
    start_interval: Duration | None = None
    disable: bool = False


class Limits(Section):
    """Limits of a service."""

    cpus: Processors | None = None
    memory: Size | None = None
    pids: int | None = None


class Resources(Section):
    """Limits, and what is set aside."""

    limits: Limits = Limits()
    reservations: Any = None


class Deploy(Section):
    """How a service is run."""

    resources: Resources = Resources()
    replicas: int | None = None
    mode: Any = None
    labels: Any = None
    restart_policy: Any = None
    update_config: Any = None


class Mount(Section):
    """A volume in its long form."""

    type: str = "volume"
    source: str | None = None
    target: str
    read_only: bool = False
    bind: Any = None
    volume: Any = None
    tmpfs: Any = None


class Dependency(Section):
    """What another service has to be before this one starts."""

    condition: str = "service_started"
    restart: Any = None
    required: bool = True


class EnvFile(Section):
    """A file of variables in its long form."""

    path: str
    required: bool = True
    format: str | None = None


class Attachment(Section):
    """How a service stands in a network."""

    aliases: Strings = Field(default_factory=list)


class Service(Section):
    """A container."""

    build: str | Build | None = None
    image: str | None = None
    command: Words = None
    entrypoint: Words = None
    environment: Pairs = Field(default_factory=dict)
    env_file: str | list[str | EnvFile] | None = None
    depends_on: Annotated[list[str] | dict[str, Dependency | None], BeforeValidator(_empty_is_list)] = Field(
        default_factory=list
    )
    healthcheck: Check | None = None
    working_dir: str | None = None
    user: str | None = None
    hostname: str | None = None
    container_name: str | None = None
    networks: Annotated[list[str] | dict[str, Attachment | None], BeforeValidator(_empty_is_list)] = Field(
        default_factory=list
    )
    network_mode: str | None = None
    volumes: Annotated[list[str | Mount], BeforeValidator(_empty_is_list)] = Field(default_factory=list)
    tmpfs: str | list[str] | None = None
    deploy: Deploy = Deploy()
    cpus: Processors | None = None
    mem_limit: Size | None = None
    shm_size: Size | None = None
    profiles: Strings = Field(default_factory=list)
    scale: int | None = None


class NetworkEntry(Section):
    """A network."""

    internal: bool = False
    external: bool | dict[str, Any] = False
    driver: str | None = None
    name: Any = None
    labels: Any = None
    ipam: Any = None
    attachable: Any = None


class VolumeEntry(Section):
    """A volume."""

    external: bool | dict[str, Any] = False
    driver: str | None = None
    driver_opts: dict[str, Any] | None = None
    name: Any = None
    labels: Any = None


class ComposeFile(Section):
    """A Compose file."""

    model_config = ConfigDict(extra="allow", frozen=True)

    version: Any = None
    name: Any = None
    services: dict[str, Service]
    networks: Annotated[dict[str, NetworkEntry | None], BeforeValidator(_empty_is_dict)] = Field(default_factory=dict)
    volumes: Annotated[dict[str, VolumeEntry | None], BeforeValidator(_empty_is_dict)] = Field(default_factory=dict)
