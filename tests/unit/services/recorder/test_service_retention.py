"""Retention of recordings of stops: only whole ones of this cell and code, never the open one."""

from collections import defaultdict
from contextlib import ExitStack
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from services.recorder.reading import RecordedFile
from tests.unit.services.recorder.conftest import WALL_NS, RecorderBench

KEPT = 2
NAMES = ("demo", "demo-2", "demo-2-stop", "d")
CODES = st.one_of(
    st.sampled_from(["force", "force-2", "FORCE", "../force", "*", "x/../../y", "", "a" * 200]),
    st.text(max_size=20),
)
STOPS: st.SearchStrategy[list[tuple[str, str, int, float]]] = st.lists(
    st.tuples(st.sampled_from(NAMES), CODES, st.integers(-3, 3), st.sampled_from([1.0, 8.0])),
    min_size=4,
    max_size=8,
)


@given(stops=STOPS)
@settings(max_examples=15, suppress_health_check=[HealthCheck.too_slow])
def test_the_newest_of_each_cell_and_code_are_kept_as_a_whole(
    stops: list[tuple[str, str, int, float]],
) -> None:
    """For any names, codes and settings of the wall clock, in one folder."""
    with TemporaryDirectory() as scratch, ExitStack() as exits:
        folder = Path(scratch) / "recordings"
        benches: dict[str, RecorderBench] = {}
        made: dict[tuple[str, str], list[list[Path]]] = defaultdict(list)
        asked = RecorderBench(folder)
        asked.start(label="STOP-force")  # a requested recording stays, whatever its name
        asked.recorder.close()
        kept = set(asked.files())
        for name, code, clock_min, after_s in stops:
            if name not in benches:
                benches[name] = RecorderBench(folder, name=name, faults_kept=KEPT, file_min=0.1)
                exits.callback(benches[name].recorder.close)
            bench, before = benches[name], set(folder.glob("*"))
            bench.wall_zero_ns = WALL_NS + clock_min * 60 * 10**9  # the clock is set
            bench.recorder._section = bench.cell.recorder.model_copy(
                update={"after_fault_s": after_s}  # the longer one makes two files
            )
            bench.trip(code=code)
            bench.pass_s(after_s / 2)
            assert bench.recorder._recording is not None
            assert bench.recorder._recording.path.exists()  # the open one
            bench.pass_s(after_s / 2 + 0.3)
            assert bench.recorder._recording is None
            made[name, code].append(sorted(set(folder.glob("*")) - before))
            expected = {
                path for of_one in made.values() for files in of_one[-KEPT:] for path in files
            }
            assert set(folder.glob("*")) == expected | kept
        assert list(Path(scratch).iterdir()) == [folder]  # no code is a path


def test_a_file_that_cannot_be_read_is_kept_counted_and_reported(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Its cell and its code are unknown; the name does not prove them."""
    bench = RecorderBench(tmp_path, after_fault_s=0.0, faults_kept=1)
    broken = tmp_path / "demo-20200101T000000Z-STOP-force-01.mcap"
    broken.write_bytes(b"\x89MCAP0\r\n")
    for _ in range(3):
        bench.trip()
        bench.pass_s(1.0)
    bench.recorder.close()
    assert broken.exists()
    (kept,) = set(bench.files()) - {broken}
    assert RecordedFile(kept).about["number"] == "3"
    assert bench.recorder.counters()["unreadable_files"] == 1
    assert capsys.readouterr().err.count(f"{broken}: not a") == 1
