from __future__ import annotations

import logging
import re
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from hashlib import sha256
from pathlib import Path

import pytest
from typer.testing import CliRunner, Result

from boxlift.errors import OptionsError
from boxlift_client.cli.keys import keys as keys_command
from boxlift_service.guards.api_keys import (
    MAX_FILE_BYTES,
    ApiKey,
    ApiKeys,
    add_key,
    new_key,
    parse_keys,
    read_keys,
    revoke_key,
)

HASH = "ab" * 32


def written(path: Path, *keys: ApiKey) -> Path:
    """A file of keys, replaced in one step."""
    new = path.with_suffix(".new")
    new.write_text("".join(f"{key.line}\n" for key in keys))
    return new.replace(path)


def knows(keys: ApiKeys, secret: str) -> bool:
    return keys.find(secret.encode()) is not None


def test_lines_are_names_hashes_and_rates() -> None:
    text = f"\ufeff# ours\n\nstudio {HASH}\n batch-7\t{'CD' * 32}  90 # night\r\nfree {'e' * 64} 0"
    assert parse_keys(text.removeprefix("\ufeff"), "keys") == (
        ApiKey("studio", bytes.fromhex(HASH)),
        ApiKey("batch-7", b"\xcd" * 32, 90),
        ApiKey("free", bytes.fromhex("e" * 64), 0),
    )
    assert parse_keys("# nobody", "keys") == ()


@pytest.mark.parametrize(
    ("line", "problem"),
    [
        ("studio", "1 words"),
        (f"studio {HASH} 5 6", "4 words"),
        (f"stu/dio {HASH}", "the name"),
        (f"{'n' * 65} {HASH}", "the name"),
        (f"studio {HASH[1:]}", "64 hexadecimal digits"),
        (f"studio {'g' * 64}", "64 hexadecimal digits"),
        ("studio boxlift_c2VjcmV0", "the key itself"),
        (f"studio {HASH} -1", "requests per minute"),
        (f"studio {HASH} 1.5", "requests per minute"),
        (f"studio {HASH} 1000000", "requests per minute"),
        (f"first {HASH}", "the name 'first' is taken"),
        (f"second {'0' * 64}", "the same key"),
    ],
)
def test_an_unusable_line_is_named_and_not_shown(line: str, problem: str, tmp_path: Path) -> None:
    path = tmp_path / "keys"
    path.write_text(f"# keys\nfirst {'0' * 64}\n{line}\n")
    with pytest.raises(OptionsError) as caught:
        ApiKeys(path)
    assert caught.value.field == f"{path}:3"
    assert problem in caught.value.problem
    for word in line.split()[1:]:
        assert len(word) < 8 or word not in str(caught.value)


@pytest.mark.parametrize(
    ("content", "problem"),
    [
        (None, "No such file"),
        (b"", "has no key"),
        (b"# nobody yet\n", "has no key"),
        (b"\xff\xfe", "no UTF-8"),
        (b"#" * (MAX_FILE_BYTES + 1), "bytes"),
    ],
)
def test_an_unusable_file_stops_the_start(content: bytes | None, problem: str, tmp_path: Path) -> None:
    path = tmp_path / "keys"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(OptionsError) as caught:
        ApiKeys(path)
    assert caught.value.field == str(path)
    assert problem in caught.value.problem


def test_only_the_hash_is_kept() -> None:
    secret, key = new_key("studio", 90)
    assert re.fullmatch(r"boxlift_[A-Za-z0-9_-]{43}", secret)
    assert key.line == f"studio {sha256(secret.encode()).hexdigest()} 90"
    assert new_key("studio")[0] != secret
    for name in ("", "a b", "x#", "ä", "n" * 65):
        with pytest.raises(OptionsError):
            new_key(name)


def test_every_key_of_the_file_is_found_and_no_other(tmp_path: Path) -> None:
    made = [new_key(f"key-{index}", index) for index in range(5)]
    keys = ApiKeys(written(tmp_path / "keys", *(key for _, key in made)))
    for secret, key in made:
        assert keys.find(secret.encode()) == key
        for other in (secret[:-1], f"{secret}=", secret.lower(), key.digest.hex(), key.name, ""):
            assert not knows(keys, other)
        assert keys.find(key.digest) is None


def test_keys_rotate_while_they_are_in_use(tmp_path: Path) -> None:
    (old_secret, old), (new_secret, new) = new_key("old"), new_key("new")
    path = written(tmp_path / "keys", old)
    keys = ApiKeys(path, check_every_s=0)
    assert (knows(keys, old_secret), knows(keys, new_secret)) == (True, False)
    add_key(path, new)
    assert (knows(keys, old_secret), knows(keys, new_secret)) == (True, True)
    revoke_key(path, "old")
    assert (knows(keys, old_secret), knows(keys, new_secret)) == (False, True)
    # As an editor may do it: in place.
    path.write_text(f"# back again\n{old.line}\n")
    assert (knows(keys, old_secret), knows(keys, new_secret)) == (True, False)


def test_keys_rotate_as_kubernetes_swaps_a_secret(tmp_path: Path) -> None:
    made = {}
    for version in ("one", "two"):
        (tmp_path / version).mkdir()
        made[version], key = new_key(version)
        written(tmp_path / version / "keys", key)
    (tmp_path / "..data").symlink_to("one")
    (tmp_path / "keys").symlink_to("..data/keys")
    keys = ApiKeys(tmp_path / "keys", check_every_s=0)
    assert (knows(keys, made["one"]), knows(keys, made["two"])) == (True, False)
    (tmp_path / "..data_tmp").symlink_to("two")
    (tmp_path / "..data_tmp").replace(tmp_path / "..data")
    assert (knows(keys, made["one"]), knows(keys, made["two"])) == (False, True)


def test_a_broken_or_missing_file_keeps_the_keys(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    secret, key = new_key("studio")
    path = written(tmp_path / "keys", key)
    keys = ApiKeys(path, check_every_s=0)
    caplog.set_level(logging.INFO, "boxlift_service")

    def logged() -> list[tuple[str, str]]:
        lines = [(record.levelname, record.getMessage()) for record in caplog.records]
        caplog.clear()
        return lines

    path.write_text("studio boxlift_half-a-li")
    assert [knows(keys, secret) for _ in range(3)] == [True] * 3
    [(level, line)] = logged()
    assert level == "ERROR"
    assert f"{path}:1" in line
    assert "half" not in line

    path.unlink()
    assert [knows(keys, secret) for _ in range(3)] == [True] * 3
    [(level, line)] = logged()
    assert level == "ERROR"
    assert "No such file" in line

    # An empty file is no accident: who wants to refuse everybody needs a way to.
    written(path)
    assert [knows(keys, secret) for _ in range(3)] == [False] * 3
    assert logged() == [("INFO", "API keys read again: none is left")]
    written(path, key)
    assert knows(keys, secret)
    assert logged() == [("INFO", "API keys read again: studio")]


def test_the_file_is_not_looked_at_for_every_request(tmp_path: Path) -> None:
    secret, key = new_key("studio")
    path = written(tmp_path / "keys", key)
    keys = ApiKeys(path, check_every_s=3600)
    written(path)
    assert knows(keys, secret)


def test_a_new_file_is_private_and_an_old_one_stays_as_it_was(tmp_path: Path) -> None:
    path = tmp_path / "keys"
    first, second, third = (new_key(name)[1] for name in ("first", "second", "third"))
    add_key(path, first)
    assert path.stat().st_mode & 0o777 == 0o600
    path.chmod(0o640)
    path.write_text(f"# ours\n{path.read_text()}# no newline")
    link = tmp_path / "link"
    link.symlink_to("keys")
    add_key(link, second)
    assert link.is_symlink()
    assert path.stat().st_mode & 0o777 == 0o640
    assert path.read_text() == f"# ours\n{first.line}\n# no newline\n{second.line}\n"
    before = path.read_bytes()
    with pytest.raises(OptionsError, match="'first' is taken"):
        add_key(path, new_key("first")[1])
    with pytest.raises(OptionsError, match="no key 'third'"):
        revoke_key(path, third.name)
    assert path.read_bytes() == before
    path.write_text("broken")
    with pytest.raises(OptionsError, match="keys:1"):
        add_key(path, third)
    assert path.read_text() == "broken"
    assert sorted(entry.name for entry in tmp_path.iterdir()) == ["keys", "link"]


def test_keys_that_are_made_at_the_same_time_are_all_kept(tmp_path: Path) -> None:
    made = [new_key(f"key-{index}")[1] for index in range(40)]
    with ThreadPoolExecutor(8) as threads:
        list(threads.map(partial(add_key, tmp_path / "keys"), made))
    assert sorted(read_keys(tmp_path / "keys"), key=lambda key: made.index(key)) == made


def boxlift_keys(*arguments: object) -> Result:
    result = CliRunner().invoke(keys_command, [str(argument) for argument in arguments])
    assert result.exception is None, result.output
    return result


def test_keys_are_made_listed_and_revoked(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("BOXLIFT_API_KEYS", raising=False)
    path = tmp_path / "keys"
    secrets = [
        boxlift_keys("new", "studio", "--file", path).stdout.strip(),
        boxlift_keys("new", "batch", "--requests-per-minute", 90, "--file", path).stdout.strip(),
    ]
    keys = ApiKeys(path, check_every_s=0)
    assert [keys.find(secret.encode()) for secret in secrets] == list(read_keys(path))
    monkeypatch.setenv("BOXLIFT_API_KEYS", str(path))
    listed = [line.split("\t") for line in boxlift_keys("list").stdout.splitlines()]
    assert [words[0] for words in listed] == ["studio", "batch"]
    assert listed[1][1:] == [read_keys(path)[1].digest.hex()[:8], "90 a minute"]
    boxlift_keys("revoke", "studio")
    assert [knows(keys, secret) for secret in secrets] == [False, True]


def test_a_key_without_a_file_comes_with_its_line(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("BOXLIFT_API_KEYS", raising=False)
    made = boxlift_keys("new", "studio")
    secret = made.stdout.strip()
    assert parse_keys(made.stderr.splitlines()[-1], "stderr") == (
        ApiKey("studio", sha256(secret.encode()).digest()),
    )
