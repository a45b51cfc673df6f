"""Functions whose parameters are the fields of a record, so that each parameter is written once.

The record is a dataclass. Its fields are the names, types and defaults of the parameters. Type
checkers, `inspect.signature` and `help` show these parameters as those of the function.
"""

from collections.abc import Callable, Mapping
from dataclasses import MISSING, fields
from difflib import get_close_matches
from inspect import Parameter, Signature, signature
from typing import Any, ParamSpec, TypeVar

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
        TypeError: The arguments do not match the parameters. For an unknown name, the message
            contains the most similar parameter.
    """
    expected = signature(function)
    try:
        expected.bind(*args, **options)
    except TypeError as error:
        raise TypeError(f"{function.__name__}() {error}{_hint(expected, options)}") from None
    return record(*args, **options)


def _hint(expected: Signature, options: Mapping[str, Any]) -> str:
    """Return a sentence with the parameter that is most similar to the first unknown name."""
    unknown = [name for name in options if name not in expected.parameters]
    similar = get_close_matches(unknown[0], expected.parameters, 1) if unknown else []
    return f". Did you mean {similar[0]!r}?" if similar else ""
