import multiprocessing
import os
import signal
import time
from functools import partial

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rodlib.ilc.files import alone
from rodlib.study.batches import _load, _save, complete, local_cluster

EXPECTED = np.arange(10.0) ** 2


def squares(folder, start, stop):
    """Some work that leaves a trace."""
    with open(folder / "trace", "a", encoding="utf-8") as file:
        file.write(f"{start}\n")
    return {"square": np.arange(start, stop, dtype=float) ** 2}


def stuck_in_the_third(folder, start, stop):
    if (folder / "trace").exists() and len(trace(folder)) == 2:
        (folder / "gate").read_bytes()
    return squares(folder, start, stop)


def killed_once(folder, start, stop):
    if start == 4 and not (folder / "killed").exists():
        (folder / "killed").touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return squares(folder, start, stop)


def failing(folder, start, stop):
    if start == 8:
        while len(list(folder.glob("*.npz"))) < 4:
            time.sleep(0.01)
        raise ArithmeticError("eight is too much")
    return squares(folder, start, stop)


def trace(folder):
    return sorted(int(line) for line in (folder / "trace").read_text(encoding="utf-8").split())


def contents(folder):
    return {path.name: path.read_bytes() for path in folder.glob("*.npz")}


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """The work done by this process, and its files."""
    folder = tmp_path_factory.mktemp("finished")
    found = complete(partial(squares, folder), "name", 10, 2, folder, workers=0)
    np.testing.assert_array_equal(found["square"], EXPECTED)
    assert trace(folder) == [0, 2, 4, 6, 8]
    return folder


def copied(finished, folder):
    for name, content in contents(finished).items():
        (folder / name).write_bytes(content)


def test_what_is_finished_is_not_computed_again(finished, tmp_path):
    copied(finished, tmp_path)
    found = complete(partial(squares, tmp_path), "name", 10, 2, tmp_path)
    np.testing.assert_array_equal(found["square"], EXPECTED)
    assert not (tmp_path / "trace").exists()


def test_a_killed_worker_changes_nothing(finished, tmp_path):
    found = complete(partial(killed_once, tmp_path), "name", 10, 2, tmp_path, workers=2)
    assert (tmp_path / "killed").exists()
    np.testing.assert_array_equal(found["square"], EXPECTED)
    assert contents(tmp_path) == contents(finished)


def test_this_process_alone_gives_the_same_files_and_starts_no_other(
    finished, tmp_path, monkeypatch
):
    monkeypatch.setattr("distributed.LocalCluster", None)
    paths = sorted(finished.glob("*.npz"))[:2]
    for path in paths:
        (tmp_path / path.name).write_bytes(path.read_bytes())
    found = complete(partial(squares, tmp_path), "name", 10, 2, tmp_path, workers=0)
    np.testing.assert_array_equal(found["square"], EXPECTED)
    assert trace(tmp_path) == [4, 6, 8]
    assert contents(tmp_path) == contents(finished)


def interrupted(folder):
    complete(partial(stuck_in_the_third, folder), "name", 10, 2, folder, workers=1)


def test_a_killed_run_goes_on_where_it_was(finished, tmp_path, gate):
    run = multiprocessing.get_context("spawn").Process(target=interrupted, args=(tmp_path,))
    run.start()
    while len(contents(tmp_path)) < 2:
        assert run.is_alive()
        time.sleep(0.01)
    run.kill()
    run.join()
    before = {path: path.stat().st_mtime_ns for path in tmp_path.glob("*.npz")}
    (tmp_path / "trace").unlink()
    found = complete(partial(squares, tmp_path), "name", 10, 2, tmp_path, workers=0)
    np.testing.assert_array_equal(found["square"], EXPECTED)
    assert len(before) == 2 and len(trace(tmp_path)) == 3
    assert all(path.stat().st_mtime_ns == when for path, when in before.items())
    assert contents(tmp_path) == contents(finished)


def test_an_error_of_the_work_is_raised_and_the_rest_is_kept(finished, tmp_path):
    with pytest.raises(ArithmeticError, match="eight is too much"):
        complete(partial(failing, tmp_path), "name", 10, 2, tmp_path, workers=2)
    assert contents(tmp_path) == {k: v for k, v in contents(finished).items() if "08-" not in k}


def test_a_cluster_by_its_address_damaged_files_and_more_numbers(finished, tmp_path):
    copied(finished, tmp_path)
    paths = sorted(tmp_path.glob("*.npz"))
    content = paths[0].read_bytes()
    paths[0].write_bytes(content[: len(content) // 2])  # cut off
    paths[1].write_bytes(content)  # another's, although whole
    paths[2].write_bytes(b"")
    with local_cluster(1) as cluster:
        address = cluster.scheduler_address
        found = complete(partial(squares, tmp_path), "name", 11, 2, tmp_path, scheduler=address)
    assert trace(tmp_path) == [0, 2, 4, 10]
    np.testing.assert_array_equal(found["square"], np.arange(11.0) ** 2)
    assert contents(finished).items() < contents(tmp_path).items()


@given(st.data())
def test_no_changed_byte_goes_unnoticed(tmp_path_factory, data):
    path = tmp_path_factory.mktemp("bytes") / "name-000000-000002.npz"
    arrays = {"x": np.linspace(0, 1, 5), "n": np.arange(4).reshape(2, 2)}
    _save(path, arrays)
    content = bytearray(path.read_bytes())
    place = data.draw(st.integers(0, len(content) - 1))
    content[place] ^= data.draw(st.integers(1, 255))
    path.write_bytes(content)
    found = _load(path)
    if found is not None:  # some bytes of the format mean nothing
        assert found.keys() == arrays.keys()
        for name, array in arrays.items():
            assert found[name].dtype == array.dtype
            np.testing.assert_array_equal(found[name], array)


def test_a_second_run_in_the_same_folder_is_refused(tmp_path):
    with (
        alone(tmp_path / "lock", "the test"),
        pytest.raises(RuntimeError, match=f"another process is at work in {tmp_path}"),
    ):
        complete(partial(squares, tmp_path), "name", 10, 2, tmp_path)
