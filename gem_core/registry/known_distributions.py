"""Which distributions of this project offer what, for the advice in an error message where one is not installed."""

from __future__ import annotations

from functools import cache

KNOWN_DISTRIBUTIONS: dict[tuple[str, str], tuple[str, ...]] = {
    ("namespace", "game"): ("gem-games",),
    ("namespace", "ta"): ("gem-games",),
    ("namespace", "math"): ("gem-math",),
    ("namespace", "train"): ("gem-train",),
    ("namespace", "rg"): ("gem-math",),
    ("namespace", "code"): ("gem-code",),
    ("namespace", "qa"): ("gem-qa",),
    ("namespace", "logic"): ("gem-qa",),
    ("namespace", "terminal"): ("gem-terminal",),
    ("namespace", "tau"): ("gem-tau",),
    ("namespace", "mcp"): ("gem-mcpmark",),
    ("namespace", "pz"): ("gem-pettingzoo",),
    ("namespace", "eval"): ("gem-math", "gem-code", "gem-qa"),
    ("tool", "python"): ("gem-tools",),
    ("tool", "search"): ("gem-tools",),
    ("tool", "mcp"): ("gem-tools",),
    ("vector backend", "ray"): ("gem-ray",),
    ("agent", "openai"): ("gem-openai",),
    ("agent", "train"): ("gem-train",),
    ("agent", "bisect"): ("gem-games",),
    ("agent", "hanoi"): ("gem-games",),
    ("agent", "mastermind"): ("gem-games",),
    ("agent", "wikigame"): ("gem-games",),
    ("agent", "tictactoe"): ("gem-games",),
    ("agent", "kuhn"): ("gem-games",),
    ("agent", "tau-assistant"): ("gem-tau",),
    ("agent", "tau-user"): ("gem-tau",),
    ("agent", "negotiator"): ("gem-games",),
    ("tool", "distractor_tools"): ("gem-eval",),
    ("wrapper", "cut_outputs"): ("gem-eval",),
    ("wrapper", "paraphrase"): ("gem-eval",),
    ("wrapper", "renamed_parameters"): ("gem-eval",),
    ("wrapper", "tool_429"): ("gem-eval",),
    ("wrapper", "tool_timeout"): ("gem-eval",),
    ("wrapper", "typos"): ("gem-eval",),
    ("command", "audit"): ("gem-eval",),
    ("command", "bench-env"): ("gem-eval",),
    ("command", "eval"): ("gem-eval",),
    ("command", "robustness"): ("gem-eval",),
    ("command", "show"): ("gem-eval",),
    ("command", "compare"): ("gem-eval",),
    ("command", "score"): ("gem-eval",),
    ("command", "replay"): ("gem-eval",),
    ("command", "report"): ("gem-eval",),
    ("command", "export"): ("gem-eval",),
    ("command", "view"): ("gem-eval",),
    ("command", "train"): ("gem-train",),
    ("command", "train-study"): ("gem-train",),
    ("command", "mcp"): ("gem-tools",),
    ("command", "serve-search"): ("gem-tools",),
    ("command", "tau"): ("gem-tau",),
    ("command", "terminal"): ("gem-terminal",),
}
"""By kind of record, as its ``kind`` says it (environments by namespace), and name."""


@cache
def own_distributions() -> frozenset[str]:
    """Return the names of this project's distributions that offer something."""
    return frozenset(owner for owners in KNOWN_DISTRIBUTIONS.values() for owner in owners)


def distributions_with(name: str, kind: str | None = None) -> list[str]:
    """Return the distributions that offer a name, of one kind or of any; none where nobody here does."""
    found = (owners for (of, known), owners in KNOWN_DISTRIBUTIONS.items() if known == name and kind in (of, None))
    return list(dict.fromkeys(owner for owners in found for owner in owners))
