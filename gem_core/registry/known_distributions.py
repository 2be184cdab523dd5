"""The names that this project's distributions offer, for errors that advise which one to install."""

from __future__ import annotations

KNOWN_DISTRIBUTIONS: dict[str, dict[str, str]] = {
    "gem-math": {"namespace": "eval math rg"},
    "gem-code": {"namespace": "code eval"},
    "gem-eval": {
        "wrapper": "polite tool_429 tool_timeout typos",
        "command": "audit compare eval export replay report score show view",
    },
    "gem-games": {"namespace": "game ta", "agent": "bisect hanoi kuhn mastermind negotiator tictactoe wikigame"},
    "gem-mcpmark": {"namespace": "mcp"},
    "gem-openai": {"agent": "openai"},
    "gem-pettingzoo": {"namespace": "pz"},
    "gem-qa": {"namespace": "eval logic qa"},
    "gem-ray": {"vector backend": "ray"},
    "gem-server": {"wrapper": "harness"},
    "gem-tau": {"namespace": "tau", "agent": "tau-assistant tau-user", "command": "tau"},
    "gem-terminal": {"namespace": "terminal", "command": "terminal"},
    "gem-tools": {"tool": "mcp python search", "command": "mcp serve-search"},
    "gem-train": {"agent": "train", "command": "train train-study"},
}
"""What each offers: names by kind of record, as its ``kind`` says it; environments by namespace."""
