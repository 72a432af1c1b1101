"""A live daemon keeps to its OpenAPI document: answers to valid and invalid requests, and all events of a scan."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import conftest
import httpx
import jsonschema_rs
import pytest

import ridged

#: Longest time for all requests, s.
REQUESTS_S = 400
#: Longest time for the end of a job or the next event, s.
WAIT_S = 120


@pytest.fixture(scope="module")
def used(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """The address of a daemon with one row of each kind, so that requests for row 1 find something."""
    daemon = conftest.Daemon(tmp_path_factory.mktemp("lab"))
    with ridged.connect(data=daemon.data) as lab, httpx.Client(base_url=f"{daemon.url}/api/v1", timeout=WAIT_S) as http:

        def post(path: str, body: object) -> None:
            answer = http.post(path, json=body)
            assert answer.is_success, f"{path}: {answer.text}"

        limits = {"theta_r_deg": {"lower": 14.0, "upper": 16.0}}
        post("/specifications", {"name": "lid", "limits": limits})
        post("/recipes", {"name": "quick", "plan": {"preset": "paper"}})
        scan = lab.measure("model 15°", recipe="quick", specification="lid")
        scan.wait(on_step=ridged.confirm, progress=False, timeout_s=WAIT_S)
        post("/queue/orders", {"orders": [{"sample_id": 1, "recipe": "quick"}]})
        post("/maps", {"scan_id": scan.id, "max_seconds": 2})
        post("/contrasts", {"scan_id": scan.id})
        scene = {"scene": (conftest.ROOT / "scenes/glass-over-diamond.toml").read_text(), "photons": 1000}
        post("/traces", scene)
        for kind in ("maps", "contrasts", "verdicts", "traces"):
            ended(http, f"/{kind}/1")
    yield daemon.url
    daemon.kill()


def ended(http: httpx.Client, path: str) -> None:
    """Waits for the end of a job."""
    with http.stream("GET", "/events?since=0") as events:
        for _ in events.iter_lines():
            if http.get(path).json().get("state") != "running":
                return


def document(url: str) -> dict[str, object]:
    found = httpx.get(f"{url}/openapi.json").json()
    assert isinstance(found, dict)
    return found


def test_every_event_has_the_form_of_the_document(used: str) -> None:
    components = document(used)["components"]
    form = {"$ref": "#/components/schemas/Event", "unevaluatedProperties": False, "components": components}
    validator = jsonschema_rs.Draft202012Validator(form)
    lease = httpx.post(f"{used}/api/v1/lease", json={"name": "test"})
    assert lease.is_success, lease.text
    seen: dict[str, int] = {}
    with httpx.stream("GET", f"{used}/api/v1/events?since=0", timeout=WAIT_S) as events:
        for line in events.iter_lines():
            if not line.startswith("data:"):
                continue
            event = json.loads(line.removeprefix("data:"))
            problems = [str(error) for error in validator.iter_errors(event)]
            assert not problems, f"{event}: {problems}"
            seen[event["type"]] = seen.get(event["type"], 0) + 1
            if event["type"] == "order" and "lease" in event["order"]:
                break
    assert seen.keys() >= {"rig", "scan", "frame", "fit", "uncertainty", "calculation", "forecast", "order"}, seen


def test_every_answer_is_one_that_the_document_lists(used: str, tmp_path: Path) -> None:
    # A valid request may be refused by what the rig and the store hold, which a schema cannot state; hence not that check.
    command = [
        *(sys.executable, "-m", "schemathesis.cli", "run", f"{used}/openapi.json", "--no-color"),
        *("--phases", "coverage,fuzzing,stateful", "--max-examples", "4", "--seed", "1", "--workers", "1"),
        *("--request-timeout", "20", "--exclude-checks", "positive_data_acceptance", "--exclude-path", "/api/v1/events"),
        *("--report", "junit", "--report-dir", str(tmp_path)),
    ]
    run = subprocess.run(command, capture_output=True, text=True, timeout=REQUESTS_S, check=False)
    assert run.returncode == 0, run.stdout[-8000:] + run.stderr[-2000:]
    assert "passed" in run.stdout or "No issues found" in run.stdout, run.stdout[-2000:]
    assert httpx.get(f"{used}/healthz").text.strip() == "ok"
