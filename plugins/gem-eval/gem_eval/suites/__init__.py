"""Suites: which tasks are evaluated and how, as YAML files of ours and of users."""

from gem_eval.suites.suite import Model, Suite, SuiteTask, builtin_suites, combined_suite, load_suite

__all__ = ["Model", "Suite", "SuiteTask", "builtin_suites", "combined_suite", "load_suite"]
