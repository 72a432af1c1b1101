"""Bodies of the HTTP API, as TypedDicts. Made by `tools/python_types.py` from the OpenAPI document; do not edit."""

from __future__ import annotations

from typing import Any, Literal, NotRequired, TypedDict

Activity = Literal["idle", "moving", "homing", "scanning", "paused", "not-connected"]
"""What the rig is doing."""

FitFindingCode = Literal["tails", "rounded-crests", "flat-lands", "translucent", "wedge-across", "lamp-azimuth", "white-reference", "non-linear", "lamp-drift", "index", "bad-block", "bad-pose"]
"""A known cause. Scripts compare its code."""

FitReferencePlane = Literal["turntable", "sample"]
"""The plane that angles refer to."""

FitStatus = Literal["converged", "at-bound", "rank-deficient", "stalled", "not-finite", "too-few-observations", "cancelled"]
"""How a fit ended. Scripts compare the word."""

FitTracerEnd = Literal["settled", "most-paths", "most-passes", "stopped"]
"""Why a tracing ended."""

FitVariantName = Literal["paper", "sawtooth", "traced"]
"""Names of the variants in the JSON form."""

FrameKind = Literal["sample", "dark", "flat"]
"""Kind of a frame."""

GaugeDesign = Literal["crossed", "parts-within-groups", "groups-within-parts", "parts-only", "groups-only"]
"""How parts and groups are combined."""

GroupedBy = Literal["operator", "day"]
"""What reproducibility is taken over."""

IncidentKind = Literal["alarm", "recovered"]
"""Whether something went wrong or is over."""

Loss = Literal["linear", "huber", "tukey"]
"""How residuals count."""

MaterialBody = dict[str, Any]
"""Nominal material: complex index N = n + ik with standard uncertainties."""

OnFailure = Literal["stop", "end"]
"""What follows a failed order of the queue."""

OperatorAction = Literal["cap-lens", "place-white-reference", "place-sample"]
"""A step of the operator at the rig, before which the scan cannot continue."""

OrderState = Literal["waiting", "running", "done", "failed", "removed"]
"""State of an order."""

Phase = Literal["dark", "flat", "sample", "done"]
"""Phase of a scan: the kind of the frames being taken, and done at its end."""

Pitch = float | list[float]
"""One number for both axes, or one for each."""

Preset = Literal["paper", "full"]
"""Named plans."""

QueueState = Literal["stopped", "running", "stopping", "paused"]
"""State of the queue."""

Role = Literal["viewer", "analyst", "operator", "admin"]
"""What the holder of a token may do. Every role may stop the rig."""

ScanOrigin = Literal["rig", "import"]
"""Where a scan comes from."""

ScanState = Literal["planned", "waiting-for-operator", "running", "pausing", "paused", "interrupted", "completed", "aborted", "failed"]
"""State of a scan."""

ScatterVerdict = Literal["consistent", "too-large", "small"]
"""Whether the scatter is as large as stated."""

SimulatedSurface = dict[str, Any]
"""The surface that a simulated rig renders for a sample; a real rig ignores it."""

TaskState = Literal["running", "completed", "failed", "cancelled", "interrupted"]
"""The state of a job."""

VarianceSource = Literal["part", "group", "interaction", "repeat"]
"""A source of variation."""

VariantChoice = Literal["paper", "sawtooth", "traced", "auto"]
"""Variant that the report is based on."""


class AreaBody(TypedDict):
    """A rectangle of a frame."""

    height_px: int
    left_px: int
    top_px: int
    width_px: int


class AxesBody(TypedDict):
    """Both axes."""

    phi_s: AxisBody
    theta_c: AxisBody


class AxisBody(TypedDict):
    """One axis."""

    homed: bool
    limit_max_deg: float
    limit_min_deg: float
    moving: NotRequired[bool | None]
    position_deg: NotRequired[float | None]
    referenced: bool
    serial: NotRequired[str | None]
    warnings: list[str]


class CalibrationBody(TypedDict):
    """A set of calibration frames."""

    created_at: str
    exposures_s: list[float]
    id: int
    kind: FrameKind
    n_frames: int
    scan_id: int
    theta_c_deg: list[float]
    valid: bool
    valid_until: str


class CameraBody(TypedDict):
    """The camera."""

    bit_depth: int
    description: str
    exposures_s: list[float]
    height_px: int
    saturation_dn: float
    width_px: int


class CertaintyBody(TypedDict):
    """Result of the live fit of the frames so far."""

    at: str
    elapsed_s: float
    id: int
    n_frames_used: int
    n_observations: int
    parameters: dict[str, UncertainBody]
    status: FitStatus
    variant: FitVariantName


class ComparedLine(TypedDict):
    """A line of the two budgets."""

    difference_std: float
    first_std: float
    line: str
    second_std: float
    shared: bool


class ComparedParameter(TypedDict):
    """A parameter of both results."""

    difference: NotRequired[Difference | None]
    first: ComparedValue
    lines: list[ComparedLine]
    name: str
    second: ComparedValue


class ComparedValue(TypedDict):
    """A value with its uncertainty, as the fit states it."""

    coverage_factor: NotRequired[float | None]
    expanded: NotRequired[float | None]
    std: NotRequired[float | None]
    value: NotRequired[float | None]


class Comparison(TypedDict):
    """Two results beside each other."""

    first: ResultOf
    notes: list[str]
    parameters: list[ComparedParameter]
    second: ResultOf
    shared_lines: list[SharedLine]


class ControllerBody(TypedDict):
    """A controller."""

    device_id: int
    firmware: str
    serial: str


class CurrentOrder(TypedDict):
    """The order whose scan has begun and has not ended."""

    operator: NotRequired[OperatorBody | None]
    order: OrderBody
    scan_state: ScanState


class CurveBody(TypedDict):
    """Predicted signal over φs at one tilt."""

    phi_s_deg: list[float]
    signal: list[float]
    theta_c_deg: float
    variant: FitVariantName


class CurvesBody(TypedDict):
    """A fit with its observations."""

    curves: list[CurveBody]
    fit_id: int
    observations: list[PointBody]
    peak: float


class DarkPlan(TypedDict):
    """Dark frames of a plan."""

    repeats: int


class DarkRequest(TypedDict):
    """Dark frames of a request."""

    repeats: NotRequired[int | None]


class DecisionRule(TypedDict):
    """Allowed risks; the documentation of the module states the rule."""

    max_false_accept_risk: NotRequired[float]
    max_false_reject_risk: NotRequired[float]


class DefinitionName(TypedDict):
    """A recipe or specification of an order. Its newest version at the start of the scan counts."""

    id: int
    name: str


class DefinitionRef(TypedDict):
    """The version of a definition that a scan used."""

    id: int
    name: str
    version: int


class Difference(TypedDict):
    """The difference of a parameter: second minus first."""

    agrees: bool
    coverage_factor: float
    expanded: float
    normalised: float
    std: float
    value: float


class EarlierName(TypedDict):
    """A name that a part had."""

    name: str
    until: str


class EarlierSample(TypedDict):
    """A part that a scan was assigned to."""

    sample_id: int
    sample_name: str
    until: str


class EstimateBody(TypedDict):
    """Estimate of a scan."""

    calibration_ids: list[int]
    disk_bytes: int
    disk_free_bytes: int
    disk_reserve_bytes: int
    duration_s: float
    n_frames: int
    n_shots: int
    operator_steps: list[OperatorBody]
    plan: Plan


class FieldProblem(TypedDict):
    """What is wrong with one value."""

    field: str
    message: str
    out_of_range: NotRequired[OutOfRange]


class FileFingerprint(TypedDict):
    """Size and hash of a file."""

    bytes: int
    sha256: str


class Fit(TypedDict):
    """A fit: its request and its state; from `status` on its report, once it has completed"""

    build: NotRequired[str]
    chi2_reduced: NotRequired[float | None]
    chi2_reduced_without_model: NotRequired[float | None]
    covariance: NotRequired[FitCovariance | None]
    created_at: str
    ended_at: NotRequired[str | None]
    error: NotRequired[FitError | None]
    findings: NotRequired[list[FitFinding]]
    fitted: NotRequired[list[FittedPoint]]
    forecast: NotRequired[Forecast | None]
    freedom: NotRequired[FitFreedom]
    id: int
    iterations: NotRequired[list[FitIteration]]
    left_out: NotRequired[list[WorkLeftOut]]
    model_discrepancy: NotRequired[float | None]
    n_frames_used: NotRequired[int]
    n_observations: NotRequired[int]
    notes: NotRequired[list[str]]
    parameters: NotRequired[FitParameters]
    program: NotRequired[str]
    progress: NotRequired[WorkProgress | None]
    reference_plane: NotRequired[FitReferencePlane]
    region: NotRequired[str | None]
    rejected_frames: NotRequired[list[FrameRejected]]
    request: FitRequest
    rms_residual: NotRequired[float | None]
    sample_id: int
    sample_name: str
    scan_id: int
    seconds: NotRequired[float]
    slope_distribution: NotRequired[FitSlopes | None]
    starts: NotRequired[FitStarts]
    state: TaskState
    status: NotRequired[FitStatus]
    timing_s: NotRequired[FitTiming]
    tracer: NotRequired[FitTracer | None]
    variant: VariantChoice
    variants: NotRequired[list[FitVariant]]
    warnings: NotRequired[list[str]]
    wedge_across: NotRequired[FitAcross | None]
    who: str


class FitAcross(TypedDict):
    """Azimuth of the facets from the stage's zero, and its possible causes; degrees."""

    azimuth_deg: float
    azimuth_std_deg: float
    azimuth_zero_deg: float
    azimuth_zero_std_deg: NotRequired[float | None]
    split: bool
    wedge_deg: float
    wedge_std_deg: NotRequired[float | None]


class FitCovariance(TypedDict):
    """Covariance of the parameters that the data determine (k = 1)."""

    parameters: list[str]
    units: list[str]
    values: list[list[float]]


class FitError(TypedDict):
    """Why a job has no result."""

    code: str
    detail: str


class FitFinding(TypedDict):
    """A cause that was found."""

    advice: str
    change_of_theta_r_deg: NotRequired[float | None]
    code: FitFindingCode
    explains: float


class FitFreedom(TypedDict):
    """Degrees of freedom of a budget's parts. The other parts count as exactly known."""

    counting: float
    model: float


class FitInterval(TypedDict):
    """Ends of an interval at the coverage of the report; null for an open end."""

    lower: NotRequired[float | None]
    upper: NotRequired[float | None]


class FitIteration(TypedDict):
    """One evaluation of the model on the way to the minimum."""

    accepted: bool
    cost: float
    error: float
    gradient: float
    seconds: float
    step: float


class FitParameter(TypedDict):
    """A parameter with its uncertainty."""

    bootstrap: NotRequired[FitInterval | None]
    budget: NotRequired[dict[str, float] | None]
    coverage_factor: NotRequired[float | None]
    degrees_of_freedom: NotRequired[float | None]
    expanded: NotRequired[float | None]
    identifiable: bool
    note: NotRequired[str | None]
    profile: NotRequired[FitInterval | None]
    std: NotRequired[float | None]
    value: NotRequired[float | None]


class FitParameters(TypedDict):
    """All parameters; angles in degrees."""

    alpha_u: FitParameter
    alpha_v: FitParameter
    azimuth_offset_deg: FitParameter
    background: FitParameter
    crest_radius: NotRequired[FitParameter | None]
    land_share: NotRequired[FitParameter | None]
    rho_d: FitParameter
    scale: FitParameter
    theta_r_deg: FitParameter
    tilt_offset_deg: FitParameter
    translucency: NotRequired[FitParameter | None]


class FitRequest(TypedDict):
    """A request for a fit."""

    bootstrap: NotRequired[int | None]
    fix: NotRequired[dict[str, float]]
    iterations: NotRequired[bool]
    judge: NotRequired[bool]
    loss: NotRequired[Loss]
    max_seconds: NotRequired[float | None]
    priors: NotRequired[dict[str, Prior]]
    profile: NotRequired[bool]
    region: NotRequired[str | None]
    scan_id: int
    shape: NotRequired[ShapeFile | None]
    starts: NotRequired[int | None]
    target_error: NotRequired[float | None]
    tolerance: NotRequired[float | None]
    variant: NotRequired[VariantChoice]


class FitSlopes(TypedDict):
    """Slope distribution of the facets."""

    alpha_half_width_u: NotRequired[float | None]
    alpha_half_width_v: NotRequired[float | None]
    name: str
    shape: NotRequired[float | None]


class FitStarts(TypedDict):
    """Outcomes of the starts."""

    at_minimum: int
    elsewhere: int
    not_converged: int
    tried: int


class FitTiming(TypedDict):
    """Durations in seconds; filled in by the caller that has a clock."""

    fit: float
    read: float
    reduce: float


class FitTracer(TypedDict):
    """What the ray tracer did for a fit."""

    end: FitTracerEnd
    error: float
    height_map: NotRequired[RidgeFacts | None]
    passes: int
    paths_per_pose: int
    polarised: bool
    profile_theta_r_deg: NotRequired[float | None]
    profile_turned: NotRequired[bool]


class FitVariant(TypedDict):
    """One variant in the comparison."""

    alpha_u: NotRequired[float | None]
    alpha_v: NotRequired[float | None]
    chi2_reduced_without_model: float
    qaic: float
    rho_d: NotRequired[float | None]
    rms_residual: float
    status: FitStatus
    theta_r_deg: NotRequired[float | None]
    variant: FitVariantName


class FittedPoint(TypedDict):
    """An observation with the value that the fit expects; angles as recorded."""

    fitted: float
    phi_s_deg: float
    sigma: float
    signal: float
    theta_c_deg: float


class FlatPlan(TypedDict):
    """White-reference frames of a plan."""

    exposures_s: list[float]
    repeats: int
    theta_c_deg: list[float]


class FlatRequest(TypedDict):
    """White-reference frames of a request."""

    exposures_s: NotRequired[list[float] | None]
    repeats: NotRequired[int | None]
    theta_c_deg: NotRequired[Values | None]


class Forecast(TypedDict):
    """Time, work and error that a calculation is expected to take."""

    amount: NotRequired[ForecastAmount | None]
    at_limit: NotRequired[ForecastAtLimit | None]
    at_most: bool
    cut_short: NotRequired[bool]
    error: NotRequired[ForecastError | None]
    parts: NotRequired[list[ForecastPart]]
    seconds: float
    uncut_seconds: NotRequired[float | None]


class ForecastAmount(TypedDict):
    """Countable work."""

    count: int
    of: str


class ForecastAtLimit(TypedDict):
    """What random sampling reaches at a time limit."""

    count: NotRequired[int | None]
    error: NotRequired[float | None]


class ForecastError(TypedDict):
    """An expected error."""

    of: str
    value: float


class ForecastPart(TypedDict):
    """Seconds of a part."""

    seconds: float
    what: str


class FrameBody(TypedDict):
    """A frame."""

    accepted: bool
    bytes: int
    exposure_s: float
    file: str
    height_px: int
    id: int
    image: str
    kind: FrameKind
    max_dn: int
    mean_dn: float
    original_sha256: NotRequired[str | None]
    phi_s_deg: float
    reason: NotRequired[str | None]
    repeat: int
    saturated_px: int
    scan_id: int
    sha256: str
    tag: NotRequired[TagBody | None]
    theta_c_deg: float
    timestamp: str
    width_px: int


class FrameRejected(TypedDict):
    """A frame that the reduction left out, with its reason."""

    detail: str
    file: str
    reason: str


class Gauge(TypedDict):
    """A gauge R&R study."""

    balanced: bool
    by: NotRequired[GroupedBy | None]
    design: GaugeDesign
    distinct_categories: NotRequired[GaugeNumber | None]
    gauge: GaugeSpread
    gauge_percent: NotRequired[GaugeNumber | None]
    interaction_pooled: bool
    interaction_probability: NotRequired[float | None]
    n_groups: int
    n_parts: int
    notes: list[str]
    part_to_part: NotRequired[GaugeSpread | None]
    repeatability: GaugeSpread
    reproducibility: NotRequired[GaugeSpread | None]
    rows: list[VarianceRow]
    total: NotRequired[GaugeSpread | None]


class GaugeNumber(TypedDict):
    """A number with its interval."""

    interval: NotRequired[list[float] | None]
    note: NotRequired[str | None]
    value: float


class GaugeSpread(TypedDict):
    """A standard deviation with its degrees of freedom and interval."""

    degrees_of_freedom: NotRequired[float | None]
    interval: NotRequired[list[float] | None]
    note: NotRequired[str | None]
    percent_of_total: NotRequired[float | None]
    std: float


class GeometryBody(TypedDict):
    """Positions of lamp and camera."""

    azimuth_zero_deg: float
    lens_angular_radius_deg: NotRequired[float | None]
    light_angular_radius_deg: NotRequired[float | None]
    light_azimuth_deg: float
    theta_l_deg: float
    wavelength_nm: NotRequired[float | None]


Grid = TypedDict("Grid", {"from": float, "step": float, "to": float})
"""Evenly spaced values."""


class HistogramBody(TypedDict):
    """A histogram of 64 bins of equal width."""

    bin_dn: int
    pixels: list[int]


class HolderBody(TypedDict):
    """Who holds the rig."""

    name: str
    until: NotRequired[str | None]
    who: str


class IncidentBody(TypedDict):
    """An alarm or a recovery."""

    at: str
    attended: NotRequired[bool | None]
    code: str
    id: int
    kind: IncidentKind
    message: str
    points: list[int]
    took_s: NotRequired[float | None]


class LeaseBody(TypedDict):
    """A lease that was taken."""

    expires_at: str
    id: str
    name: str
    taken_from: NotRequired[HolderBody | None]
    who: str


class LeaseStateBody(TypedDict):
    """State of the lease."""

    holder: NotRequired[HolderBody | None]
    own: bool


class LeftOutScan(TypedDict):
    """A scan that is not part of the study."""

    scan_id: int
    why: str


class ObservationBody(TypedDict):
    """A reduced measurement."""

    n_frames: int
    phi_s_deg: float
    sigma: float
    signal: float
    theta_c_deg: float


class ObservationsBody(TypedDict):
    """Observations of a scan."""

    absolute: bool
    complete: bool
    items: list[ObservationBody]
    next_cursor: NotRequired[str | None]
    region: NotRequired[str | None]
    rejected_frames: list[FrameRejected]
    scan_id: int
    warnings: list[str]


class OperatorBody(TypedDict):
    """An operator step."""

    action: OperatorAction
    message: str


class OrderBody(TypedDict):
    """An order of the queue."""

    created_at: str
    external_id: NotRequired[str | None]
    failures: int
    id: int
    lot: NotRequired[str | None]
    note: NotRequired[str | None]
    operator_name: NotRequired[str | None]
    part: str
    reason: NotRequired[str | None]
    recipe: DefinitionName
    sample_id: int
    scan_id: NotRequired[int | None]
    specification: NotRequired[DefinitionName | None]
    state: OrderState
    verdict: NotRequired[str | None]
    who: str


class OrderCounts(TypedDict):
    """Number of orders by state."""

    done: int
    failed: int
    removed: int
    running: int
    waiting: int


class OutOfRange(TypedDict):
    """A value and the range that it should be in, in the unit of the field."""

    lower: float
    upper: float
    value: float


class PictureBody(TypedDict):
    """A picture of a frame."""

    height_px: int
    high_dn: float
    low_dn: float
    path: str
    width_px: int


class Plan(TypedDict):
    """A whole plan, nothing left open."""

    dark: DarkPlan
    exposures_s: list[float]
    flat: FlatPlan
    phi_s_deg: list[float]
    poses: NotRequired[list[PlanPose]]
    reference_every: NotRequired[int]
    repeats: int
    reuse_calibrations: bool
    theta_c_deg: list[float]


class PlanPose(TypedDict):
    """A pose that a plan states."""

    phi_s_deg: float
    theta_c_deg: float


class PlanRequest(TypedDict):
    """A plan as a file or a request states it: everything may be left out that a preset or the rig's settings know. Unknown keys are errors."""

    dark: NotRequired[DarkRequest]
    exposures_s: NotRequired[list[float] | None]
    flat: NotRequired[FlatRequest]
    phi_s_deg: NotRequired[Values | None]
    poses: NotRequired[list[PlanPose] | None]
    preset: NotRequired[Preset | None]
    reference_every: NotRequired[int | None]
    repeats: NotRequired[int | None]
    reuse_calibrations: NotRequired[bool | None]
    theta_c_deg: NotRequired[Values | None]


class PointBody(TypedDict):
    """An observation and the prediction of the fit."""

    phi_s_deg: float
    predicted: float
    residual: float
    sigma: float
    signal: float
    theta_c_deg: float


class PreviewAnswer(TypedDict):
    """A preview."""

    area: AreaBody
    defects_known: bool
    frames: list[PreviewFrameBody]
    lamp: bool
    phi_s_deg: float
    referenced: bool
    suggestion: NotRequired[SuggestionBody | None]
    theta_c_deg: float


class PreviewFrameBody(TypedDict):
    """A frame of a preview. The figures are those of the area without its defect pixels."""

    defect_px: int
    exposure_s: float
    focus: NotRequired[float | None]
    height_px: int
    histogram: HistogramBody
    id: int
    image: PictureBody
    max_dn: int
    mean_dn: float
    median_dn: int
    min_dn: int
    pixels: str
    saturated_px: int
    taken_at: str
    width_px: int


class Prior(TypedDict):
    """Prior knowledge of a parameter: a value and its standard uncertainty."""

    std: float
    value: float


class Problem(TypedDict):
    """A problem by RFC 9457 (`application/problem+json`)."""

    code: Literal["analysis-failed", "bad-json", "bad-request", "body-too-large", "body-too-slow", "broken-off", "busy", "camera-failed", "camera-replaced", "camera-temperature", "data-folder-gone", "disk-failed", "disk-full", "disk-silent", "export-failed", "external-condition", "external-id-taken", "fit-not-started", "forbidden-host", "forbidden-origin", "forbidden-region", "frame-damaged", "frame-stale", "frame-unreadable", "frames-rejected", "homing-blocked", "host-suspended", "idempotency-mismatch", "internal", "invalid-value", "jog-ended", "lamp-failed", "lease-held", "lease-lost", "map-not-written", "method-not-allowed", "name-taken", "no-contrast", "no-fit", "no-lamp-switch", "no-map", "no-observations", "no-rig", "no-token", "no-trace", "not-by-proxy", "not-found", "not-judged", "other-stages", "other-step", "outside-limits", "plan-invalid", "point-skipped", "port-failed", "port-forbidden", "port-in-use", "port-missing", "port-not-serial", "port-unreachable", "queue-empty", "queue-waits", "reference-changed", "region-needed", "region-unknown", "role-too-low", "scan-interrupted", "scan-paused", "scan-unrecorded", "series-invalid", "stage-address-conflict", "stage-disagrees", "stage-disconnected", "stage-fault", "stage-foreign-traffic", "stage-homing-failed", "stage-interrupted", "stage-lost-steps", "stage-missed", "stage-no-scale", "stage-no-such-axis", "stage-not-carried-out", "stage-not-referenced", "stage-other-device", "stage-port-changed", "stage-power-cycled", "stage-protocol", "stage-refused", "stage-setting-wrong", "stage-settings-restored", "stage-silent", "stage-slipped", "stage-stalled", "stage-supply", "stage-timed-out", "stage-wrong-device", "stages-accepted", "stages-changed", "stages-pinned", "state-conflict", "stop-unconfirmed", "stopped", "stopping", "store-damaged", "store-failed", "store-in-use", "store-locked", "store-missing", "too-many-bodies", "too-many-connections", "too-many-guesses", "too-many-streams", "trace-not-written", "unknown-field", "version-conflict", "wrong-content-encoding", "wrong-content-type", "wrong-token"]
    detail: str
    errors: NotRequired[list[FieldProblem]]
    holder: NotRequired[HolderBody]
    status: int
    title: str
    type: str


class ProgressBody(TypedDict):
    """Progress of a scan."""

    elapsed_s: float
    fraction: float
    frames_done: int
    frames_total: int
    phase: NotRequired[Phase | None]
    shots_done: int
    shots_total: int
    time_left_s: NotRequired[float | None]


class QueueBody(TypedDict):
    """The queue."""

    changed_at: NotRequired[str | None]
    counts: OrderCounts
    current: NotRequired[CurrentOrder | None]
    message: str
    next: NotRequired[OrderBody | None]
    on_failure: OnFailure
    reason: NotRequired[str | None]
    state: QueueState
    who: NotRequired[str | None]


class Recipe(TypedDict):
    """How a part is measured: the keys of docs/examples/recipe.toml."""

    fit: NotRequired[RecipeFit]
    layout: NotRequired[RecipeLayout | None]
    material: NotRequired[RecipeMaterial | None]
    name: str
    note: NotRequired[str | None]
    plan: PlanRequest
    target_expanded_deg: NotRequired[float | None]


class RecipeBody(TypedDict):
    """One version of a recipe."""

    archived: bool
    id: int
    name: str
    newest_version: int
    recipe: Recipe
    saved_at: str
    version: int
    who: str


class RecipeFit(TypedDict):
    """The fit of a recipe: options of POST /fits without those of a single scan."""

    bootstrap: NotRequired[int | None]
    fix: NotRequired[dict[str, float]]
    judge: NotRequired[bool]
    loss: NotRequired[Loss]
    max_seconds: NotRequired[float | None]
    priors: NotRequired[dict[str, Prior]]
    profile: NotRequired[bool]
    region: NotRequired[str | None]
    starts: NotRequired[int | None]
    target_error: NotRequired[float | None]
    tolerance: NotRequired[float | None]
    variant: NotRequired[VariantChoice]


class RecipeLayout(TypedDict):
    """A board of square patches, as `[sample.layout]` of a manifest."""

    centre_mm: NotRequired[list[float]]
    even_patches: NotRequired[str | None]
    odd_patches: NotRequired[str | None]
    patch_size_mm: float
    patches_x: int
    patches_y: int


class RecipeMaterial(TypedDict):
    """Nominal material of a part: complex index N = n + ik with standard uncertainties."""

    eta: float
    eta_std: NotRequired[float | None]
    k: NotRequired[float | None]
    k_std: NotRequired[float | None]


class Repeatability(TypedDict):
    """Scatter of several scans, and gauge R&R."""

    gauge: NotRequired[Gauge | None]
    gauge_note: NotRequired[str | None]
    left_out: list[LeftOutScan]
    parameter: str
    results: list[StudiedResult]
    scatter: NotRequired[Scatter | None]
    shared_lines: list[SharedLine]


class Result(TypedDict):
    """A scan with its newest fit and verdict. Without `fields`, a row has the columns up to `ended_at` that a list needs and at most 600 bytes: texts that are too long for it are shortened. Uncertainties have three significant digits, values end at the same decimal; /fits/{id} has all digits"""

    alpha_u: NotRequired[float | None]
    alpha_u_std: NotRequired[float | None]
    alpha_v: NotRequired[float | None]
    alpha_v_std: NotRequired[float | None]
    archived: NotRequired[bool | None]
    azimuth_offset_deg: NotRequired[float | None]
    azimuth_offset_deg_std: NotRequired[float | None]
    background: NotRequired[float | None]
    background_std: NotRequired[float | None]
    coverage_factor: NotRequired[float | None]
    created_at: NotRequired[str | None]
    crest_radius: NotRequired[float | None]
    crest_radius_std: NotRequired[float | None]
    ended_at: NotRequired[str | None]
    eta: NotRequired[float | None]
    external_id: NotRequired[str | None]
    finding: NotRequired[Literal["tails", "rounded-crests", "flat-lands", "translucent", "wedge-across", "lamp-azimuth", "white-reference", "non-linear", "lamp-drift", "index", "bad-block", "bad-pose", None]]
    fit_id: NotRequired[int | None]
    fitted_at: NotRequired[str | None]
    k: NotRequired[float | None]
    land_share: NotRequired[float | None]
    land_share_std: NotRequired[float | None]
    lot: NotRequired[str | None]
    material: NotRequired[Literal["dielectric", "conductor", None]]
    note: NotRequired[str | None]
    operator_name: NotRequired[str | None]
    origin: NotRequired[Literal["rig", "import", None]]
    part: NotRequired[str | None]
    recipe: NotRequired[str | None]
    recipe_version: NotRequired[int | None]
    region: NotRequired[str | None]
    rho_d: NotRequired[float | None]
    rho_d_std: NotRequired[float | None]
    rms_residual: NotRequired[float | None]
    sample_id: NotRequired[int | None]
    scale: NotRequired[float | None]
    scale_std: NotRequired[float | None]
    scan_id: NotRequired[int | None]
    shortened: NotRequired[bool]
    specification: NotRequired[str | None]
    state: NotRequired[Literal["planned", "waiting-for-operator", "running", "pausing", "paused", "interrupted", "completed", "aborted", "failed", None]]
    status: NotRequired[Literal["converged", "at-bound", "rank-deficient", "stalled", "not-finite", "too-few-observations", "cancelled", None]]
    tags: NotRequired[list[str]]
    theta_r_deg: NotRequired[float | None]
    theta_r_deg_expanded: NotRequired[float | None]
    theta_r_deg_std: NotRequired[float | None]
    tilt_offset_deg: NotRequired[float | None]
    tilt_offset_deg_std: NotRequired[float | None]
    translucency: NotRequired[float | None]
    translucency_std: NotRequired[float | None]
    variant: NotRequired[Literal["paper", "sawtooth", "traced", None]]
    verdict: NotRequired[Literal["pass", "fail", "cannot-tell", None]]
    verdict_id: NotRequired[int | None]
    verdict_matches: NotRequired[bool | None]
    who: NotRequired[str | None]


class ResultOf(TypedDict):
    """The scan and fit of a result."""

    fit_id: int
    measured_at: str
    operator_name: NotRequired[str | None]
    part: str
    region: NotRequired[str | None]
    sample_id: int
    scan_id: int
    variant: FitVariantName


class RidgeFacts(TypedDict):
    """Properties of a height map; lengths in µm."""

    explained: float
    filled_share: NotRequired[float]
    height_um: float
    lean_azimuth_deg: float
    lobe_error_deg: NotRequired[float]
    period_um: float
    ridges: int
    sample_um: float
    theta_r_deg: float
    unevenness_um: float
    unseen_share: NotRequired[float]


class RigBody(TypedDict):
    """State of the rig."""

    activity: Activity
    axes: AxesBody
    camera: CameraBody
    connected: bool
    description: str
    failure: NotRequired[RigProblem | None]
    geometry: GeometryBody
    problem: NotRequired[RigProblem | None]
    refused_stages: NotRequired[StagesBody | None]
    scan_id: NotRequired[int | None]
    scan_reason: NotRequired[str | None]
    scan_state: NotRequired[ScanState | None]
    simulated: bool
    time_scale: float


class RigProblem(TypedDict):
    """What is wrong with the stages."""

    code: str
    detail: str


class SampleBody(TypedDict):
    """A part."""

    created_at: str
    earlier_names: list[EarlierName]
    id: int
    material: MaterialBody
    name: str
    note: NotRequired[str | None]
    simulated: NotRequired[SimulatedSurface | None]


class ScanBody(TypedDict):
    """A scan."""

    archived: bool
    calibration_ids: list[int]
    camera: ScanCameraBody
    created_at: str
    earlier_samples: list[EarlierSample]
    ended_at: NotRequired[str | None]
    external_id: NotRequired[str | None]
    frames_rejected: int
    id: int
    lot: NotRequired[str | None]
    note: NotRequired[str | None]
    operator: NotRequired[OperatorBody | None]
    operator_name: NotRequired[str | None]
    order_id: NotRequired[int | None]
    origin: ScanOrigin
    plan: Plan
    progress: ProgressBody
    reason: NotRequired[str | None]
    recipe: NotRequired[DefinitionRef | None]
    regions: list[str]
    sample_id: int
    sample_name: str
    specification: NotRequired[DefinitionRef | None]
    started_at: NotRequired[str | None]
    state: ScanState
    tags: list[str]
    target_expanded_deg: NotRequired[float | None]
    who: str


class ScanCameraBody(TypedDict):
    """Properties of the camera that displaying its frames needs."""

    height_px: int
    saturation_dn: float
    states_exposure_start: NotRequired[bool | None]
    width_px: int


class Scatter(TypedDict):
    """Scatter within parts beside the stated uncertainty."""

    chi_square: NotRequired[float | None]
    degrees_of_freedom: int
    mean: NotRequired[float | None]
    message: NotRequired[str | None]
    n: int
    n_parts: int
    probability: NotRequired[float | None]
    ratio: NotRequired[float | None]
    scattering_std: float
    stated_expanded: float
    stated_std: float
    std: float
    std_interval: list[float]
    verdict: NotRequired[ScatterVerdict | None]


class SessionBody(TypedDict):
    """Who sends requests."""

    logged_in: bool
    role: Role
    who: str


class ShapeFile(TypedDict):
    """The part's own shape, measured: a profile or a height map (see `docs/reference/height-maps.md`)."""

    content: FileContent
    height_unit_um: NotRequired[float | None]
    name: str
    pitch_um: NotRequired[Pitch | None]


class SharedLine(TypedDict):
    """A line of the budget, and whether it has the same error in all scans."""

    line: str
    shared: bool
    why: str


class Specification(TypedDict):
    """Limits and decision rule of one kind of part."""

    decision: NotRequired[DecisionRule]
    limits: dict[str, ToleranceLimits]
    name: str
    reference_plane: NotRequired[FitReferencePlane | None]


class SpecificationBody(TypedDict):
    """One version of a specification."""

    archived: bool
    id: int
    name: str
    newest_version: int
    saved_at: str
    specification: Specification
    version: int
    who: str


class StagesBody(TypedDict):
    """Two controllers."""

    phi_s: ControllerBody
    theta_c: ControllerBody


class SuggestionBody(TypedDict):
    """Exposures for a scan."""

    exposures_s: list[float]
    reason: NotRequired[str | None]


class TagBody(TypedDict):
    """What a camera's program states with a frame."""

    counter: NotRequired[int | None]
    exposure_s: NotRequired[float | None]
    exposure_start: NotRequired[str | None]
    gain: NotRequired[float | None]
    serial: NotRequired[str | None]
    temperature_c: NotRequired[float | None]


class ToleranceLimits(TypedDict):
    """Tolerance limits; one of them may be missing."""

    lower: NotRequired[float | None]
    upper: NotRequired[float | None]


class UncertainBody(TypedDict):
    """A parameter with its standard uncertainty."""

    coverage_factor: NotRequired[float]
    std: float
    value: float


class VarianceRow(TypedDict):
    """A row of the analysis of variance."""

    degrees_of_freedom: int
    mean_square: float
    source: VarianceSource
    sum_of_squares: float


class WorkLeftOut(TypedDict):
    """Something that a computation omits."""

    cost: NotRequired[float | None]
    what: str
    why: str


class WorkProgress(TypedDict):
    """A snapshot of a job's progress."""

    elapsed_s: float
    fraction: float
    queued_position: NotRequired[int | None]
    stage: str
    time_left_s: NotRequired[float | None]


FileContent = str | FileFingerprint
"""The content of a file as it is described: base64 in a request, and what is kept of it in the request of a job."""


StudiedResult = ResultOf | dict[str, Any]
"""A result of the study."""


Values = list[float] | Grid
"""A list of numbers, written out or as a grid."""
