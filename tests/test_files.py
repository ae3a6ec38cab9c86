"""Files are there whole or not at all, whatever goes wrong while they are written."""

import errno
import os
import resource
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import NoReturn

import pytest

from swarmchase.errors import InputError
from swarmchase.files import (
    atomic_path,
    new_file,
    require_writable_file,
    require_writable_folder,
    write_text_atomically,
)
from swarmchase.locks import LockFile


def refuse(number: int) -> Callable[..., NoReturn]:
    def raise_error(*_arguments: object, **_options: object) -> NoReturn:
        raise OSError(number, os.strerror(number))

    return raise_error


def test_text_arrives_with_its_folders_and_can_be_read_by_others(tmp_path: Path) -> None:
    path = tmp_path / "a" / "b" / "note.txt"
    write_text_atomically(path, "ρ = 0.9\n")
    write_text_atomically(path, "ρ = 0.5\n")
    assert path.read_bytes() == "ρ = 0.5\n".encode()
    assert path.stat().st_mode & 0o777 == 0o644
    assert list(path.parent.iterdir()) == [path]


@pytest.mark.parametrize(
    ("call", "number"),
    [
        ("os.fsync", errno.ENOSPC),  # delayed allocation: the disk is full when it is asked to be sure
        ("os.fsync", errno.EIO),
        ("pathlib.Path.write_text", errno.ENOSPC),
        ("pathlib.Path.replace", errno.EACCES),
    ],
)
def test_a_failed_write_keeps_the_old_file_and_leaves_nothing_new(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, call: str, number: int
) -> None:
    kept = tmp_path / "kept.txt"
    kept.write_text("old")
    monkeypatch.setattr(call, refuse(number))
    for path in (kept, tmp_path / "new.txt"):
        with pytest.raises(InputError, match=rf"^cannot write {path}: {os.strerror(number)}$"):
            write_text_atomically(path, "new")
    assert list(tmp_path.iterdir()) == [kept]
    assert kept.read_text() == "old"


@pytest.mark.parametrize("error", [KeyboardInterrupt, RuntimeError])
def test_an_interrupted_write_leaves_nothing(tmp_path: Path, error: type[BaseException]) -> None:
    def interrupted() -> None:
        with atomic_path(tmp_path / "new.bin") as temporary:
            temporary.write_bytes(b"half")
            assert not (tmp_path / "new.bin").exists()
            raise error

    with pytest.raises(error):
        interrupted()
    assert list(tmp_path.iterdir()) == []


def test_a_real_limit_on_file_size_is_one_refusal(tmp_path: Path) -> None:
    """The operating system itself refuses the write (EFBIG), as it does on a full disk."""
    program = (
        "import sys\n"
        "from pathlib import Path\n"
        "from swarmchase.errors import InputError\n"
        "from swarmchase.files import write_text_atomically\n"
        "try:\n"
        "    write_text_atomically(Path(sys.argv[1]), 'x' * 100_000)\n"
        "except InputError as error:\n"
        "    print(error)\n"
    )
    path = tmp_path / "large.txt"
    ran = subprocess.run(
        [sys.executable, "-c", program, str(path)],
        capture_output=True,
        text=True,
        check=True,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (4096, 4096)),
    )
    assert ran.stdout == f"cannot write {path}: {os.strerror(errno.EFBIG)}\n"
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    "writable",
    [
        lambda path: require_writable_file(path, replaces=True),
        lambda path: new_file(path, "log"),
        lambda path: write_text_atomically(path, "text"),
    ],
)
@pytest.mark.parametrize(
    "place", ["file.txt/below.txt", "file.txt/folder/below.txt", "/proc/none.txt", "folder", "/dev/null"]
)
def test_places_that_cannot_be_written_are_refused(
    tmp_path: Path, writable: Callable[[Path], None], place: str
) -> None:
    (tmp_path / "file.txt").write_text("a file")
    (tmp_path / "folder").mkdir()
    with pytest.raises(InputError, match="cannot write "):
        writable(tmp_path / place)
    assert sorted(path.name for path in tmp_path.rglob("*")) == ["file.txt", "folder"]
    assert Path("/dev/null").is_char_device()


def test_asking_whether_a_file_can_be_written_makes_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "old.txt").write_text("old")
    require_writable_file(tmp_path / "new" / "folder" / "new.txt", replaces=False)
    require_writable_file(tmp_path / "old.txt", replaces=True)
    with pytest.raises(InputError, match=r"old\.txt: it exists already; give --overwrite to replace it"):
        require_writable_file(tmp_path / "old.txt", replaces=False)
    monkeypatch.chdir(tmp_path)
    require_writable_file(Path("relative.txt"), replaces=False)
    assert [path.name for path in tmp_path.iterdir()] == ["old.txt"]
    assert (tmp_path / "old.txt").read_text() == "old"
    monkeypatch.setattr("tempfile.TemporaryFile", refuse(errno.ENOSPC))
    with pytest.raises(InputError, match=os.strerror(errno.ENOSPC)):
        require_writable_file(tmp_path / "new.txt", replaces=False)


def test_a_writable_folder_is_made_and_left_empty(tmp_path: Path) -> None:
    require_writable_folder(tmp_path / "a" / "b")
    assert list((tmp_path / "a" / "b").iterdir()) == []
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="cannot write to folder"):
        require_writable_folder(tmp_path / "file" / "b")


def test_what_a_killed_writer_left_is_swept_and_what_a_live_one_holds_is_not(tmp_path: Path) -> None:
    """Two processes in the middle of a write, one of which is killed; both parts are old."""
    program = (
        "import sys\n"
        "from pathlib import Path\n"
        "from swarmchase.files import atomic_path\n"
        "with atomic_path(Path(sys.argv[1])) as temporary:\n"
        "    temporary.write_bytes(b'half')\n"
        "    print(temporary, flush=True)\n"
        "    sys.stdin.read()\n"
    )
    writers, parts = [], []
    for name in ("killed.bin", "live.bin"):
        writer = subprocess.Popen(
            [sys.executable, "-c", program, str(tmp_path / name)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        assert writer.stdout is not None
        writers.append(writer)
        parts.append(Path(writer.stdout.readline().strip()))
    killed, live = writers
    killed.kill()
    killed.communicate()
    young, others = tmp_path / ".young.bin.abc.swarmchase.part", tmp_path / ".download.part"
    young.touch()
    others.touch()
    for part in (*parts, others):
        os.utime(part, (0, 0))
    write_text_atomically(tmp_path / "other.txt", "text")
    assert not parts[0].exists()
    assert parts[1].read_bytes() == b"half"
    live.communicate("")
    assert {path.name for path in tmp_path.iterdir()} == {young.name, others.name, "live.bin", "other.txt"}
    assert (tmp_path / "live.bin").read_bytes() == b"half"


def test_a_part_that_cannot_be_removed_does_not_stop_a_write(tmp_path: Path) -> None:
    folder, pipe, link = (tmp_path / f".{name}.swarmchase.part" for name in ("folder", "pipe", "link"))
    folder.mkdir()
    os.mkfifo(pipe)
    link.symlink_to("/dev/zero")
    for part in (folder, pipe, link):
        os.utime(part, (0, 0), follow_symlinks=False)
    write_text_atomically(tmp_path / "it.txt", "text")
    assert (tmp_path / "it.txt").read_text() == "text"
    assert folder.is_dir()
    assert link.is_symlink()


def test_a_lock_is_one_process_and_goes_with_it(tmp_path: Path) -> None:
    path = tmp_path / "it.lock"
    program = (
        "import sys\n"
        "from pathlib import Path\n"
        "from swarmchase.locks import LockFile\n"
        "lock = LockFile(Path(sys.argv[1]), 'in use')\n"
        "print('held', flush=True)\n"
        "sys.stdin.read()\n"
    )
    with subprocess.Popen(
        [sys.executable, "-c", program, str(path)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as holder:
        assert holder.stdout is not None
        assert holder.stdout.readline() == "held\n"
        inode = path.stat().st_ino
        with pytest.raises(InputError, match=r"^in use$"):
            LockFile(path, "in use")
        holder.kill()
    lock = LockFile(path, "in use")
    with pytest.raises(InputError, match=r"^in use$"):
        LockFile(path, "in use")
    lock.close()
    LockFile(path, "in use").close()
    assert path.stat().st_ino == inode
    with pytest.raises(InputError, match="cannot write"):
        LockFile(tmp_path / "none" / "it.lock", "in use")
