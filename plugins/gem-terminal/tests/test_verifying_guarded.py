"""Which of the agent's changes are put back before the tests run, and which are its own business."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest
from verifying_toys import DONE, ToyMachine, as_machine

from gem_terminal.verifying.guarded import Inventories, PutBack, names_of, put_back_rest, put_back_tools

if TYPE_CHECKING:
    from gem_terminal.backends.interface import Change

HAS = frozenset({"sh", "bash", "python3", "libc.so.6", "pytest", "_pytest"})
PY = "/usr/local/lib/python3.12"
SITE = f"{PY}/site-packages"


HOMES = "/home"


def put_back(changes: dict[str, Change] | None, files: dict[str, bytes] | None = None) -> list[str] | None:
    machine = ToyMachine(lambda _: DONE)
    machine.changes, machine.files = changes, files or {}
    return both(machine).shown


def both(machine: ToyMachine) -> PutBack:
    return put_back_rest(as_machine(machine), put_back_tools(as_machine(machine), lambda: HAS))


@pytest.mark.parametrize(
    ("path", "how"),
    [
        ("/usr/bin/bash", "changed"),
        ("/usr/bin/python3", "changed"),
        ("/usr/bin/python3.11", "removed"),
        ("/usr/local/bin/python3", "added"),
        ("/root/.local/bin/bash", "added"),
        (f"{HOMES}/agent/.local/bin/sh", "added"),
        ("/etc/alternatives/awk", "changed"),
        ("/usr/bin", "changed"),
        ("/bin", "removed"),
        ("/usr/lib/x86_64-linux-gnu", "changed"),
        ("/usr/lib/x86_64-linux-gnu/libc.so.6", "changed"),
        ("/usr/local/lib/libc.so.6", "added"),
        ("/usr/lib/x86_64-linux-gnu/glibc-hwcaps/x86-64-v2/libc.so.6", "added"),
        ("/etc/ld.so.preload", "added"),
        ("/etc/ld.so.conf.d/evil.conf", "added"),
        ("/etc/nsswitch.conf", "changed"),
        ("/usr/lib/python3.11/os.py", "changed"),
        ("/usr/lib/python3.11/random/__init__.py", "added"),
        (f"{PY}/__pycache__/os.cpython-312.pyc", "added"),
        (SITE, "changed"),
        ("/usr/lib/python311.zip", "added"),
        ("/usr/bin/pyvenv.cfg", "added"),
        (f"{SITE}/sitecustomize.py", "added"),
        ("/root/.local/lib/python3.12/site-packages/usercustomize.py", "added"),
        ("/etc/python3.11/sitecustomize.py", "changed"),
        (f"{SITE}/_pytest/runner.py", "changed"),
        (f"{SITE}/_pytest/evil.py", "added"),
        (f"{SITE}/pluggy/__init__.py", "removed"),
        ("/conftest.py", "added"),
        ("/pytest.ini", "added"),
        ("/app/pytest.py", "added"),
    ],
)
def test_change_of_what_tests_stand_on_is_put_back(path: str, how: Change) -> None:
    assert put_back({path: how}) == [path]


@pytest.mark.parametrize(
    ("path", "how"),
    [
        ("/app/main.py", "changed"),
        ("/app/conftest.py", "added"),
        ("/usr/bin/nginx", "changed"),
        ("/usr/local/bin/curl", "added"),  # the image has none
        ("/usr/lib/x86_64-linux-gnu/libssl.so.3", "added"),
        ("/usr/lib/x86_64-linux-gnu/libpq.so.5", "changed"),
        ("/etc/hosts", "changed"),
        ("/etc/passwd", "changed"),
        (f"{SITE}/numpy/__init__.py", "added"),
        (f"{SITE}/requests/api.py", "changed"),
        ("/usr/lib/python3/dist-packages/yaml/__init__.py", "changed"),
        ("/opt/tool/python3", "added"),
        ("/app/src/pytest.py", "added"),
        ("/app/pytest.py", "changed"),
        (f"{HOMES}/agent/.bashrc", "changed"),
    ],
)
def test_change_that_a_task_may_be_about_stays(path: str, how: Change) -> None:
    assert put_back({path: how}) == []


def test_python_that_the_agent_installed_keeps_its_library() -> None:
    root = "/usr/local/lib/python3.13"
    changes: dict[str, Change] = {
        root: "added",
        f"{root}/os.py": "added",
        f"{root}/site-packages/yaml/__init__.py": "added",
        "/usr/local/bin/python3.13": "added",
    }
    assert put_back(changes) == []


def test_pytest_that_stands_in_for_the_images_goes_and_another_package_stays() -> None:
    """Python looks for packages of the user's before those of the image."""
    user = "/root/.local/lib/python3.12/site-packages"
    changes: dict[str, Change] = {
        f"{user}/_pytest": "added",
        f"{user}/_pytest/runner.py": "added",
        f"{user}/pytest-99.0.dist-info": "added",
        f"{user}/iniconfig": "added",
        f"{user}/iniconfig/__init__.py": "added",
    }
    assert put_back(changes) == [f"{user}/_pytest", f"{user}/pytest-99.0.dist-info"]


def test_start_files_go_where_they_hold_code() -> None:
    files = {
        f"{SITE}/path.pth": b"/app/src\n",
        f"{SITE}/code.pth": b"/app\nimport evil\n",
        f"{SITE}/good-1.0.dist-info/entry_points.txt": b"[console_scripts]\na = b:c\n",
        f"{SITE}/evil-1.0.dist-info/entry_points.txt": b"[pytest11]\na = b\n",
    }
    assert put_back(dict.fromkeys(files, "added"), files) == [
        f"{SITE}/code.pth",
        f"{SITE}/evil-1.0.dist-info/entry_points.txt",
    ]


def test_start_file_that_is_no_regular_file_counts_as_code() -> None:
    assert put_back({f"{SITE}/link.pth": "added"}) == [f"{SITE}/link.pth"]


def test_untouched_machine_is_asked_only_about_what_was_added_under_a_tools_name() -> None:
    def ask() -> frozenset[str]:
        raise AssertionError("asked")

    machine = ToyMachine(lambda _: DONE)
    machine.changes = {"/usr/bin/bash": "changed", "/app/x": "added", "/usr/bin/nginx": "added"}
    assert put_back_tools(as_machine(machine), ask).paths == ["/usr/bin/bash"]


def test_nothing_is_asked_of_a_machine_in_which_nothing_was_changed() -> None:
    machine = ToyMachine(lambda _: DONE)
    assert both(machine).shown == []
    assert machine.log == []


def test_backend_that_cannot_tell_is_said_so() -> None:
    assert put_back(None) is None


def test_libraries_are_looked_for_again_when_the_loaders_cache_was_put_back() -> None:
    machine = ToyMachine(lambda _: DONE)
    machine.changes = {"/etc/ld.so.cache": "changed"}
    assert both(machine).shown == ["/etc/ld.so.cache"]
    assert machine.log == ["agent: put back /etc/ld.so.cache", "agent: ldconfig"]


def test_long_list_is_cut() -> None:
    found = put_back({f"/usr/lib/python3.11/a{n:03}.py": "added" for n in range(80)})
    assert found is not None
    assert len(found) == 51
    assert found[-1] == "and 30 more"


def test_inventory_of_a_task_is_taken_once() -> None:
    machine = ToyMachine(lambda _: DONE)
    inventories = Inventories()
    for _ in range(3):
        assert "pytest" in inventories.get("task", lambda: names_of(as_machine(machine)))
    assert machine.log == ["agent: list"]
