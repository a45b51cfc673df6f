"""Messages of the package as the command says them: its words are options there."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from inspect import signature
from typing import Any, get_type_hints

import typer

from ..rendering.settings import SCENE_NAMES

OTHER_NAMES = {scene_name: name for name, scene_name in SCENE_NAMES.items()}
OTHER_NAMES |= {"width": "size", "height": "size"}
"""Names in scenes and films of what options give."""

_options: dict[str, tuple[str, bool]] = {}
"""Names of the options of the command under way, by its parameters, and whether each is given."""


def set_command(command: Callable[..., Any] | None, given: Mapping[str, Any]) -> None:
    """From now on, messages are about this command, called with these values; None for none."""
    _options.clear()
    if command is None:
        return
    kinds = get_type_hints(command, include_extras=True)
    for name, parameter in signature(command).parameters.items():
        about = [each for each in getattr(kinds[name], "__metadata__", ()) if each is not None]
        if any(isinstance(each, typer.models.ArgumentInfo) for each in about):
            continue
        declared = [name for each in about for name in getattr(each, "param_decls", None) or ()]
        option = declared[0] if declared else f"--{name.replace('_', '-')}"
        _options[name] = option, given.get(name) != parameter.default


def with_option_names(message: str) -> str:
    """A message with the options of the command under way in place of the package's words.

    The word that it starts with is an option if that was given; a word in backticks is one
    wherever the command has it.
    """

    def first(found: re.Match[str]) -> str:
        option, given = _options.get(_own(found[1]), ("", False))
        return f"{option if given else found[1]}{found[2]}"

    def quoted(found: re.Match[str]) -> str:
        option, _ = _options.get(_own(found[1]), ("", False))
        return found[0] if not option else f"{option} {found[3]}" if found[3] else option

    message = re.sub(r"\A(\w+)( = |:)", first, message)
    if "variant" in _options:
        message = re.sub(r"call mi\.set_variant\('(\w+)'\) first", r"give --variant \1", message)
    return re.sub(r"`(\w+)(='?([^`']*)'?)?`", quoted, message)


def _own(word: str) -> str:
    return OTHER_NAMES.get(word, word)
