"""Commands of well-known programs, by name: how each is pointed at the endpoint and given the task."""

from __future__ import annotations

RECIPES: dict[str, list[str]] = {
    # Codex 0.169 (npm @openai/codex): the Responses API, streamed.
    "codex": [
        "codex", "exec", "--skip-git-repo-check", "--dangerously-bypass-approvals-and-sandbox",
        "-c", "model_provider=gem",
        "-c", 'model_providers.gem={name="gem",base_url="{base_url}/v1",env_key="OPENAI_API_KEY",wire_api="responses"}',
        "-m", "gem", "{instruction}",
    ],
    # Claude Code 2.1 (npm @anthropic-ai/claude-code): the Messages API, streamed.
    "claude-code": ["claude", "-p", "{instruction}", "--model", "gem", "--allowedTools", "Bash"],
    # mini-swe-agent 2.4 (PyPI mini-swe-agent): the Chat Completions API by LiteLLM.
    "mini-swe-agent": ["mini", "-m", "openai/gem", "-t", "{instruction}", "-y", "--exit-immediately"],
}  # fmt: skip

VARIABLES: dict[str, dict[str, str]] = {
    "claude-code": {"CLAUDE_CODE_DISABLE_NONESSENTIAL_TRAFFIC": "1"},
    "mini-swe-agent": {"MSWEA_CONFIGURED": "true", "MSWEA_COST_TRACKING": "ignore_errors"},
}
"""Environment variables that they need besides."""
