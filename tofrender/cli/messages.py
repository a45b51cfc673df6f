"""Messages of the package with the names of the command's options in them."""

import re
from typing import Any

from ..rendering.settings import SCENE_NAMES

OPTION_NAMES = {scene_name: name for name, scene_name in SCENE_NAMES.items()}
OPTION_NAMES |= {"width": "size", "height": "size"}
"""Parameters of commands by the names of the same settings in scenes and films."""

_options: dict[str, tuple[str, bool]] = {}
"""Options of the running command by parameter, with whether each is given."""


def set_command(context: Any = None) -> None:
    """Set the command that messages are about, by the context of its call; None for no command."""
    _options.clear()
    for parameter in context.command.params if context else ():
        if parameter.param_type_name == "option":
            source = context.get_parameter_source(parameter.name)
            _options[parameter.name] = parameter.opts[0], source.name != "DEFAULT"


def with_option_names(message: str) -> str:
    """Replace names of parameters in a message by options of the running command.

    The first word is replaced if that option was given, a word in backticks wherever the command
    has the option.
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
