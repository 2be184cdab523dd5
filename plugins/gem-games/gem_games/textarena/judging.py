"""``Judge``: stands in for the language models that TextArena asks in GuessWho, TwentyQuestions, Debate and others."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from gem_core.background import run_sync
from gem_core.rollouts import AgentTraits, Context, as_agent, load_agent


class JudgeError(Exception):
    """The judge failed, whatever the players did."""


def _nobody(question: str) -> str:
    raise JudgeError("there is no judge")


class Judge:
    """Answers what TextArena's game master is asked, and votes as its jury.

    Args:
        options: What a vote is between.
        ask: Answers a question.
        **_: What else TextArena gives its jury and its game master.
    """

    def __init__(self, options: Sequence[str] = (), ask: Callable[[str], str] = _nobody, **_: Any) -> None:
        self.options, self.ask = options, ask

    def __deepcopy__(self, memo: dict[int, Any]) -> Judge:
        return Judge(self.options, self.ask)

    def __call__(self, question: str) -> str:
        """Answer as the game master."""
        return self.ask(question)

    def evaluate(self, context: str) -> dict[str, float]:
        """Vote as a jury of one; an answer that names no option is a vote for none."""
        listed = ", ".join(map(repr, self.options))
        answer = self.ask(f"{context}\n\nAnswer with one of these, and nothing else: {listed}.").lower()
        places = {option: answer.rfind(option.lower()) for option in self.options}
        chosen = max(places, key=places.__getitem__)
        return {option: float(option == chosen and places[option] >= 0) for option in self.options}


class AgentJudge:
    """An agent that answers as a judge; each question is a conversation of its own.

    Args:
        agent: An agent, or the name of one.
    """

    def __init__(self, agent: Any) -> None:
        self._agent = load_agent(agent) if isinstance(agent, str) else as_agent(agent)

    def __deepcopy__(self, memo: dict[int, Any]) -> AgentJudge:
        return self  # it keeps nothing of a game

    def ask(self, question: str, episode: str, env_id: str) -> str:
        """Return the answer to a question.

        Raises:
            JudgeError: The agent failed.
        """
        traits = AgentTraits.of(self._agent)
        messages = [{"role": "system", "content": traits.system}] if traits.system is not None else []
        messages.append({"role": "user", "content": question})
        context = Context(
            episode=episode,
            env_id=env_id,
            group=None,
            turn=0,
            info={},
            tools=[],
            transitions=[],
            system=traits.system,
            read_messages=messages.copy,
        )
        try:
            answer = self._agent(context.messages if traits.reads == "messages" else question, context)
            return str(answer if isinstance(answer, str) else run_sync(answer))
        except Exception as error:
            raise JudgeError(f"{type(error).__name__}: {error}"[:300]) from error


def judges_of(game: Any) -> list[Judge]:
    """Return the judges of a game of TextArena."""
    return [part for part in vars(game).values() if isinstance(part, Judge)]
