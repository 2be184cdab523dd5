"""Reading the tests' own reports in ``/logs/verifier``: CTRF (``ctrf.json``), or JUnit's XML."""

from __future__ import annotations

import json
from collections.abc import Mapping
from xml.etree import ElementTree

from gem_terminal.verifying.verdict import TestResult

_MOST_TESTS = 10_000
_MOST_NAME = 500
_GOOD = {"passed", "skipped", "pending", "other"}


def read_report(files: Mapping[str, bytes]) -> tuple[TestResult, ...]:
    """Return the tests that a report names; none where there is no report, or none that can be read.

    A report only adds detail to a reward file, so that one that is broken is no problem of the verdict.

    Args:
        files: Contents of what is in ``/logs/verifier``, by path relative to it.

    Source: ctrf.io's schema (``results.tests[]`` with ``name``, ``status``, ``message``), and JUnit's ``testcase``.
    """
    if "ctrf.json" in files:
        return _unique(_from_ctrf(files["ctrf.json"]))
    for name in sorted(files):
        if name.endswith(".xml") and (tests := _from_junit(files[name])):
            return _unique(tests)
    return ()


def _from_ctrf(content: bytes) -> list[TestResult]:
    try:
        report = json.loads(content)
        entries = report["results"]["tests"]
    except (ValueError, RecursionError, KeyError, TypeError, IndexError):
        return []
    found = []
    for entry in entries[:_MOST_TESTS] if isinstance(entries, list) else ():
        if isinstance(entry, dict) and isinstance(entry.get("name"), str) and isinstance(entry.get("status"), str):
            message = entry.get("message")
            passed = entry["status"] in _GOOD
            shown = message[:500] if isinstance(message, str) and not passed else ""
            found.append(TestResult(entry["name"][:_MOST_NAME], passed, message=shown))
    return found


def _from_junit(content: bytes) -> list[TestResult]:
    if b"<!DOCTYPE" in content or b"<!ENTITY" in content or b"\0" in content:
        return []  # reports have none; entities can grow without bound, and UTF-16 could hide them
    try:
        root = ElementTree.fromstring(content)  # the parser itself bounds depth
    except (ElementTree.ParseError, ValueError, LookupError, RecursionError):
        return []
    found = []
    for case in root.iter("testcase"):
        wrong = next((child for child in case if child.tag in ("failure", "error")), None)
        message = "" if wrong is None else (wrong.get("message") or wrong.text or "")
        group, name = case.get("classname") or "", case.get("name") or ""
        found.append(TestResult(f"{group}::{name}"[:_MOST_NAME], wrong is None, message=message[:500]))
        if len(found) == _MOST_TESTS:
            break
    return found


def _unique(tests: list[TestResult]) -> tuple[TestResult, ...]:
    """Keep each name once; one that is there twice has passed if it did both times."""
    kept: dict[str, TestResult] = {}
    for test in tests:
        if test.name not in kept or kept[test.name].passed:
            kept[test.name] = test
    return tuple(kept.values())
