"""What the store holds of a scan, arranged as its report: rows of the API, and the manifest and the programs in the database."""

from __future__ import annotations

import hashlib
import json
import math
import sqlite3
import tomllib
from collections.abc import Callable, Iterator
from datetime import datetime
from pathlib import Path
from typing import Any

Get = Callable[[str], Any]

#: Fields that the report makes itself: the name of its form, and the hash over all other fields.
MADE = {"form", "sha256"}


def differences(report: Any, stored: Any, path: str = "") -> Iterator[str]:
    """The paths of a report whose values the store does not hold."""
    match report, stored:
        case dict(), dict():
            for name, value in report.items():
                if path or name not in MADE:
                    yield from differences(value, stored.get(name), f"{path}.{name}" if path else name)
        case list(), list() if len(report) == len(stored):
            for index, (value, known) in enumerate(zip(report, stored, strict=True)):
                yield from differences(value, known, f"{path}[{index}]")
        # The last digit of a value that the report computes, such as an age, may differ.
        case float(), float() if math.isclose(report, stored, rel_tol=1e-14):
            pass
        case _ if report != stored:
            yield path


def of_row(get: Get, data: Path, row: dict[str, Any]) -> dict[str, Any]:
    """What the store of the data folder holds of the scan of a row of results."""
    scan = get(f"/scans/{row['scan_id']}")
    fit, verdict = get(f"/fits/{row['fit_id']}"), get(f"/verdicts/{row['verdict_id']}")
    sample = get(f"/samples/{scan['sample_id']}")
    observations = get(f"/scans/{scan['id']}/observations")
    calibrations = [get(f"/calibrations/{number}") for number in scan["calibration_ids"]]
    database = sqlite3.connect(f"file:{data / 'ridged.sqlite'}?mode=ro", uri=True)

    def one(query: str, *values: object) -> Any:
        return database.execute(query, values).fetchone()[0]

    try:
        manifest = tomllib.loads(one("SELECT manifest FROM scan_now WHERE scan_id = ?", scan["id"]))
        program = one("SELECT program FROM scans WHERE id = ?", scan["id"])
        fitted_by = one("SELECT program FROM jobs WHERE kind = 'fit' AND number = ?", fit["id"])
        controllers = "SELECT identity FROM rig_stages r JOIN scan_stages s ON s.stages_id = r.id WHERE s.scan_id = ?"
        identity = json.loads(one(controllers, scan["id"]))
    finally:
        database.close()
    frames = frames_of(get, scan["id"], calibrations)
    return {
        # One program does it all here.
        "program": program,
        "part": sample | {"sample_id": sample["id"]},
        "scan": scan | {"program": program},
        "plan": scan["plan"],
        "rig": {
            "simulated": get("/rig")["simulated"],
            "geometry": manifest["rig"],
            "camera": manifest["camera"],
            "stages": [{"axis": axis, **identity[axis]} for axis in ("theta_c", "phi_s")],
            "camera_serial": frames[0]["tag"]["serial"],
        },
        "white_reference": manifest["flat"],
        "calibrations": [made | {"age_h": max(0.0, hours(made["created_at"], scan["started_at"]))} for made in calibrations],
        "fit": fit | {"computed_by": fitted_by},
        "absolute": observations["absolute"],
        "observations": observations["items"],
        "verdict": verdict,
        "incidents": get(f"/scans/{scan['id']}/incidents?limit=1000")["items"],
        "frames": {
            "count": len(frames),
            "sha256": hashlib.sha256("".join(f"{f['sha256']}  {f['file']}\n" for f in frames).encode()).hexdigest(),
            "files": frames,
        },
    }


def frames_of(get: Get, scan_id: int, calibrations: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """The frames that count for a scan, by name: its own, and those of the calibrations of earlier scans."""
    sources = {(scan_id, ""), *((made["scan_id"], f"&kind={made['kind']}") for made in calibrations if made["scan_id"] != scan_id)}
    found = [frame for source, kind in sources for frame in get(f"/scans/{source}/frames?limit=1000{kind}")["items"]]
    return sorted((frame for frame in found if frame["accepted"]), key=lambda frame: (frame["file"], frame["sha256"]))


def hours(since: str, until: str) -> float:
    """Time between two times of the store, h."""
    return (datetime.fromisoformat(until) - datetime.fromisoformat(since)).total_seconds() / 3600
