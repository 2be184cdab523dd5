"""Check arguments against the signature of a class or function, with an error that names those it takes."""

from __future__ import annotations

import copy
import inspect
import typing
from collections.abc import Callable, Mapping, Sequence
from typing import Any, ClassVar, Self

from gem_core.errors import ArgumentError, GemError, StateNotSupported
from gem_core.suggestions import did_you_mean

Arguments = tuple[tuple[Any, ...], dict[str, Any]]
"""Positional and keyword arguments of one call."""


class RemembersArguments:
    """An environment or a wrapper: it can be made again from the same arguments, and forked in the same state."""

    shared_by_forks: ClassVar[tuple[str, ...]] = ()
    """Attributes that a fork shares: what is large and never changes, such as the rows of a data set."""

    _init_args: Arguments = ((), {})

    def __new__(cls, *args: Any, **kwargs: Any) -> Self:
        """Remember the arguments; they are still checked by ``__init__``."""
        if (args or kwargs) and cls.__init__ is object.__init__:
            # The message of Python for a class without its own __new__.
            raise TypeError(f"{cls.__name__}() takes no arguments")
        self = super().__new__(cls)
        self._init_args = (args, kwargs)
        return self

    def fork(self) -> Self:
        """Return an independent copy in the same state, generators included: the same actions give the same results.

        It is ``copy.deepcopy``, of a whole stack of wrappers too. A class that holds something outside of Python, such
        as a container, overrides ``__deepcopy__``: it makes another one, or raises ``StateNotSupported``.

        Raises:
            StateNotSupported: The environment holds something that cannot be copied.
        """
        try:
            return copy.deepcopy(self)
        except GemError:
            raise
        except Exception as error:
            cause = f"{type(self).__name__} cannot be forked ({type(error).__name__}: {error})"
            raise StateNotSupported(f"{cause}; make another, and repeat the seed and the actions") from error

    def __deepcopy__(self, memo: dict[int, Any]) -> Self:
        # What is made again from the arguments shares them as well.
        shared = [vars(self).get(name) for name in ("_init_args", *self.shared_by_forks)]
        memo.update({id(value): value for value in shared})
        copied = object.__new__(type(self))
        memo[id(self)] = copied
        vars(copied).update(copy.deepcopy(vars(self), memo))
        return copied


def signature_of(maker: Callable[..., Any]) -> inspect.Signature | None:
    """Return the signature of a callable, or None if it is C code without one."""
    if isinstance(maker, type) and issubclass(maker, RemembersArguments):
        # inspect may show its __new__, which takes anything.
        if maker.__init__ is object.__init__:
            return inspect.Signature()
        return inspect.Signature(_constructor_parameters(maker))
    try:
        return inspect.signature(maker)
    except (TypeError, ValueError):
        return None


def _constructor_parameters(maker: type) -> list[inspect.Parameter]:
    """Return what a class takes; ``**options: Unpack[SomeTypedDict]`` becomes the keywords that it stands for."""
    constructors = [vars(base)["__init__"] for base in maker.__mro__[:-1] if "__init__" in vars(base)]
    found = list(inspect.signature(constructors[0]).parameters.values())[1:]
    if not found or found[-1].kind is not found[-1].VAR_KEYWORD or "Unpack[" not in str(found[-1].annotation):
        return found
    try:
        hint = typing.get_type_hints(constructors[0])[found[-1].name]
        names = list(typing.get_type_hints(typing.get_args(hint)[0]))
    except (NameError, TypeError, AttributeError):  # what is imported for the type checker alone
        return found
    # They are passed on to the function that defines their types and defaults.
    known = {name: inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=None) for name in names}
    for constructor in reversed(constructors[1:]):
        known |= {name: each for name, each in inspect.signature(constructor).parameters.items() if name in known}
    return [*found[:-1], *(each.replace(kind=inspect.Parameter.KEYWORD_ONLY) for each in known.values())]


def check_arguments(maker: Callable[..., Any], args: tuple[Any, ...], options: Mapping[str, Any], owner: str) -> None:
    """Raise if a callable does not take these arguments, before it is called.

    Raises:
        ArgumentError: Names the arguments that are accepted.
    """
    signature = signature_of(maker)
    if signature is None:
        return
    try:
        signature.bind(*args, **options)
    except TypeError as error:
        names = [
            name
            for name, parameter in list(signature.parameters.items())[len(args) :]
            if parameter.kind in (parameter.POSITIONAL_OR_KEYWORD, parameter.KEYWORD_ONLY)
        ]
        wrong = [name for name in options if name not in names]
        hint = did_you_mean(wrong[0], names) if wrong else ""
        raise ArgumentError(f"{owner}: {error}.{hint} It accepts: {', '.join(names) or 'no arguments'}") from None
    for name, value in options.items():
        parameter = signature.parameters.get(name)
        if isinstance(value, str) and parameter is not None and parameter.annotation in (bool, "bool"):
            # Any text, even "False", would silently count as true.
            raise ArgumentError(f"{owner}: {name} must be True or False, not the text {value!r:.100}")


def takes_keyword(maker: Callable[..., Any], name: str) -> bool:
    """Tell whether a callable has an argument of a name; one that takes any keywords has none of this name."""
    parameter = (signature_of(maker) or inspect.Signature()).parameters.get(name)
    return parameter is not None and parameter.kind in (parameter.POSITIONAL_OR_KEYWORD, parameter.KEYWORD_ONLY)


def parse_choice(given: Any, rule: str, is_one: Callable[[object], bool]) -> tuple[Any, dict[str, Any]]:
    """Split a choice, ``one`` or ``(one, {option: value})``, into the chosen thing and its options.

    Args:
        given: The choice.
        rule: The form of a choice, for the error.
        is_one: Tells whether an object is a choice without options.

    Raises:
        ArgumentError: It is no choice.
    """
    if is_one(given):
        return given, {}
    if isinstance(given, Sequence) and len(given) == 2 and is_one(given[0]) and isinstance(given[1], Mapping):
        return given[0], dict(given[1])
    raise ArgumentError(f"{rule}, not {given!r:.200}")
