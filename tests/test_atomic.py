"""Atomic writing: the whole new file or the untouched old one, and never a temporary file left behind."""

from __future__ import annotations

import errno
import os
import stat
from pathlib import Path

import pytest

from cubicsplat_cli.errors import InputError
from cubicsplat_cli.files.write import check_writable, write_atomically

both = pytest.mark.parametrize("act", [lambda path: write_atomically(path, b"new"), check_writable])
posix = pytest.mark.skipif(os.name != "posix", reason="POSIX permissions and links")


def refuse(act, path: Path, *words: str) -> None:
    with pytest.raises(InputError) as caught:
        act(path)
    message = str(caught.value)
    assert "\n" not in message
    assert path.name in message
    for word in (*words, ";"):
        assert word in message


@pytest.mark.parametrize("old", [[], [b"old and longer"]], ids=["a new file", "an old file"])
def test_writes_a_new_file_and_replaces_an_old_one(old, tmp_path):
    path = tmp_path / "out.svg"
    for data in old:
        path.write_bytes(data)
    check_writable(path)
    assert [each.read_bytes() for each in tmp_path.iterdir()] == old, "checking leaves nothing behind"
    write_atomically(path, b"new")
    assert path.read_bytes() == b"new"
    assert list(tmp_path.iterdir()) == [path]


def test_writes_through_a_relative_path_without_a_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_atomically(Path("plain.json"), b"{}")
    assert (tmp_path / "plain.json").read_bytes() == b"{}"


def test_long_and_odd_names(tmp_path):
    for name in ("a" * 250 + ".svg", "line\nbreak.svg", "übung é 線.svg"):
        write_atomically(tmp_path / name, b"x")
        assert (tmp_path / name).read_bytes() == b"x"
    assert len(list(tmp_path.iterdir())) == 3


@posix
def test_permissions_follow_the_umask_or_the_old_file(tmp_path):
    path = tmp_path / "out.svg"
    before = os.umask(0o027)
    try:
        write_atomically(path, b"x")
    finally:
        os.umask(before)
    assert stat.S_IMODE(path.stat().st_mode) == 0o640
    path.chmod(0o604)
    write_atomically(path, b"y")
    assert stat.S_IMODE(path.stat().st_mode) == 0o604


@posix
def test_a_link_stays_a_link(tmp_path):
    (tmp_path / "real").mkdir()
    target, link = tmp_path / "real" / "target.svg", tmp_path / "link.svg"
    target.write_bytes(b"old")
    link.symlink_to(target)
    write_atomically(link, b"new")
    assert link.is_symlink()
    assert target.read_bytes() == b"new"


@both
def test_missing_folder(tmp_path, act):
    refuse(act, tmp_path / "nowhere" / "out.svg", "nowhere", "does not exist")


@both
def test_folder_as_output(tmp_path, act):
    refuse(act, tmp_path, "is a folder")


@both
def test_file_in_place_of_the_folder(tmp_path, act):
    (tmp_path / "file").write_bytes(b"x")
    refuse(act, tmp_path / "file" / "out.svg", "not a folder")


@both
@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no FIFOs on this system")
@pytest.mark.timeout(100)
def test_fifo_as_output(tmp_path, act):
    path = tmp_path / "pipe.svg"
    os.mkfifo(path)
    refuse(act, path, "pipe")


@both
@posix
def test_a_loop_of_links(tmp_path, act):
    path = tmp_path / "loop.svg"
    path.symlink_to(path)
    refuse(act, path)


@both
def test_null_byte(act):
    with pytest.raises(InputError, match="null"):
        act(Path("a\0b.svg"))


@both
@posix
def test_name_too_long(tmp_path, act):
    refuse(act, tmp_path / ("a" * 300), "too long")


@both
def test_read_only_folder(tmp_path, act, monkeypatch):
    path = tmp_path / "out.svg"
    fail_open(monkeypatch, errno.EACCES)  # also for root, whom permission bits do not stop
    refuse(act, path, "no permission")


@both
def test_read_only_file_system(tmp_path, act, monkeypatch):
    fail_open(monkeypatch, errno.EROFS)
    refuse(act, tmp_path / "out.svg", os.strerror(errno.EROFS))


@both
def test_write_protected_file(tmp_path, act, monkeypatch):
    path = tmp_path / "out.svg"
    path.write_bytes(b"old")
    path.chmod(0o444)
    if os.access(path, os.W_OK):  # root
        monkeypatch.setattr(os, "access", lambda *args: False)
    refuse(act, path, "write-protected")
    assert path.read_bytes() == b"old"


def fail_open(monkeypatch, code: int) -> None:
    real = os.open

    def fake(path, flags, *args, **kwargs):
        if flags & os.O_CREAT:
            raise OSError(code, os.strerror(code), str(path))
        return real(path, flags, *args, **kwargs)

    monkeypatch.setattr(os, "open", fake)


@pytest.mark.parametrize("call", ["fsync", "replace"])
@pytest.mark.parametrize(
    ("error", "raised"),
    [(OSError(errno.ENOSPC, "No space left"), InputError), (KeyboardInterrupt(), KeyboardInterrupt)],
)
def test_failure_leaves_the_old_file_and_no_temporary(tmp_path, monkeypatch, call, error, raised):
    path = tmp_path / "out.svg"
    path.write_bytes(b"old")

    def fail(*args):
        assert len(list(tmp_path.iterdir())) == 2, "the temporary file is there when the failure happens"
        raise error

    monkeypatch.setattr(os if call == "fsync" else Path, call, fail)
    with pytest.raises(raised) as caught:
        write_atomically(path, b"new")
    monkeypatch.undo()
    assert path.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [path]
    if raised is InputError:
        assert "free some space" in str(caught.value)


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full on this system")
def test_a_device_is_no_output():
    refuse(lambda path: write_atomically(path, b"x"), Path("/dev/full"), "device")


def test_the_temporary_file_is_in_the_same_folder(tmp_path, monkeypatch):
    seen = []
    real = Path.replace

    def spy(self, target):
        seen.append((self, target))
        return real(self, target)

    monkeypatch.setattr(Path, "replace", spy)
    write_atomically(tmp_path / "out.svg", b"x")
    ((temporary, target),) = seen
    assert temporary.parent == target.parent
    assert temporary != target


@pytest.mark.skipif(os.name != "posix", reason="locks of POSIX")
def test_temporary_files_of_the_dead_are_removed_and_those_of_the_living_stay(tmp_path):
    import fcntl

    path = tmp_path / "out.svg"
    dead, living = (tmp_path / f".out.svg.{digit * 12}.tmp" for digit in "ab")
    others = [tmp_path / name for name in (".other.svg.aaaaaaaaaaaa.tmp", ".out.svg.tmp", ".out.svg.aaaaaaaaaaaX.tmp")]
    for temporary in (dead, living, *others):
        temporary.write_bytes(b"half")
    with living.open("rb+") as writer:
        fcntl.flock(writer, fcntl.LOCK_EX)
        write_atomically(path, b"whole")
    assert sorted(tmp_path.iterdir()) == sorted([path, living, *others])


@pytest.mark.skipif(os.name != "posix", reason="locks of POSIX")
def test_a_temporary_file_that_was_taken_for_a_dead_ones_is_made_again(tmp_path, monkeypatch):
    from cubicsplat_cli.files import write

    real, removed = write._lock, []

    def lock_after_a_cleaner(descriptor: int) -> bool:
        if not removed:
            removed.extend(tmp_path.glob(".*.tmp"))
            removed[0].unlink()
        return real(descriptor)

    monkeypatch.setattr(write, "_lock", lock_after_a_cleaner)
    write_atomically(tmp_path / "out.svg", b"whole")
    assert removed
    assert (tmp_path / "out.svg").read_bytes() == b"whole"
    assert list(tmp_path.iterdir()) == [tmp_path / "out.svg"]
