"""For gallery.py with ``--measure``: play the environments, for scores, two episodes of each family, and pictures."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import gallery_players as players
from gallery_drawing import Frame, plain, spread

import gem_core as gem
from gem_core.records import Episode, JointEpisode
from gem_core.records.summary import EnvSummary
from gem_core.registry import EnvSpec
from gem_core.terminal import observation_text

SEED = 20
"""Seed of every run."""
MOST_FRAMES = 12
MOST_TURNS = 8
"""Turns of a transcript; of a longer one the first and the last ones are kept."""
_LONGEST_OPENING, _LONGEST_ANSWER = 2_400, 700

Player = str | Callable[..., Any]


class Solver(NamedTuple):
    """Who plays well.

    Args:
        name: What the tables call it.
        make: Returns the agent, or its name, for an environment.
        told: A sentence about it.
    """

    name: str
    make: Callable[[Any], Player]
    told: str


class Case(NamedTuple):
    """A way to play an environment: the name of the table's row, and the agent, or the agents by seat."""

    name: str
    agents: dict[str, Player]
    """By seat; ``""`` is the seat of an agent alone."""


def _agent(name: str) -> Solver:
    return Solver(
        f"`{name}`", lambda env: name, f"`{name}` is an agent that comes with the plugin (`gem info {name}`)."
    )


def _script(name: str, make: Callable[[], Player], told: str) -> Solver:
    return Solver(
        name, lambda env: make(), f"{told} It is part of the script that made this page, `scripts/gallery_players.py`."
    )


GOLD = Solver(
    "own solution",
    lambda env: lambda observation: env.get_wrapper_attr("gold_action")() or "",
    "The own solution is what the environment itself knows to be right (`gold_action`). It is no agent: it shows the "
    "highest return that there is.",
)
SOLVERS = {
    "game/guess-the-number": _agent("bisect"),
    "game/mastermind": _agent("mastermind"),
    "game/towerof-hanoi": _agent("hanoi"),
    "game/wiki-game": _agent("wikigame"),
    "game/tic-tac-toe": _agent("tictactoe"),
    "game/kuhn-poker": _agent("kuhn"),
    "game/negotiation": _agent("negotiator"),
    "game/wordle": _script(
        "word list", lambda: players.wordle, "It guesses the first common word that fits all marks."
    ),
    "game/hangman": _script(
        "word list", lambda: players.hangman, "It asks for the letter that most of the words have that still fit."
    ),
    "game/minesweeper": _script(
        "reasoning", lambda: players.minesweeper, "It reveals what the numbers show to be safe, and else guesses."
    ),
    "game/game2048": _script("corner", lambda: players.game_2048, "It keeps its large tiles in a corner."),
    "game/fifteen-puzzle": _script(
        "search", players.fifteen_puzzle, "It searches for a way (A*), in 4,000 positions a turn."
    ),
    "game/sokoban": _script("search", players.sokoban, "It searches for a short way (A*)."),
    "terminal/sample": _script("its solution", players.terminal, "It types the solution that comes with the task."),
    "mcp/sample": _script("its solution", players.databases, "It runs the SQL that solves the task."),
    "tau/sample": Solver(
        "`tau-assistant`",
        lambda env: "tau-assistant:careful",
        "`tau-assistant:careful` is an agent that comes with the plugin; the user is `tau-user:patient`.",
    ),
}
SOLVERS["tau/sample-solo"] = SOLVERS["tau/sample"]
SOLVERS["terminal/sample-terminal-bench"] = SOLVERS["terminal/sample"]
NO_SOLVER = {"game/rock-paper-scissors", "pz/connect-four", "pz/rps", "pz/tictactoe", "ta"}
"""Nobody here plays these well, or knows an answer; and in rock, paper, scissors nothing is better than chance."""

EPISODES = {
    "game": 1_000,
    "code": 20,
    "math": 60,
    "qa": 60,
    "rg": 20,
    "ta": 5,
    "pz": 50,
    "tau": 10,
    "mcp": 8,
    "terminal": 14,
}
"""Episodes of each player, by namespace."""
FEWER = {
    "game:Sokoban-v0-hard": 10,
    "game:Sokoban-v0-random": 10,
    "game:FifteenPuzzle-v0-hard": 20,
    "game:FifteenPuzzle-v0-random": 20,
}
USER = {"user": "tau-user:patient"}


def solver_of(page: str) -> Solver | None:
    """Return who plays a family well; None where nobody does."""
    return None if page in NO_SOLVER else SOLVERS.get(page, GOLD)


def episodes_of(record: EnvSpec) -> int:
    """Return how many episodes each player plays."""
    return FEWER.get(record.id, EPISODES.get(record.namespace, 100))


def cases_of(page: str, record: EnvSpec, env: Any) -> list[Case]:
    """Return who plays an environment: a random player first."""
    solver = solver_of(page)
    seats = getattr(env.unwrapped, "possible_agents", None)
    if not seats:
        knows = solver is not GOLD or _knows(env)
        good = [Case(solver.name, {"": solver.make(env)})] if solver is not None and knows else []
        return [Case("`random`", {"": "random"}), *good]
    if "user" in seats:
        return [Case(name, {"assistant": agent, **USER}) for name, agent in _two(solver, env)]
    cases = [Case("`random`", dict.fromkeys(seats, "random"))]
    if solver is not None:
        first, second = seats
        made = solver.make(env)
        cases.append(Case(f"{solver.name} as {first}", {first: made, second: "random"}))
        cases.append(Case(f"{solver.name} as {second}", {first: "random", second: made}))
        cases.append(Case(f"{solver.name} in both seats", dict.fromkeys(seats, made)))
    return cases


def _knows(env: Any) -> bool:
    """Return whether an environment can say a right answer."""
    env.reset(seed=SEED)
    return env.get_wrapper_attr("gold_action")() is not None


def _two(solver: Solver | None, env: Any) -> Iterable[tuple[str, Player]]:
    yield "`random`", "random"
    if solver is not None:
        yield solver.name, solver.make(env)


def measure_family(page: str, records: Sequence[EnvSpec]) -> dict[str, Any]:
    """Play all environments of a family, and record two episodes of the first.

    Returns:
        Plain JSON: ``rows`` of scores, and the ``good`` and the ``bad`` episode, where there are such.
    """
    measured: dict[str, Any] = {"rows": []}
    for record in records:
        env = gem.make(record.id)
        try:
            for case in cases_of(page, record, env):
                played = list(_play(env, case, episodes_of(record)))
                measured["rows"] += [{"id": record.id, "player": case.name, **row} for row in _scores(played)]
                for wanted in _shows(page, case):
                    if wanted not in measured and (shown := _choose(played, good=wanted == "good")):
                        measured[wanted] = {"id": record.id, "player": case.name, **_recorded(shown, record)}
        finally:
            env.close()
    return measured


def _shows(page: str, case: Case) -> list[str]:
    """Return which episodes a player's runs show: good ones of a random player only where nobody plays better."""
    if case.name != "`random`":
        return ["good"]
    return ["good", "bad"] if solver_of(page) is None else ["bad"]


def _play(env: Any, case: Case, episodes: int) -> Iterable[Any]:
    tasks = env.get_wrapper_attr("num_tasks") if "" in case.agents else None
    count = min(episodes, tasks) if tasks else episodes
    if "" in case.agents:
        return gem.rollout(env, case.agents[""], episodes=count, seed=SEED)
    return gem.rollout(env, agents=case.agents, episodes=count, seed=SEED)


def _scores(played: Sequence[Any]) -> Iterable[dict[str, Any]]:
    """Return a row for an agent alone, or one for each seat that is judged."""
    rows: dict[str | None, EnvSummary] = {}
    for episode in played:
        for each in episode if isinstance(episode, JointEpisode) else [episode]:
            if each.seat != "user":
                rows.setdefault(each.seat, EnvSummary(each.id)).add(each)
    for seat, row in rows.items():
        values = {
            "mean_return": row.mean_return,
            "return_error": row.return_standard_error,
            "success": row.success_rate,
            "success_error": row.success_standard_error,
            "turns": row.mean_turns,
        }
        rounded = {name: None if value is None else round(value, 4) for name, value in values.items()}
        yield {"seat": seat, "episodes": row.episodes, "errors": row.errors, **rounded}


def _choose(played: Sequence[Any], *, good: bool) -> Any:
    """Return the first episode that succeeded, or that did not; else the one with the highest or the lowest return."""
    fine = [episode for episode in played if episode.error is None and episode.turns]
    wanted = [episode for episode in fine if _verdict(episode) is good]
    if wanted or not fine:
        return wanted[0] if wanted else None
    lowest, highest = min(fine, key=_first_return), max(fine, key=_first_return)
    if not good:
        return lowest
    return highest if _first_return(highest) > _first_return(lowest) else None


def _verdict(episode: Any) -> bool | None:
    if isinstance(episode, JointEpisode):
        judged = [each for each in episode if each.seat != "user"]
        return bool(judged) and judged[0].success is True
    return None if episode.success is None else bool(episode.success)


def _first_return(episode: Any) -> float:
    return float(next(iter(episode.returns.values())) if isinstance(episode, JointEpisode) else episode.episode_return)


# An episode as it is shown.


def _recorded(episode: Any, record: EnvSpec) -> dict[str, Any]:
    """Return an episode as plain JSON: what was said, and the frames of its picture."""
    joint = isinstance(episode, JointEpisode)
    first = next(iter(episode)) if joint else episode
    turns = list(_turns(episode))
    kept = turns if len(turns) <= MOST_TURNS else [*turns[: MOST_TURNS - 2], *turns[-2:]]
    judged = [each for each in (episode if joint else [episode]) if each.seat != "user"]
    return {
        "seed": episode.seed,
        "options": dict(episode.options or {}),
        "opening": cut(observation_text(first.observation), _LONGEST_OPENING),
        "turns": [{**turn, "action": cut(turn["action"]), "answer": cut(turn["answer"])} for turn in kept],
        "num_turns": len(turns),
        "returns": {each.seat or "": round(each.episode_return, 4) for each in judged},
        "success": {each.seat or "": each.success for each in judged},
        "frames": [list(frame) for frame in spread(_frames(episode, record, turns), MOST_FRAMES)],
    }


def _turns(episode: Any) -> Iterable[dict[str, Any]]:
    pairs = (
        episode.transcript() if isinstance(episode, JointEpisode) else ((None, turn) for turn in episode.transitions)
    )
    after = _answers(episode)
    for number, (seat, turn) in enumerate(pairs, start=1):
        answer = next(after[seat])
        yield {
            "number": number,
            "seat": seat,
            "action": str(turn.action) or "\n".join(map(_called, turn.action.tool_calls or ())),
            "reward": round(turn.reward, 4),
            "answer": answer,
        }


def _called(call: Mapping[str, Any]) -> str:
    function = call["function"]
    return f"{function['name']}({function['arguments']})"


def _answers(episode: Any) -> dict[str | None, Any]:
    """Return, by seat, what each turn was answered: the feedback where there is one, else what is seen next."""

    def told(each: Episode) -> Iterable[str]:
        seen = [*(turn.observation for turn in each.transitions[1:]), each.final_observation]
        for turn, observation in zip(each.transitions, seen, strict=True):
            reason = turn.info.get("reason") or turn.info.get("status") or ""
            text = turn.info.get("feedback") or observation_text(observation)
            yield f"{text} {reason}".strip() if text == "<episode over>" else text

    episodes = list(episode) if isinstance(episode, JointEpisode) else [episode]
    return {each.seat: iter(list(told(each))) for each in episodes}


def _frames(episode: Any, record: EnvSpec, turns: Sequence[dict[str, Any]]) -> list[Frame]:
    """Return the frames of an episode; a game is played again, with what it draws after each turn."""
    first = next(iter(episode)).observation if isinstance(episode, JointEpisode) else episode.observation
    image = image_of(first)
    drawings = _drawings(episode, record) or [image] * (len(turns) + 1)
    opening = "" if drawings[0] and not image else cut(observation_text(first), 1_200)
    frames = [Frame(drawings[0], "the beginning", "", None, opening)]
    for turn, drawing in zip(turns, drawings[1:], strict=True):
        who = f", {turn['seat']}" if turn["seat"] else ""
        said = cut(turn["action"], 400), turn["reward"], cut(turn["answer"], 700)
        frames.append(Frame(drawing, f"turn {turn['number']}{who}", *said))
    return frames


def _drawings(episode: Any, record: EnvSpec) -> list[str]:
    env = gem.make(record.id)
    modes = env.unwrapped.metadata.get("render_modes", [])
    env.close()
    if "ansi" not in modes or record.namespace not in ("game", "pz"):
        return []  # text that is no drawing stands beside the turns
    env = gem.make(record.id, render_mode="ansi")
    env.reset(seed=episode.seed, options=dict(episode.options) if episode.options else None)
    drawings = [str(env.render())]
    for action in _actions(episode):
        env.step(action)
        # Seats that act at once have a turn each, and see the same.
        drawings += [str(env.render())] * (len(action) if isinstance(action, dict) else 1)
    env.close()
    return drawings


def _actions(episode: Any) -> Iterable[Any]:
    if not isinstance(episode, JointEpisode):
        yield from (str(turn.action) for turn in episode.transitions)
        return
    left = {seat: iter(each.transitions) for seat, each in episode.seats.items()}
    for acted in episode.order:
        yield {seat: str(next(left[seat]).action) for seat in acted}


def image_of(observation: Any) -> str:
    """Return the first image of an observation as a ``data:`` address; ``""`` where there is none."""
    import base64
    import io

    for part in observation if isinstance(observation, list) else []:
        image = part.get("image")
        if hasattr(image, "save"):
            buffer = io.BytesIO()
            image.save(buffer, format="PNG", optimize=True)
            return "data:image/png;base64," + base64.b64encode(buffer.getvalue()).decode()
    return ""


def cut(text: str, most: int = _LONGEST_ANSWER) -> str:
    """Return text that is no longer than this, with a note where something is left out of its middle."""
    text = "\n".join(plain(line).rstrip() for line in text.split("\n")).strip()
    if len(text) <= most:
        return text
    half = most // 2
    return f"{text[:half].rstrip()}\n[… {len(text) - 2 * half} characters are left out here …]\n{text[-half:].lstrip()}"
