"""``Engine``: the connection to Docker, or to Podman's socket of the same kind, and its errors in words that help."""

from __future__ import annotations

import contextlib
import os
import threading
from collections.abc import Iterator
from math import inf
from typing import Any

import docker
import docker.errors
import requests
import urllib3.exceptions
from docker.utils import version_lt

from gem_core.errors import MissingRequirementError
from gem_terminal.backends.interface import Resources
from gem_terminal.errors import EngineError
from gem_tools.container_engine import EnginePlace, find_engine, why_silent

OLDEST_API = "1.40"
"""Docker 19.03; what is used here was in the interface by then."""

NEWEST_API = "1.47"
"""Docker 27. Newer interfaces than those that were tried here may mean other things by the same words."""

ANSWER_S = 120
"""Seconds in which the engine answers any question; with 32 starts at once on two cores it takes a while."""

FAILURES = (docker.errors.DockerException, requests.RequestException, urllib3.exceptions.HTTPError, OSError, ValueError)
"""What the client raises when the engine does not do its part; it does not turn all of them into its own."""


def is_full(error: object) -> bool:
    """Whether an error says that a disk is full."""
    return any(words in str(error).lower() for words in ("no space left on device", "disk quota exceeded"))


class Client(docker.APIClient):
    """Docker's own client, with a request for what it has no method for."""

    def ask(self, method: str, path: str, **options: Any) -> requests.Response:
        """Ask the engine for something by its path, as ``/containers/NAME/archive``.

        Raises:
            docker.errors.APIError: It refused.
        """
        options.setdefault("timeout", self.timeout)
        response = self.request(method, f"{self.base_url}/v{self.api_version}{path}", **options)
        try:
            response.raise_for_status()
        except requests.HTTPError as error:
            with contextlib.closing(response):
                docker.errors.create_api_error_from_http_exception(error)
        return response

    def negotiate(self) -> bool:
        """Ask for the version, which is used from then on; return whether it is Podman that answers.

        Raises:
            ValueError: It is too old, or no container engine.
        """
        try:
            said = self.version(api_version=False)  # which an engine answers however old it is
            version = str(said["ApiVersion"])
            is_podman = any("podman" in str(part.get("Name", "")).lower() for part in said.get("Components") or ())
        except (KeyError, TypeError, AttributeError) as error:
            raise ValueError("what answers there is no container engine") from error
        if version_lt(version, OLDEST_API):
            raise ValueError(f"its interface has version {version}, and {OLDEST_API} is needed: install a newer engine")
        self._version = version if version_lt(version, NEWEST_API) else NEWEST_API
        return is_podman


class Engine:
    """The connection to a container engine, safe in threads and after a fork.

    Args:
        base_url: Where it is; None for the first that answers, see ``gem_tools.container_engine``.
    """

    def __init__(self, base_url: str | None = None) -> None:
        self._base_url = base_url
        self._lock = threading.Lock()
        self._client: Client | None = None
        self._pid = 0
        self._place = EnginePlace("", "")
        self.is_podman = False
        self._resources: Resources | None = None

    @property
    def client(self) -> Client:
        """The client of this process, connected at the first use.

        Raises:
            EngineError: There is no engine, or none of use; says what to do.
        """
        with self._lock:
            if self._client is None or self._pid != os.getpid():
                # A child that was forked must not speak on its parent's sockets, nor close them with a farewell.
                self._client, self._pid = self._connect(), os.getpid()
            return self._client

    @property
    def variables(self) -> dict[str, str]:
        """The environment in which the commands ``docker`` and ``podman`` talk to this engine."""
        _ = self.client
        if self._place.context:
            return dict(os.environ)  # the command finds it in the same context
        return {**os.environ, "DOCKER_HOST": self._place.url, "CONTAINER_HOST": self._place.url}

    def resources(self) -> Resources:
        """Return the processors and the memory of its computer, asked once; infinity where it does not say.

        Raises:
            EngineError: It does not answer.
        """
        if self._resources is None:
            with self.asking("ask for its resources") as client:
                said = client.info()
            self._resources = Resources(said.get("NCPU") or inf, (said.get("MemTotal") or inf) / 2**20)
        return self._resources

    def close(self) -> None:
        """Close the connections; the next use makes new ones."""
        with self._lock:
            if self._client is not None and self._pid == os.getpid():
                self._client.close()
            self._client = None

    def _connect(self) -> Client:
        """Connect to the engine that the user names, else to the first that answers."""
        try:
            self._place = find_engine(self._base_url or "")
        except MissingRequirementError as error:
            raise EngineError(str(error)) from error
        try:
            return self._open(self._place)
        except FAILURES as error:
            raise EngineError(
                f"no container engine answers at {self._place.url} ({self._place.source}): {why_silent(error)}"
            ) from error

    def _open(self, place: EnginePlace) -> Client:
        options: dict[str, Any] = {}
        if place.source == "DOCKER_HOST":
            options |= docker.utils.kwargs_from_env()
        elif place.context:
            context = docker.context.ContextAPI.get_context(place.context)
            options = {"tls": (context and context.TLSConfig) or False}
        options = {"base_url": place.url, **options}
        client = Client(version=OLDEST_API, timeout=10, max_pool_size=64, **options)
        # Proxies and .netrc have no say on a local socket, and looking for them takes longer than the question.
        client.trust_env = not place.url.startswith("unix:")
        try:
            self.is_podman = client.negotiate()
        except BaseException:
            client.close()
            raise
        client.timeout = ANSWER_S
        return client

    @contextlib.contextmanager
    def asking(self, what: str) -> Iterator[Client]:
        """Give the client, and turn what goes wrong into :class:`EngineError`; a thing that is not there passes.

        Args:
            what: What is tried, in words for the error: "start a container".

        Raises:
            EngineError: The engine failed, or refused.
            docker.errors.NotFound: A container, image or network is not there.
        """
        try:
            yield self.client
        except docker.errors.NotFound:
            raise
        except docker.errors.APIError as error:
            hint = ""
            if is_full(error):
                hint = ". The engine's disk is full: free space ('docker system df')"
            raise EngineError(f"could not {what}: {error.explanation or error}{hint}") from error
        except FAILURES as error:
            raise EngineError(f"could not {what}: the container engine failed: {why_silent(error)}") from error
