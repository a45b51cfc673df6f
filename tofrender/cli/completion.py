"""Completions for shells: names that are known without importing what has them."""

from collections.abc import Callable, Iterable
from pathlib import Path

from ..runtime.lazy import public_names

VARIANTS = tuple(
    f"{backend}_{kind}"
    for backend in ("llvm", "cuda", "metal")
    for kind in (
        *("ad_rgb", "ad_mono", "ad_spectral", "ad_mono_polarized", "ad_spectral_polarized"),
        *("mono", "rgb", "spectral"),
    )
)


def among(names: Iterable[str]) -> Callable[[str], list[str]]:
    """Make a function that completes text to one of some names."""
    known = tuple(names)
    return lambda incomplete: [name for name in known if name.startswith(incomplete)]


variant = among(VARIANTS)


def scene_names() -> list[str]:
    """Names of the built-in scenes, as the package's stub lists them."""
    names = public_names("tofrender", str(Path(__file__).parents[1] / "__init__.py"))
    return [name for name, module in names.items() if module == "tofrender.scenes"]


def scene(incomplete: str) -> list[str]:
    """Completions to a built-in scene, an XML file, or a folder on the way to one."""
    names = [n.replace("_", "-") if "-" in incomplete else n for n in scene_names()]
    return among(names)(incomplete) + paths(incomplete, ".xml")


def paths(incomplete: str, *suffixes: str) -> list[str]:
    """Completions to files that end in one of these, and folders."""
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
