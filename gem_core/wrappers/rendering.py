"""``Rendered``: the render modes ``"ansi"`` and ``"human"`` of every environment."""

from __future__ import annotations

from typing import Any

from gem_core.env.wrapper import AnyEnv, Wrapper
from gem_core.types import Observation, ResetResult, StepResult

TEXT_MODES = ("ansi", "human")
"""What ``make`` offers for every environment of one agent."""


class Rendered(Wrapper):
    """Shows a task as text: as the task draws itself, or else its last observation.

    ``make`` puts it there where ``render_mode`` is given. ``"ansi"``: ``render`` returns the text. ``"human"``: the
    text is printed after every reset and step, as in Gymnasium.

    Args:
        env: A task, whose own render mode is ``"ansi"``.
        mode: ``"ansi"`` or ``"human"``.

    Source: the render modes of Gymnasium, https://gymnasium.farama.org/api/env/#gymnasium.Env.render.
    """

    hidden_in_spec = True
    _observation: Observation = ""

    def __init__(self, env: AnyEnv, mode: str) -> None:
        super().__init__(env)
        self._mode = mode

    @property
    def render_mode(self) -> str | None:  # type: ignore[override]  # a property of Gymnasium's own wrappers, too
        """The mode that was asked for."""
        return self._mode

    def render(self) -> str | None:
        """Return the text in the mode ``"ansi"``; None in ``"human"``, which has printed it."""
        return self._drawn() if self._mode == "ansi" else None

    def after_reset(self, result: ResetResult) -> ResetResult:
        """Show the beginning."""
        self._show(result[0])
        return result

    def after_step(self, action: str, result: StepResult) -> StepResult:
        """Show what the step led to."""
        self._show(result[0])
        return result

    def _show(self, observation: Observation) -> None:
        self._observation = observation
        if self._mode == "human":
            from gem_core.terminal import Terminal

            Terminal().show_drawing(self._drawn())

    def _drawn(self) -> str:
        drawn: Any = self.env.render()
        if drawn is None:
            from gem_core.terminal import observation_text

            return observation_text(self._observation)
        return drawn if isinstance(drawn, str) else str(drawn.getvalue())  # Gymnasium allows a StringIO
