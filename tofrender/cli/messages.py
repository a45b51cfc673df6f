"""Replace names of parameters by names of options in messages of the package."""

import re
from typing import Any

from ..rendering.settings import SCENE_NAMES

OPTION_NAMES = {scene_name: name for name, scene_name in SCENE_NAMES.items()}
OPTION_NAMES |= {"width": "size", "height": "size"}
"""Parameter of a command for each name of a setting in scenes and films."""

_options: dict[str, tuple[str, bool]] = {}
"""For each parameter of the running command, its option and whether the user has given it."""


def set_command(context: Any = None) -> None:
    """Set the running command by the context of its call; None for no command."""
    _options.clear()
    for parameter in context.command.params if context else ():
        if parameter.param_type_name == "option":
            source = context.get_parameter_source(parameter.name)
            _options[parameter.name] = parameter.opts[0], source.name != "DEFAULT"


def with_option_names(message: str) -> str:
    """Replace names of parameters in a message by options of the running command.

    The first word of the message is replaced if the user has given this option. A word in backticks
    is replaced if the command has the option.
    """

    def first(found: re.Match[str]) -> str:
        option, given = _option(found[1])
        return f"{option if given else found[1]}{found[2]}"

    def quoted(found: re.Match[str]) -> str:
        option, _ = _option(found[1])
        return found[0] if not option else f"{option} {found[3]}" if found[3] else option

    message = re.sub(r"\A(\w+)( = |:)", first, message)
    if "variant" in _options:
        message = re.sub(r"call mi\.set_variant\('(\w+)'\) first", r"give --variant \1", message)
    return re.sub(r"`(\w+)(='?([^`']*)'?)?`", quoted, message)


def _option(word: str) -> tuple[str, bool]:
    return _options.get(OPTION_NAMES.get(word, word), ("", False))
