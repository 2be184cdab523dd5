"""The public names, which are imported on first use."""

from .suite import (
    Model as Model,
    Suite as Suite,
    SuiteChanges as SuiteChanges,
    SuiteTask as SuiteTask,
    builtin_suites as builtin_suites,
    changed_suite as changed_suite,
    combined_suite as combined_suite,
    load_suite as load_suite,
)
