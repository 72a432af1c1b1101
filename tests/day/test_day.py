"""A day of parts by queue, done four ways on four equal simulated rigs: the rows at the end are the same, and every figure of a
report is in the store."""

from __future__ import annotations

import copy
import csv
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import conftest
import httpx
import pytest
import stored

HERE = Path(__file__).resolve().parent
WEB = conftest.ROOT / "web"
WAYS = ("page", "curl", "python", "cli")
PARTS = int(os.environ.get("DAY_PARTS", "3"))
TIME_SCALE = 200
#: Longest time of a day with a debug binary on a busy machine, s.
DAY_S_MAX = 120 + 60 * PARTS
#: Columns that differ between two days: times, and the number of a verdict, which counts the ends of fits that run side by side.
VARYING = {"created_at", "ended_at", "fitted_at", "verdict_id"}


@dataclass
class Day:
    """What one way left behind."""

    way: str
    daemon: conftest.Daemon
    http: httpx.Client
    process: subprocess.Popen[bytes]
    seconds: float = 0.0

    def get(self, path: str) -> Any:
        """Returns what a route of the daemon answers."""
        answer = self.http.get(path)
        assert answer.is_success, f"{self.way}: {path}: {answer.text}"
        return answer.json()

    def rows(self) -> list[dict[str, Any]]:
        """The rows of the daemon with all columns, in the order of the scans."""
        rows: list[dict[str, Any]] = self.get("/results?fields=all&sort=scan_id&limit=1000")["items"]
        return rows

    def written(self) -> list[dict[str, str]]:
        """The rows that the way itself wrote."""
        with (self.daemon.folder / "rows.csv").open(newline="") as file:
            return list(csv.DictReader(file))

    def output(self) -> str:
        """The ends of what the way and the daemon wrote, for the message of a failure."""
        texts = ((self.daemon.folder / name).read_text(errors="replace") for name in ("way.txt", "log.txt"))
        return f"{self.way}:\n" + "\n".join(text[-4000:] for text in texts)


def parts_of_the_day() -> list[tuple[str, str, str]]:
    """Part, lot and external id of each order. The last part has another ridge angle and does not pass."""
    names = [f"B-{number:03}" for number in range(1, PARTS)] + ["model 15°"]
    return [(name, "7" if at < PARTS // 2 else "8", f"A-{1000 + at}") for at, name in enumerate(names)]


def start(way: str, daemon: conftest.Daemon) -> subprocess.Popen[bytes]:
    """Starts a way on its daemon, in the folder of the daemon."""
    folder = daemon.folder
    parts, rows = folder / "parts.csv", folder / "rows.csv"
    with parts.open("w", newline="") as file:
        csv.writer(file).writerows([("part", "lot", "external_id"), *parts_of_the_day()])
    commands: dict[str, list[str | Path]] = {
        "page": [WEB / "node_modules/.bin/vitest", "run", "--project", "day"],
        "curl": [HERE / "by_curl", daemon.url, parts],
        "python": [sys.executable, HERE / "by_python.py", parts],
        "cli": [HERE / "by_cli", parts],
    }
    (folder / "bin").mkdir()
    (folder / "bin/ridged").symlink_to(conftest.RIDGED)
    variables = os.environ | {
        "PATH": f"{folder / 'bin'}:{os.environ['PATH']}",
        "PYTHONPATH": str(conftest.ROOT / "python/src"),
        "RIDGED_URL": daemon.url,
        "DAY_PARTS_CSV": str(parts),
        "DAY_ROWS_CSV": str(rows),
        "NO_COLOR": "1",
    }
    output = (folder / "way.txt").open("wb")
    # The page writes its rows by itself.
    to = output if way == "page" else rows.open("wb")
    with output, to:
        return subprocess.Popen(
            commands[way],
            cwd=WEB if way == "page" else folder,
            env=variables,
            stdin=subprocess.DEVNULL,
            stdout=to,
            stderr=output,
            # A group of its own, which is ended as a whole.
            start_new_session=True,
        )


def end(process: subprocess.Popen[bytes]) -> None:
    """Ends a way with all that it started."""
    if process.poll() is None:
        os.killpg(process.pid, signal.SIGTERM)
        try:
            process.wait(10)
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)
            process.wait()


@pytest.fixture(scope="module")
def days() -> Iterator[list[Day]]:
    """The four days, all done."""
    # A request to end must end the daemons too.
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    # Four daemons share the cores: with more threads their fits would wait for threads that do not run.
    os.environ["RAYON_NUM_THREADS"] = "1"
    began = time.monotonic()
    with ExitStack() as ending:
        days = []
        for way in WAYS:
            folder = Path(ending.enter_context(tempfile.TemporaryDirectory(prefix=f"ridged-day-{way}-")))
            daemon = conftest.Daemon(folder, "--time-scale", str(TIME_SCALE), "--seed", "1")
            ending.callback(daemon.stop)
            http = ending.enter_context(httpx.Client(base_url=f"{daemon.url}/api/v1", timeout=60))
            days.append(Day(way, daemon, http, start(way, daemon)))
            ending.callback(end, days[-1].process)
        going = list(days)
        while going:
            time.sleep(0.05)
            for day in [day for day in going if day.process.poll() is not None]:
                going.remove(day)
                day.seconds = time.monotonic() - began
                assert day.process.returncode == 0, day.output()
            late = time.monotonic() - began > DAY_S_MAX
            assert not (going and late), f"not done after {DAY_S_MAX} s: " + "\n".join(day.output() for day in going)
        yield days


def plain(row: dict[str, Any]) -> dict[str, float | str]:
    """A row of results without what varies and without empty cells. Numbers are compared as numbers."""

    def value(cell: object) -> float | str:
        try:
            return float(str(cell))
        except ValueError:
            return str(cell)

    return {name: value(cell) for name, cell in row.items() if name not in VARYING and cell not in (None, "")}


def differing(row: dict[str, Any], known: dict[str, Any]) -> dict[str, list[float | str | None]]:
    """The columns in which two rows of results differ, with both values."""
    pairs = [plain(row), plain(known)]
    values = {name: [pair.get(name) for pair in pairs] for name in pairs[0] | pairs[1]}
    return {name: both for name, both in values.items() if both[0] != both[1]}


def unlike(day: Day, other: Day, row: dict[str, Any]) -> str:
    """What may have made one part differ between two days: frames with other counts, and incidents of both scans."""
    files, incidents = [], []
    for each in (day, other):
        scan = f"/scans/{row['scan_id']}"
        report = each.get(f"{scan}/report?format=json")
        files.append({file["file"]: file["sha256"] for file in report["frames"]["files"]})
        incidents.append(each.get(f"{scan}/incidents?limit=1000")["items"])
    names = sorted(name for name in files[0] | files[1] if files[0].get(name) != files[1].get(name))
    return f"{day.way}: {row['part']}; frames that differ from {other.way}: {names}; incidents: {incidents}"


def test_the_rows_are_the_same_four_ways(days: list[Day]) -> None:
    first = days[0].rows()
    for day in days:
        rows = day.rows()
        print()
        for row in rows:
            angle = f"θr {row['theta_r_deg']}° ± {row['theta_r_deg_expanded']}° (k = {row['coverage_factor']:.3g})"
            print(f"{day.way:<7} {row['part']:<10} lot {row['lot']}  {row['external_id']}  {angle}  {row['verdict']}")
        print(f"{day.way}: {len(rows)} parts in {day.seconds:.1f} s")
        # In the order of the queue.
        assert [(row["part"], row["lot"], row["external_id"]) for row in rows] == parts_of_the_day(), day.way
        assert [row["verdict"] for row in rows] == ["pass"] * (PARTS - 1) + ["fail"], day.way
        # The simulated rig draws its noise from its seed and the number of the frame, so that equal days have equal values.
        for row, known in zip(rows, first, strict=True):
            assert differing(row, known) == {}, unlike(day, days[0], row)
        # What the way itself wrote.
        written = day.written()
        assert len(written) == len(rows), day.way
        for row, own in zip(rows, written, strict=True):
            assert {"part", "theta_r_deg", "theta_r_deg_expanded", "verdict", "specification"} <= plain(own).keys(), day.way
            assert plain(own).items() <= plain(row).items(), day.way


def test_recipe_and_specification_are_the_same_four_ways(days: list[Day]) -> None:
    for kind in ("recipe", "specification"):
        definitions = [day.get(f"/{kind}s/1") for day in days]
        assert [made["version"] for made in definitions] == [1] * len(days)
        for day, made in zip(days, definitions, strict=True):
            assert made[kind] == definitions[0][kind], day.way
            for row in day.rows():
                used = day.get(f"/scans/{row['scan_id']}")[kind]
                assert (used["id"], used["name"], used["version"]) == (1, made["name"], 1), day.way


def test_every_figure_of_a_report_is_in_the_store(days: list[Day]) -> None:
    first: dict[int, dict[str, Any]] = {}
    for day in days:
        for row in day.rows():
            report = day.get(f"/scans/{row['scan_id']}/report?format=json")
            assert list(stored.differences(report, stored.of_row(day.get, day.daemon.data, row))) == [], day.way
            # All digits, too, are the same four ways.
            known = first.setdefault(row["scan_id"], report)
            for name in ("parameters", "covariance", "rms_residual"):
                assert report["fit"][name] == known["fit"][name], f"{day.way}: {name}"
            assert report["observations"] == known["observations"], day.way
            assert report["frames"]["sha256"] == known["frames"]["sha256"], day.way


def test_a_figure_that_is_not_in_the_store_is_found(days: list[Day]) -> None:
    day = days[0]
    row = day.rows()[0]
    report = day.get(f"/scans/{row['scan_id']}/report?format=json")
    held = stored.of_row(day.get, day.daemon.data, row)
    altered = copy.deepcopy(report)
    altered["fit"]["parameters"]["theta_r_deg"]["value"] *= 1 + 1e-12
    altered["frames"]["files"][3]["sha256"] = altered["frames"]["files"][4]["sha256"]
    altered["calibrations"][0]["n_frames"] += 1
    altered["verdict"]["limit"] = 10.0
    assert set(stored.differences(altered, held)) == {
        "fit.parameters.theta_r_deg.value",
        "frames.files[3].sha256",
        "calibrations[0].n_frames",
        "verdict.limit",
    }
