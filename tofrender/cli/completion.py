"""Completions for shells. They need no import of Mitsuba."""

from collections.abc import Callable, Iterable
from pathlib import Path

from ..runtime.lazy import public_names

KINDS = (
    "ad_rgb",
    "ad_mono",
    "ad_spectral",
    "ad_mono_polarized",
    "ad_spectral_polarized",
    "mono",
    "rgb",
    "spectral",
)
VARIANTS = tuple(f"{backend}_{kind}" for backend in ("llvm", "cuda", "metal") for kind in KINDS)


def among(names: Iterable[str]) -> Callable[[str], list[str]]:
    """Return a function that completes text to one of `names`."""
    known = tuple(names)
    return lambda incomplete: [name for name in known if name.startswith(incomplete)]


variant = among(VARIANTS)


def scene_names() -> list[str]:
    """Return the names of the built-in scenes, read from the package's stub."""
    names = public_names("tofrender", str(Path(__file__).parents[1] / "__init__.py"))
    return [name for name, module in names.items() if module == "tofrender.scenes"]


def scene(incomplete: str) -> list[str]:
    """Complete text to a built-in scene, an XML file, or a folder."""
    names = [n.replace("_", "-") if "-" in incomplete else n for n in scene_names()]
    return among(names)(incomplete) + paths(incomplete, ".xml")


def paths(incomplete: str, *suffixes: str) -> list[str]:
    """Complete text to a folder, or to a file with one of `suffixes`."""
    folder, _, start = incomplete.rpartition("/")
    root = f"{folder}/" if "/" in incomplete else ""
    try:
        found = sorted(Path(root or ".").expanduser().iterdir())
    except OSError:
        return []
    return [
        f"{root}{each.name}" + "/" * each.is_dir()
        for each in found
        if each.name.startswith(start)
        and (start.startswith(".") or not each.name.startswith("."))
        and (each.is_dir() or each.suffix in suffixes)
    ]
