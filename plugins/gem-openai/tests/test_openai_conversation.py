"""Whole episodes of a model: what it is sent as the conversation goes on."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from chat_server import ChatServer, MakeAgent, Reply, completion
from PIL import Image
from toys import EchoEnv, Notebook

import gem_core as gem

if TYPE_CHECKING:
    import pytest


def test_a_model_calls_a_tool_and_is_sent_the_conversation(server: ChatServer, make_agent: MakeAgent) -> None:
    """Each request begins with the one before; results stand under the ids of their calls."""
    call = {"id": "c1", "type": "function", "function": {"name": "note", "arguments": '{"line": "one"}'}}
    server.script = [Reply(completion("I note.", tool_calls=[call])), Reply(completion("stop"))]
    (episode,) = gem.rollout(gem.ToolEnv(EchoEnv(), [Notebook()]), make_agent(system="Be brief."), episodes=1)
    first, second = (chat["messages"] for chat in server.chats)
    assert [message["role"] for message in first] == ["system", "user"]
    assert first[0]["content"] == "Be brief."
    assert second[:2] == first
    assert second[2] == {"role": "assistant", "content": "I note.", "tool_calls": [call]}
    assert (second[3]["role"], second[3]["tool_call_id"], second[3]["content"][:4]) == ("tool", "c1", "one\n")
    assert all(chat["tools"] == [Notebook().schema()] for chat in server.chats)
    assert (episode.reads, episode.system, episode.native_tools) == ("messages", "Be brief.", True)


def test_an_image_is_encoded_once_in_a_conversation(
    server: ChatServer, make_agent: MakeAgent, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Though it stands in every later request."""
    picture = Image.new("RGB", (8, 8), "red")

    class Picture(EchoEnv):
        def reset(self, seed: Any = None, options: Any = None) -> Any:
            return [{"type": "image", "image": picture}, {"type": "text", "text": "Look."}], super().reset(seed)[1]

    encoded = []
    save = Image.Image.save
    monkeypatch.setattr(Image.Image, "save", lambda self, *args, **kw: encoded.append(save(self, *args, **kw)))
    server.script = [Reply(completion("<note>one</note>")), Reply(completion("stop"))]
    list(gem.rollout(gem.ToolEnv(Picture(), [Notebook()]), make_agent(), episodes=1))
    first, second = (chat["messages"][0]["content"] for chat in server.chats)
    assert first == second
    assert first[0]["image_url"]["url"].startswith("data:image/png;base64,")
    assert len(encoded) == 1
