"""Extract the files that an assignment asks for from a submission, a folder or a zip."""

import errno
import fnmatch
import io
import os
import stat
import zipfile
import zlib
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path, PurePosixPath
from typing import IO

MAX_BYTES = 512 << 20  # of all files together, as they really are
MAX_FILES = 2000
LEVELS = 2  # folders around the files
MAX_NAME = 250  # with its folders [bytes]
MAX_DIRECTORY = 1 << 20  # of a zip: what it says of its files [bytes]
# Names of files that configure the judge, in no folder of a submission. All others may be helpers,
# also `probes.py`, which the tests have, too: neither meets the other.
NEVER = {
    *("conftest.py", "pytest.ini", ".pytest.ini", "pyproject.toml", "setup.cfg", "tox.ini"),
    *("rubric.toml", "results.json", "sitecustomize.py", "usercustomize.py"),
}
BROKEN = (EOFError, NotImplementedError, RuntimeError, ValueError)
OF_THE_MACHINE = {errno.EIO, errno.EMFILE, errno.ENFILE, errno.ENOMEM, errno.ENOSPC, errno.ESTALE}
"""Numbers of errors that no submission is to blame for."""
Opener = Callable[[], IO[bytes]]


class BadSubmission(ValueError):
    """A submission cannot be extracted; one line for the student."""


class Nothing(BadSubmission):
    """A submission has none of the files that were asked for."""


def extract(
    source: Path, patterns: Sequence[str], target: Path, names: Sequence[str] = ()
) -> list[str]:
    """Copy matching files of a submission into a new folder; returns their names, sorted.

    They may lie up to two folders deep, or in the only zip of a folder: those are copied that lie
    with most of `names`, which are matching files. Links in a folder are passed over.
    `BadSubmission` for too many or too large files, or a broken or dangerous zip.
    """
    depth = LEVELS + max(len(pattern.split("/")) for pattern in patterns)
    with _open_files(source, depth) as files:
        chosen = _chosen(files, patterns, names)
        if not chosen:
            zips = [name for name in files if name.lower().endswith(".zip")]
            if source.is_dir() and len(zips) == 1:
                return extract(source / zips[0], patterns, target, names)
            shown = ", ".join(sorted(files)[:3]) + ", ..." * (len(files) > 3)
            raise Nothing(f"has none of {', '.join(names or patterns)}; has {shown or 'no files'}")
        if len(chosen) > MAX_FILES:
            raise BadSubmission(f"has {len(chosen)} files, more than {MAX_FILES}")
        folders = {str(up) for name in chosen.values() for up in PurePosixPath(name).parents}
        for name in folders.intersection(chosen.values()):
            raise BadSubmission(f"holds {name!a} as a file and as a folder")
        target.mkdir(parents=True)
        left = MAX_BYTES
        for name, new in chosen.items():
            path = target / new
            path.parent.mkdir(parents=True, exist_ok=True)
            with path.open("xb") as outgoing:
                for chunk in _chunks(files[name]):
                    left -= len(chunk)
                    if left < 0:
                        raise BadSubmission(f"unpacks to more than {MAX_BYTES >> 20} MiB")
                    outgoing.write(chunk)
    return sorted(chosen.values())


def _chosen(files: Iterable[str], patterns: Sequence[str], names: Sequence[str]) -> dict[str, str]:
    """New names of the files of one folder, by their names."""
    found: dict[str, dict[str, str]] = {}
    for name in files:
        parts = name.split("/")
        for level in range(min(LEVELS + 1, len(parts))):
            inner = "/".join(parts[level:])
            if matches(inner, patterns) and not any(part.startswith(".") for part in parts[:level]):
                found.setdefault("/".join(parts[:level]), {})[name] = inner
    if not found:
        return {}

    def rank(folder: str) -> tuple[int, int]:
        return len({*found[folder].values()} & {*names}), -len([*filter(None, folder.split("/"))])

    first, *others = sorted(found, key=rank, reverse=True)
    if others and rank(others[0]) == rank(first):
        raise BadSubmission(f"has its files in two folders, {first!a} and {others[0]!a}")
    return found[first]


def matches(name: str, patterns: Iterable[str]) -> bool:
    """Whether a file, by its path inside the submission with `/`, matches a pattern.

    Example:
        >>> names = ["deliverables/a.png", "deliverables/old/a.png", "conftest.py"]
        >>> [matches(name, ["deliverables/*", "*.py"]) for name in names]
        [True, False, False]
    """
    parts = name.split("/")
    return parts[-1].lower() not in NEVER and any(
        len(parts) == len(pattern) and all(map(fnmatch.fnmatchcase, parts, pattern))
        for pattern in (each.split("/") for each in patterns)
    )


@contextmanager
def _open_files(source: Path, depth: int) -> Iterator[dict[str, Opener]]:
    """Names of all files down to `depth`, each with a function that opens it."""
    with ExitStack() as stack:
        with _readable():
            if source.is_dir():
                files = dict(_files_of(source, depth))
            else:
                file = stack.enter_context(_CarefulFile(source))
                files = _entries_of(stack.enter_context(zipfile.ZipFile(file)))
        yield files


def _chunks(opener: Opener) -> Iterator[bytes]:
    with _readable(), opener() as file:
        while chunk := file.read(1 << 16):
            yield chunk


@contextmanager
def _readable() -> Iterator[None]:
    """Blame the submission for errors when it is read, but not for a disk that is full."""
    try:
        yield
    except BadSubmission:
        raise
    except OSError as error:
        if error.errno in OF_THE_MACHINE:
            raise
        raise BadSubmission(f"cannot be read: {error}") from None
    except (*BROKEN, zipfile.BadZipFile, zlib.error) as error:
        raise BadSubmission(f"cannot be read: {error}") from None


class _CarefulFile(io.FileIO):
    """File that reads little at a time, against zips that claim a huge directory."""

    def read(self, size: int = -1, /) -> bytes:
        if size < 0 or size > MAX_DIRECTORY:
            size = MAX_DIRECTORY + 1
        data = super().read(size) or b""
        if len(data) > MAX_DIRECTORY:
            raise BadSubmission(f"has more than {MAX_FILES} files")
        return data


def _entries_of(archive: zipfile.ZipFile) -> dict[str, Opener]:
    """Files of a zip; BadSubmission if any of its entries is suspicious."""
    entries = archive.infolist()
    if len(entries) > MAX_FILES:
        raise BadSubmission(f"has {len(entries)} entries, more than {MAX_FILES}")
    files: dict[str, Opener] = {}
    for entry in entries:
        name = entry.filename.replace("\\", "/")
        shown = ascii(entry.filename[:100])
        path, kind = PurePosixPath(name), stat.S_IFMT(entry.external_attr >> 16)
        if ".." in path.parts or path.is_absolute() or name[1:2] == ":":
            raise BadSubmission(f"holds {shown}, which lies outside of it")
        if not name.isprintable() or len(name.encode()) > MAX_NAME:
            raise BadSubmission(f"holds {shown}, a name with odd characters or too many")
        if kind not in (0, stat.S_IFREG, stat.S_IFDIR):
            raise BadSubmission(f"holds {shown}, which is a link or a device")
        if entry.flag_bits & 1:
            raise BadSubmission(f"holds {shown}, which is encrypted")
        if name.endswith("/") or name.startswith("__MACOSX/"):
            continue
        if str(path) in files:
            raise BadSubmission(f"holds {shown} twice")
        files[str(path)] = lambda entry=entry: archive.open(entry)
    return files


def _files_of(source: Path, depth: int) -> Iterator[tuple[str, Opener]]:
    """Regular files of a folder, without those behind links."""
    for folder, folders, names in os.walk(source):
        inside = Path(folder).relative_to(source)
        if len(inside.parts) + 1 >= depth:
            folders.clear()
        folders[:] = sorted(name for name in folders if not name.startswith("."))
        for name in sorted(names):
            path = Path(folder, name)
            if stat.S_ISREG(path.lstat().st_mode):
                yield (inside / name).as_posix(), lambda path=path: path.open("rb")
