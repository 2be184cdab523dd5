"""From keyword arguments to a configuration of reasoning-gym, with errors that say what there is."""

from __future__ import annotations

import dataclasses
import datetime
import enum
from collections.abc import Mapping
from typing import Any

from reasoning_gym.factory import CURRICULA, DATASETS

from gem_core.suggestions import did_you_mean

_OURS = ("size", "seed")


class WrongError(Exception):
    """What was asked for cannot be right."""


def configuration(spec: Mapping[str, Any]) -> Any:
    """Return the configuration that a record asks for, checked by reasoning-gym.

    Args:
        spec: ``task``, ``size``, and perhaps ``level``, ``levels`` and ``parameters``.

    Raises:
        WrongError: There is no such parameter, level or attribute, or reasoning-gym refuses a value.
    """
    task = spec["task"]
    config_class = DATASETS[task][1]
    names = [field.name for field in dataclasses.fields(config_class) if field.name not in _OURS]
    given = dict(spec.get("parameters") or {})
    level, levels = spec.get("level"), dict(spec.get("levels") or {})
    if "difficulty" in given and "difficulty" not in names and level is None:
        level = given.pop("difficulty")
    for name in given:
        if name not in names:
            raise WrongError(
                f"no parameter {name!r}.{did_you_mean(name, names)} There is: {', '.join(names) or 'none'}; "
                "and for every task: size, seed, epochs, level, levels, prompt_template, time_limit_s"
            )
    by_level = _at_levels(task, level, levels)
    defaults = config_class()
    try:
        arguments = {name: _converted(getattr(defaults, name), value) for name, value in given.items()}
        config = config_class(**{**by_level, **arguments, "size": spec["size"], "seed": 0})
        if hasattr(config, "validate"):
            config.validate()
    except Exception as error:
        told = str(error) or type(error).__name__
        raise WrongError(f"reasoning-gym refuses the parameters {given or by_level!r}: {told}") from error
    return config


def _at_levels(task: str, level: Any, levels: dict[str, Any]) -> dict[str, Any]:
    """Return the parameters that a curriculum has at a level, and at levels of some of its attributes."""
    if level is None and not levels:
        return {}
    if task not in CURRICULA:
        raise WrongError("it has no levels; set its parameters instead")
    curriculum = CURRICULA[task]()
    lengths = {name: len(attribute.levels) for name, attribute in curriculum.attributes.items()}
    if level is not None:
        _check_level("level", level, max(lengths.values()))
        curriculum.set_global_level(level)
    for name, own in levels.items():
        if name not in lengths:
            raise WrongError(f"no attribute {name!r}.{did_you_mean(name, lengths)} There is: {', '.join(lengths)}")
        _check_level(f"the level of {name!r}", own, lengths[name])
        curriculum.set_attr_level(name, own)
    try:
        config = curriculum.generate_configuration()
    except Exception as error:
        raise WrongError(f"reasoning-gym has no configuration for level {level!r}, {levels!r}: {error}") from error
    governed = set()
    for attribute in curriculum.attributes.values():
        for key in ("field_name", "lower_field_name", "upper_field_name"):
            governed.add(getattr(attribute, key, None))
    return {name: value for name, value in vars(config).items() if name in governed}


def _check_level(what: str, level: Any, count: int) -> None:
    if type(level) is not int or not 0 <= level < count:
        raise WrongError(f"{what} must be a whole number from 0 to {count - 1}, not {level!r}")


def _converted(default: Any, value: Any) -> Any:
    """Return a value as the default's type: JSON has no tuples, enumerations, dates and times."""
    if isinstance(default, datetime.date | datetime.time) and isinstance(value, str):
        return type(default).fromisoformat(value)
    if isinstance(default, tuple | enum.Enum):
        return type(default)(value)
    return value
