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
export type Jog = Sent<openapi.JogAnswer>;
export type RefusedStages = Sent<openapi.StagesBody>;
export type Material = openapi.MaterialBody;
export type Sample = Omit<Sent<openapi.SampleBody>, 'material' | 'simulated' | 'created_at'> & { readonly material: Sent<openapi.MaterialBody>; readonly simulated: unknown };
export type ScanState = openapi.ScanState;
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
type Finding = Sent<openapi.FitFinding>;
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

/** The object of `ridged map --json`; maps of older versions lack some fields. */
export type MapResult = ScanJob & SentBut<openapi.MapResult, 'pixels_left_out' | 'flags' | 'flag_bits' | 'left_out'>;

/** The object of `ridged contrast --json`. */
export type ContrastResult = Sent<openapi.Contrast>;

export type LimitPair = { readonly lower?: number; readonly upper?: number };

/** Limits by quantity and the accepted risks, 0 to 0.5. */
export type Specification = Omit<openapi.Specification, 'limits'> & { readonly limits: Readonly<Record<string, LimitPair>> };

export type VerdictWord = openapi.VerdictWord;

/** The object of `ridged judge --json`; verdicts of older versions lack some fields. */
export type VerdictResult = ScanJob &
  Omit<SentBut<openapi.Judgement, 'would_decide'>, 'items'> & { readonly items: readonly SentBut<openapi.JudgedItem, 'coverage_factor' | 'guard_band'>[]; readonly region?: string | null };

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

/** The object of `ridged trace --json` with the daemon's fields; without a result it lacks most of them. */
export type Trace = Job & Partial<TraceResult> & { readonly request: Pick<Sent<openapi.TraceRequest>, 'scene' | 'max_seconds' | 'target_error' | 'compare'> & { readonly photons?: number } };

export type TraceResult = Pick<Sent<openapi.Trace>, 'photons' | 'polarised' | 'relative_error' | 'batches' | 'bins' | 'files' | 'warnings'> &
  Partial<Pick<Sent<openapi.Trace>, 'surfaces' | 'notes' | 'ridge_angles' | 'comparison'>> & {
    readonly seconds: number;
    /** Only of the scene's own wavelength. */
    readonly run_seconds: number;
    readonly light: Omit<openapi.TraceLight, 'stokes'> & { readonly stokes: readonly [number, number, number, number] };
    readonly energy: Readonly<Record<'reflected' | 'transmitted' | 'absorbed' | 'truncated', Estimated>> & {
      readonly by_interactions: Readonly<Record<string, Estimated>>;
    };
  };

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
