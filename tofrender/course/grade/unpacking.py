"""Extract the files that an assignment asks for from a submission.

A submission is a folder, an archive (zip or tar), or a single file.
"""

import bz2
import errno
import fnmatch
import gzip
import io
import json
import lzma
import os
import re
import stat
import tarfile
import tempfile
import zipfile
import zlib
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import IO

MAX_BYTES = 512 << 20  # largest size of all files together, after unpacking [bytes]
MAX_FILES = 2000
LEVELS = 4  # largest number of folders around the files
MAX_NOTEBOOK = 32 << 20  # part of a notebook that is searched for solutions [bytes]
MAX_NAME = 250  # longest name of a file with its folders [bytes]
MAX_DIRECTORY = 1 << 20  # largest size of an archive's directory [bytes]
MAX_XZ_MEMORY = 128 << 20  # largest memory that the header of an xz file may request [bytes]
ARCHIVES = (".zip", ".tar", ".tar.gz", ".tgz", ".tar.bz2", ".tbz2", ".tar.xz", ".txz")
"""Endings of the archives that can be read."""
LITTER = {"__macosx", "thumbs.db", "desktop.ini"}
"""Files and folders that operating systems leave behind, in lower case."""
# Files that could configure the judge are never copied from any folder of a submission. All other
# names are allowed, also `probes.py`, because the tests' own `probes.py` is in another folder
NEVER = {
    "conftest.py",
    "pytest.ini",
    ".pytest.ini",
    "pyproject.toml",
    "setup.cfg",
    "tox.ini",
    "rubric.toml",
    "results.json",
    "sitecustomize.py",
    "usercustomize.py",
}
BROKEN = (
    EOFError,
    NotImplementedError,
    RuntimeError,
    ValueError,
    lzma.LZMAError,
    tarfile.TarError,
    zipfile.BadZipFile,
    zlib.error,
)
"""Errors of Python's libraries for broken archives."""
OF_THE_MACHINE = {errno.EIO, errno.EMFILE, errno.ENFILE, errno.ENOMEM, errno.ENOSPC, errno.ESTALE}
"""Numbers of operating system errors that a submission cannot cause."""
Opener = Callable[[], IO[bytes]]


class BadSubmission(ValueError):
    """A submission cannot be extracted; the message is one line for the student."""


class Nothing(BadSubmission):
    """A submission contains none of the requested files."""


def extract(
    source: Path,
    patterns: Sequence[str],
    target: Path,
    names: Sequence[str] = (),
    notes: list[str] | None = None,
) -> list[str]:
    """Copy matching files of a submission into a new folder.

    The files may be up to four folders deep, or in the only archive of a folder. If several folders
    contain matching files, the folder with most of `names` is used. Links in a folder are ignored.
    A file whose name differs from one of `names` only in capitals gets this name. If none of the
    files has one of `names`, they are taken from the cells `%%solution NAME` of a notebook.

    Args:
        source: The submission: a folder, an archive, or a single file.
        patterns: Patterns of the files to copy.
        target: The new folder.
        names: Names of the files that the problems ask for.
        notes: List to which a sentence is added for each file that was found in an unusual place.

    Returns:
        Sorted names of the copied files.

    Raises:
        BadSubmission: There are too many files, the files are too large, or an archive is broken
            or dangerous.
    """
    notes = [] if notes is None else notes
    copied = _copy(source, patterns, target, names, notes)
    if names and not set(names).intersection(copied):
        for notebook in (name for name in copied if name.endswith(".ipynb")):
            written = _from_notebook(target / notebook, names)
            copied = sorted({*copied, *written})
            if written:
                notes.append(f"{', '.join(written)}: taken from the cells of {notebook}")
    return copied


def _from_notebook(notebook: Path, names: Sequence[str]) -> list[str]:
    """Write the cells `%%solution NAME` of a notebook to files next to it, and return their names.

    The result is empty if the file is not a notebook.
    """
    try:
        with notebook.open("rb") as file:
            cells = json.loads(file.read(MAX_NOTEBOOK))["cells"]
        texts = ["".join(cell["source"]) for cell in cells if cell["cell_type"] == "code"]
    except (ValueError, KeyError, TypeError, RecursionError):
        return []
    written = {}
    for text in texts:
        first, _, rest = text.partition("\n")
        words = first.split()
        if len(words) == 2 and words[0] == "%%solution" and words[1] in names:
            written[words[1]] = rest
    for name, text in written.items():
        (notebook.parent / name).write_text(text, encoding="utf-8", errors="replace")
    return sorted(written)


def _copy(
    source: Path, patterns: Sequence[str], target: Path, names: Sequence[str], notes: list[str]
) -> list[str]:
    """Copy matching files of a submission, see `extract`."""
    if source.is_file() and not is_archive(source):
        return _extract_single(source, patterns, target, names)

    # List the files, and choose the matching files of one folder
    depth = LEVELS + max(len(pattern.split("/")) for pattern in patterns)
    with _open_files(source, depth) as files:
        chosen = _chosen(files, patterns, names)
        if not chosen:
            archives = [name for name in files if is_archive(Path(name))]
            if source.is_dir() and len(archives) == 1:
                return _copy(source / archives[0], patterns, target, names, notes)
            shown = ", ".join(sorted(files)[:3]) + ", ..." * (len(files) > 3)
            wanted = ", ".join(names or patterns)
            raise Nothing(f"contains none of {wanted}; contains {shown or 'no files'}")

        # Check number and names
        if len(chosen) > MAX_FILES:
            raise BadSubmission(f"contains {len(chosen)} files, more than {MAX_FILES}")
        folders = {str(up) for name in chosen.values() for up in PurePosixPath(name).parents}
        for name in folders.intersection(chosen.values()):
            raise BadSubmission(f"contains {name!a} as a file and as a folder")

        # Note unusual names and deep folders
        deepest = 0
        for name, new in chosen.items():
            if not name.endswith(new):
                notes.append(f"{name.rpartition('/')[2]!a} was graded as {new}")
            deepest = max(deepest, name.count("/") - new.count("/"))
        if deepest > 1:
            notes.append(f"the files were found in a folder that is {deepest} levels deep")

        # Copy the files, and measure their real size
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


def _extract_single(
    source: Path, patterns: Sequence[str], target: Path, names: Sequence[str]
) -> list[str]:
    """Copy a submission that is one file, under the name that the assignment asks for."""
    name = asked_name(source.name, patterns, names)
    if name is None:
        wanted = ", ".join(names or patterns)
        raise Nothing(f"is one file; its name must end in one of {wanted}")
    with _readable():
        size = source.stat().st_size
    if size > MAX_BYTES:
        raise BadSubmission(f"has more than {MAX_BYTES >> 20} MiB")
    target.mkdir(parents=True)
    with (target / name).open("xb") as outgoing:
        for chunk in _chunks(lambda: source.open("rb")):
            outgoing.write(chunk)
    return [name]


def asked_name(name: str, patterns: Sequence[str], names: Sequence[str]) -> str | None:
    """Find the file of an assignment that a single submitted file replaces.

    Learning management systems put the student's name in front (`ada_12_tent.py`), and number a
    repeated upload (`ada_12_tent-1.py`). If the assignment asks for one file of this type only,
    the file may have any name.

    Args:
        name: Name of the single file.
        patterns: Patterns of all files that may be handed in.
        names: Names of the files that the problems ask for.

    Returns:
        Name of the assignment's file, None if the name does not identify it.

    Example:
        >>> files = (["*.py", "notebook.ipynb"], ["tent.py", "disk.py"])
        >>> [asked_name(name, *files) for name in ("ada_12_tent-1.py", "x.py", "ada.ipynb")]
        ['tent.py', None, 'notebook.ipynb']
    """
    # Collect the names that are asked for; patterns without wildcards are names, too
    whole = [pattern for pattern in patterns if not set("*?[/") & set(pattern)]
    asked = list(dict.fromkeys([*names, *whole]))

    # Compare with the end of the name
    stem, suffix = os.path.splitext(name)
    first_upload = re.sub(r"-\d+$", "", stem) + suffix
    for candidate in (name, first_upload):
        found = [each for each in asked if re.search(rf"(^|[\s_.-]){re.escape(each)}$", candidate)]
        if found:
            return max(found, key=len)

    # Is there only one file of this type?
    same_type = [each for each in asked if each.endswith(suffix)]
    if suffix and len(same_type) == 1:
        return same_type[0]
    return None


def is_archive(path: Path) -> bool:
    """Return whether a file is an archive that can be read, by the ending of its name."""
    return path.name.lower().endswith(ARCHIVES)


def stem_of(path: Path) -> str:
    """Return the name of a submission without the ending of an archive or of a single file."""
    name = path.name
    for ending in (*ARCHIVES, ".py", ".ipynb"):
        if name.lower().endswith(ending):
            return name[: -len(ending)]
    return name


def _chosen(files: Iterable[str], patterns: Sequence[str], names: Sequence[str]) -> dict[str, str]:
    """Choose the folder with the requested files.

    Returns:
        Names relative to this folder, by the names in the submission. Empty if no file matches.

    Raises:
        BadSubmission: Two folders match equally well.
    """
    # Group the matching files by folder. A file with the exact name comes before one in capitals
    found: dict[str, dict[str, str]] = {}
    exact = {name.lower(): name for name in names}
    files = list(files)
    present = set(files)
    for name in files:
        parts = name.split("/")
        for level in range(min(LEVELS + 1, len(parts))):
            inner = "/".join(parts[level:])
            asked = exact.get(inner.lower(), inner)
            inner_exact = "/".join([*parts[:level], asked])
            if asked != inner and inner_exact not in present:
                present.add(inner_exact)
                inner = asked
            if matches(inner, patterns) and not any(part.startswith(".") for part in parts[:level]):
                found.setdefault("/".join(parts[:level]), {})[name] = inner
    if not found:
        return {}

    # Prefer the folder with most of the requested names, then the folder with the shortest path
    def rank(folder: str) -> tuple[int, int]:
        """Return a key for sorting folders."""
        return len({*found[folder].values()} & {*names}), -len([*filter(None, folder.split("/"))])

    first, *others = sorted(found, key=rank, reverse=True)
    if others and rank(others[0]) == rank(first):
        raise BadSubmission(f"contains the files in two folders, {first!a} and {others[0]!a}")
    return found[first]


def matches(name: str, patterns: Iterable[str]) -> bool:
    """Return whether a file matches a pattern. Files that could configure the judge never match.

    Args:
        name: Path of the file inside the submission, with `/`.
        patterns: Patterns; `*` does not match `/`.

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
    """Return the names of all files of a submission, each with a function that opens the file.

    Args:
        source: A folder or an archive.
        depth: Number of levels of a folder that are listed.
    """
    with ExitStack() as stack:
        with _readable():
            if source.is_dir():
                files = dict(_files_of(source, depth))
            else:
                entries = stack.enter_context(_open_archive(source))
                files = _checked(entries)
        yield files


def _chunks(opener: Opener) -> Iterator[bytes]:
    """Yield the content of a file in chunks."""
    with _readable(), opener() as file:
        while chunk := file.read(1 << 16):
            yield chunk


@contextmanager
def _readable() -> Iterator[None]:
    """Convert errors of reading to `BadSubmission`, except errors of the machine."""
    try:
        yield
    except BadSubmission:
        raise
    except OSError as error:
        if error.errno in OF_THE_MACHINE:
            raise
        raise BadSubmission(f"cannot be read: {error}") from None
    except BROKEN as error:
        raise BadSubmission(f"cannot be read: {error}") from None


class _CarefulFile(io.FileIO):
    """File that refuses large reads, because an archive can claim to have a huge directory."""

    def read(self, size: int = -1, /) -> bytes:
        """Read at most `MAX_DIRECTORY` bytes; raise BadSubmission for more."""
        if size < 0 or size > MAX_DIRECTORY:
            size = MAX_DIRECTORY + 1
        data = super().read(size) or b""
        if len(data) > MAX_DIRECTORY:
            raise BadSubmission(f"contains more than {MAX_FILES} files")
        return data


@dataclass(frozen=True)
class _Entry:
    """Entry of an archive."""

    name: str  # name in the archive
    is_folder: bool
    fault: str  # why the entry cannot be used, "" if it can
    open: Opener  # opens the content


@contextmanager
def _open_archive(source: Path) -> Iterator[list[_Entry]]:
    """Open a zip or tar archive, and list its entries."""
    with ExitStack() as stack:
        if source.name.lower().endswith(".zip"):
            file = stack.enter_context(_CarefulFile(source))
            archive = stack.enter_context(zipfile.ZipFile(file))
            yield [_zip_entry(archive, info) for info in archive.infolist()]
        else:
            scratch = stack.enter_context(tempfile.TemporaryDirectory())
            plain = Path(scratch, "plain.tar")
            _decompress(source, plain)
            file = stack.enter_context(_CarefulFile(plain))
            tar = stack.enter_context(tarfile.open(fileobj=file, mode="r:"))
            yield [_tar_entry(tar, info) for info in _few(tar)]


def _zip_entry(archive: zipfile.ZipFile, info: zipfile.ZipInfo) -> _Entry:
    """Describe an entry of a zip archive in the common form for zip and tar.

    Links, devices and encrypted entries get a `fault`, which is the reason why the entry is
    refused.
    """
    kind = stat.S_IFMT(info.external_attr >> 16)
    fault = ""
    if kind not in (0, stat.S_IFREG, stat.S_IFDIR):
        fault = "which is a link or a device"
    elif info.flag_bits & 1:
        fault = "which is encrypted"
    is_folder = info.filename.replace("\\", "/").endswith("/")
    return _Entry(
        name=info.filename, is_folder=is_folder, fault=fault, open=lambda: archive.open(info)
    )


def _tar_entry(archive: tarfile.TarFile, info: tarfile.TarInfo) -> _Entry:
    """Describe an entry of a tar archive."""

    def open_entry() -> IO[bytes]:
        file = archive.extractfile(info)
        assert file is not None, "only regular files are opened"
        return file

    fault = ""
    if not info.isfile() and not info.isdir():
        fault = "which is a link or a device"
    elif info.issparse():
        fault = "which is a sparse file"
    return _Entry(name=info.name, is_folder=info.isdir(), fault=fault, open=open_entry)


def _few(archive: tarfile.TarFile) -> Iterator[tarfile.TarInfo]:
    """Yield the members of a tar archive. Raise an error for one with too many."""
    for number, info in enumerate(archive):
        if number >= MAX_FILES:
            raise BadSubmission(f"contains more than {MAX_FILES} entries")
        yield info


def _decompress(source: Path, target: Path) -> None:
    """Write a tar file without compression. Raise an error for a file that expands to too much."""
    limit = MAX_BYTES + MAX_FILES * 2 * tarfile.BLOCKSIZE
    written = 0
    with source.open("rb") as file, target.open("xb") as outgoing:
        start = file.read(6)
        file.seek(0)
        for chunk in _decompressed(file, start):
            written += len(chunk)
            if written > limit:
                raise BadSubmission(f"unpacks to more than {MAX_BYTES >> 20} MiB")
            outgoing.write(chunk)


def _decompressed(file: IO[bytes], start: bytes) -> Iterator[bytes]:
    """Yield the content of a file that may be compressed by gzip, bzip2 or xz."""
    if start.startswith(b"\xfd7zXZ"):
        yield from _decompressed_xz(file)
        return
    reader: IO[bytes] | gzip.GzipFile | bz2.BZ2File = file
    if start.startswith(b"\x1f\x8b"):
        reader = gzip.GzipFile(fileobj=file)
    elif start.startswith(b"BZh"):
        reader = bz2.BZ2File(file)
    while chunk := reader.read(1 << 16):
        yield chunk


def _decompressed_xz(file: IO[bytes]) -> Iterator[bytes]:
    """Yield the content of an xz file, with a limit for the memory that its header requests."""
    decompressor = lzma.LZMADecompressor(memlimit=MAX_XZ_MEMORY)
    while not decompressor.eof:
        data = file.read(1 << 16) if decompressor.needs_input else b""
        if decompressor.needs_input and not data:
            raise EOFError("the xz file ends too early")
        yield decompressor.decompress(data, max_length=1 << 16)


def _checked(entries: Sequence[_Entry]) -> dict[str, Opener]:
    """Return the files of an archive by name; raise BadSubmission for a suspicious entry."""
    if len(entries) > MAX_FILES:
        raise BadSubmission(f"contains {len(entries)} entries, more than {MAX_FILES}")
    files: dict[str, Opener] = {}
    for entry in entries:
        # Refuse dangerous names and entries
        name = entry.name.replace("\\", "/")
        shown = ascii(entry.name[:100])
        path = PurePosixPath(name)
        if ".." in path.parts or path.is_absolute() or name[1:2] == ":":
            raise BadSubmission(f"contains {shown}, a path outside the archive")
        if not name.isprintable() or len(name.encode()) > MAX_NAME:
            text = "a name with unprintable characters, or a name that is too long"
            raise BadSubmission(f"contains {shown}, {text}")
        if entry.fault:
            raise BadSubmission(f"contains {shown}, {entry.fault}")

        # Skip folders, and files of macOS
        if entry.is_folder or name.startswith("__MACOSX/") or path.name.startswith("._"):
            continue
        if str(path) in files:
            raise BadSubmission(f"contains {shown} twice")
        files[str(path)] = entry.open
    return files


def _files_of(source: Path, depth: int) -> Iterator[tuple[str, Opener]]:
    """Yield the regular files of a folder down to `depth`. Links are ignored."""
    for folder, folders, names in os.walk(source):
        # Descend into visible folders only
        inside = Path(folder).relative_to(source)
        if len(inside.parts) + 1 >= depth:
            folders.clear()
        folders[:] = sorted(name for name in folders if not name.startswith("."))
        for name in sorted(names):
            path = Path(folder, name)
            if stat.S_ISREG(path.lstat().st_mode):
                yield (inside / name).as_posix(), lambda path=path: path.open("rb")
