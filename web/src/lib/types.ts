// Names of the bodies of the HTTP interface (/api/v1). Their fields are in `openapi.ts`, which `npm run types` makes from the
// daemon's OpenAPI document. Only results that the document describes as plain objects are written out here.

import type * as openapi from './openapi';

/** A body whose fields are always sent: null if there is no value. */
type Sent<T> = T extends object ? { readonly [K in keyof T]-?: Sent<T[K]> } : T;

/** A body some of whose fields are omitted without a value. */
type SentBut<T, K extends keyof T> = Sent<Omit<T, K>> & Partial<Pick<T, K>>;

export type Session = Sent<openapi.SessionBody>;
export type Holder = Sent<openapi.HolderBody>;
export type LeaseState = { readonly holder: Holder | null; readonly own: boolean };
export type LeaseTaken = Pick<Sent<openapi.LeaseBody>, 'id'>;
export type AxisName = keyof openapi.AxesBody;
export type Axis = Sent<openapi.AxisBody>;
export type Rig = Sent<openapi.RigBody>;
export type Preview = Sent<openapi.PreviewAnswer>;
export type PreviewFrame = Preview['frames'][number];
export type Jog = Sent<openapi.JogAnswer>;
export type RefusedStages = Sent<openapi.StagesBody>;
export type Material = openapi.MaterialBody;
export type Sample = Omit<Sent<openapi.SampleBody>, 'material' | 'simulated' | 'created_at'> & { readonly material: Sent<openapi.MaterialBody>; readonly simulated: unknown };
export type ScanState = openapi.ScanState;
export type Plan = openapi.Plan;
export type OperatorStep = openapi.OperatorBody;
export type Imported = Sent<openapi.ImportBody>;
export type Progress = Sent<openapi.ProgressBody>;
export type Scan = Sent<openapi.ScanBody>;
export type Estimate = Sent<openapi.EstimateBody>;
export type Calibration = Omit<Sent<openapi.CalibrationBody>, 'kind'> & { readonly kind: Exclude<openapi.FrameKind, 'sample'> };

/** A frame. Its event, which comes first, does not have its size and may lack its statistics. */
export type FrameRow = Pick<Sent<openapi.FrameBody>, 'id' | 'scan_id' | 'kind' | 'theta_c_deg' | 'phi_s_deg' | 'exposure_s' | 'repeat' | 'accepted' | 'reason' | 'image'> &
  Partial<Pick<openapi.FrameBody, 'width_px' | 'height_px'>> & { readonly [K in 'mean_dn' | 'max_dn' | 'saturated_px']: number | null };

export type Parameter = SentBut<openapi.FitParameter, 'profile' | 'bootstrap' | 'note' | 'degrees_of_freedom'>;
export type RejectedFrame = openapi.FrameRejected;
export type Finding = Sent<openapi.FitFinding>;
export type LeftOut = Sent<openapi.WorkLeftOut>;
export type Forecast = openapi.Forecast;
export type JobState = openapi.TaskState;
/** Progress of a running job. */
export type JobProgress = SentBut<openapi.WorkProgress, 'queued_position'>;
/** The request of a fit; fits of older versions kept only a part of it. */
export type FitAsked = Partial<Omit<openapi.FitRequest, 'shape'>> & { readonly shape?: { readonly name?: string } | null };
export interface Fit extends Job, Omit<openapi.Fit, keyof Job | 'parameters' | 'request' | 'findings'> {
  readonly scan_id: number;
  readonly parameters?: Readonly<Record<string, Parameter>>;
  readonly request?: FitAsked;
  readonly findings?: readonly Finding[];
}
/** A row of the live fit of a scan. */
export type Certainty = Omit<Sent<openapi.CertaintyBody>, 'at' | 'variant' | 'status' | 'parameters'> & {
  readonly variant: string;
  readonly status: string;
  /** Rows of older data folders lack the coverage factor. */
  readonly parameters: Readonly<Record<string, Omit<openapi.UncertainBody, 'coverage_factor'> & { readonly coverage_factor?: number | null }>>;
};
/** An alarm of a scan, or the end of a fault. */
export type Incident = openapi.IncidentBody;
/** An observation; without a prediction before there is a fit. */
export type CurvePoint = Omit<openapi.PointBody, 'predicted' | 'residual'> & { readonly n_frames?: number; readonly predicted: number | null; readonly residual: number | null };
export type Curves = Omit<openapi.CurvesBody, 'observations' | 'fit_id'> & { readonly observations: readonly CurvePoint[] };

export type SharedLine = openapi.SharedLine;
export type Comparison = Sent<openapi.Comparison>;
export type GaugeBy = openapi.GroupedBy;
export type GaugeSpread = Sent<openapi.GaugeSpread>;
export type Repeatability = Sent<openapi.Repeatability>;
/** A control chart of results, and what is due. */
export type ResultChart = Sent<openapi.ResultChart>;
export type Due = Sent<openapi.Due>;
/** A record of a scan as it was after a change. */
export type RecordChange = Sent<openapi.RecordChange>;

/** Kinds of jobs, as they appear in paths. */
export type JobKind = 'fits' | 'maps' | 'contrasts' | 'verdicts' | 'traces';

/** Fields that jobs of all kinds share. */
export interface Job {
  readonly id: number;
  readonly scan_id: number | null;
  readonly state: JobState;
  /** Who started it. */
  readonly who?: string;
  readonly created_at: string;
  readonly progress?: JobProgress;
  readonly forecast?: Forecast;
  /** Run time. */
  readonly seconds?: number;
  readonly error?: openapi.FitError | null;
  readonly left_out?: readonly LeftOut[];
}

/** A map, a contrast table or a verdict. */
export interface ScanJob extends Job {
  readonly scan_id: number;
  readonly request: { readonly specification?: Specification; readonly region?: string | null; /** The fit that a verdict rests on. */ readonly fit_id?: number | null };
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
  /** Pixels that were fitted. */
  readonly pixels: number;
  /** Pixels that were not reached within the time limit. */
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
  /** Pixels per flag, and the bit of each flag in `flags.tif`. */
  readonly flags?: Readonly<Record<string, number>>;
  readonly flag_bits?: Readonly<Record<string, number>>;
  readonly files: readonly string[];
  readonly warnings: readonly string[];
}

/** The object of `ridged contrast --json`. */
export type ContrastResult = Sent<openapi.Contrast>;

export type LimitPair = { readonly lower?: number; readonly upper?: number };

/** Limits by quantity and the accepted risks, 0 to 0.5. */
export interface Specification {
  readonly name: string;
  /** Allowed risks; 0.025 each where they are omitted. */
  readonly decision?: { readonly max_false_accept_risk?: number; readonly max_false_reject_risk?: number };
  readonly limits: Readonly<Record<string, LimitPair>>;
  /** Plane that limits of angles refer to; either one if it is omitted. */
  readonly reference_plane?: 'turntable' | 'sample' | null;
}

export type VerdictWord = 'pass' | 'fail' | 'cannot-tell';

/** The object of `ridged judge --json`. */
export interface VerdictResult extends ScanJob {
  readonly verdict: VerdictWord;
  readonly specification: string;
  readonly region?: string | null;
  readonly decision_rule: string;
  readonly items: readonly {
    readonly quantity: string;
    readonly value: number | null;
    readonly std: number | null;
    readonly expanded: number | null;
    /** Verdicts of older versions lack it. */
    readonly coverage_factor?: number | null;
    readonly lower: number | null;
    readonly upper: number | null;
    readonly acceptance_lower: number | null;
    readonly acceptance_upper: number | null;
    readonly conformance_probability: number | null;
    readonly verdict: VerdictWord;
    readonly reason: string;
  }[];
  /** What would decide the quantities that are not decided; verdicts of older versions lack it. */
  readonly would_decide?: Readonly<Record<string, { readonly message: string }>>;
}

/** How parts are measured. */
export type Recipe = openapi.Recipe;
/** The newest or another version of a recipe. */
export type StoredRecipe = openapi.RecipeBody;
export type StoredSpecification = Omit<openapi.SpecificationBody, 'specification'> & { readonly specification: Specification };
export type StoredDefinition = StoredRecipe | StoredSpecification;
/** A row of the results with the fields that were asked for, null without a value; the region only where there is one. */
export type ResultRow = { readonly [K in keyof openapi.Result]: openapi.Result[K] | null } & { readonly scan_id: number; /** Whether the verdict judged the values of this fit. */ readonly verdict_matches?: boolean | null };

export type Queue = Sent<openapi.QueueBody>;
export type QueueOrder = Sent<openapi.OrderBody>;
/** An order to add. */
export type NewOrder = openapi.OrderRequest;

/** A mean and its standard error; the latter is null with one replicate only. */
export interface Estimated {
  readonly value: number;
  readonly std: number | null;
}

interface DirectionsSummary {
  readonly greatest: number;
  readonly percentile_99: number;
  readonly mean: number;
}

/** The object of `ridged trace --json` with the daemon's fields; without a result it lacks most of them. */
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
        /** From linear light at 45°; traces of older versions have none. */
        readonly psi_delta?: {
          readonly psi_deg: number;
          readonly psi_std_deg: number | null;
          readonly delta_deg: number;
          readonly delta_std_deg: number | null;
          readonly dop: number;
          readonly dop_std: number | null;
        };
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

export type AccuracyPoint = Sent<openapi.AccuracyPoint>;
/** The newest results of `ridged accuracy`. */
export type Accuracy = Sent<openapi.AccuracyReport>;

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
