"""Key files: only their owner reads them, and what is broken is one clear line that shows no key."""

import stat
from pathlib import Path

import pytest

from swarmchase.errors import InputError
from swarmchase.live.link.keys import new_keys, read_keys, write_keys


def test_key_files(tmp_path: Path) -> None:
    keys = new_keys()
    assert sorted(keys) == list(range(6))
    assert {len(key) for key in keys.values()} == {32}
    assert len(set(keys.values()) | set(new_keys().values())) == 12
    path = tmp_path / "keys"
    write_keys(path, keys)
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    assert read_keys(path) == keys
    with pytest.raises(InputError, match="exists already"):
        write_keys(path, keys)
    with pytest.raises(InputError, match="cannot write key file"):
        write_keys(tmp_path / "missing" / "keys", keys)
    assert [entry.name for entry in tmp_path.iterdir()] == ["keys"], "nothing is left behind"
    one = tmp_path / "one"
    write_keys(one, {3: keys[3]})
    assert read_keys(one) == {3: keys[3]}
    for mode in (0o640, 0o604, 0o620, 0o644, 0o666):
        path.chmod(mode)
        with pytest.raises(InputError, match=f"is open to others \\(mode {mode:04o}\\): run chmod 600"):
            read_keys(path)
    with pytest.raises(InputError, match="No such file"):
        read_keys(tmp_path / "none")
    with pytest.raises(InputError, match="key file"):
        read_keys(tmp_path)


HEX = "0123456789abcdef" * 4


@pytest.mark.parametrize(
    ("text", "what"),
    [
        ("", "there is no key"),
        ("# only a comment\n\n", "there is no key"),
        (f"0 {HEX[:-2]}\n", "31 bytes: needed are 32"),
        (f"0 {HEX}00\n", "33 bytes"),
        (f"0 {HEX[:-1]}\n", "line 1: expected is"),
        (f"# title\nx {HEX}\n", "line 2: expected is"),
        (f"{HEX}\n", "line 1: expected is"),
        ("0\n", "line 1: expected is"),
        (f"0 {HEX} {HEX}\n", "line 1: more than"),
        (f"0 {HEX}\n0 {HEX[::-1]}\n", "line 2: more than"),
        (f"0 {HEX}\n1 {HEX}\n", "two trackers have the same key"),
        (f"6 {HEX}\n", "tracker 6 is refused"),
        (f"-1 {HEX}\n", "tracker -1 is refused"),
        ("0 " + "ä" * 64 + "\n", "line 1: expected is"),
        ("#" * 70_000, "longer than"),
    ],
)
def test_broken_key_files_are_one_clear_line_without_the_key(tmp_path: Path, text: str, what: str) -> None:
    path = tmp_path / "keys"
    path.write_text(text, encoding="utf-8")
    path.chmod(0o600)
    with pytest.raises(InputError, match=what) as caught:
        read_keys(path)
    message = str(caught.value)
    assert str(path) in message
    assert "\n" not in message
    assert HEX[:16] not in message
