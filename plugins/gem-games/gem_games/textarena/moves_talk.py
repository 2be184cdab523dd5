"""Moves of games of talking, bargaining and deciding together. Each function returns moves that are all valid now."""

from __future__ import annotations

import random
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from gem_games import words

Sampler = Callable[[Any, random.Random], Sequence[str]]
"""Takes TextArena's game, which it only reads, and a generator, the only one it draws from."""

_REMARKS = ("I thought about the {}.", "Tell me more about the {}.", "I would rather have a {}.", "What of the {}?")


def always(*moves: str) -> Sampler:
    """Return a sampler for a game in which the same moves are valid at any time."""
    return lambda game, rng: moves


def remark(game: Any, rng: random.Random) -> Sequence[str]:
    """Return something to say: without brackets, and without digits."""
    return [rng.choice(_REMARKS).format(rng.choice(words.nouns(rng.randrange(4, 8))))]


def _talk_then(decide: Sampler) -> Sampler:
    """Return a sampler for a game whose state tells that it is time to talk, or else to decide."""
    return lambda game, rng: (remark if game.state.game_state["phase"] == "conversation" else decide)(game, rng)


def _up_to(most: Callable[[Any], int]) -> Sampler:
    return lambda game, rng: [f"[{rng.randint(0, most(game))}]"]


def _toward_each(game: Any, rng: random.Random) -> Sequence[str]:
    others = game.state.game_state["decisions"][game.state.current_player_id]
    return [" ".join(f"[{other} {rng.choice(('cooperate', 'defect'))}]" for other in sorted(others))]


def _ultimatum(game: Any, rng: random.Random) -> Sequence[str]:
    if game.state.game_state["phase"] == "offering":
        return [f"[Offer: ${rng.randint(0, game.state.game_state['pool'])}]"]
    return "[Accept]", "[Reject]"


def _recruit(game: Any, rng: random.Random) -> Sequence[str]:
    letters = " ".join(rng.choice(sorted(game.choice_letters[issue])) for issue in game.issues)
    answers = ("[Accept]", "[Reject]") if game.state.game_state["current_proposal"] else ()
    return f"[Propose] {letters}", *answers


def _two_dollars(game: Any, rng: random.Random) -> Sequence[str]:
    seat, proposal = game.state.current_player_id, game.current_proposal
    if proposal["amount"] is not None and proposal["proposer"] != seat and rng.random() < 0.5:
        return "[Accept]", "[Reject]"
    before = game.player_proposal_history[seat]
    # One role may concede no more than a cent at a time, which rounding can break: it concedes nothing.
    held = before and game.player_roles[seat].get("name") == "high_tension"
    cents = rng.randint(round(before[-1] * 100) if held else 0, round(game.total_amount * 100))
    return [f"[Propose] ${cents / 100:.2f}"]


def _affords(hand: Mapping[Any, int], costs: Mapping[Any, int]) -> bool:
    return all(hand.get(good, 0) >= amount for good, amount in costs.items())


def _offer(hand: Mapping[str, int], goods: Sequence[str], rng: random.Random) -> Sequence[str]:
    """Return an offer that this hand can pay, if it holds anything."""
    held = [good for good in goods if hand.get(good, 0) > 0]
    if not held:
        return ()
    given, wanted = rng.choice(held), rng.choice(goods)
    return [f"[Offer: {rng.randint(1, min(5, hand[given]))} {given} -> {rng.randint(1, 5)} {wanted}]"]


def _bargain(game: Any, rng: random.Random) -> Sequence[str]:
    seat, state = game.state.current_player_id, game.state.game_state
    hand, offer = state["player_resources"][seat], state["current_offer"]
    answers = []
    if offer and offer["to_player"] == seat:
        answers = ["[Deny]"] + ["[Accept]"] * _affords(hand, offer["requested_resources"])
    return [*_offer(hand, game.resource_names, rng), *remark(game, rng), *answers]


def _bids(game: Any, rng: random.Random) -> Sequence[str]:
    left = game.state.game_state["remaining_capital"][game.state.current_player_id]
    bids = []
    for item in sorted(rng.sample(range(game.num_items), rng.randint(1, game.num_items))):
        if left > 0:
            bids.append((item, rng.randint(1, left)))
            left -= bids[-1][1]
    return [" ".join(f"[Bid on Item {item}: {amount}]" for item, amount in bids) or "I bid nothing."]


def _settlers(game: Any, rng: random.Random) -> Sequence[str]:
    state, seat = game.state.game_state, game.state.current_player_id
    seats = range(game.state.num_players)
    if state["turn_phase"] == "action":
        return [f"[{move[0]}]" for move in game.game_moves]
    if state["turn_phase"] == "negotiation_start":
        return [f"[{other}]" for other in seats if other != seat and other not in state["eliminated_players"]]
    hands = [game.board.players[game.board.str_to_enum(game.roles[other])].hand for other in seats]
    offer = state.get("current_offer")
    if offer and offer["to_player"] == seat:
        # Anything but an acceptance turns an offer down; and with it, another may be made.
        payable = _affords(hands[seat], offer["requested_resources"])
        giver = _affords(hands[offer["from_player"]], offer["offered_resources"])
        return ["[deny]"] + ["[accept]"] * (payable and giver)
    ends = ["[done]"] if seat == state["main_negotiator"] else []
    held = {terrain.name.title(): amount for terrain, amount in hands[seat].items()}
    return [*_offer(held, ("Wheat", "Wood", "Sheep", "Brick", "Ore"), rng), *remark(game, rng), *ends]


def _mafia(game: Any, rng: random.Random) -> Sequence[str]:
    if game.phase.name == "DAY_DISCUSSION":
        return remark(game, rng)
    return [f"[{seat}]" for seat in game.state.game_state["alive_players"] if seat != game.state.current_player_id]


def _facts(game: Any, rng: random.Random) -> Sequence[str]:
    last = game.state.turn >= game.state.max_turns - 1
    return ("[Fact 1]", "[Fact 2]") if last else remark(game, rng)


SAMPLERS: dict[str, Sampler] = {
    "Debate": remark,
    "GuessWho": remark,
    "IteratedMatchingPennies": always("[heads]", "[tails]"),
    "IteratedPrisonersDilemma": _talk_then(always("[Cooperate]", "[Defect]")),
    "IteratedRockPaperScissors": always("[rock]", "[paper]", "[scissors]"),
    "IteratedStagHunt": _talk_then(always("[Stag]", "[Hare]")),
    "IteratedTwoThirdsAverage": _up_to(lambda game: int(game.max_guess)),
    "IteratedUltimatumGame": _ultimatum,
    "NewRecruit": _recruit,
    "SecretMafia": _mafia,
    "SettlersOfCatan": _settlers,
    "SimpleBlindAuction": _talk_then(_bids),
    "SimpleNegotiation": _bargain,
    "ThreePlayerIPD": _talk_then(_toward_each),
    "TruthAndDeception": _facts,
    "TwentyQuestions": remark,
    "TwoDollar": _two_dollars,
}
