"""WikiGame: its rules and rewards, its variants, and whose failure it is when an article cannot be had."""

from __future__ import annotations

import json
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

import gem_core as gem
from gem_core.env import concurrency_of
from gem_core.errors import ArgumentError
from gem_core.types import TERMINAL_STATE
from gem_games.cheap_random import CheapRandom
from gem_games.wiki.embedded import EmbeddedArticles
from gem_games.wiki.graph import Article, ArticleError, ArticleGraph, ArticleNotFound
from gem_games.wiki_game import VARIANTS, WikiGameEnv

SMALL = {
    "Sea": "A sea has a [[Coast]] and an [[End]], and it feeds the [[River]].",
    "Coast": "A coast lies at the [[Sea]]. It has a [[Beach bar]], and its [[Sand]].",
    "River": "A river flows to the [[Sea]].",
    "Sand": "Sand is what a [[Goal]] stands on.",
    "Beach bar": "A bar at the [[Coast]].",
    "End": "Here nothing goes on.",
    "Goal": "This is the [[Sea|goal]].",
}
PAIR = {"start": "Sea", "target": "Goal"}


def small_graph() -> EmbeddedArticles:
    return EmbeddedArticles("\n".join(json.dumps({"title": name, "text": text}) for name, text in SMALL.items()))


def small_game(variant: str = "noregrets", max_turns: int = 10, **kwargs: Any) -> WikiGameEnv:
    """Return a game from Sea to Goal, begun."""
    env = WikiGameEnv(max_turns, variant, backend=small_graph(), **kwargs)
    env.render_mode = "ansi"
    env.reset(seed=0, options=PAIR)
    return env


def says(title: str) -> str:
    return f"Let us take \\boxed{{{title}}}."


def rewards(env: WikiGameEnv, *titles: str) -> list[float]:
    return [env.step(says(title))[1] for title in titles]


@given(
    st.lists(st.text() | st.sampled_from([*SMALL, "<PREV_PAGE>", "<LINKS 1>"]), max_size=12), st.sampled_from(VARIANTS)
)
def test_any_answers_end_within_the_turns(answers: list[str], variant: str) -> None:
    """Every turn is counted and has one of the rewards of the rules."""
    env = small_game(variant, max_turns=5)
    for number, answer in enumerate(answers, start=1):
        _, reward, terminated, truncated, info = env.step(says(answer))
        assert not truncated
        assert reward in (1.0, 0.0, -0.05, -0.1, -0.2)
        assert number <= env.turn <= 5
        assert terminated == ("correct" in info)
        if terminated:
            return
        assert env.turn < 5


# The rules.


def test_opening() -> None:
    env = WikiGameEnv(10, backend=small_graph())
    observation, info = env.reset(seed=0, options=PAIR)
    assert observation == (
        "WikiGame: go from one article to another by following links.\n"
        "Each article shows its links. Follow one by its exact title inside \\boxed{}. A title that is not among the "
        "links costs a turn.\n"
        "There is no way back but by links, and an article without links ends the game.\n"
        "Start at Sea and reach Goal; the fewer turns you need, the better.\n"
        "Only the last box that can be read counts. A response without one costs a turn; an answer that breaks a rule "
        "costs a turn. You have 10 turns.\n"
        "\nYour target: Goal.\nYou are at: Sea.\nA sea has a Coast and an End, and it feeds the River.\n"
        "Links from here:\n- Coast\n- End\n- River\n"
        "Turns left: 10. Put the title of a link inside \\boxed{}."
    )
    assert observation == info["feedback"] + info["suffix"]


def test_following_links_to_the_target() -> None:
    env = small_game()
    observation, reward, terminated, truncated, info = env.step(says("Coast"))
    assert (reward, terminated, truncated, info["parsed_action"]) == (-0.05, False, False, "Coast")
    assert observation.startswith("You followed the link to Coast.\nYour target: Goal.\nYou are at: Coast.\n")
    assert rewards(env, "Sand") == [-0.05]
    observation, reward, terminated, truncated, info = env.step(says("Goal"))
    assert (reward, terminated, truncated, info["correct"]) == (1.0, True, False, True)
    assert observation.startswith("You have reached Goal: well done.\n")
    assert observation.endswith("\nThe game is over: you won.")


def test_underscores_stand_for_spaces() -> None:
    env = small_game()
    assert rewards(env, "Coast", "Beach_bar") == [-0.05, -0.05]
    assert env.path[-1].title == "Beach bar"


def test_wrong_title() -> None:
    """It costs a turn and 0.2; a title that differs by case, or in part, is named."""
    env = small_game()
    observation, reward, terminated, _, info = env.step(says("Moon"))
    assert (reward, terminated, info["parsed_action"]) == (-0.2, False, None)
    assert info["feedback"] == "'Moon' is not among the links. The turn is lost."
    assert env.turn == 1
    assert (
        env.step(says("coast"))[4]["feedback"]
        == "'coast' is not among the links. Did you mean 'Coast'? The turn is lost."
    )
    assert (
        env.step(says("Riv"))[4]["feedback"] == "'Riv' is not among the links. Did you mean 'River'? The turn is lost."
    )
    assert env.path[-1].title == "Sea"
    assert "Turns left: 9." in observation


@pytest.mark.parametrize("response", ["no box", "\\boxed{}", "\\boxed{ }", "\\boxed{Coast"])
def test_format_error_costs_a_turn_and_ends_nothing(response: str) -> None:
    env = small_game()
    _, reward, terminated, truncated, info = env.step(response)
    assert (reward, terminated, truncated, info["parsed_action"]) == (-0.2, False, False, None)
    assert info["feedback"].endswith("The turn is lost.")


def test_format_error_ends_the_game_if_asked_to() -> None:
    env = small_game(format_error_ends=True)
    _, reward, terminated, _, info = env.step("no box")
    assert (reward, terminated, info["correct"]) == (-0.2, True, False)


@pytest.mark.parametrize(
    ("response", "reward"),
    [
        (says("River"), 0.0),
        (says("Moon"), 0.0),
        ("no box", -0.2),
        (says("<PREV_PAGE>"), -0.2),
        (says("<LINKS 1>"), 0.0),
    ],
)
def test_last_turn(response: str, reward: float) -> None:
    """It is terminated, not truncated, and tells the way."""
    env = small_game(max_turns=1, min_distance=1)
    observation, *result, info = env.step(response)
    assert (result, info["correct"]) == ([reward, True, False], False)
    assert "You have used all your turns. A shortest way was: Sea → Coast → Sand → Goal." in observation


def test_target_in_the_last_turn_wins() -> None:
    env = small_game(max_turns=3)
    assert rewards(env, "Coast", "Sand", "Goal") == [-0.05, -0.05, 1.0]


@pytest.mark.parametrize("variant", ["noregrets", "eidetic"])
def test_no_way_back(variant: str) -> None:
    env = small_game(variant)
    env.step(says("Coast"))
    _, reward, _, _, info = env.step(says("<PREV_PAGE>"))
    assert (reward, info["feedback"]) == (-0.2, "There is no way back in this game. The turn is lost.")
    assert env.path[-1].title == "Coast"


def test_dead_end_ends_the_game_without_regrets() -> None:
    env = small_game()
    observation, reward, terminated, truncated, info = env.step(says("End"))
    assert (reward, terminated, truncated, info["correct"], info["parsed_action"]) == (0.0, True, False, False, "End")
    assert observation.startswith(
        "End has no links, and so the game ends. A shortest way was: Sea → Coast → Sand → Goal."
    )
    assert "Links from here: none\n" in observation


def test_target_without_links_wins() -> None:
    env = WikiGameEnv(backend=small_graph())
    env.reset(seed=0, options={"start": "Sea", "target": "End"})
    assert env.step(says("End"))[1:3] == (1.0, True)


def test_eidetic_remembers_every_link() -> None:
    """Also at an article without links, from which one goes on with those seen before."""
    env = small_game("eidetic")
    observation, reward, terminated, _, _ = env.step(says("End"))
    assert (reward, terminated) == (-0.05, False)
    assert "Links that you may follow:\n- Coast\n- End\n- River\n" in observation
    assert rewards(env, "Coast", "River") == [-0.05, -0.05]
    observation, reward, *_ = env.step(says("Sand"))
    assert reward == -0.05
    assert "Links that you may follow:\n- Goal\n- Sea\n- Beach bar\n- Sand\n- Coast\n- End\n- River\n" in observation
    assert rewards(env, "Goal") == [1.0]


@pytest.mark.parametrize("variant", ["oneback", "freenav"])
def test_dead_end_sends_back_for_a_second_turn(variant: str) -> None:
    env = small_game(variant)
    observation, reward, terminated, _, info = env.step(says("End"))
    assert (reward, terminated, env.turn, env.path[-1].title) == (-0.1, False, 2, "Sea")
    assert info["feedback"] == "End has no links. You are back at Sea, which cost a second turn."
    assert "Turns left: 8." in observation


@pytest.mark.parametrize("max_turns", [1, 2])
def test_dead_end_may_use_up_the_turns(max_turns: int) -> None:
    env = small_game("freenav", max_turns, min_distance=1)
    _, reward, terminated, truncated, info = env.step(says("End"))
    assert (reward, terminated, truncated, info["correct"]) == (-0.1, True, False, False)
    assert env.turn == max_turns


def test_oneback_goes_back_once_in_a_row() -> None:
    env = small_game("oneback")
    assert rewards(env, "<PREV_PAGE>") == [-0.2]  # nothing lies before the start
    assert rewards(env, "Coast", "Sand", "<PREV_PAGE>", "<PREV_PAGE>") == [-0.05, -0.05, -0.05, -0.2]
    assert env.path[-1].title == "Coast"
    assert rewards(env, "Beach bar", "<PREV_PAGE>") == [-0.05, -0.05]
    assert env.path[-1].title == "Coast"


def test_oneback_cannot_go_back_after_a_dead_end() -> None:
    env = small_game("oneback")
    assert rewards(env, "Coast", "Sea", "End", "<PREV_PAGE>") == [-0.05, -0.05, -0.1, -0.2]


def test_freenav_goes_back_as_often_as_it_likes() -> None:
    env = small_game("freenav")
    assert rewards(env, "Coast", "Sand", "<PREV_PAGE>", "<PREV_PAGE>", "<PREV_PAGE>") == [-0.05] * 4 + [-0.2]
    assert env.path[-1].title == "Sea"
    env = small_game("freenav", max_turns=2)
    assert rewards(env, "Coast", "<PREV_PAGE>") == [-0.05, -0.05]
    assert env.outcome == "lost"


def test_rules_say_what_the_variant_allows() -> None:
    rules = {name: small_game(name).reset(seed=0, options=PAIR)[0].splitlines()[2] for name in VARIANTS}
    assert rules["eidetic"] == "You may also follow any link that you have seen earlier in this game."
    assert rules["oneback"].startswith(
        "\\boxed{<PREV_PAGE>} takes you back to the article before, but not twice in a row;"
    )
    assert rules["freenav"].startswith("\\boxed{<PREV_PAGE>} takes you back to the article before; it costs a turn")


def test_long_lists_of_links_come_in_parts() -> None:
    """Turning to another part costs a turn; a link can be taken from any of them."""
    env = small_game(links_per_part=2)
    heading = "Links from here, part {} of 2 (3 links in all; \\boxed{{<LINKS {}>}} shows part {} and costs a turn):\n"
    assert heading.format(1, 2, 2) + "- Coast\n- End\nTurns" in env.reset(seed=0, options=PAIR)[0]
    observation, reward, _, _, info = env.step(says("<LINKS 2>"))
    assert (reward, info["parsed_action"]) == (-0.05, "<LINKS 2>")
    assert heading.format(2, 1, 1) + "- River\nTurns" in observation
    assert env.step(says("<LINKS 3>"))[4]["feedback"] == "There is no part 3 of the links. The turn is lost."
    assert rewards(env, "Coast") == [-0.05]
    assert env.part == 1


@pytest.mark.parametrize(
    ("length", "shown"),
    [
        ((9, "characters"), "A coast l…"),
        ([3, "words"], "A coast lies …"),
        ((1, "sentences"), "A coast lies at the Sea. …"),
        ((2, "sentences"), "A coast lies at the Sea. It has a Beach bar, and its Sand."),
        ((0, "words"), " …"),
    ],
)
def test_page_summary_length(length: Any, shown: str) -> None:
    env = small_game(page_summary_length=length)
    assert f"You are at: Coast.\n{shown}\nLinks" in env.step(says("Coast"))[0]


def test_drawing() -> None:
    env = small_game()
    env.step(says("Coast"))
    env.step(says("Sand"))
    assert env.render() == (
        "\x1b[2mSea → Coast → \x1b[0m\x1b[1mSand\x1b[0m   (target: \x1b[32mGoal\x1b[0m)\n"
        "Sand is what a Goal stands on.\n\x1b[32mGoal\x1b[0m\nturn 2 of 10 · \x1b[1mplaying\x1b[0m"
    )


@pytest.mark.parametrize(
    ("kwargs", "message"),
    [
        ({"variant": "wild"}, "variant must be one of 'noregrets', 'oneback', 'freenav', 'eidetic', not 'wild'"),
        ({"max_turns": 0}, "max_turns must be a whole number from 1 to 1000000, or None to draw it, not 0"),
        (
            {"min_distance": 4, "max_distance": 3},
            "min_distance and max_distance must be whole numbers, 1 <= min_distance <= max_distance <= 100, "
            "not 4 and 3",
        ),
        ({"max_turns": 3, "min_distance": 4}, "min_distance=4 cannot be travelled in 3 turns"),
        ({"links_per_part": 0}, "links_per_part must be a whole number from 1 up, not 0"),
        (
            {"page_summary_length": (3, "lines")},
            "page_summary_length must be a pair such as (100, 'characters'), not (3, 'lines')",
        ),
        (
            {"backend": "paper"},
            "backend must be one of 'embedded', 'kiwix', 'mediawiki', or an ArticleGraph, not 'paper'",
        ),
        (
            {"url": "http://x"},
            "url goes with backend='kiwix' or backend='mediawiki'; leave it out, or name one of them",
        ),
        ({"book": "x"}, "book goes with backend='kiwix' alone; leave it out"),
        ({"backend": "mediawiki"}, "backend='mediawiki' needs url, the address of the wiki's api.php"),
        (
            {"backend": "kiwix", "url": "file:/etc/passwd"},
            "url must be an address such as 'http://localhost:8080', not 'file:/etc/passwd'",
        ),
    ],
)
def test_wrong_arguments(kwargs: dict[str, Any], message: str) -> None:
    with pytest.raises(ArgumentError) as caught:
        WikiGameEnv(**kwargs)
    assert str(caught.value) == message


def test_options_name_two_articles() -> None:
    env = WikiGameEnv(backend=small_graph())
    with pytest.raises(ArgumentError, match=r"^options of WikiGame are 'start' and 'target', both titles, not"):
        env.reset(seed=0, options={"start": "Sea"})
    with pytest.raises(ArgumentError, match=r"^start and target are the same article, 'Sea'; choose two$"):
        env.reset(seed=0, options={"start": "Sea", "target": "Sea"})
    with pytest.raises(ArticleNotFound, match=r"^there is no embedded article 'See'. Did you mean 'Sea'\?$"):
        env.reset(seed=0, options={"start": "See", "target": "Goal"})
    env.reset(seed=0, options=PAIR)
    env.reset(seed=0)
    assert (env.start, env.target) != ("Sea", "Goal")
    assert env.distance is not None


# Whose failure it is.


class Flaky(ArticleGraph):
    """Articles of the small graph, one of which cannot be fetched."""

    def __init__(self, broken: str) -> None:
        self.inner, self.broken = small_graph(), broken

    def article(self, title: str) -> Article:
        if title == self.broken:
            raise ArticleError("the server burns; put it out")
        return self.inner.article(title)

    def random_article(self, draws: CheapRandom) -> Article:
        return self.inner.random_article(draws)


def test_failing_backend_is_no_failure_of_the_agent() -> None:
    """The episode is truncated with an error, and nothing is scored."""
    env = WikiGameEnv(backend=Flaky("Coast"))
    env.reset(seed=0, options=PAIR)
    assert env.step(says("Coast")) == (
        TERMINAL_STATE,
        0.0,
        False,
        True,
        {"error": {"kind": "articles", "message": "the server burns; put it out"}},
    )


def test_reset_with_a_failing_backend_says_what_to_do() -> None:
    env = WikiGameEnv(backend=Flaky("Sea"))
    with pytest.raises(ArticleError, match=r"^the server burns; put it out$"):
        env.reset(seed=0, options=PAIR)


def test_concurrency_is_that_of_the_articles() -> None:
    assert concurrency_of(gem.make("game:WikiGame-v0-easy")) == "inline"
    assert concurrency_of(gem.make("game:WikiGame-v0-easy", backend=Flaky(""))) == "thread"
    assert concurrency_of(gem.make("game:WikiGame-v0-easy", backend="kiwix")) == "thread"


def test_walks_give_pairs_where_no_map_is_known() -> None:
    """No link of an earlier article leads to the target, and links lead there."""
    graph = Flaky("")
    for seed in range(200):
        pair = graph.pair(CheapRandom(seed), 2, 3)
        assert 2 <= pair.distance <= 3
        assert len(graph.inner.way(pair.start, pair.target)) - 1 == pair.distance
    with pytest.raises(ArticleError, match=r"^no walk of 9 links was found in 10 attempts; lower min_distance"):
        graph.pair(CheapRandom(0), 9, 9)
