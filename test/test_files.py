import errno
from pathlib import Path

import pytest

from hydro_twin.files import write_whole, written_whole


def test_a_file_that_is_not_written_whole_stays_as_it_was(tmp_path):
    path = tmp_path / 'model.yaml'
    write_whole(path, 'before')
    writing = written_whole(path)
    writing.__enter__().write_text('half')
    assert not writing.__exit__(KeyboardInterrupt, KeyboardInterrupt(), None)
    assert path.read_text() == 'before'
    assert list(tmp_path.iterdir()) == [path]


def test_text_and_bytes_take_the_place_of_the_file(tmp_path):
    path = tmp_path / 'model.yaml'
    for content in ('η = 0.9\n', b'\x00\x01'):
        write_whole(path, content)
        assert path.read_bytes() == (content if isinstance(content, bytes) else content.encode())
    assert list(tmp_path.iterdir()) == [path]


def test_a_folder_that_is_not_there_is_an_os_error(tmp_path):
    with pytest.raises(OSError, match='No such file') as caught:
        write_whole(tmp_path / 'none' / 'model.yaml', '')
    assert caught.value.filename == str(tmp_path / 'none' / 'model.yaml')


def test_a_folder_in_its_place_is_an_os_error(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for path in (Path(), tmp_path):     # the first is what an empty argument becomes
        with pytest.raises(IsADirectoryError, match='Is a directory'):
            write_whole(path, '')


def test_an_error_of_the_disk_names_the_file(tmp_path):
    path = tmp_path / 'picture.png'
    with pytest.raises(OSError, match='No space left') as caught, written_whole(path):
        raise OSError(errno.ENOSPC, 'No space left on device')
    assert caught.value.filename == str(path)
    assert not list(tmp_path.iterdir())
