"""``TextArenaEnv``: one seat at a game of TextArena."""

from __future__ import annotations

import random
from collections.abc import Sequence
from typing import Any, ClassVar

from gem_core.env import Env, stable_hash
from gem_core.errors import ArgumentError, EnvFaultError, ResetNeededError
from gem_core.suggestions import did_you_mean
from gem_core.types import Concurrency, Info, ResetResult, StepResult
from gem_games.textarena.games import GAMES
from gem_games.textarena.judging import JudgeError
from gem_games.textarena.moves import random_move
from gem_games.textarena.opponents import Player, opponent_of
from gem_games.textarena.table import Table

_MOST_OPPONENT_TURNS = 300
_STALLED = f"the agent's turn did not come in {_MOST_OPPONENT_TURNS} turns of the opponents"

_MOST_DEALS = 10
_SCORES = "Blackjack", "Set"
"""Games of one player that pay a score, and have no aim that is reached or missed."""
_FULL_REWARDS = {"Klondike": 52}
"""What solving a game of one player pays, where that is not 1."""


class TextArenaEnv(Env):
    """A seat at a game of TextArena; the other seats are played by opponents.

    The reward is TextArena's own for this seat, at the end, and 0 before. ``info["textarena"]`` holds what it says
    about the seat, ``info["invalid_move"]`` whether the last action was one. ``info["correct"]`` at the end says
    whether the seat won: alone, by the full reward of 1 (in Klondike of 52, the number of cards); among others, by one
    above 0 that no other seat exceeds. Blackjack and Set, which only keep a score, have none.

    An action that makes the library raise loses the game with -1, if another action would not have done so; else the
    episode is truncated with ``info["error"]``. So it is where the agent's turn does not come in 300 turns of the
    opponents.

    A seat sees nothing of its own responses, and of another seat's the move alone, as the game describes it or in its
    brackets. Where the game is to talk, all that is said is heard; thinking blocks never are.

    The limits are TextArena's, and so is the reward when they are reached. A game without one is truncated after 1,000
    turns of the agent; for one player, the reward is then TextArena's for what is done.

    Args:
        game: The game's id in TextArena.
        players: How many seats it has.
        seat: Which of them the agent holds.
        opponents: ``"random"``, an agent or the name of one (as in ``"openai:MODEL"``), or a sequence or mapping by
            seat of these. Seats that a mapping leaves out play at random. An agent that reads messages is sent the
            conversation of its seat.
        max_turns: Turns after which the agent's episode is cut off at the latest, with TextArena's reward for what is
            done. A game that takes a limit itself is made with this one; it counts the turns of all seats.
        judge: An agent, or the name of one, that answers as the game master and the jury of GuessWho, TwentyQuestions,
            Debate and ScenarioPlanning.

    Source: the games and rewards of textarena 0.7.4, https://github.com/LeonGuertler/TextArena.
    """

    concurrency: ClassVar[Concurrency] = "process"

    def __init__(
        self,
        game: str,
        players: int = 1,
        seat: int = 0,
        opponents: Any = "random",
        max_turns: int | None = None,
        judge: Any = None,
    ) -> None:
        super().__init__()
        if game not in GAMES:
            raise ArgumentError(f"textarena has no game {game!r}.{did_you_mean(str(game), GAMES)} Run 'gem list ta'")
        if type(players) is not int or not 1 <= players <= 15:
            raise ArgumentError(f"players must be a whole number from 1 to 15, not {players!r}")
        if type(seat) is not int or not 0 <= seat < players:
            raise ArgumentError(f"seat must be a whole number from 0 to {players - 1}, not {seat!r}")
        self.game, self.players, self.seat = game, players, seat
        others = [other for other in range(players) if other != seat]
        self._opponents = {other: opponent_of(opponents, other, others) for other in others}
        if max_turns is not None and (type(max_turns) is not int or max_turns < 1):
            raise ArgumentError(f"max_turns must be a positive whole number, not {max_turns!r}")
        self.max_turns = max_turns
        self._judge = None if judge is None else Player(judge)
        try:
            self.table = Table(game, players, max_turns, self._verdict)
        except AssertionError as error:
            raise ArgumentError(f"max_turns={max_turns} is not for {game}: {error}") from error
        self._check_players()
        self._turns = 0
        self._begun = False
        self._over = False
        self._stalled = False

    def _check_players(self) -> None:
        """Refuse a number of seats that the game does not take, before an episode does."""
        usual = max(GAMES[self.game], 1)
        if self.players == usual:
            return
        try:
            self.table.reset(0)
        except Exception as error:
            message = f"players={self.players} is not for {self.game}, which can be played by {usual}: {error}"
            raise ArgumentError(message) from error

    def reset(self, seed: int | None = None, options: dict[str, Any] | None = None) -> ResetResult:
        """Begin a game, and let the opponents play until it is the agent's turn.

        Where that never comes, since the seat is out or the game is over before, another game is dealt.

        Raises:
            EnvFaultError: An opponent or the judge failed, or the agent's turn did not come.
        """
        super().reset(seed=seed)
        self._begun = self._over = False
        self._turns = 0
        failure, cause = "", None
        for deal in range(_MOST_DEALS):
            try:
                self._deal(stable_hash(self.np_random_seed, "deal", deal) if deal else self.np_random_seed)
            except JudgeError as error:
                raise EnvFaultError(f"{self.env_id or self.game}: the judge: {error}") from error
            failure, cause = self._let_others_play()
            if failure or not self.table.done:
                break
        else:
            failure = f"{_MOST_DEALS} games in a row were over before the agent's turn"
        if failure or self._stalled:
            raise EnvFaultError(f"{self.env_id or self.game}: {failure or _STALLED}") from cause
        self._begun = True
        return self._see()

    def step(self, action: str) -> StepResult:
        """Play for the agent's seat, and let the opponents answer."""
        table = self.table
        errors = table.errors()
        self._turns += 1
        try:
            played = table.act(str(action))
        except Exception as error:  # noqa: BLE001 - the library may raise anything; blame is told apart below
            return self._failed(error)
        invalid = not table.done and table.seat == self.seat and table.errors() > errors
        failure, _ = self._let_others_play()
        observation, info = self._see()
        info["parsed_action"] = played
        info["invalid_move"] = invalid or bool(info["textarena"].get("invalid_move"))
        if info["invalid_move"]:
            info["parsed_action"] = None
        if failure:
            self._over = True
            info["error"] = {"kind": "opponent", "message": failure}
            return observation, 0.0, False, True, info
        rewards = table.rewards() if table.done else {}
        reward = rewards.get(self.seat, 0.0)
        family = self.game.partition("-")[0]
        cut_off = not table.done and not self._stalled and self._turns >= self.table.most_turns
        if table.done:
            self._over = True
            if self.seat in rewards and "correct" not in info:
                full = _FULL_REWARDS.get(family, 1)
                info["correct"] = reward >= full if self.players == 1 else 0 < reward == max(rewards.values())
        elif cut_off:
            self._over = True
            reward = table.progress() if self.players == 1 else 0.0
            info.setdefault("correct", False)
        if self._stalled:
            info["error"] = {"kind": "opponent", "message": _STALLED}
        return observation, reward, table.done, self._stalled or cut_off, info

    def _failed(self, error: Exception) -> StepResult:
        """End an episode in which the library raised: by the agent's fault if a valid action was to be had."""
        judged = isinstance(error, JudgeError)
        self._replay(self.table.seed, self.table.actions, self.table.verdicts)
        self._over = True
        move = random_move(self.table, random.Random(self.table.seed))
        agents_fault = not judged and self.table.tries(move)
        message = f"{type(error).__name__}: {error}"[:300]
        observation, info = self._see()
        info["invalid_move"] = agents_fault
        if agents_fault:
            info["feedback"] = f"The game could not read your response ({type(error).__name__}), and is lost."
            info |= {"correct": False, "parsed_action": None}
            return info["feedback"] + info["suffix"], -1.0, True, False, info
        info["error"] = {"kind": "judge" if judged else "textarena", "message": message}
        return observation, 0.0, False, True, info

    def _let_others_play(self) -> tuple[str, Exception | None]:
        """Play for the others until it is the agent's turn; return what failed, ``""`` if nothing did."""
        table = self.table
        self._stalled = False
        for _ in range(_MOST_OPPONENT_TURNS):
            if table.done or table.seat == self.seat:
                return "", None
            seat = table.seat
            try:
                self._play(seat, None)
            except Exception as error:  # noqa: BLE001 - the library or an opponent may raise anything
                return f"seat {seat}: {type(error).__name__}: {error}"[:300], error
        self._stalled = not table.done and table.seat != self.seat
        return "", None

    def _play(self, seat: int, action: str | None) -> None:
        """Play for another seat: an action, or else what its player answers."""
        table, player = self.table, self._opponents.get(seat)
        view = table.look(seat)
        question = view.feedback + view.suffix
        if action is None:
            draws = random.Random(stable_hash(table.seed, "opponent", len(table.actions)))
            action = self._ask(player, question, draws) if player else random_move(table, draws)
        played = table.act(action)
        if player:
            player.note(question, played)

    def _verdict(self, question: str) -> str:
        """Answer as the judge."""
        if self._judge is None:
            raise JudgeError(f"{self.game} has a judge: make it with judge=, an agent or the name of one")
        try:
            return self._ask(self._judge, question, None)
        except Exception as error:
            raise JudgeError(f"{type(error).__name__}: {error}"[:300]) from error

    def _ask(self, player: Player, question: str, draws: random.Random | None) -> str:
        return player.ask(
            question,
            episode=str(self.table.seed),
            env_id=self.env_id or self.game,
            sample=lambda: random_move(self.table, draws) if draws else "",
        )

    def _see(self) -> tuple[str, Info]:
        view = self.table.look(self.seat)
        info: Info = {"feedback": view.feedback, "suffix": view.suffix, "textarena": self.table.report(self.seat)}
        if self.game.partition("-")[0] in _SCORES:
            info["correct"] = None  # said from the beginning: an episode that is cut off has not failed
        return view.feedback + view.suffix, info

    def sample_random_action(self) -> str:
        """Return a move that TextArena takes as a valid one; where there is none, ``"[no move]"``."""
        if not self._begun:
            raise ResetNeededError(f"{self.env_id or self.game}: call reset() before sample_random_action()")
        return random_move(self.table, random.Random(int(self.action_random.integers(2**53))))

    def _get_state(self) -> dict[str, Any]:
        return {
            "begun": self._begun,
            "over": self._over,
            "turns": self._turns,
            "seed": self.table.seed,
            "actions": list(self.table.actions),
            "verdicts": list(self.table.verdicts),
        }

    def _set_state(self, state: dict[str, Any]) -> None:
        self._begun, self._over = bool(state["begun"]), bool(state["over"])
        self._turns = int(state["turns"])
        if self._begun:
            self._replay(int(state["seed"]), list(map(str, state["actions"])), list(map(str, state["verdicts"])))

    def _replay(self, seed: int, actions: list[str], verdicts: list[str]) -> None:
        """Bring the game to where these actions of all seats lead, and each seat to have seen what it saw."""
        self._deal(seed, verdicts)
        for action in actions:
            if self.table.seat == self.seat:
                self.table.look(self.seat)
                self.table.act(action)
            else:
                self._play(self.table.seat, action)
        self.table.look(self.seat)

    def _deal(self, seed: int, verdicts: Sequence[str] = ()) -> None:
        for player in self._opponents.values():
            if player:
                player.begin()
        self.table.reset(seed, verdicts)
