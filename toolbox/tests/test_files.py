import os
import signal
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor

import pytest

from ilctools.files import alone, append, replacing, write_whole


def test_a_file_is_replaced_where_its_link_leads_and_stays_private(tmp_path):
    path, link = tmp_path / "log.csv", tmp_path / "link"
    link.symlink_to(path)
    write_whole(link, "old\n")
    path.chmod(0o600)
    write_whole(link, "Gałkowski\n")
    assert path.read_bytes() == "Gałkowski\n".encode()
    assert link.is_symlink() and path.stat().st_mode & 0o777 == 0o600
    assert {*tmp_path.iterdir()} == {path, link}


def test_after_an_error_the_old_file_is_whole_and_nothing_else_is_left(tmp_path):
    path = tmp_path / "log.csv"
    write_whole(path, "old")
    with pytest.raises(UnicodeEncodeError):
        write_whole(path, "new \ud800")
    with pytest.raises(KeyboardInterrupt), replacing(path) as temporary:
        temporary.write_text("half")
        raise KeyboardInterrupt
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_the_second_is_refused_until_the_first_is_killed(tmp_path):
    lock = tmp_path / "lock"
    call = "import sys; from pathlib import Path; from ilctools.files import alone\n"
    call += "with alone(Path(sys.argv[1]), ''): print('at it', flush=True); sys.stdin.read()"
    command, pipe = [sys.executable, "-c", call, lock], subprocess.PIPE
    with subprocess.Popen(command, stdin=pipe, stdout=pipe) as first:
        assert first.stdout.readline() == b"at it\n"
        with pytest.raises(RuntimeError, match="busy"):
            alone(lock, "busy").__enter__()
        first.send_signal(signal.SIGKILL)
    with alone(lock, "busy"):
        pass


@pytest.mark.skipif(os.name != "posix", reason="links, pipes")
def test_a_lock_does_not_follow_a_link_and_waits_for_no_pipe(tmp_path):
    lock, planted, pipe = tmp_path / "lock", tmp_path / "planted", tmp_path / "pipe"
    lock.symlink_to(planted)
    os.mkfifo(pipe)
    for name in (lock, pipe):
        with (
            pytest.raises(FileExistsError, match=f"{name} is not a .* link: remove it"),
            alone(name, ""),
        ):
            pytest.fail("must not come that far")
    assert not planted.exists()


def test_readers_see_one_text_or_another_whole_while_two_write(tmp_path):
    path, texts = tmp_path / "log.csv", ["a" * 50_000, "b" * 50_000]
    write_whole(path, texts[0])
    write = lambda text: [write_whole(path, text) for _ in range(100)]  # noqa: E731
    with ThreadPoolExecutor(2) as pool:
        writers = [pool.submit(write, text) for text in texts]
        while not all(writer.done() for writer in writers):
            assert path.read_text() in texts
    assert [len(writer.result()) for writer in writers] == [100, 100]
    assert os.listdir(tmp_path) == ["log.csv"]


def test_what_cannot_be_added_leaves_a_file_as_it_was(tmp_path):
    def pieces():
        yield b"2\n" * 100_000
        raise KeyboardInterrupt

    path = tmp_path / "log.csv"
    write_whole(path, "1\n")
    with pytest.raises(KeyboardInterrupt):
        append(path, pieces())
    assert path.read_text() == "1\n"
    append(path, [b"2\n", b"3\n"])
    assert path.read_text() == "1\n2\n3\n"
