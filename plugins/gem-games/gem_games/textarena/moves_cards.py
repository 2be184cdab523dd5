"""Moves of games with cards, dice and heaps. Each function returns moves that are all valid now."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from gem_games.textarena.moves_talk import Sampler, always

if TYPE_CHECKING:
    import random

_MOST_RAISED = 20  # chips


def _briscola(game: Any, rng: random.Random) -> Sequence[str]:
    hand = game.state.game_state["players"][game.state.current_player_id]["hand"]
    return [f"[play {place}]" for place in range(1, len(hand) + 1)]


def _german_whist(game: Any, rng: random.Random) -> Sequence[str]:
    seat = game.state.current_player_id
    hand = game.state.game_state["players"][seat]["hand"]
    return [f"[play {place}]" for place, card in enumerate(hand, 1) if game._is_valid_play(seat, card)]


def _chopsticks(game: Any, rng: random.Random) -> Sequence[str]:
    seat, hands = game.state.current_player_id, game.state.game_state["hands"]
    own, total = hands[seat], sum(hands[seat])
    attacks = [f"[attack {mine} {its}]" for mine in (0, 1) for its in (0, 1) if own[mine] and hands[1 - seat][its]]
    return attacks + [f"[split {left} {total - left}]" for left in range(total + 1) if left != own[0]]


def _blotto(game: Any, rng: random.Random) -> Sequence[str]:
    cuts = sorted(rng.randint(0, game.num_total_units) for _ in game.field_names[1:])
    units = [end - start for start, end in zip([0, *cuts], [*cuts, game.num_total_units], strict=True)]
    return [f"[{' '.join(f'{field}{count}' for field, count in zip(game.field_names, units, strict=True))}]"]


def _golf(game: Any, rng: random.Random) -> Sequence[str]:
    state = game.state.game_state
    if state["turn_phase"] == "draw":
        return ["[draw]"] + ["[take]"] * bool(state["discard_pile"])
    swaps = [f"[swap {r} {c}]" for r in range(1, game.num_rows + 1) for c in range(1, game.num_columns + 1)]
    return swaps if state.get("took_from_discard") else [*swaps, "[discard]"]


def _pure_strategy(game: Any, rng: random.Random) -> Sequence[str]:
    hand = game.state.game_state["player_hands"][game.state.current_player_id]
    return [f"[{game._val_to_face(card)}]" for card in hand]


def _high_society(game: Any, rng: random.Random) -> Sequence[str]:
    return [f"[{card}]" for card in game.state.game_state["player_money"][game.state.current_player_id]]


def _indian_poker(game: Any, rng: random.Random) -> Sequence[str]:
    state, seat = game.state.game_state, game.state.current_player_id
    due, chips = state["highest_bet"] - state["current_bets"][seat], state["player_chips"][seat]
    if chips < 0:  # the ante is taken from those who have none left too, and then even folding is refused
        return ()
    moves = ["[fold]", "[check]"] if not due else ["[fold]"] + ["[call]"] * (due <= chips)
    if chips > due:
        moves.append(f"[{'raise' if due else 'bet'} {rng.randint(1, min(_MOST_RAISED, chips - due))}]")
    return moves


def _kuhn_poker(game: Any, rng: random.Random) -> Sequence[str]:
    return [f"[{move}]" for move in game.state.game_state["current_legal_action_tree"]]


def _liars_dice(game: Any, rng: random.Random) -> Sequence[str]:
    state = game.state.game_state
    count, face = state["current_bid"]["quantity"], state["current_bid"]["face_value"]
    counts = range(max(count, 1), max(count, sum(state["remaining_dice"].values())) + 1)
    bids = [(more, high) for more in counts for high in range(max(face, 1), 7) if (more, high) != (count, face)]
    if count and (not bids or rng.random() < 0.3):
        return ["[Call]"]
    return [f"[Bid: {more}, {high}]" for more, high in bids]


def _poker(game: Any, rng: random.Random) -> Sequence[str]:
    state, seat = game.state.game_state, game.state.current_player_id
    due = state["current_bet"] - state["player_bets"][seat]
    more = rng.randint(1, _MOST_RAISED)
    if due > 0:
        return "[fold]", "[call]", f"[raise {more}]"
    return "[check]", "[check]", f"[bet {state['player_bets'][seat] + more}]"


def _spite_and_malice(game: Any, rng: random.Random) -> Sequence[str]:
    own = game.players[game.state.current_player_id]
    cards = own["hand"] + own["payoff"][-1:] + [pile[-1] for pile in own["discard"] if pile]
    piles = list(enumerate(game.center_piles))
    plays = [f"[play {card} {at}]" for card in cards for at, pile in piles if game._can_play_on_center(card, pile)]
    discards = [f"[discard {card} {place}]" for card in own["hand"] for place in range(4)]
    # Drawing nothing is valid at any time, but does not end a turn: whoever can do nothing else is stuck for ever.
    draws = ["[draw]"] if game.deck and len(own["hand"]) < 5 else []
    return plays + discards + draws


def _holdem(game: Any, rng: random.Random) -> Sequence[str]:
    return [f"[{move}]" for move in game.state.game_state["legal_actions"]]


def _nim(game: Any, rng: random.Random) -> Sequence[str]:
    piles = enumerate(game.state.game_state["piles"])
    return [f"[{place} {count}]" for place, pile in piles for count in range(1, pile + 1)]


SAMPLERS: dict[str, Sampler] = {
    "Blackjack": always("[Hit]", "[Stand]"),
    "Briscola": _briscola,
    "Chopsticks": _chopsticks,
    "ColonelBlotto": _blotto,
    "GameOfPureStrategy": _pure_strategy,
    "GermanWhist": _german_whist,
    "Golf": _golf,
    "HighSociety": _high_society,
    "IndianPoker": _indian_poker,
    "KuhnPoker": _kuhn_poker,
    "LiarsDice": _liars_dice,
    "Nim": _nim,
    "PigDice": always("[roll]", "[hold]"),
    "Poker": _poker,
    "SpiteAndMalice": _spite_and_malice,
    "ThreePlayerGOPS": _pure_strategy,
    "UltimateTexasHoldem": _holdem,
}
