"""Task folders: which are found, by what names, and what is said of those that cannot be read."""

from __future__ import annotations

import json

import pytest
from mcpmark_helping import NOTHING_TO_DO, write_task

import gem_core as gem
from gem_core.errors import ArgumentError
from gem_mcpmark import TaskError, read_tasks, requirements
from gem_mcpmark.tasks import find_dump


def test_tasks_are_found_at_any_depth_and_chosen_by_pattern(tmp_path):
    """They are called by category and name; tasks of other services are passed over."""
    for name in ("easy/shop/fruit", "easy/shop/bread", "standard/farm/cows", "standard/web/pages"):
        root = write_task(tmp_path, name=name, verify=NOTHING_TO_DO)
    (root / "standard/web/pages/meta.json").write_text(json.dumps({"mcp": ["playwright"]}))
    assert [task.name for task in read_tasks(root)] == ["farm/cows", "shop/bread", "shop/fruit"]
    assert [task.name for task in read_tasks(root, ["shop/*"])] == ["shop/bread", "shop/fruit"]
    assert [task.name for task in read_tasks(root / "easy/shop/fruit")] == ["shop/fruit"]
    with pytest.raises(ArgumentError, match=r"there is none called 'shop/fruits' among 3. Did you mean 'shop/fruit'"):
        read_tasks(root, "shop/fruits")


def test_what_cannot_be_read_is_named(tmp_path):
    with pytest.raises(TaskError, match="there is no such folder"):
        read_tasks(tmp_path / "none")
    with pytest.raises(TaskError, match=r"has no PostgreSQL task; expected folders with description.md and verify.py"):
        read_tasks(tmp_path)
    root = write_task(tmp_path, name="easy/shop/fruit", verify=NOTHING_TO_DO)
    write_task(tmp_path, name="hard/shop/fruit", verify=NOTHING_TO_DO)
    with pytest.raises(TaskError, match="two tasks are called 'shop/fruit'"):
        read_tasks(root)
    (root / "easy/shop/fruit/meta.json").write_text("{")
    with pytest.raises(TaskError, match=r"meta.json: cannot be read as JSON"):
        read_tasks(root)


@pytest.mark.parametrize(
    ("words", "makes"),
    [
        ("**Create** a new database role called `clerk`.", True),
        ("Use `CREATE ROLE`, and grant.", True),
        ("List the roles and users; create a table of user roles.", False),
    ],
)
def test_tasks_that_make_roles_are_known(tmp_path, words, makes):
    (task,) = read_tasks(write_task(tmp_path, verify=NOTHING_TO_DO, words=words))
    assert task.agent_makes_roles is makes
    assert not task.verify_makes_roles
    assert not task.prepare_makes_roles


def test_a_dump_is_looked_for_where_mcpmark_has_it(tmp_path):
    """In ``postgres_state`` beside the tasks, or where the user says."""
    (task,) = read_tasks(write_task(tmp_path, verify=NOTHING_TO_DO))
    assert find_dump(task, None) is None
    (tmp_path / "postgres_state").mkdir()
    (tmp_path / "postgres_state" / "shop.backup").touch()
    assert find_dump(task, None) == tmp_path / "postgres_state" / "shop.backup"
    (tmp_path / "shop.sql.gz").touch()
    assert find_dump(task, tmp_path) == tmp_path / "shop.sql.gz"
    with pytest.raises(TaskError, match="is no folder"):
        find_dump(task, tmp_path / "none")


def test_what_to_install_is_said(monkeypatch):
    """Where there are neither PostgreSQL's programs nor a server that is named."""
    monkeypatch.delenv("GEM_MCPMARK_POSTGRES", raising=False)
    monkeypatch.setattr(requirements, "server_programs", lambda: None)
    found = requirements.postgres("")
    assert found.status == "unmet"
    assert "apt-get install postgresql" in found.advice
    with pytest.raises(gem.errors.MissingRequirementError, match="apt-get install postgresql"):
        gem.make("mcp:Sample")
    monkeypatch.setenv("GEM_MCPMARK_POSTGRES", "postgresql://postgres@127.0.0.1:1/none")
    assert requirements.postgres("").status == "met"
    assert requirements.postgres("", closely=True).status != "met"
