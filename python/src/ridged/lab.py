"""The lab: what a connection to the daemon gives."""

from __future__ import annotations

import os
import ssl
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, cast, overload

from . import events, samples, tables
from ._api import CalibrationBody, Comparison, EstimateBody, Preset, Problem, RecipeBody, Repeatability, Result
from ._api import Role, ScanState, SessionBody, SpecificationBody
from ._connection import Connection
from ._place import place_of
from .errors import ConnectionLost, NoDaemon, NotFound, WrongValue
from .events import Event
from .fits import Fit
from .jobs import Files, Map, Work
from .plans import Angles, Poses, plan_of
from .queue import Queue
from .rig import Rig
from .samples import Sample
from .scans import Scan

if TYPE_CHECKING:
    from pandas import DataFrame


def connect(
    url: str | None = None,
    *,
    token: str | None = None,
    token_file: str | Path | None = None,
    lease: str | None = None,
    data: str | Path | None = None,
    verify: bool | str | ssl.SSLContext = True,
    patience_s: float = 60.0,
) -> Lab:
    """Connects to a daemon.

    Without `url`, to the daemon of this machine: that of the data folder `data` or `ridged-data`, or else the only one
    of this user. It needs no token.

    `token` or `token_file` (or the variable RIDGED_TOKEN_FILE) presents a token, `lease` (or RIDGED_LEASE) a lease that
    `ridged rig lease take` printed. `verify` may name a file with the certificate to trust. While the daemon does not
    answer, requests are sent again for `patience_s` seconds; none is executed twice.

    Raises NoDaemon if none is found or it does not answer, Unauthorized if it asks for another token.
    """
    place = place_of(url, token, token_file, data)
    held = lease or os.environ.get("RIDGED_LEASE") or None
    connection = Connection(place, lease=held, patience_s=0.0, verify=verify)
    try:
        session = cast("SessionBody", connection.get("/session"))
    except ConnectionLost as error:
        connection.close()
        raise NoDaemon(str(error)) from error
    except Exception:
        connection.close()
        raise
    connection.patience_s = patience_s
    return Lab(connection, session)


class Lab:
    """A daemon: its parts, its rig, its scans. A `with` block closes the connection at its end."""

    def __init__(self, connection: Connection, session: SessionBody) -> None:
        self._connection = connection
        self.who: str = session["who"]
        """Name under which the daemon records what this program does."""
        self.role: Role = session["role"]
        """What this program may do: viewer, analyst, operator, admin."""
        self.rig = Rig(connection)
        """The stages."""
        self.queue = Queue(connection)
        """Parts in sequence, each by its recipe."""

    def __repr__(self) -> str:
        return f"<lab {self.url} as {self.who} ({self.role})>"

    def __enter__(self) -> Lab:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def url(self) -> str:
        """Address of the daemon, which is also that of the page."""
        return self._connection.address.url

    def close(self) -> None:
        """Closes the connection."""
        self._connection.close()

    def samples(self, name: str | None = None, *, limit: int | None = None) -> list[Sample]:
        """Returns parts, newest first; with `name`, those of this name."""
        rows = self._connection.pages("/samples", {"name": name}, limit)
        return [Sample(self._connection, row) for row in rows]

    def sample(self, sample: str | int | Sample) -> Sample:
        """Returns the part of a name or number.

        Raises NotFound if there is none, WrongValue if several have the name.
        """
        match sample:
            case Sample():
                return sample
            case int():
                return Sample(self._connection, self._connection.get(f"/samples/{sample}"))
        found = self.samples(sample)
        match found:
            case [one]:
                return one
            case []:
                way_out = f"lab.add_sample({sample!r}, index=1.54) adds one, lab.samples() lists them"
                raise NotFound(not_found(f"no part has the name {sample!r}; {way_out}"))
            case _:
                numbers = ", ".join(str(one.id) for one in found)
                raise WrongValue(f"{len(found)} parts have the name {sample!r}; give the number of one: {numbers}")

    def add_sample(
        self,
        name: str,
        *,
        index: float | complex | None = None,
        index_std: float | None = None,
        metal: str | None = None,
        note: str | None = None,
        simulated: Mapping[str, Any] | None = None,
    ) -> Sample:
        """Adds a part of a material: an index of refraction (`1.54`, or `n + 1jk`), or a metal by name.

        `index_std` is its standard uncertainty (0.01 if omitted). `simulated` describes the surface that a simulated
        rig shows for it.
        """
        body = samples.request_of(name, index, index_std, metal, note)
        if simulated is not None:
            body["simulated"] = dict(simulated)
        return Sample(self._connection, self._connection.post("/samples", body))

    def measure(
        self,
        sample: str | int | Sample,
        *,
        recipe: str | int | None = None,
        specification: str | int | None = None,
        preset: Preset | None = None,
        plan: Mapping[str, Any] | None = None,
        theta_c_deg: Angles | None = None,
        phi_s_deg: Angles | None = None,
        poses: Poses | None = None,
        exposures_s: Iterable[float] | None = None,
        repeats: int | None = None,
        operator_name: str | None = None,
        lot: str | None = None,
        external_id: str | None = None,
    ) -> Scan:
        """Starts a scan of a part and returns it at once; `scan.wait()` waits for it.

        A `recipe` (name or number) states plan and fit, and the material of a part whose name is new. Without one,
        `preset` is `paper` (5 × 3 poses) or `full` (9 × 12), or give the angles, or the `poses` one by one as pairs of
        θc and φs; `plan` takes all fields of the plan of a request. With a `specification` the scan is judged once it is fitted (`scan.verdict`). Raises Invalid if
        the plan cannot run (`fields` lists why), Conflict if the rig is busy.
        """
        given = (plan, preset, theta_c_deg, phi_s_deg, poses, exposures_s, repeats)
        if recipe is None:
            request: dict[str, Any] = {"plan": plan_of(*given), "sample_id": self.sample(sample).id}
        elif any(part is not None for part in given):
            raise WrongValue("a recipe states the plan: give a recipe or a plan, not both")
        else:
            request = {"recipe": recipe, "sample_id": self._part(sample, recipe).id}
        facts = {
            "specification": specification,
            "operator_name": operator_name,
            "lot": lot,
            "external_id": external_id,
        }
        request |= {name: value for name, value in facts.items() if value is not None}
        return self.scan(self._connection.post("/scans", request)["id"])

    def _part(self, sample: str | int | Sample, recipe: str | int) -> Sample:
        """Returns the part, which is added with the material of the recipe if its name is new."""
        try:
            return self.sample(sample)
        except NotFound:
            material = self.recipe(recipe)["recipe"].get("material")
            if not isinstance(sample, str) or material is None:
                raise
        known = {name: value for name, value in material.items() if value is not None}
        known["kind"] = "dielectric" if "k" not in known else "conductor"
        body = {"name": sample, "material": known}
        return Sample(self._connection, self._connection.post("/samples", body))

    def recipes(self, *, limit: int | None = None) -> list[RecipeBody]:
        """Returns the recipes that are not archived, newest first."""
        return list(self._connection.pages("/recipes", {}, limit))

    def recipe(self, recipe: str | int) -> RecipeBody:
        """Returns the newest version of a recipe by its name or number. Raises NotFound if there is none."""
        return cast("RecipeBody", self._definition("recipes", recipe))

    def add_recipe(self, recipe: Mapping[str, Any]) -> RecipeBody:
        """Adds a recipe: `name`, `plan`, and optionally `fit`, `material`, `target_expanded_deg`, `layout`, `note`."""
        return cast("RecipeBody", self._connection.post("/recipes", dict(recipe)))

    def specifications(self, *, limit: int | None = None) -> list[SpecificationBody]:
        """Returns the specifications that are not archived, newest first."""
        return list(self._connection.pages("/specifications", {}, limit))

    def specification(self, specification: str | int) -> SpecificationBody:
        """Returns the newest version of a specification by its name or number. Raises NotFound if there is none."""
        return cast("SpecificationBody", self._definition("specifications", specification))

    def add_specification(self, specification: Mapping[str, Any]) -> SpecificationBody:
        """Adds a specification: `name`, `limits`, and optionally `decision` and `reference_plane`."""
        return cast("SpecificationBody", self._connection.post("/specifications", dict(specification)))

    def _definition(self, kind: str, which: str | int) -> Any:
        if isinstance(which, int):
            return self._connection.get(f"/{kind}/{which}")
        for found in self._connection.pages(f"/{kind}", {"name": which}, 1):
            return found
        raise NotFound(not_found(f"no {kind.removesuffix('s')} has the name {which!r}; lab.{kind}() lists them"))

    def estimate(
        self,
        sample: str | int | Sample,
        *,
        preset: Preset | None = None,
        plan: Mapping[str, Any] | None = None,
        theta_c_deg: Angles | None = None,
        phi_s_deg: Angles | None = None,
        poses: Poses | None = None,
        exposures_s: Iterable[float] | None = None,
        repeats: int | None = None,
    ) -> EstimateBody:
        """Returns time, disk space and operator steps of a scan. Nothing moves and nothing is stored."""
        request = {
            "sample_id": self.sample(sample).id,
            "plan": plan_of(plan, preset, theta_c_deg, phi_s_deg, poses, exposures_s, repeats),
        }
        return cast("EstimateBody", self._connection.post("/scans/estimate", request))

    def scan(self, number: int) -> Scan:
        """Returns a scan by its number."""
        return Scan(self._connection, self._connection.get(f"/scans/{number}"))

    def scans(
        self, *, sample: str | int | Sample | None = None, state: ScanState | None = None, limit: int | None = None
    ) -> list[Scan]:
        """Returns scans, newest first."""
        of = None if sample is None else self.sample(sample).id
        rows = self._connection.pages("/scans", {"sample_id": of, "state": state}, limit)
        return [Scan(self._connection, row) for row in rows]

    @overload
    def results(self, *, rows: Literal[True], limit: int | None = None, **filters: Any) -> list[Result]: ...

    @overload
    def results(
        self, *, rows: bool = False, limit: int | None = None, **filters: Any
    ) -> DataFrame | list[Result]: ...

    def results(
        self, *, rows: bool = False, limit: int | None = None, **filters: Any
    ) -> DataFrame | list[Result]:
        """Returns one short row per scan with its newest result, newest first.

        A filter is a parameter of `GET /results`: `part="B-17"`, `verdict="fail"`, `theta_r_deg_min=14.9`,
        `since="2026-11-01"`, `latest=True`, `sort="-theta_r_deg"`. A DataFrame; with `rows=True`, or without pandas, a
        list of typed rows.
        """
        # The usual columns by name: without `fields`, the daemon shortens long texts.
        found: list[Result] = list(self._connection.pages("/results", {"fields": "usual", **filters}, limit))
        frame = None if rows else tables.frame_of(found)
        return found if frame is None else frame

    def import_series(self, series: str | Path, *, skip_unreadable: bool = False) -> Scan:
        """Imports a recorded series and returns it as a scan.

        `series` is a zip archive of this machine (its name ends with .zip), or a folder of the daemon's machine. Without
        `skip_unreadable`, a frame that cannot be read refuses the series.
        """
        if str(series).lower().endswith(".zip"):
            archive = Path(series)
            params = {"name": archive.name, "skip_unreadable": skip_unreadable}
            answer = self._connection.upload("/imports/upload", archive, "application/zip", params)
            return self.scan(answer["scan_id"])
        body = {"folder": str(series), "skip_unreadable": skip_unreadable}
        return self.scan(self._connection.post("/imports", body, timeout_s=None)["scan_id"])

    def fit(self, number: int) -> Fit:
        """Returns a fit by its number."""
        return Fit(self._connection, self._connection.get(f"/fits/{number}"))

    def fits(
        self,
        *,
        sample: str | int | Sample | None = None,
        theta_r_deg_min: float | None = None,
        theta_r_deg_max: float | None = None,
        since: str | None = None,
        limit: int | None = None,
    ) -> list[Fit]:
        """Returns fits, newest first, by part, range of θr and time (`since`, RFC 3339)."""
        filters = {
            "sample_id": None if sample is None else self.sample(sample).id,
            "theta_r_deg_min": theta_r_deg_min,
            "theta_r_deg_max": theta_r_deg_max,
            "since": since,
        }
        return [Fit(self._connection, row) for row in self._connection.pages("/fits", filters, limit)]

    def compare(
        self,
        first: int | Scan,
        second: int | Scan,
        *,
        region: str | None = None,
        shared: Iterable[str] | None = None,
    ) -> Comparison:
        """Compares two scans by their newest fits: per parameter the difference, its U and E_n.

        `shared` names the lines of the budget with the same error in both scans; without it the records decide.
        Raises Conflict if a scan has no completed fit.
        """
        answer = self._connection.get("/comparisons", study_of([first, second], region, shared))
        return cast("Comparison", answer)

    def repeatability(
        self,
        scans: Iterable[int | Scan],
        *,
        parameter: str = "theta_r_deg",
        by: Literal["operator", "day"] | None = None,
        region: str | None = None,
        shared: Iterable[str] | None = None,
    ) -> Repeatability:
        """Compares the scatter of scans with the uncertainty that their newest fits state, and gives gauge R&R.

        Reproducibility is taken over operators or days (`by`). `shared` is as in `compare`.
        """
        params = study_of(scans, region, shared) | {"parameter": parameter}
        if by is not None:
            params["by"] = by
        return cast("Repeatability", self._connection.get("/repeatability", params))

    def map(self, number: int) -> Map:
        """Returns a map by its number."""
        return Map(self._connection, "maps", self._connection.get(f"/maps/{number}"))

    def contrast(self, number: int) -> Work:
        """Returns a measurement of the contrast by its number."""
        return Work(self._connection, "contrasts", self._connection.get(f"/contrasts/{number}"))

    def verdict(self, number: int) -> Work:
        """Returns a verdict by its number."""
        return Work(self._connection, "verdicts", self._connection.get(f"/verdicts/{number}"))

    def start_trace(self, scene: str, **options: Any) -> Files:
        """Traces polarised light through a scene (TOML); `options` are the fields of the request, e.g. `photons`."""
        begun = self._connection.post("/traces", {"scene": scene, **options})
        return self.trace(begun["id"])

    def trace(self, number: int) -> Files:
        """Returns a trace by its number."""
        return Files(self._connection, "traces", self._connection.get(f"/traces/{number}"))

    def calibrations(self, *, limit: int | None = None) -> list[CalibrationBody]:
        """Returns dark frames and white references that were taken, newest first."""
        return list(self._connection.pages("/calibrations", {}, limit))

    def events(self, since: int | None = None, *, positions: bool = False) -> Iterator[Event]:
        """Yields events as they happen, without end; `since` continues after an id, 0 begins with the first.

        With `positions`, events `rig` tell both positions five times a second while an axis moves. When the stream breaks off it is opened again, and continues after the last event.
        """
        return events.follow(self._connection, since, positions)


def study_of(scans: Iterable[int | Scan], region: str | None, shared: Iterable[str] | None) -> dict[str, Any]:
    """The parameters of a comparison or study."""
    ids = [scan.id if isinstance(scan, Scan) else scan for scan in scans]
    params: dict[str, Any] = {"scan_id": ids}
    if region is not None:
        params["region"] = region
    if shared is not None:
        params["shared"] = ",".join(shared) or "none"
    return params


def not_found(detail: str) -> Problem:
    """The problem of a name that nothing has."""
    return {
        "type": "urn:ridged:problem:not-found",
        "title": "not found",
        "status": 404,
        "code": "not-found",
        "detail": detail,
    }
