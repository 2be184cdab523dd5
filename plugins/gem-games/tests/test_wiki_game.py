"""WikiGame: its rules and rewards by variant, its articles, and its solver."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from game_solvers import box

import gem_core as gem
from gem_core.errors import AgentError, ArgumentError
from gem_games.cheap_random import CheapRandom
from gem_games.wiki.agent import WikiGameAgent
from gem_games.wiki.articles import load_articles
from gem_games.wiki_game import WikiGameEnv

SMALL = Path(__file__).with_name("small_articles.jsonl")
"""Sea → Coast → Sand → Goal → Sea; also River, Beach bar, and End, from which no link leads."""
PAIR = {"start": "Sea", "target": "Goal"}
BACK = "<PREV_PAGE>"


def small_game(variant: str = "noregrets", max_turns: int = 10, **kwargs: Any) -> WikiGameEnv:
    """Return a game from Sea to Goal, begun."""
    env = WikiGameEnv(max_turns, variant, articles=SMALL, **kwargs)
    env.reset(seed=0, options=PAIR)
    return env


@pytest.mark.parametrize(
    ("variant", "titles", "rewards", "end"),
    [
        ("noregrets", ["Coast", "Sand", "Goal"], [-0.05, -0.05, 1], "Goal"),
        ("noregrets", ["Coast", "Beach_bar"], [-0.05, -0.05], "Beach bar"),
        ("noregrets", ["Moon", "coast", "Coast", BACK], [-0.2, -0.2, -0.05, -0.2], "Coast"),
        ("noregrets", ["End"], [0], "End"),
        ("eidetic", ["Coast", BACK], [-0.05, -0.2], "Coast"),
        ("eidetic", ["End", "Coast", "River", "Sand", "Goal"], [-0.05, -0.05, -0.05, -0.05, 1], "Goal"),
        ("oneback", ["End"], [-0.1], "Sea"),
        ("oneback", [BACK, "Coast", "Sand", BACK, BACK], [-0.2, -0.05, -0.05, -0.05, -0.2], "Coast"),
        ("oneback", ["Coast", BACK, "Coast", BACK], [-0.05, -0.05, -0.05, -0.05], "Sea"),
        ("oneback", ["Coast", "Sea", "End", BACK], [-0.05, -0.05, -0.1, -0.2], "Sea"),
        ("freenav", ["Coast", "Sand", BACK, BACK, BACK], [-0.05, -0.05, -0.05, -0.05, -0.2], "Sea"),
    ],
)
def test_rewards_of_a_way(variant: str, titles: list[str], rewards: list[float], end: str) -> None:
    """The game is over at the target, and without regrets at an article without links."""
    env = small_game(variant)
    results = [env.step(box(title)) for title in titles]
    assert [result[1] for result in results] == rewards
    assert env.path[-1].title == end
    assert results[-1][2] == (end == "Goal" or (variant, end) == ("noregrets", "End"))
    assert results[-1][4].get("correct", False) == (end == "Goal")


def test_wrong_title_names_the_nearest_link() -> None:
    env = small_game()
    for answer, meant in {"Moon": None, "coast": "'Coast'", "Riv": "'River'"}.items():
        _, _, _, _, info = env.step(box(answer))
        assert info["parsed_action"] is None
        assert (f"Did you mean {meant}?" in info["feedback"]) == (meant is not None)


@pytest.mark.parametrize(
    ("response", "reward"),
    [
        (box("River"), 0.0),
        (box("Moon"), 0.0),
        ("no box", -0.2),
        (box(BACK), -0.2),
        (box("<LINKS 1>"), 0.0),
        (box("Coast"), 0.0),
    ],
)
def test_last_turn_terminates_and_tells_the_way(response: str, reward: float) -> None:
    observation, *result, info = small_game(max_turns=1, min_distance=1).step(response)
    assert (result, info["correct"]) == ([reward, True, False], False)
    assert "Sea → Coast → Sand → Goal" in observation


def test_target_wins_in_the_last_turn_and_without_links() -> None:
    env = small_game(max_turns=3)
    assert [env.step(box(title))[1] for title in ("Coast", "Sand", "Goal")] == [-0.05, -0.05, 1.0]
    env = small_game(max_turns=3)
    env.reset(seed=0, options={"start": "Sea", "target": "End"})
    assert env.step(box("End"))[1:3] == (1.0, True)


@pytest.mark.parametrize("max_turns", [1, 2, 3])
def test_dead_end_costs_two_turns(max_turns: int) -> None:
    env = small_game("freenav", max_turns, min_distance=1)
    assert env.step(box("End"))[1:3] == (-0.1, max_turns < 3)
    assert env.turn == min(2, max_turns)


def test_long_lists_of_links_come_in_parts() -> None:
    """Turning to another part costs a turn; a link can be taken from any of them."""
    env = small_game(links_per_part=2)
    assert "- Coast\n- End\nTurns" in env.reset(seed=0, options=PAIR)[0]
    observation, reward, _, _, info = env.step(box("<LINKS 2>"))
    assert (reward, info["parsed_action"]) == (-0.05, "<LINKS 2>")
    assert "3 links in all; \\boxed{<LINKS 1>} shows part 1 and costs a turn):\n- River\nTurns" in observation
    assert env.step(box("<LINKS 3>"))[1] == -0.2
    assert env.step(box("Coast"))[1] == -0.05
    assert env.part == 1
    assert env.gold_action() == "\\boxed{Sand}"
    dead = small_game("eidetic")
    dead.step(box("End"))
    assert dead.gold_action() is None  # the target is out of reach
    assert len(dead.step(box("x_" * 2_500_000))[0]) < 1_500


@pytest.mark.parametrize(
    ("length", "shown"),
    [
        ((9, "characters"), "A coast l…"),
        ([3, "words"], "A coast lies …"),
        ((1, "sentences"), "A coast lies at the Sea. …"),
        ((2, "sentences"), "A coast lies at the Sea. It has a Beach bar, and its Sand."),
    ],
)
def test_page_summary_length(length: Any, shown: str) -> None:
    assert f"Coast.\n{shown}\nLinks" in small_game(page_summary_length=length).step(box("Coast"))[0]


@pytest.mark.parametrize(
    ("kwargs", "value"),
    [
        ({"variant": "wild"}, "'wild'"),
        ({"max_turns": 0}, "max_turns"),
        ({"min_distance": 4, "max_distance": 3}, "4 and 3"),
        ({"max_turns": 3, "min_distance": 4}, "3 turns"),
        ({"links_per_part": 0}, "links_per_part"),
        ({"page_summary_length": (3, "lines")}, "'lines'"),
        ({"articles": "no/such.jsonl"}, "no/such.jsonl"),
        ({"articles": __file__}, "line 1"),
    ],
)
def test_wrong_arguments(kwargs: dict[str, Any], value: str) -> None:
    with pytest.raises(ArgumentError, match=value):
        WikiGameEnv(**kwargs)


@pytest.mark.parametrize(
    ("options", "value"),
    [
        ({"start": "Sea"}, "'start'"),
        ({"start": "Sea", "target": "Sea"}, "'Sea'"),
        ({"start": "See", "target": "Goal"}, r"Did you mean 'Sea'\?"),
        ({"start": "End", "target": "Goal"}, "'End'"),
    ],
)
def test_options_name_two_articles(options: dict[str, str], value: str) -> None:
    env = WikiGameEnv(articles=SMALL)
    with pytest.raises(ArgumentError, match=value):
        env.reset(seed=0, options=options)


# The articles.


def test_shipped_articles_are_one_web() -> None:
    """Every article has links and leads to every other in nine links, so the farthest pair fits the shortest limit."""
    articles = load_articles()
    links = {title: articles.article(title).links for title in articles.titles}
    assert len(links) > 300
    assert min(map(len, links.values())) >= 3
    for title, own in links.items():
        assert title not in own
        assert set(own) <= set(links)
        reached = {title}
        for _ in range(9):
            reached |= {link for article in reached for link in links[article]}
        assert reached == set(links)


def test_pairs_have_the_wanted_distance() -> None:
    """A start without such a target is passed over."""
    articles = load_articles(str(SMALL))
    pairs = {articles.pair(CheapRandom(seed), 4, 9) for seed in range(200)}
    assert {pair[:2] for pair in pairs} == {("River", "Goal"), ("Sand", "Beach bar")}
    for pair in {articles.pair(CheapRandom(seed), 1, 3) for seed in range(200)}:
        assert len(articles.way(pair.start, pair.target)) - 1 == pair.distance <= 3
    with pytest.raises(ArgumentError):
        articles.pair(CheapRandom(0), 7, 9)


# The ids, and the solver.


@pytest.mark.parametrize(
    ("env_id", "turns", "distances"),
    [
        ("game:WikiGame-v0-easy", {30}, {2, 3}),
        ("game:WikiGame-v0-hard", {15}, {4, 5, 6}),
        ("game:WikiGame-v0-random", {15, 30}, set(range(2, 10))),
    ],
)
def test_solver_wins_in_the_fewest_turns(env_id: str, turns: set[int], distances: set[int]) -> None:
    """Each id draws its turns and distances; the solver reads a history as well."""
    agent = WikiGameAgent()
    env = gem.make(env_id, wrappers="concat")
    drawn = set()
    for seed in range(60):
        observation, _ = env.reset(seed=seed)
        game, over, info = env.unwrapped, False, {}
        drawn.add(game.max_turns)
        assert game.distance in distances
        while not over:
            observation, _, over, _, info = env.step(agent(observation))
        assert info["correct"]
        assert game.turn == game.distance <= game.max_turns
    assert drawn == turns


def test_solver_refuses_what_it_does_not_know() -> None:
    for env in (gem.make("game:GuessTheNumber-v0"), small_game()):
        with pytest.raises(AgentError):
            WikiGameAgent()(env.reset(seed=0)[0])
