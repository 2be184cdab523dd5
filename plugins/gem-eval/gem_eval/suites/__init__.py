"""Suites: which tasks are evaluated and how, as YAML files of ours and of users."""

from gem_eval.suites.suite import (
    Model,
    Suite,
    SuiteChanges,
    SuiteTask,
    builtin_suites,
    changed_suite,
    combined_suite,
    load_suite,
)

__all__ = [
    "Model",
    "Suite",
    "SuiteChanges",
    "SuiteTask",
    "builtin_suites",
    "changed_suite",
    "combined_suite",
    "load_suite",
]
