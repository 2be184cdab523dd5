"""Episodes as a model server, tools, images and an ill-meaning model leave them, for the tests of gem show."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from PIL import Image

from gem_core import Episode, JointEpisode, Response, Transition, write_episodes

HOSTILE = (
    "</script><script>alert(1)</script><!-- <img src=x onerror=alert(2)> ]]> &lt; \u2028\u2029 \x1b[2J\x1b]0;owned\x07 "
    "\x9b31m \u202eback \ud800 {{DATA}} {{SCRIPT}} \x00 end"
)
RULES = "Find a way out of the maze. You see what is beside you, and nothing else of the whole of it.\n" * 4


def turn(
    observation: Any, action: str | Response, reward: float = 0.0, *, end: bool = False, **info: Any
) -> Transition:
    """One turn; ``end`` terminates."""
    return Transition(observation, Response.of(action), reward, end, False, info)


def maze(picture: Image.Image | None = None) -> Episode:
    """A solved episode with everything that a server reports, a tool, an image, and observations that repeat."""
    call = {"id": "c1", "type": "function", "function": {"name": "python", "arguments": '{"code": "print(6 * 7)"}'}}
    first = Response(
        "I look around.",
        token_ids=[1, 2, 3],
        logprobs=[-0.1, -0.2, -0.3],
        finish_reason="tool_calls",
        tool_calls=[call],
        reasoning="Where is the door?",
        usage={"prompt_tokens": 120, "completion_tokens": 34},
        model="tiny-1",
    )
    shown = [{"type": "text", "text": "A picture of the room:"}, {"type": "image", "image": picture}]
    observation: Any = RULES + "You are in a room." if picture is None else shown
    return Episode(
        id="maze:Room-v0",
        seed=7,
        observation=observation,
        info={"task_id": "room-7"},
        transitions=[
            turn(observation, first, 0.25, tool={"name": "python", "failed": False}, feedback="The tool says 42."),
            turn(RULES + "The tool says 42.\nA door.", Response("go", finish_reason="length"), -0.5, feedback="Ouch."),
            turn(RULES + "The tool says 42.\nOuch.", "open the door", 1.0, end=True, correct=True),
        ],
        final_observation="You are outside.",
        tools=["python"],
        wrappers=[["concat", {}]],
        group="g1",
    )


def failed(seed: int = 7, group: str = "g1") -> Episode:
    """The same start, another second turn, and no solution."""
    episode = maze()
    second = turn(episode.transitions[1].observation, "stay", 0.0, end=True, correct=False)
    return Episode(
        **{
            **vars(episode),
            "seed": seed,
            "group": group,
            "transitions": [episode.transitions[0], second],
            "final_observation": "Night falls.",
        }
    )


def broken() -> Episode:
    """An episode that the machinery ended."""
    turns = [turn("Say something.", "hello", error={"kind": "timeout", "message": "no answer in 5 s"})]
    return Episode(id="chat:Talk-v0", seed=3, observation="Say something.", info={}, transitions=turns)


def hostile() -> Episode:
    """Text of somebody who means ill, wherever text can stand."""
    info = {"feedback": HOSTILE, HOSTILE: HOSTILE}
    action = Response(HOSTILE, reasoning=HOSTILE, model=HOSTILE, finish_reason=HOSTILE)
    messages: Any = [{"role": HOSTILE, "content": HOSTILE}, {"type": "image", "image": {"__image__": "../" + HOSTILE}}]
    return Episode(
        id=f"evil:{HOSTILE}",
        seed=1,
        observation=messages,
        info={},
        transitions=[Transition(messages, action, 0.0, True, False, info)],
        final_observation=HOSTILE,
        group=HOSTILE,
    )


def seat_of_duel(seat: str, agent: str, turns: list[Transition], **fields: Any) -> Episode:
    """What one seat of a duel saw and did."""
    last = "You have won." if turns and turns[-1].info.get("correct") else "You have lost."
    start = {"observation": turns[0].observation if turns else "Wait.", "info": {}, "final_observation": last}
    return Episode("duel:Words-v0", 4, **start, transitions=turns, seat=seat, agent=agent, **fields)


def duel(winner: str = "white", number: int = 4) -> JointEpisode:
    """An episode of two agents: white, black, then both at once."""
    white = [turn("Say a word.", "apple", 0.5), turn("Black said pear.", "plum", end=True, correct=winner == "white")]
    black = [
        turn("White said apple.", Response("pear", reasoning="Pears beat apples."), -0.5),
        turn("Both at once now.", "fig", 1.0, end=True, correct=winner == "black"),
    ]
    return JointEpisode(
        "duel:Words-v0",
        number,
        seats={"white": seat_of_duel("white", "openai:tiny", white), "black": seat_of_duel("black", "random", black)},
        agents={"white": "openai:tiny", "black": "random"},
        order=[["white"], ["black"], ["white", "black"]],
        group="g2",
    )


def broken_duel() -> JointEpisode:
    """An episode of two agents that ended because one had no answer."""
    error = {"error": {"kind": "agent", "message": "no route"}}
    opponent = {"error": {"kind": "opponent", "message": "the agent at 'black' has no answer"}}
    white = [turn("Say a word.", "apple", 0.5, **opponent)]
    seats = {"white": seat_of_duel("white", "openai:tiny", white), "black": seat_of_duel("black", "random", [])}
    seats["black"].info, seats["black"].first_reward = error, 2.0
    return JointEpisode("duel:Words-v0", 5, seats=seats, order=[["white"]])


def write_all(path: Path) -> Path:
    """Write the five of them, with an image beside the file, and return the path."""
    picture = Image.new("RGB", (64, 48), (200, 40, 40))
    picture.paste((40, 40, 200), (8, 8, 40, 40))
    write_episodes(path, [maze(), failed(), broken(), hostile(), maze(picture)])
    return path
