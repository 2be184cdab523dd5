"""A model server for the tests, and agents that ask it."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest
import toys
from chat_server import KEY, MODEL, ChatServer, MakeAgent, Waits

from gem_core.background import run_sync
from gem_openai import OpenAIAgent

toys.register_toys()


@pytest.fixture
def server() -> Iterator[ChatServer]:
    """A server that speaks the OpenAI chat API."""
    served = ChatServer()
    yield served
    served.close()


@pytest.fixture
def make_agent(server: ChatServer, monkeypatch: pytest.MonkeyPatch) -> Iterator[MakeAgent]:
    """Makes agents that ask the server, with a key, and whose waits between attempts take no time."""
    monkeypatch.setenv("OPENAI_API_KEY", KEY)
    made: list[OpenAIAgent] = []

    def make(**options: Any) -> OpenAIAgent:
        agent = OpenAIAgent(MODEL, **{"base_url": server.url, **options})
        agent.client.sleep = Waits()
        agent.client.jitter = max
        made.append(agent)
        return agent

    yield make
    for agent in made:
        run_sync(agent.aclose())
