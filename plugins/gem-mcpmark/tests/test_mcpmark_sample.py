"""The eight sample tasks: what solves them counts, and what only comes near does not."""

from __future__ import annotations

import contextlib

import pytest
from mcpmark_helping import needs_postgres
from sample_solutions import SOLUTIONS

from gem_mcpmark.tasks import read_tasks

pytestmark = needs_postgres
TASKS = {task.name: task for task in read_tasks("gem_mcpmark:sample")}


def solved(name: str, sql: str) -> bool:
    """Tell whether a task counts as solved after the agent has executed some SQL."""
    import psycopg

    from gem_mcpmark.episode import EpisodeDatabase

    with contextlib.closing(EpisodeDatabase(TASKS[name], None)) as episode:
        with psycopg.connect(episode.variables["DATABASE_URI"]) as connection:
            connection.execute(sql)
        return episode.verify(60).exit_code == 0


def test_every_task_has_a_solution():
    assert set(SOLUTIONS) == set(TASKS)
    assert len(TASKS) == 8


@pytest.mark.few(1)
@pytest.mark.parametrize("name", SOLUTIONS)
def test_the_solution_counts(name):
    assert solved(name, SOLUTIONS[name][0])


@pytest.mark.few(1)
@pytest.mark.parametrize("name", SOLUTIONS)
def test_what_comes_near_does_not_count(name):
    assert not solved(name, SOLUTIONS[name][1])


@pytest.mark.thorough
@pytest.mark.parametrize("name", SOLUTIONS)
def test_nothing_does_not_count(name):
    assert not solved(name, "SELECT")
