// The bodies of the HTTP API (/api/v1) as this page reads them; the daemon's OpenAPI document is the source.

export type AxisName = 'theta_c' | 'phi_s';

export interface Axis {
  readonly position_deg: number | null;
  /** null where the stages do not answer: it may move. */
  readonly moving: boolean | null;
  readonly homed: boolean;
  readonly warnings: readonly string[];
  readonly serial: string | null;
  readonly limit_min_deg: number;
  readonly limit_max_deg: number;
}

export interface Rig {
  readonly connected: boolean;
  readonly problem: { readonly code: string; readonly detail: string } | null;
  readonly simulated: boolean;
  readonly description: string;
  readonly camera: {
    readonly description: string;
    readonly width_px: number;
    readonly height_px: number;
    readonly bit_depth: number;
    readonly saturation_dn: number;
    readonly exposures_s: readonly number[];
  } | null;
  readonly time_scale: number;
  readonly axes: Readonly<Record<AxisName, Axis>>;
  readonly activity: 'idle' | 'moving' | 'homing' | 'scanning' | 'paused' | 'not-connected';
  readonly geometry?: { readonly wavelength_nm: number | null };
  readonly scan_id: number | null;
  readonly scan_state: ScanState | null;
  readonly scan_reason: string | null;
}

export type Material =
  | { readonly kind: 'dielectric'; readonly eta: number; readonly eta_std: number }
  | { readonly kind: 'conductor'; readonly eta: number; readonly k: number; readonly eta_std: number; readonly k_std: number };

export interface Sample {
  readonly id: number;
  readonly name: string;
  readonly material: Material;
  readonly note: string | null;
  readonly simulated: unknown;
}

export type ScanState =
  | 'planned'
  | 'waiting-for-operator'
  | 'running'
  | 'pausing'
  | 'paused'
  | 'interrupted'
  | 'completed'
  | 'aborted'
  | 'failed';

export interface Plan {
  readonly theta_c_deg: readonly number[];
  readonly phi_s_deg: readonly number[];
  readonly exposures_s: readonly number[];
  readonly repeats: number;
}

export interface OperatorStep {
  readonly action: 'cap-lens' | 'place-white-reference' | 'place-sample';
  readonly message: string;
}

export interface Progress {
  readonly phase: 'dark' | 'flat' | 'sample' | 'done';
  readonly frames_done: number;
  readonly frames_total: number;
  readonly fraction: number;
  readonly elapsed_s: number;
  readonly time_left_s: number | null;
}

export interface Scan {
  readonly id: number;
  readonly sample_id: number;
  readonly sample_name: string;
  readonly state: ScanState;
  readonly reason: string | null;
  readonly origin: 'rig' | 'import';
  readonly operator: OperatorStep | null;
  readonly plan: Plan;
  readonly progress: Progress | null;
  readonly frames_rejected?: number;
  /** Regions of a sample with a layout; a fit is of one of them. */
  readonly regions?: readonly string[];
  /** Calibrations that it uses, its own included. */
  readonly calibration_ids?: readonly number[];
  readonly created_at: string;
  readonly started_at: string | null;
  readonly ended_at: string | null;
}

export interface Estimate {
  readonly n_frames: number;
  readonly n_shots: number;
  readonly duration_s: number;
  readonly disk_bytes: number;
  readonly disk_free_bytes: number | null;
  readonly operator_steps: readonly OperatorStep[];
  /** Calibrations of earlier scans that it would use. */
  readonly calibration_ids?: readonly number[];
  readonly plan: Plan;
}

/** Dark or white-reference frames that scans after it may use. */
export interface Calibration {
  readonly id: number;
  readonly kind: 'dark' | 'flat';
  /** The scan that took them. */
  readonly scan_id: number;
  readonly exposures_s: readonly number[];
  /** Empty for dark frames. */
  readonly theta_c_deg: readonly number[];
  readonly n_frames: number;
  readonly created_at: string;
  readonly valid_until: string;
  readonly valid: boolean;
}

export interface FrameRow {
  readonly id: number;
  readonly scan_id: number;
  readonly kind: 'sample' | 'dark' | 'flat';
  readonly theta_c_deg: number;
  readonly phi_s_deg: number;
  readonly exposure_s: number;
  readonly repeat: number;
  readonly mean_dn: number | null;
  readonly max_dn: number | null;
  /** Missing where the frame is known by its event alone. */
  readonly width_px?: number;
  readonly height_px?: number;
  readonly saturated_px: number | null;
  readonly accepted: boolean;
  readonly reason: string | null;
  readonly image: string;
}

export interface Parameter {
  readonly value: number | null;
  readonly std: number | null;
  readonly expanded: number | null;
  readonly coverage_factor: number | null;
  readonly identifiable: boolean;
  readonly budget: Readonly<Record<string, number>> | null;
  readonly note?: string | null;
  readonly reason?: string | null;
  /** Where it was asked for. */
  readonly profile?: { readonly lower: number | null; readonly upper: number | null } | null;
}

export interface RejectedFrame {
  readonly file: string;
  readonly reason: string;
  readonly detail?: string | null;
}

/** A known trouble of sample, detector or lamp that a fit found. */
export interface Finding {
  readonly code: string;
  /** Share of χ² that goes with it. */
  readonly explains: number;
  readonly change_of_theta_r_deg: number | null;
  readonly advice: string;
}

/** A finished fit: the object of `ridged fit --json` with what the store adds. */
export interface FitResult {
  readonly variant: string;
  readonly status: string;
  readonly n_observations: number;
  readonly n_frames_used: number;
  readonly region: string | null;
  readonly parameters: Readonly<Record<string, Parameter>>;
  /** The plane that ridge angle and azimuth refer to; fits kept from before do not say it. */
  readonly reference_plane?: 'turntable' | 'sample';
  readonly rms_residual: number | null;
  readonly model_discrepancy: number | null;
  readonly chi2_reduced: number | null;
  readonly chi2_reduced_without_model: number | null;
  readonly rejected_frames: readonly RejectedFrame[];
  readonly warnings: readonly string[];
  /** Worth knowing, with nothing to do; fits kept from before have none. */
  readonly notes?: readonly string[];
  /** What explains the residual, most first; fits kept from before have none. */
  readonly findings?: readonly Finding[];
  readonly variants: readonly {
    readonly variant: string;
    readonly status?: string | null;
    readonly rms_residual: number | null;
    readonly theta_r_deg: number | null;
  }[];
  readonly left_out: readonly LeftOut[];
  /** Where the ray tracer worked. */
  readonly tracer?: Tracer | null;
  readonly starts?: { readonly tried: number; readonly at_minimum: number; readonly elsewhere: number; readonly not_converged: number };
  readonly timing_s: Readonly<Record<string, number>>;
  readonly program: string;
}

/** What the ray tracer did for a fit. */
export interface Tracer {
  readonly paths_per_pose: number;
  /** Standard error of a radiance, as a share of the largest. */
  readonly error: number;
  readonly polarised: boolean;
  /** Effective ridge angle of the shape that came with the request, by its heights. */
  readonly profile_theta_r_deg?: number | null;
  /** What that shape was made of, where it is a height map. */
  readonly height_map?: { readonly ridges: number; readonly period_um: number; readonly height_um: number; readonly explained: number } | null;
}

/** What a calculation will take, told before it starts; it stays with the result. */
export interface Forecast {
  readonly seconds: number;
  readonly at_most: boolean;
  readonly parts?: readonly { readonly what: string; readonly seconds: number }[];
  readonly amount?: { readonly count: number; readonly of: string };
  readonly error?: { readonly value: number; readonly of: string };
  /** The time allowed is too short for what was asked for. */
  readonly cut_short: boolean;
  /** Seconds that all of it would take, where a limit cuts it. */
  readonly uncut_seconds?: number;
  /** What a limit leaves of work that is drawn at random; amount and error are of all of it. */
  readonly at_limit?: { readonly count?: number; readonly error?: number };
}

/** Kinds of jobs, as they appear in paths. */
export type JobKind = 'fits' | 'maps' | 'contrasts' | 'verdicts' | 'traces';

export type JobState = 'running' | 'completed' | 'failed' | 'cancelled' | 'interrupted';

/** Progress of a running job. */
export interface JobProgress {
  readonly stage: string;
  readonly fraction: number;
  readonly elapsed_s: number;
  readonly time_left_s: number | null;
  /** 1 for the next to start; only while the job waits. */
  readonly queued_position?: number;
}

/** What jobs of all kinds have in common. */
export interface Job {
  readonly id: number;
  readonly scan_id: number | null;
  readonly state: JobState;
  readonly created_at: string;
  readonly progress?: JobProgress;
  readonly forecast?: Forecast;
  /** Run time. */
  readonly seconds?: number;
  readonly error?: { readonly code: string; readonly detail: string } | null;
  readonly left_out?: readonly LeftOut[];
}

/** What was asked of a fit; older ones kept less of it. */
export interface FitAsked {
  readonly variant?: string;
  readonly region?: string | null;
  readonly judge?: boolean;
  readonly loss?: string;
  readonly fix?: Readonly<Record<string, number>>;
  readonly priors?: Readonly<Record<string, { readonly value: number; readonly std: number }>>;
  readonly profile?: boolean;
  readonly bootstrap?: number | null;
  readonly starts?: number | null;
  readonly tolerance?: number | null;
  readonly max_seconds?: number | null;
  readonly target_error?: number | null;
  readonly shape?: { readonly name?: string } | null;
}

export interface Fit extends Job, Partial<FitResult> {
  readonly scan_id: number;
  readonly request?: FitAsked;
  readonly sample_id?: number;
  readonly sample_name?: string;
}

/** What the fit that runs along with a scan says of the frames so far. */
export interface Certainty {
  readonly id: number;
  /** Time that the rig had spent moving and exposing. */
  readonly elapsed_s: number;
  readonly n_observations: number;
  readonly n_frames_used: number;
  readonly variant: string;
  readonly status: string;
  /** By name; what the frames so far cannot tell is missing. */
  readonly parameters: Readonly<Record<string, { readonly value: number; readonly std: number }>>;
}

export interface CurvePoint {
  readonly theta_c_deg: number;
  readonly phi_s_deg: number;
  readonly signal: number;
  readonly sigma: number;
  readonly n_frames?: number;
  /** The fit's own variant at this pose; null before there is a fit. */
  readonly predicted: number | null;
  /** (signal − predicted) / peak. */
  readonly residual: number | null;
}

export interface Curves {
  /** Largest observation. */
  readonly peak: number;
  readonly observations: readonly CurvePoint[];
  readonly curves: readonly {
    readonly variant: string;
    readonly theta_c_deg: number;
    readonly phi_s_deg: readonly number[];
    readonly signal: readonly number[];
  }[];
}

/** A map, a contrast table or a verdict. */
export interface ScanJob extends Job {
  readonly scan_id: number;
  readonly request: { readonly specification?: Specification; readonly region?: string | null };
  readonly left_out?: readonly LeftOut[];
}

interface Spread {
  readonly median: number | null;
  readonly p5: number | null;
  readonly p95: number | null;
  readonly std_median: number | null;
  readonly std_shared: number | null;
}

/** The object of `ridged map --json`. */
export interface MapResult extends ScanJob {
  /** That were fitted. */
  readonly pixels: number;
  /** That were not reached within the time allowed. */
  readonly pixels_left_out?: number;
  readonly pixels_with_value: number;
  readonly parameters: Readonly<Record<string, Spread>>;
  readonly lean_directions: readonly { readonly azimuth_deg: number; readonly share: number }[];
  readonly defects: readonly {
    readonly x_mm: number;
    readonly y_mm: number;
    readonly area_mm2: number;
    readonly worst: string;
    readonly deviations: readonly { readonly parameter: string; readonly value: number; readonly usual: number; readonly sigmas: number }[];
  }[];
  readonly files: readonly string[];
  readonly warnings: readonly string[];
}

interface ContrastPair {
  readonly absolute: number;
  readonly absolute_std: number | null;
  /** Null where the pair is dark. */
  readonly michelson: number | null;
  readonly michelson_std?: number | null;
}

/** The object of `ridged contrast --json`. */
export interface ContrastResult extends ScanJob {
  readonly lines: readonly {
    readonly theta_c_deg: number;
    readonly radiance: Readonly<Record<string, number>>;
    readonly contrast: Readonly<Record<'0-90' | '90-180', ContrastPair>>;
  }[];
}

export type LimitPair = { readonly lower?: number; readonly upper?: number };

export interface Specification {
  readonly name: string;
  readonly limits: Readonly<Record<string, LimitPair>>;
}

export type VerdictWord = 'pass' | 'fail' | 'cannot-tell';

/** The object of `ridged judge --json`. */
export interface VerdictResult extends ScanJob {
  readonly verdict: VerdictWord;
  readonly specification: string;
  readonly decision_rule: string;
  readonly items: readonly {
    readonly quantity: string;
    readonly value: number | null;
    readonly expanded: number | null;
    readonly lower: number | null;
    readonly upper: number | null;
    readonly acceptance_lower: number | null;
    readonly acceptance_upper: number | null;
    readonly conformance_probability: number | null;
    readonly verdict: VerdictWord;
    readonly reason: string;
  }[];
}

/** A mean and its standard error; the latter is null where there is one replicate alone. */
export interface Estimated {
  readonly value: number;
  readonly std: number | null;
}

interface DirectionsSummary {
  readonly greatest: number;
  readonly percentile_99: number;
  readonly mean: number;
}

/** The object of `ridged trace --json` with what the daemon adds; a trace that has no result yet lacks most of it. */
export interface Trace extends Job, Partial<Omit<TraceResult, keyof Job>> {
  readonly request: {
    readonly scene: unknown;
    readonly photons?: number;
    readonly max_seconds: number | null;
    readonly target_error: number | null;
    readonly compare: boolean;
  };
}

/** A share of the light over several surfaces. */
export interface Between {
  readonly value: number;
  readonly std: number;
  readonly std_by_sampling: number;
  readonly std_between_surfaces: number;
}

export interface TraceResult {
  readonly photons: number;
  readonly seconds: number;
  /** Of the scene's own wavelength alone. */
  readonly run_seconds: number;
  readonly polarised: boolean;
  readonly energy: Readonly<Record<'reflected' | 'transmitted' | 'absorbed' | 'truncated', Estimated>> & {
    readonly by_interactions: Readonly<Record<string, Estimated>>;
  };
  readonly relative_error: number | null;
  readonly batches: number;
  /** Energies over several surfaces of the same statistics, where they were asked for. */
  readonly surfaces?: { readonly count: number } & Readonly<Record<'reflected' | 'transmitted' | 'absorbed', Between>>;
  /** What the standard errors are of, and what they are not. */
  readonly notes?: readonly string[];
  readonly ridge_angles?: readonly { readonly interface: number; readonly theta_r_deg: number }[];
  readonly light: {
    readonly theta_i_deg: number;
    readonly phi_i_deg: number;
    readonly wavelength_nm: number;
    readonly stokes: readonly [number, number, number, number];
  };
  readonly bins: { readonly n_theta: number; readonly n_phi: number; readonly sides: readonly string[]; readonly numbers: readonly string[] };
  readonly comparison?: {
    readonly wavelengths_nm: readonly number[];
    readonly mask: { readonly divisor: number; readonly error_max: number };
    readonly adm: DirectionsSummary | null;
    readonly mdm: DirectionsSummary | null;
    readonly worst: { readonly theta_deg: number; readonly phi_deg: number; readonly mean: number; readonly std: number } | null;
    readonly directions: number;
    readonly too_dark: number;
    readonly not_settled: number;
  };
  readonly files: readonly string[];
  readonly warnings: readonly string[];
}

/** The file `plane.json` of a trace: the plane of incidence by the angle of reflection. */
export interface TracePlane {
  readonly states: readonly { readonly name: string; readonly stokes: readonly [number, number, number, number] }[];
  readonly points:
    | readonly {
        readonly theta_s_deg: number;
        readonly readings: readonly {
          readonly stokes: readonly number[];
          readonly stokes_std: readonly (number | null)[];
          readonly dolp: number | null;
          readonly aop_deg: number | null;
          readonly dolp_std?: number | null;
          readonly aop_std_deg?: number | null;
        }[];
      }[]
    | null;
  readonly lobe: readonly { readonly theta_s_deg: number; readonly polarised: Estimated; readonly scalar: Estimated; readonly difference: Estimated }[] | null;
}

/** Something that a computation does without. */
export interface LeftOut {
  readonly what: string;
  readonly why: string;
  /** Share of the quantity asked for; null where nobody knows. */
  readonly cost: number | null;
}

export interface AccuracyPoint {
  readonly scene: string;
  readonly method: string;
  readonly seconds: number;
  readonly error: number;
  readonly quantity: string;
  readonly reference: string;
}

/** What `ridged accuracy` measured last. */
export interface Accuracy {
  readonly machine: string;
  readonly written_at: string | null;
  readonly points: readonly AccuracyPoint[];
  readonly forecasts: readonly { readonly scene: string; readonly forecast_s: number; readonly taken_s: number }[];
  readonly proofs: readonly {
    readonly scene: string;
    readonly off: number;
    readonly allowed: number;
    readonly holds: boolean;
    readonly full_s: number;
    readonly planned_s: number;
    readonly parts: readonly { readonly what: string; readonly speed_up: number | null }[];
  }[];
}

export interface Alarm {
  readonly id: number;
  readonly at: string;
  readonly code: string;
  readonly message: string;
  readonly scan_id: number | null;
}

export interface Page<T> {
  readonly items: readonly T[];
  readonly next_cursor: string | null;
}
