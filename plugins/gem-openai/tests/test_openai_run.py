"""``gem run`` with a model server: options, one-line errors, token usage."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import pytest
from chat_server import KEY, ChatServer

import gem_core as gem
from gem_core import extract_code_blocks
from gem_core.cli import main
from gem_core.records import read_episodes

COUNTDOWN = "toy:Countdown-v0"

Run = Callable[..., tuple[int, str, str]]


@pytest.fixture
def run(server: ChatServer, capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Run:
    """Call ``gem run`` in this process, in an empty folder, beside a server and with a key."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("OPENAI_API_KEY", KEY)
    monkeypatch.setenv("OPENAI_BASE_URL", server.url)

    def call(*arguments: str) -> tuple[int, str, str]:
        with pytest.raises(SystemExit) as caught:
            main(["run", *arguments])
        captured = capsys.readouterr()
        everything = captured.out + captured.err + "".join(path.read_text() for path in tmp_path.rglob("*.jsonl"))
        assert KEY not in everything
        return int(caught.value.code or 0), captured.out, captured.err

    return call


def test_token_usage_is_in_the_table_and_in_the_json(run: Run) -> None:
    """Columns that a run without a model does not have."""
    code, out, _ = run(COUNTDOWN, "-n", "3", "--agent", "openai:toy-model", "-o", "a.jsonl")
    turns = sum(episode.turns for episode in read_episodes("a.jsonl"))
    header, row = out.splitlines()[:2]
    assert code == 0
    assert header.endswith("turns/s  tokens in  tokens out")
    assert row.split()[-2:] == [str(7 * turns), str(3 * turns)]
    report = json.loads(run(COUNTDOWN, "-n", "3", "--agent", "openai:toy-model", "--json")[1])
    counted = report["environments"][0]
    assert (counted["prompt_tokens"], counted["completion_tokens"]) == (7 * counted["turns"], 3 * counted["turns"])
    assert "tokens in" not in run(COUNTDOWN, "-n", "3")[1]


def test_options_reach_the_server(server: ChatServer, run: Run) -> None:
    """Those that were given, and a system prompt from a file."""
    Path("system.txt").write_text("Be brief.", encoding="utf-8")
    options = ["--temperature", "0", "--top-p", "0.5", "--max-tokens", "7", "--stop", "x", "--sampling-seed", "0"]
    options += ["--system", "@system.txt", "--extra-body", '{"top_k": 2}', "--token-ids", "--request-timeout", "9"]
    assert run(COUNTDOWN, "-n", "1", "--agent", "openai:toy-model", *options)[0] == 0
    chat = server.chats[0]
    assert chat.pop("messages")[0] == {"role": "system", "content": "Be brief."}
    assert chat == {
        "model": "toy-model",
        "temperature": 0.0,
        "top_p": 0.5,
        "max_tokens": 7,
        "stop": ["x"],
        "seed": 0,
        "top_k": 2,
        "return_token_ids": True,
        "logprobs": True,
    }


def test_two_models_and_a_random_agent_at_their_seats(server: ChatServer, run: Run) -> None:
    """Options reach both models, and not the agent that takes none; each seat's tokens are its own."""
    seats = ("a", "b", "c")
    gem.register("toy:Auction-v0", "joint_toys:AuctionEnv", agents=list(seats), rounds=3, seats=seats)
    by_seat = ["--agent", "a=openai:one", "--agent", "b=openai:two", "--agent", "c=random"]
    code, out, _ = run("toy:Auction-v0", "-n", "2", *by_seat, "--temperature", "0.5", "--json")
    assert code == 0
    asked = [chat for chat in server.chats if "max_tokens" not in chat]  # that is the question at the start
    assert sorted((chat["model"], chat["temperature"]) for chat in asked) == [("one", 0.5)] * 2 + [("two", 0.5)] * 2
    rows = {row["agent"]: row["prompt_tokens"] for row in json.loads(out)["environments"]}
    assert rows == {"openai:one": 14, "openai:two": 14, "random": None}


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--agent", "random", "--top-p", "1"], "unexpected keyword argument 'top_p'. It accepts: no arguments"),
        (["--agent", "openai"], "the agent 'openai' needs the name of a model, as in openai:MODEL"),
        (["--agent", "openai:"], "the agent 'openai' needs the name of a model, as in openai:MODEL"),
        (["--agent", "toys:CountdownEnv.step", "--top-p", "1"], "is not a class, so it takes no options"),
        (["--agent", "openai:m", "--system", "@none.txt"], "--system: cannot read 'none.txt': No such file"),
        (["--agent", "openai:m", "--extra-body", "{"], "--extra-body is no valid JSON"),
        (["--agent", "openai:m", "--extra-body", "[1]"], "--extra-body must be a JSON object, not [1]"),
    ],
)  # fmt: skip
def test_wrong_options_get_one_line_and_exit_code_2(run: Run, arguments: list[str], message: str) -> None:
    """That says what the agent takes."""
    code, out, err = run(COUNTDOWN, *arguments)
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert message in err


def test_the_example_of_the_readme_runs(
    server: ChatServer, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Against a server elsewhere."""
    pytest.importorskip("gem_games")
    monkeypatch.delenv("OPENAI_API_KEY", raising=False)
    readme = Path(__file__).parent.parent / "README.md"
    (example,) = extract_code_blocks(readme.read_text(encoding="utf-8"), "python")
    exec(example.code.replace("http://localhost:8000/v1", server.url), {})
    assert len(capsys.readouterr().out.splitlines()) == 16
