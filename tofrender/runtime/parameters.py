"""Functions whose parameters are the fields of a record, so that each parameter is written once.

The record is a dataclass. Its fields are the names, types and defaults of the parameters. Type
checkers, `inspect.signature` and `help` show these parameters as those of the function.
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import MISSING, fields
from difflib import get_close_matches
from inspect import Parameter, Signature, signature
from typing import Any, ParamSpec, TypeVar

from .checks import join_names

P = ParamSpec("P")
Record = TypeVar("Record")
Result = TypeVar("Result")


def takes(record: Callable[P, Any]) -> Callable[[Callable[..., Result]], Callable[P, Result]]:
    """Give a function the fields of a dataclass as its parameters.

    The function itself has the parameters `*args` and `**options`. It passes them to `filled`.

    Example:
        >>> from dataclasses import dataclass, field
        >>> @dataclass(frozen=True, kw_only=True)
        ... class Speed:
        ...     distance_m: float = field(kw_only=False)
        ...     time_s: float = 1.0
        >>> @takes(Speed)
        ... def speed(*args, **options):
        ...     given = filled(Speed, speed, args, options)
        ...     return given.distance_m / given.time_s
        >>> signature(speed)
        <Signature (distance_m: float, *, time_s: float = 1.0)>
        >>> speed(3.0, time_s=2.0)
        1.5
    """

    def decorate(function: Callable[..., Result]) -> Callable[P, Result]:
        # Positional parameters precede keywords in a signature, but not always in a record
        parameters = [
            Parameter(
                each.name,
                Parameter.KEYWORD_ONLY if each.kw_only else Parameter.POSITIONAL_OR_KEYWORD,
                default=Parameter.empty if each.default is MISSING else each.default,
                annotation=each.type,
            )
            for each in sorted(fields(record), key=lambda each: each.kw_only)  # type: ignore
        ]
        returned = signature(function).return_annotation
        function.__signature__ = Signature(parameters, return_annotation=returned)  # type: ignore
        return function

    return decorate


def filled(
    record: Callable[..., Record],
    function: Callable[..., Any],
    args: tuple[Any, ...],
    options: Mapping[str, Any],
) -> Record:
    """Return the record of the arguments with which a function was called.

    Args:
        record: Dataclass with the parameters of the function.
        function: The function.
        args: Positional arguments.
        options: Keyword arguments.

    Raises:
        TypeError: The arguments do not match the parameters.
    """
    expected = signature(function)
    require_names(function.__name__, options, expected.parameters)
    try:
        expected.bind(*args, **options)
    except TypeError as error:
        raise TypeError(f"{function.__name__}() {error}") from None
    return record(*args, **options)


def require_names(function: str, given: Iterable[str], allowed: Iterable[str]) -> None:
    """Raise a TypeError if a function does not have a keyword argument.

    The message contains the most similar name, or all names if no name is similar.

    Args:
        function: Name of the function.
        given: Names of the keyword arguments.
        allowed: Names of the parameters.

    Example:
        >>> require_names("render", ["ssp"], ["spp", "seed"])
        Traceback (most recent call last):
        TypeError: render() got an unexpected keyword argument 'ssp'. Did you mean 'spp'?
    """
    names = list(allowed)
    for name in given:
        if name not in names:
            similar = get_close_matches(name, names, 1)
            remedy = (
                f"Did you mean {similar[0]!r}?" if similar else f"Use one of {join_names(names)}"
            )
            raise TypeError(f"{function}() got an unexpected keyword argument {name!r}. {remedy}")
