"""Bounds of what a file may make a reader reserve: an error that names the file, at once."""

from pathlib import Path

import pytest
import zstandard
from mcap.writer import CompressionType, Writer

from cli.report.log_mcap import McapTable
from cli.report.log_table import CsvTable
from forcemesh.errors import DataError, ForcemeshError
from forcemesh.yaml_file import read_yaml
from identification.recording import COLUMNS, read_recording
from services.recorder import reading
from services.recorder.reading import RecordedFile

LAUGHS = "a: &a [x, x, x, x, x, x, x, x, x, x]\n" + "".join(
    f"{new}: &{new} [{', '.join([f'*{old}'] * 10)}]\n"
    for old, new in zip("abcdefgh", "bcdefghi", strict=True)
)


def test_aliases_of_yaml_are_bounded(tmp_path: Path) -> None:
    """Nine lines that stand for 1e9 values; a few aliases are no mistake."""
    path = tmp_path / "cell.yaml"
    path.write_text(LAUGHS, encoding="utf-8")
    with pytest.raises(ForcemeshError, match=r"cell\.yaml.* values, the limit is 100000"):
        read_yaml(path, str(path))
    path.write_text("a: &a {b: 1}\nc: *a\n", encoding="utf-8")
    assert read_yaml(path, "it") == {"a": {"b": 1}, "c": {"b": 1}}


@pytest.mark.parametrize("head", ["", f"{','.join(COLUMNS)}\n"])
@pytest.mark.parametrize("read", [read_recording, lambda path: list(CsvTable(path).rows(["t"]))])
def test_an_endless_line_is_an_error(read: object, head: str, tmp_path: Path) -> None:
    """It is not read to its end."""
    path = tmp_path / "log.csv"
    path.write_text(head + "1" * (1 << 21), encoding="utf-8")
    with pytest.raises(DataError, match=r"log\.csv.*line [12]: longer than 1048576"):
        read(path)  # type: ignore[operator]


def test_the_size_that_a_zstd_frame_declares_is_bounded(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A small frame that declares 300 MB is refused before the decompressor reserves them."""
    path = tmp_path / "bomb.mcap"
    with path.open("wb") as stream:
        writer = Writer(stream, chunk_size=1 << 30, compression=CompressionType.ZSTD)
        writer.start()
        writer.add_metadata("forcemesh", {"cell": "demo"})
        schema = writer.register_schema("s", "jsonschema", b"{}")
        channel = writer.register_channel("t", "json", schema)
        for _ in range(3):
            writer.add_message(channel, 1, b"1" * 1000, 1)
        writer.finish()
    declared = zstandard.frame_content_size(zstandard.compress(b"1" * 3000, 1))
    assert declared == 3000
    monkeypatch.setattr(reading, "MOST_CHUNK_B", 2000)
    monkeypatch.setattr(zstandard, "decompress", lambda *_: pytest.fail("it was decompressed"))
    for read in (lambda: list(RecordedFile(path).messages()), lambda: McapTable(path, None)):
        with pytest.raises(DataError, match=r"bomb\.mcap: a chunk declares .* the limit is"):
            read()


def test_a_length_that_no_memory_holds_is_the_end_of_the_file(tmp_path: Path) -> None:
    """An attachment that declares 2**56 bytes: what stands before it is read."""
    path = tmp_path / "declared.mcap"
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        writer.add_metadata("forcemesh", {"cell": "demo"})
        writer.add_attachment(0, 0, "cell.yaml", "application/yaml", b"1" * 1000)
        writer.finish()
    size, huge = (number.to_bytes(8, "little") for number in (1000, 1 << 56))
    path.write_bytes(path.read_bytes().replace(size, huge))
    read = RecordedFile(path)
    assert (read.about, list(read.messages()), read.is_whole) == ({"cell": "demo"}, [], False)
