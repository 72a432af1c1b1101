// Made from src/api/openapi.json by `npm run types`; do not edit.

export type paths = Record<string, never>;
export type webhooks = Record<string, never>;
export interface components {
    schemas: {
        /** @description The controllers to accept. */
        readonly AcceptStagesBody: {
            /** @description Serial number of the controller of the sample azimuth. */
            readonly phi_s_serial: string;
            /** @description Serial number of the controller of the camera tilt. */
            readonly theta_c_serial: string;
        };
        /** @description One measurement. */
        readonly AccuracyPoint: {
            /**
             * Format: double
             * @description Error, in the quantity's unit.
             */
            readonly error: number;
            /** @description Method. */
            readonly method: string;
            /** @description The quantity that has the error. */
            readonly quantity: string;
            /** @description The reference of the error. */
            readonly reference: string;
            /** @description Scene. */
            readonly scene: string;
            /**
             * Format: double
             * @description Wall-clock seconds.
             */
            readonly seconds: number;
        };
        /** @description Measurements with the machine that made them: the object of `accuracy --json`. */
        readonly AccuracyReport: components["schemas"]["Measurements"] & {
            /** @description What was not measured. */
            readonly left_out: readonly components["schemas"]["WorkLeftOut"][];
            /** @description Program, processor, threads, system and seconds of the whole run. */
            readonly machine: string;
            /**
             * Format: double
             * @description Seconds of the whole run.
             */
            readonly seconds: number;
            /** @description When they were written to the data folder, RFC 3339 in UTC; only over HTTP. */
            readonly written_at?: string | null;
        };
        /**
         * @description What the rig is doing.
         * @enum {string}
         */
        readonly Activity: "idle" | "moving" | "homing" | "scanning" | "paused" | "not-connected";
        /** @description A rectangle of a frame. */
        readonly AreaBody: {
            /**
             * Format: int32
             * @description Rows.
             */
            readonly height_px: number;
            /**
             * Format: int32
             * @description First column, from 0.
             */
            readonly left_px: number;
            /**
             * Format: int32
             * @description First row, from 0.
             */
            readonly top_px: number;
            /**
             * Format: int32
             * @description Columns.
             */
            readonly width_px: number;
        };
        /** @description Both axes. */
        readonly AxesBody: {
            /** @description Sample azimuth φs. */
            readonly phi_s: components["schemas"]["AxisBody"];
            /** @description Camera tilt θc. */
            readonly theta_c: components["schemas"]["AxisBody"];
        };
        /** @description One axis. */
        readonly AxisBody: {
            /** @description Whether the axis has a reference position. */
            readonly homed: boolean;
            /**
             * Format: double
             * @description Highest position allowed, degrees.
             */
            readonly limit_max_deg: number;
            /**
             * Format: double
             * @description Lowest position allowed, degrees.
             */
            readonly limit_min_deg: number;
            /** @description Whether it moves; null if the stage does not answer, so that it may move. */
            readonly moving?: boolean | null;
            /**
             * Format: double
             * @description Position read from the controller, degrees; null if the stage does not answer. Not a position of the axis while
             *     `referenced` is false.
             */
            readonly position_deg?: number | null;
            /** @description Whether `position_deg` counts from the reference position. False until the axis is homed. */
            readonly referenced: boolean;
            /** @description Serial number of the device; null if unknown. */
            readonly serial?: string | null;
            /** @description Warnings of the controller: code and meaning. */
            readonly warnings: readonly string[];
        };
        /** @description What an axis did. */
        readonly AxisEvent: {
            /**
             * Format: double
             * @description Position read back; `None` when unknown.
             */
            readonly position_deg?: number | null;
            /**
             * Format: double
             * @description Where it was sent; `None` when at rest.
             */
            readonly target_deg?: number | null;
        };
        /** @description The answer to a request for work that takes longer than the request. */
        readonly Begun: {
            /**
             * Format: int64
             * @description Number of the new row; null for a motion.
             */
            readonly id?: number | null;
            /** @description Its state now. */
            readonly state: string;
        };
        /** Format: binary */
        readonly Binary: string;
        /** @description A column of a BiRD file. */
        readonly BirdColumn: {
            /** @description What the values are. */
            readonly comments?: string | null;
            /** @description Notation of the words. */
            readonly notation?: string | null;
            /** @description Unit of the values, where they have one. */
            readonly unit?: string | null;
            /** @description The values: numbers, or words of a notation. */
            readonly values: readonly unknown[];
        };
        /** @description A file of the BiRD project's universal BRDF format, version 1.0. `metadata.schema` names the schema of the format. */
        readonly BirdFile: {
            /** @description Columns of equal length: directions in degrees, BRDF and its standard uncertainty in 1/sr. */
            readonly data: {
                readonly [key: string]: components["schemas"]["BirdColumn"];
            };
            /** @description What was measured, by whom and with what. */
            readonly metadata: {
                readonly [key: string]: unknown;
            };
        };
        /** @description A set of calibration frames. */
        readonly CalibrationBody: {
            /** @description When the frames were taken, RFC 3339 in UTC. */
            readonly created_at: string;
            /** @description Exposure times, s. */
            readonly exposures_s: readonly number[];
            /**
             * Format: int64
             * @description Number of the calibration.
             */
            readonly id: number;
            /** @description Kind of its frames: dark or flat. */
            readonly kind: components["schemas"]["FrameKind"];
            /**
             * Format: int32
             * @description Number of frames.
             */
            readonly n_frames: number;
            /**
             * Format: int64
             * @description Number of the scan that took the frames.
             */
            readonly scan_id: number;
            /** @description Camera tilts θc, degrees; empty for dark frames. */
            readonly theta_c_deg: readonly number[];
            /** @description Whether scans can use it now. */
            readonly valid: boolean;
            /** @description End of its validity under the current settings, RFC 3339 in UTC. */
            readonly valid_until: string;
        };
        /** @description The camera. */
        readonly CameraBody: {
            /**
             * Format: int32
             * @description Resolution of the converter, bit.
             */
            readonly bit_depth: number;
            /** @description Make and model. */
            readonly description: string;
            /** @description Default exposure times of a plan, s. */
            readonly exposures_s: readonly number[];
            /**
             * Format: int32
             * @description Rows of a frame, px.
             */
            readonly height_px: number;
            /**
             * Format: double
             * @description Count at which a pixel is full, DN.
             */
            readonly saturation_dn: number;
            /**
             * Format: int32
             * @description Columns of a frame, px.
             */
            readonly width_px: number;
        };
        /** @description `[camera]`: how counts are made. */
        readonly CameraFacts: {
            /**
             * Format: int32
             * @description Bits of the converter.
             */
            readonly bit_depth?: number | null;
            /**
             * Format: double
             * @description Count without light and without dark current; dark frames replace it.
             */
            readonly black_level_dn?: number | null;
            /**
             * Format: double
             * @description From the centre of tilt to the camera's pupil, where it is finite and `[rig]` does not say.
             */
            readonly camera_distance_mm?: number | null;
            /**
             * Format: double
             * @description Relative standard uncertainty of an exposure time, independent between exposure times.
             */
            readonly exposure_rel_std?: number | null;
            /** @description Exposure times that the series has. */
            readonly exposures_s?: readonly number[];
            /**
             * Format: double
             * @description Height of the field.
             */
            readonly field_height_mm?: number | null;
            /**
             * Format: double
             * @description Width of the field in the plane through the centre of tilt, across the view.
             */
            readonly field_width_mm?: number | null;
            /**
             * Format: double
             * @description Counts per electron.
             */
            readonly gain_dn_per_electron: number;
            /**
             * Format: int32
             * @description Rows of a frame.
             */
            readonly height_px: number;
            /** @description Column and row of the foot of a near camera's optical axis. That of the centre of tilt by default. */
            readonly principal_point_px?: readonly number[] | null;
            /** @description `orthographic` (telecentric) or `perspective`. */
            readonly projection?: string;
            /**
             * Format: double
             * @description Read noise.
             */
            readonly read_noise_electrons_rms?: number | null;
            /**
             * Format: double
             * @description Count at which a pixel is full; by default what `bit_depth` allows, else 65535.
             */
            readonly saturation_dn?: number | null;
            /**
             * Format: int32
             * @description Columns of a frame.
             */
            readonly width_px: number;
        };
        /** @description Result of the live fit of the frames so far. */
        readonly CertaintyBody: {
            /** @description When it was reported, RFC 3339 in UTC. */
            readonly at: string;
            /**
             * Format: double
             * @description Time that the rig had spent moving and exposing, s, without waiting for the operator.
             */
            readonly elapsed_s: number;
            /**
             * Format: int64
             * @description Number of the event that reported it.
             */
            readonly id: number;
            /**
             * Format: int32
             * @description Number of frames used, including dark and white-reference frames.
             */
            readonly n_frames_used: number;
            /** @description Number of poses fitted. */
            readonly n_observations: number;
            /** @description By name, without the parameters that the frames so far do not determine. */
            readonly parameters: {
                readonly [key: string]: components["schemas"]["UncertainBody"];
            };
            /** @description How the fit ended. */
            readonly status: components["schemas"]["FitStatus"];
            /** @description Variant of the model that gave the values. */
            readonly variant: components["schemas"]["FitVariantName"];
        };
        /** @description A point of the chart. */
        readonly ChartPoint: components["schemas"]["ChartedResult"] & {
            /** @description Whether the value is beyond the control limits (Western Electric rule 1). */
            readonly beyond: boolean;
            /**
             * Format: double
             * @description k of the expanded uncertainty.
             */
            readonly coverage_factor: number;
            /**
             * Format: double
             * @description Expanded uncertainty U = k·u, same unit.
             */
            readonly expanded: number;
            /** @description Whether the value is in a run on one side of the mean. */
            readonly in_run: boolean;
            /**
             * Format: double
             * @description Difference from the value before, without its sign; null for the first value.
             */
            readonly moving_range?: number | null;
            /** @description Whether the moving range is above its limit. */
            readonly range_beyond: boolean;
            /**
             * Format: double
             * @description Standard uncertainty u (k = 1), same unit.
             */
            readonly std: number;
            /**
             * Format: double
             * @description Value, in the unit of the parameter's name.
             */
            readonly value: number;
        };
        /** @description Values in a row on one side of the mean, at least `run_length` of them. */
        readonly ChartRun: {
            /** @description Place of the first value among the points, from 0. */
            readonly first: number;
            /** @description Whether the values are above the mean. */
            readonly is_above: boolean;
            /** @description Place of the last value. */
            readonly last: number;
        };
        /** @description The result that a point shows. */
        readonly ChartedResult: {
            /** @description When the scan was started or imported, RFC 3339 in UTC. */
            readonly created_at: string;
            /**
             * Format: int64
             * @description Number of the fit: the newest completed one.
             */
            readonly fit_id: number;
            /** @description Name of the part. */
            readonly part: string;
            /** @description Region of a part that has several. */
            readonly region?: string | null;
            /**
             * Format: int64
             * @description Number of the scan.
             */
            readonly scan_id: number;
            /** @description Name of the specification of that verdict. */
            readonly specification?: string | null;
            /**
             * @description Newest verdict: pass, fail or cannot-tell; null where the scan was not judged, or where the verdict judged other values
             *     than those of this fit.
             */
            readonly verdict?: string | null;
            /**
             * Format: int64
             * @description Number of that verdict.
             */
            readonly verdict_id?: number | null;
        };
        /** @description A specification beside the chart: its limits of the parameter with their guard band, in the unit of the parameter's name. */
        readonly ChartedSpecification: {
            /**
             * Format: double
             * @description Lower acceptance limit: tolerance limit plus guard band; null also where the guard bands of two limits meet.
             */
            readonly acceptance_lower?: number | null;
            /**
             * Format: double
             * @description Upper acceptance limit.
             */
            readonly acceptance_upper?: number | null;
            /**
             * Format: double
             * @description Width of the guard band inside the limits; null without limits or without values.
             */
            readonly guard_band?: number | null;
            readonly guard_basis?: components["schemas"]["GuardBasis"] | null;
            /** @description Keys of all quantities that the specification limits. */
            readonly limited: readonly string[];
            /**
             * Format: double
             * @description Lower tolerance limit; null if there is none.
             */
            readonly lower?: number | null;
            /**
             * Format: double
             * @description Largest allowed probability that an item which passes does not conform.
             */
            readonly max_false_accept_risk: number;
            /** @description Name. */
            readonly name: string;
            /**
             * Format: double
             * @description Upper tolerance limit; null if there is none.
             */
            readonly upper?: number | null;
            /**
             * Format: int64
             * @description Number of the verdict that it comes from.
             */
            readonly verdict_id?: number | null;
        };
        /** @description A line of the two budgets. */
        readonly ComparedLine: {
            /**
             * Format: double
             * @description What it contributes to the standard uncertainty of the difference.
             */
            readonly difference_std: number;
            /**
             * Format: double
             * @description Its standard uncertainty in the first result, in the unit of the parameter.
             */
            readonly first_std: number;
            /** @description Key of the line. */
            readonly line: string;
            /**
             * Format: double
             * @description The same in the second result.
             */
            readonly second_std: number;
            /** @description Whether it has the same error in both. */
            readonly shared: boolean;
        };
        /** @description A parameter of both results. */
        readonly ComparedParameter: {
            readonly difference?: components["schemas"]["Difference"] | null;
            /** @description First result. */
            readonly first: components["schemas"]["ComparedValue"];
            /** @description Lines of the budgets that are not zero in both. */
            readonly lines: readonly components["schemas"]["ComparedLine"][];
            /** @description Key of the parameter; its unit is the end of the name. */
            readonly name: string;
            /** @description Second result. */
            readonly second: components["schemas"]["ComparedValue"];
        };
        /** @description A value with its uncertainty, as the fit states it. */
        readonly ComparedValue: {
            /**
             * Format: double
             * @description U divided by u.
             */
            readonly coverage_factor?: number | null;
            /**
             * Format: double
             * @description Expanded uncertainty U, same unit.
             */
            readonly expanded?: number | null;
            /**
             * Format: double
             * @description Standard uncertainty u (k = 1), same unit.
             */
            readonly std?: number | null;
            /**
             * Format: double
             * @description Value, in the unit of the parameter's name.
             */
            readonly value?: number | null;
        };
        /** @description Two results beside each other. */
        readonly Comparison: {
            /** @description First result, A. */
            readonly first: components["schemas"]["ResultOf"];
            /** @description What limits the comparison: other parts, other models. */
            readonly notes: readonly string[];
            /** @description The parameters that at least one result has. */
            readonly parameters: readonly components["schemas"]["ComparedParameter"][];
            /** @description Second result, B. */
            readonly second: components["schemas"]["ResultOf"];
            /** @description Lines of the budgets, and whether they have the same error in both results. */
            readonly shared_lines: readonly components["schemas"]["SharedLine"][];
        };
        /** @description The operator step that is done. */
        readonly ContinueBody: {
            readonly action?: components["schemas"]["OperatorAction"] | null;
        };
        /** @description A contrast: its request and its state, and the object of `contrast --json`, once it has completed */
        readonly Contrast: {
            /** @description When it was accepted, RFC 3339 in UTC. */
            readonly created_at: string;
            /** @description When it ended, RFC 3339 in UTC; null while it runs. */
            readonly ended_at?: string | null;
            readonly error?: components["schemas"]["FitError"] | null;
            readonly findings?: components["schemas"]["ReportedFindings"] | null;
            readonly forecast?: components["schemas"]["Forecast"] | null;
            /**
             * Format: int64
             * @description Number of the job within its kind.
             */
            readonly id: number;
            /** @description What no uncertainty includes. */
            readonly left_out?: readonly components["schemas"]["WorkLeftOut"][];
            /** @description One line for each tilt, and where it was predicted for each ridge angle. */
            readonly lines?: readonly components["schemas"]["ReportedLine"][];
            /** @description Means of the contrasts. */
            readonly mean?: components["schemas"]["ReportedMeans"];
            /** @description `measured`. */
            readonly mode?: string;
            readonly model_error?: components["schemas"]["ForecastError"] | null;
            /** @description Program and version. */
            readonly program?: string;
            readonly progress?: components["schemas"]["WorkProgress"] | null;
            /** @description Region of the frames; null for the whole frame. */
            readonly region?: string | null;
            readonly request: components["schemas"]["ContrastRequest"];
            /**
             * Format: int64
             * @description Number of the part of that scan.
             */
            readonly sample_id?: number | null;
            /** @description Name of that part. */
            readonly sample_name?: string | null;
            /**
             * @description `white reference`: radiances and absolute contrasts are for a lamp irradiance of 1; `arbitrary`: they are fractions
             *     of the brightest level.
             */
            readonly scale?: string;
            /**
             * Format: int64
             * @description Number of its scan; null without one.
             */
            readonly scan_id?: number | null;
            /** @description State of the job. */
            readonly state: components["schemas"]["TaskState"];
            /** @description Stray light in every signal. */
            readonly stray_light?: components["schemas"]["StrayLight"];
            /** @description What a person must know. */
            readonly warnings?: readonly string[];
            /** @description Who started it: the name of a token, or `local`. */
            readonly who: string;
        };
        /** @description Contrasts of the paper's pairs of azimuths φs. */
        readonly ContrastByPair: {
            /** @description Between 0° and 90°. */
            readonly "0-90": components["schemas"]["ReportedContrast"];
            /** @description Between 90° and 180°. */
            readonly "90-180": components["schemas"]["ReportedContrast"];
        };
        /** @description A request for a contrast table. */
        readonly ContrastRequest: {
            /** @description Region of a part that has several. */
            readonly region?: string | null;
            /**
             * Format: int64
             * @description Scan to read.
             */
            readonly scan_id: number;
        };
        /** @description A control chart of individual values and moving ranges. */
        readonly ControlChart: {
            readonly limits?: components["schemas"]["ControlLimits"] | null;
            /** @description Values in their order, oldest first. */
            readonly points: readonly components["schemas"]["ChartPoint"][];
            /** @description Least number of values of a run. */
            readonly run_length: number;
            /** @description Runs on one side of the mean, oldest first. */
            readonly runs: readonly components["schemas"]["ChartRun"][];
        };
        /** @description Mean and control limits, in the unit of the parameter's name. */
        readonly ControlLimits: {
            /**
             * Format: double
             * @description Lower control limit: mean − 3 s.
             */
            readonly lower: number;
            /**
             * Format: double
             * @description Mean of the values.
             */
            readonly mean: number;
            /**
             * Format: double
             * @description Mean moving range.
             */
            readonly mean_range: number;
            /** @description Number of values. */
            readonly n: number;
            /**
             * Format: double
             * @description Upper limit of a moving range: 3.267 times the mean moving range.
             */
            readonly range_limit: number;
            /**
             * Format: double
             * @description Scatter from one value to the next: mean moving range / 1.128.
             */
            readonly s: number;
            /**
             * Format: double
             * @description Upper control limit: mean + 3 s.
             */
            readonly upper: number;
        };
        /** @description A controller. */
        readonly ControllerBody: {
            /**
             * Format: int32
             * @description The manufacturer's product number.
             */
            readonly device_id: number;
            /** @description Firmware version. */
            readonly firmware: string;
            /** @description Serial number. */
            readonly serial: string;
        };
        /** @description Convergence of the last steps of a solver, predicted and measured. */
        readonly ConvergenceRate: {
            /**
             * Format: double
             * @description Measured value; null where rounding hides it.
             */
            readonly found?: number | null;
            /**
             * Format: double
             * @description Prediction of theory.
             */
            readonly predicted: number;
            /** @description The predicted quantity. */
            readonly quantity: string;
            /** @description Scene. */
            readonly scene: string;
        };
        /** @description The order whose scan has begun and has not ended. */
        readonly CurrentOrder: {
            readonly operator?: components["schemas"]["OperatorBody"] | null;
            /** @description The order. */
            readonly order: components["schemas"]["OrderBody"];
            /** @description State of its scan. */
            readonly scan_state: components["schemas"]["ScanState"];
        };
        /** @description Predicted signal over φs at one tilt. */
        readonly CurveBody: {
            /** @description Sample azimuths φs as recorded, degrees. */
            readonly phi_s_deg: readonly number[];
            /** @description Predicted signals at these azimuths, in the observations' unit of radiance. */
            readonly signal: readonly number[];
            /**
             * Format: double
             * @description Camera tilt θc as recorded, degrees.
             */
            readonly theta_c_deg: number;
            /** @description Variant of the model. */
            readonly variant: components["schemas"]["FitVariantName"];
        };
        /** @description A fit with its observations. */
        readonly CurvesBody: {
            /** @description One curve per tilt and variant. */
            readonly curves: readonly components["schemas"]["CurveBody"][];
            /**
             * Format: int64
             * @description Number of the fit.
             */
            readonly fit_id: number;
            /** @description Observed and predicted. */
            readonly observations: readonly components["schemas"]["PointBody"][];
            /**
             * Format: double
             * @description Largest observation, in the observations' unit of radiance; residuals are fractions of it.
             */
            readonly peak: number;
        };
        /** @description A row that the store cannot read. */
        readonly DamagedBody: {
            /** @description What is wrong with it. */
            readonly detail: string;
            /**
             * Format: int64
             * @description Number of the row.
             */
            readonly id: number;
        };
        /** @description Dark frames of a plan. */
        readonly DarkPlan: {
            /**
             * Format: int32
             * @description Frames per exposure; 0 for none.
             */
            readonly repeats: number;
        };
        /** @description Dark frames of a request. */
        readonly DarkRequest: {
            /**
             * Format: int32
             * @description Frames per exposure; 0 leaves the dark frames out.
             */
            readonly repeats?: number | null;
        };
        /**
         * @description An effect that can be omitted.
         * @enum {string}
         */
        readonly Decision: "polarisation" | "bounces" | "layers" | "cone-average" | "per-pixel-geometry" | "costly-terms";
        /** @description Allowed risks; the documentation of the module states the rule. */
        readonly DecisionRule: {
            /**
             * Format: double
             * @description Largest allowed probability that an item which passes does not conform.
             * @default 0.025
             */
            readonly max_false_accept_risk: number;
            /**
             * Format: double
             * @description Largest allowed probability that an item which fails conforms.
             * @default 0.025
             */
            readonly max_false_reject_risk: number;
        };
        /** @description A recipe or specification of an order. Its newest version at the start of the scan counts. */
        readonly DefinitionName: {
            /**
             * Format: int64
             * @description Number.
             */
            readonly id: number;
            /** @description Name. */
            readonly name: string;
        };
        /** @description The version of a definition that a scan used. */
        readonly DefinitionRef: {
            /**
             * Format: int64
             * @description Number of the recipe or specification.
             */
            readonly id: number;
            /** @description Its name. */
            readonly name: string;
            /**
             * Format: int64
             * @description The version that was used, from 1.
             */
            readonly version: number;
        };
        /** @description The difference of a parameter: second minus first. */
        readonly Difference: {
            /** @description Whether |E_n| is at most 1. */
            readonly agrees: boolean;
            /**
             * Format: double
             * @description Expanded divided by standard uncertainty: 2, or Student's t for 95.45 % where the degrees of freedom are fewer than
             *     50. The lines that cancel have no part in them.
             */
            readonly coverage_factor: number;
            /**
             * Format: double
             * @description Its expanded uncertainty, same unit.
             */
            readonly expanded: number;
            /**
             * Format: double
             * @description E_n: the difference divided by its expanded uncertainty, no unit.
             */
            readonly normalised: number;
            /**
             * Format: double
             * @description Its standard uncertainty (k = 1), same unit.
             */
            readonly std: number;
            /**
             * Format: double
             * @description Second minus first, in the unit of the parameter's name; of an azimuth within ±180°.
             */
            readonly value: number;
        };
        /** @description Something that the settings ask to measure again at intervals (`[due]`). */
        readonly Due: {
            /** @description When it is due, RFC 3339 in UTC; null where it was never measured, so that it is due now. */
            readonly due_at?: string | null;
            /** @description Whether it is due now. */
            readonly is_due: boolean;
            /**
             * @description When it was last measured, RFC 3339 in UTC: the start or import of the newest scan of the check standard with a
             *     converged fit that is not archived; of the newest dark and the newest white-reference frames, the older ones. Null if
             *     never.
             */
            readonly last_at?: string | null;
            /** @description Name of the check standard; null for references. */
            readonly part?: string | null;
            /** @description What it is. */
            readonly what: components["schemas"]["DueKind"];
        };
        /** @description What is measured again at intervals. */
        readonly DueBody: {
            /** @description Check standard and references, due or not; empty where the settings state no interval. */
            readonly items: readonly components["schemas"]["Due"][];
        };
        /**
         * @description What is measured again.
         * @enum {string}
         */
        readonly DueKind: "check-standard" | "references";
        /** @description Something that was corrected. */
        readonly Earlier: {
            /** @description What it was. */
            readonly name: string;
            /** @description When it was corrected, RFC 3339 in UTC. */
            readonly until: string;
        };
        /** @description A name that a part had. */
        readonly EarlierName: {
            /** @description The name. */
            readonly name: string;
            /** @description When it was replaced, RFC 3339 in UTC. */
            readonly until: string;
        };
        /** @description A part that a scan was assigned to. */
        readonly EarlierSample: {
            /**
             * Format: int64
             * @description Number of the part.
             */
            readonly sample_id: number;
            /** @description The part's present name. */
            readonly sample_name: string;
            /** @description When the scan was assigned to another part, RFC 3339 in UTC. */
            readonly until: string;
        };
        /** @description Estimate of a scan. */
        readonly EstimateBody: {
            /** @description Calibrations of earlier scans that it uses. */
            readonly calibration_ids: readonly number[];
            /**
             * Format: int64
             * @description Largest disk space that the frames can take, bytes.
             */
            readonly disk_bytes: number;
            /**
             * Format: int64
             * @description Free disk space, bytes.
             */
            readonly disk_free_bytes: number;
            /**
             * Format: double
             * @description Time for motion, settling and exposure, s, without waiting for the operator.
             */
            readonly duration_s: number;
            /**
             * Format: int32
             * @description Number of frames.
             */
            readonly n_frames: number;
            /**
             * Format: int32
             * @description Number of points (pose and exposure).
             */
            readonly n_shots: number;
            /** @description Operator steps, in order. */
            readonly operator_steps: readonly components["schemas"]["OperatorBody"][];
            /** @description The whole plan without the frames that those calibrations replace. */
            readonly plan: components["schemas"]["Plan"];
        };
        /** @description An event: the object in `data`. Its `type` is also the name of the server-sent event. */
        readonly Event: components["schemas"]["WhatHappened"] & {
            /** @description When it was recorded, RFC 3339 in UTC. */
            readonly at: string;
            /**
             * Format: int64
             * @description Number of the event, growing without reuse; negative for an event that the store does not have.
             */
            readonly id: number;
            /** @description Who caused it: the name of a token, `local` or `daemon`. */
            readonly who?: string | null;
        };
        /** @description Positions of both axes. */
        readonly EventAxes: {
            /** @description Sample azimuth φs. */
            readonly phi_s: components["schemas"]["AxisEvent"];
            /** @description Camera tilt θc. */
            readonly theta_c: components["schemas"]["AxisEvent"];
        };
        /** @description What is wrong with one value. */
        readonly FieldProblem: {
            /** @description Path of the value, e.g. `plan.theta_c_deg[2]`. */
            readonly field: string;
            /** @description What is wrong, with the allowed values. */
            readonly message: string;
            /** @description The value and its range, where it is out of one. */
            readonly out_of_range?: components["schemas"]["OutOfRange"];
        };
        /** @description The content of a file as it is described: base64 in a request, and what is kept of it in the request of a job. */
        readonly FileContent: string | components["schemas"]["FileFingerprint"];
        /** @description Size and hash of a file. */
        readonly FileFingerprint: {
            /** @description Number of its bytes. */
            readonly bytes: number;
            /** @description SHA-256 of its bytes, hexadecimal. */
            readonly sha256: string;
        };
        /** @description A fit: its request and its state; from `status` on its report, once it has completed */
        readonly Fit: {
            /** @description The same with the commit of the build; empty in fits of programs that did not state it. */
            readonly build?: string;
            /**
             * Format: double
             * @description χ² per degree of freedom with the model error among the uncertainties.
             */
            readonly chi2_reduced?: number | null;
            /**
             * Format: double
             * @description The same with counting noise only.
             */
            readonly chi2_reduced_without_model?: number | null;
            readonly covariance?: components["schemas"]["FitCovariance"] | null;
            /** @description When it was accepted, RFC 3339 in UTC. */
            readonly created_at: string;
            /** @description When it ended, RFC 3339 in UTC; null while it runs. */
            readonly ended_at?: string | null;
            readonly error?: components["schemas"]["FitError"] | null;
            /**
             * @description What explains the residual that an ideal sawtooth, a steady lamp and a linear detector leave, largest share
             *     first.
             */
            readonly findings?: readonly components["schemas"]["FitFinding"][];
            /** @description Observations with their fitted values. */
            readonly fitted?: readonly components["schemas"]["FittedPoint"][];
            readonly forecast?: components["schemas"]["Forecast"] | null;
            /** @description Degrees of freedom of the two parts of every budget that come from scatter. */
            readonly freedom?: components["schemas"]["FitFreedom"];
            /**
             * Format: int64
             * @description Number of the job within its kind.
             */
            readonly id: number;
            /** @description One descent to the reported minimum, step by step, on request. */
            readonly iterations?: readonly components["schemas"]["FitIteration"][];
            /** @description What the fit leaves out, why, and its possible effect. */
            readonly left_out?: readonly components["schemas"]["WorkLeftOut"][];
            /**
             * Format: double
             * @description Model error at the peak, as a share of the largest observation.
             */
            readonly model_discrepancy?: number | null;
            /**
             * Format: int32
             * @description Frames used, including darks and flats.
             */
            readonly n_frames_used?: number;
            /** @description Number of observations fitted. */
            readonly n_observations?: number;
            /** @description Sentences worth knowing that need no action. */
            readonly notes?: readonly string[];
            /** @description The parameters. */
            readonly parameters?: components["schemas"]["FitParameters"];
            /** @description Program and version. */
            readonly program?: string;
            readonly progress?: components["schemas"]["WorkProgress"] | null;
            /** @description The plane that θr and the azimuth refer to. */
            readonly reference_plane?: components["schemas"]["FitReferencePlane"];
            /** @description Region of interest, if the sample has several. */
            readonly region?: string | null;
            /** @description Rejected frames. */
            readonly rejected_frames?: readonly components["schemas"]["FrameRejected"][];
            readonly request: components["schemas"]["FitRequest"];
            /**
             * Format: double
             * @description Root mean square residual, as a share of the largest observation. Like the next three, none if the fit has no
             *     result.
             */
            readonly rms_residual?: number | null;
            /**
             * Format: int64
             * @description Number of its part
             */
            readonly sample_id: number;
            /** @description Name of its part */
            readonly sample_name: string;
            /**
             * Format: int64
             * @description Number of its scan
             */
            readonly scan_id: number;
            /**
             * Format: double
             * @description Run time, s
             */
            readonly seconds?: number;
            readonly slope_distribution?: components["schemas"]["FitSlopes"] | null;
            /** @description Outcomes of the starts. */
            readonly starts?: components["schemas"]["FitStarts"];
            /** @description State of the job. */
            readonly state: components["schemas"]["TaskState"];
            /** @description How the fit ended. */
            readonly status?: components["schemas"]["FitStatus"];
            /** @description Durations in seconds. */
            readonly timing_s?: components["schemas"]["FitTiming"];
            readonly tracer?: components["schemas"]["FitTracer"] | null;
            readonly variant: components["schemas"]["VariantChoice"];
            /** @description All variants fitted. */
            readonly variants?: readonly components["schemas"]["FitVariant"][];
            /** @description Sentences on what the user has to check or change. */
            readonly warnings?: readonly string[];
            readonly wedge_across?: components["schemas"]["FitAcross"] | null;
            /** @description Who started it: the name of a token, or `local`. */
            readonly who: string;
        };
        /** @description Azimuth of the facets from the stage's zero, and its possible causes; degrees. */
        readonly FitAcross: {
            /**
             * Format: double
             * @description Azimuth of the facets relative to the recorded φs and the stated zero.
             */
            readonly azimuth_deg: number;
            /**
             * Format: double
             * @description Its standard uncertainty from the data, without a stated wedge.
             */
            readonly azimuth_std_deg: number;
            /**
             * Format: double
             * @description Error of the azimuth's zero: what to add to it.
             */
            readonly azimuth_zero_deg: number;
            /**
             * Format: double
             * @description Its standard uncertainty; none if it is not separated from the wedge.
             */
            readonly azimuth_zero_std_deg?: number | null;
            /**
             * @description Whether wedge and zero are separated: by a fit that contains the wedge, or because the zero is stated with an
             *     uncertainty. Otherwise each of the next two is the whole azimuth: the one *or* the other.
             */
            readonly split: boolean;
            /**
             * Format: double
             * @description Tilt of the sample across v, towards rising azimuth.
             */
            readonly wedge_deg: number;
            /**
             * Format: double
             * @description Its standard uncertainty; none if it is not separated from the zero.
             */
            readonly wedge_std_deg?: number | null;
        };
        /** @description Covariance of the parameters that the data determine (k = 1). */
        readonly FitCovariance: {
            /** @description Names of the parameters, in the order of rows and columns. Fixed and held parameters are not in the list. */
            readonly parameters: readonly string[];
            /** @description Units of their values: `deg`, `1`, `1/sr`, or `arbitrary` without a white reference. */
            readonly units: readonly string[];
            /**
             * @description The matrix, row by row, in the product of the two units. The diagonal has the squares of `std`. The rest has what
             *     the errors that rows share or scatter (counting, references, angles, drift, detector, priors) have in common; wedge,
             *     shape and the error of the closed form count as independent between parameters.
             */
            readonly values: readonly (readonly number[])[];
        };
        /** @description Why a job has no result. */
        readonly FitError: {
            /** @description Stable word for programs. */
            readonly code: string;
            /** @description Cause and remedy. */
            readonly detail: string;
        };
        /** @description A cause that was found. */
        readonly FitFinding: {
            /** @description What the user should do. */
            readonly advice: string;
            /**
             * Format: double
             * @description Change of the ridge angle in degrees when the cause is accounted for; none if it cannot be determined.
             */
            readonly change_of_theta_r_deg?: number | null;
            /** @description Which one. */
            readonly code: components["schemas"]["FitFindingCode"];
            /**
             * Format: double
             * @description Share of χ² that it explains, 0 to 1.
             */
            readonly explains: number;
        };
        /**
         * @description A known cause. Scripts compare its code.
         * @enum {string}
         */
        readonly FitFindingCode: "tails" | "rounded-crests" | "translucent" | "wedge-across" | "lamp-azimuth" | "non-linear" | "lamp-drift" | "index" | "bad-block" | "bad-pose";
        /** @description Degrees of freedom of a budget's parts. The other parts count as exactly known. */
        readonly FitFreedom: {
            /**
             * Format: double
             * @description Of `counting`: residuals minus fitted directions.
             */
            readonly counting: number;
            /**
             * Format: double
             * @description Of `model`: groups of poses left out in turn, minus one.
             */
            readonly model: number;
        };
        /** @description Ends of an interval at the coverage of the report; null for an open end. */
        readonly FitInterval: {
            /**
             * Format: double
             * @description Lower end.
             */
            readonly lower?: number | null;
            /**
             * Format: double
             * @description Upper end.
             */
            readonly upper?: number | null;
        };
        /** @description One evaluation of the model on the way to the minimum. */
        readonly FitIteration: {
            /** @description Whether the cost is no higher than at all points before. */
            readonly accepted: boolean;
            /**
             * Format: double
             * @description Sum of squared weighted residuals.
             */
            readonly cost: number;
            /**
             * Format: double
             * @description Largest distance of a parameter from the end of the descent, in its standard uncertainty.
             */
            readonly error: number;
            /**
             * Format: double
             * @description Largest cosine between the residuals and the derivatives of a parameter: 0 at a minimum.
             */
            readonly gradient: number;
            /**
             * Format: double
             * @description Time since the first one.
             */
            readonly seconds: number;
            /**
             * Format: double
             * @description Largest step of a parameter from the last accepted point, in its standard uncertainty.
             */
            readonly step: number;
        };
        /** @description A parameter with its uncertainty. */
        readonly FitParameter: {
            readonly bootstrap?: components["schemas"]["FitInterval"] | null;
            /** @description Parts of the standard uncertainty. */
            readonly budget?: {
                readonly [key: string]: number;
            } | null;
            /**
             * Format: double
             * @description k, the expanded uncertainty divided by the standard uncertainty: 2, or Student's t for 95.45 % where the degrees of
             *     freedom are fewer than 50.
             */
            readonly coverage_factor?: number | null;
            /**
             * Format: double
             * @description Effective degrees of freedom (Welch–Satterthwaite); null if practically infinite.
             */
            readonly degrees_of_freedom?: number | null;
            /**
             * Format: double
             * @description Expanded uncertainty, same unit.
             */
            readonly expanded?: number | null;
            /** @description Whether the data determine it. */
            readonly identifiable: boolean;
            /** @description Why the value is null or fixed. */
            readonly note?: string | null;
            readonly profile?: components["schemas"]["FitInterval"] | null;
            /**
             * Format: double
             * @description Combined standard uncertainty, same unit.
             */
            readonly std?: number | null;
            /**
             * Format: double
             * @description Best value in the unit of the parameter (degrees in keys with `_deg`; roughness as the tangent of a slope).
             */
            readonly value?: number | null;
        };
        /** @description All parameters; angles in degrees. */
        readonly FitParameters: {
            /** @description Roughness along the ridges. */
            readonly alpha_u: components["schemas"]["FitParameter"];
            /** @description Roughness across the ridges. */
            readonly alpha_v: components["schemas"]["FitParameter"];
            /** @description Δφs, to be added to a recorded φs, degrees. */
            readonly azimuth_offset_deg: components["schemas"]["FitParameter"];
            /** @description Stray light B, as a radiance if the scale is absolute. */
            readonly background: components["schemas"]["FitParameter"];
            readonly crest_radius?: components["schemas"]["FitParameter"] | null;
            /** @description Diffuse reflectance: in `paper` that of the printed lobe, otherwise the Lambertian equivalent of a flat piece. */
            readonly rho_d: components["schemas"]["FitParameter"];
            /** @description Gain g of the signals; 1 with a white reference. */
            readonly scale: components["schemas"]["FitParameter"];
            /** @description Effective ridge angle. */
            readonly theta_r_deg: components["schemas"]["FitParameter"];
            /** @description Δθc, to be added to a recorded θc, degrees. */
            readonly tilt_offset_deg: components["schemas"]["FitParameter"];
            readonly translucency?: components["schemas"]["FitParameter"] | null;
        };
        /**
         * @description The plane that angles refer to.
         * @enum {string}
         */
        readonly FitReferencePlane: "turntable" | "sample";
        /** @description The complete result. */
        readonly FitReport: {
            /** @description The same with the commit of the build; empty in fits of programs that did not state it. */
            readonly build?: string;
            /**
             * Format: double
             * @description χ² per degree of freedom with the model error among the uncertainties.
             */
            readonly chi2_reduced?: number | null;
            /**
             * Format: double
             * @description The same with counting noise only.
             */
            readonly chi2_reduced_without_model?: number | null;
            readonly covariance?: components["schemas"]["FitCovariance"] | null;
            /**
             * @description What explains the residual that an ideal sawtooth, a steady lamp and a linear detector leave, largest share
             *     first.
             */
            readonly findings?: readonly components["schemas"]["FitFinding"][];
            /** @description Observations with their fitted values. */
            readonly fitted?: readonly components["schemas"]["FittedPoint"][];
            /** @description Degrees of freedom of the two parts of every budget that come from scatter. */
            readonly freedom?: components["schemas"]["FitFreedom"];
            /** @description One descent to the reported minimum, step by step, on request. */
            readonly iterations?: readonly components["schemas"]["FitIteration"][];
            /** @description What the fit leaves out, why, and its possible effect. */
            readonly left_out: readonly components["schemas"]["WorkLeftOut"][];
            /**
             * Format: double
             * @description Model error at the peak, as a share of the largest observation.
             */
            readonly model_discrepancy?: number | null;
            /**
             * Format: int32
             * @description Frames used, including darks and flats.
             */
            readonly n_frames_used: number;
            /** @description Number of observations fitted. */
            readonly n_observations: number;
            /** @description Sentences worth knowing that need no action. */
            readonly notes?: readonly string[];
            /** @description The parameters. */
            readonly parameters: components["schemas"]["FitParameters"];
            /** @description Program and version. */
            readonly program: string;
            /** @description The plane that θr and the azimuth refer to. */
            readonly reference_plane?: components["schemas"]["FitReferencePlane"];
            /** @description Region of interest, if the sample has several. */
            readonly region?: string | null;
            /** @description Rejected frames. */
            readonly rejected_frames: readonly components["schemas"]["FrameRejected"][];
            /**
             * Format: double
             * @description Root mean square residual, as a share of the largest observation. Like the next three, none if the fit has no
             *     result.
             */
            readonly rms_residual?: number | null;
            readonly slope_distribution?: components["schemas"]["FitSlopes"] | null;
            /** @description Outcomes of the starts. */
            readonly starts?: components["schemas"]["FitStarts"];
            /** @description How the fit ended. */
            readonly status: components["schemas"]["FitStatus"];
            /** @description Durations in seconds. */
            readonly timing_s: components["schemas"]["FitTiming"];
            readonly tracer?: components["schemas"]["FitTracer"] | null;
            /** @description Variant that the parameters belong to. */
            readonly variant: components["schemas"]["FitVariantName"];
            /** @description All variants fitted. */
            readonly variants: readonly components["schemas"]["FitVariant"][];
            /** @description Sentences on what the user has to check or change. */
            readonly warnings: readonly string[];
            readonly wedge_across?: components["schemas"]["FitAcross"] | null;
        };
        /** @description A request for a fit. */
        readonly FitRequest: {
            /**
             * Format: int32
             * @description Number of series drawn for bootstrap intervals; none if omitted.
             */
            readonly bootstrap?: number | null;
            /** @description Parameters fixed at a value, by the names of the report, and eta, k: `{"rho_d": 0.3}`. */
            readonly fix?: {
                readonly [key: string]: number;
            };
            /** @description Adds one descent to the minimum to the report, step by step. */
            readonly iterations?: boolean;
            /** @description Takes the difference to the variant traced as the model error of the budget (see [`FitOptions::judge`]). */
            readonly judge?: boolean;
            /** @description Loss function of the residuals; linear if omitted. */
            readonly loss?: components["schemas"]["Loss"];
            /**
             * Format: double
             * @description Ends search, ray tracer and bootstrap after this time, s.
             */
            readonly max_seconds?: number | null;
            /** @description Priors of parameters, by the same names. */
            readonly priors?: {
                readonly [key: string]: components["schemas"]["Prior"];
            };
            /** @description Adds profile-likelihood intervals. */
            readonly profile?: boolean;
            /** @description Region of a part with several regions. */
            readonly region?: string | null;
            /**
             * Format: int64
             * @description Number of the scan to fit.
             */
            readonly scan_id: number;
            readonly shape?: components["schemas"]["ShapeFile"] | null;
            /**
             * Format: int32
             * @description Largest number of starts of a search per variant; if omitted 8, and more where their results disagree.
             */
            readonly starts?: number | null;
            /**
             * Format: double
             * @description Ends the ray tracer once its standard error, as a share of the largest radiance, is below this.
             */
            readonly target_error?: number | null;
            /**
             * Format: double
             * @description Share of the peak that the model may omit (see [`FitOptions::tolerance`]).
             */
            readonly tolerance?: number | null;
            /** @description Variant of the model; auto if omitted. */
            readonly variant?: components["schemas"]["VariantChoice"];
        };
        /** @description Slope distribution of the facets. */
        readonly FitSlopes: {
            /**
             * Format: double
             * @description Beckmann roughness with the same half width along the ridges, comparable between distributions.
             */
            readonly alpha_half_width_u?: number | null;
            /**
             * Format: double
             * @description The same across the ridges.
             */
            readonly alpha_half_width_v?: number | null;
            /** @description `beckmann` or `student-t`. */
            readonly name: string;
            /**
             * Format: double
             * @description γ of Student's t (GGX is 2); null for Beckmann.
             */
            readonly shape?: number | null;
        };
        /** @description Outcomes of the starts. */
        readonly FitStarts: {
            /** @description Starts that ended at the reported minimum. */
            readonly at_minimum: number;
            /** @description Starts that converged to a worse minimum. */
            readonly elsewhere: number;
            /** @description Starts that did not converge. */
            readonly not_converged: number;
            /** @description Starts tried. */
            readonly tried: number;
        };
        /**
         * @description How a fit ended. Scripts compare the word.
         * @enum {string}
         */
        readonly FitStatus: "converged" | "at-bound" | "rank-deficient" | "stalled" | "not-finite" | "too-few-observations" | "cancelled";
        /** @description Durations in seconds; filled in by the caller that has a clock. */
        readonly FitTiming: {
            /**
             * Format: double
             * @description Fitting.
             */
            readonly fit: number;
            /**
             * Format: double
             * @description Reading frames.
             */
            readonly read: number;
            /**
             * Format: double
             * @description Reducing frames.
             */
            readonly reduce: number;
        };
        /** @description What the ray tracer did for a fit. */
        readonly FitTracer: {
            /** @description Why it ended. */
            readonly end: components["schemas"]["FitTracerEnd"];
            /**
             * Format: double
             * @description Root mean square standard error of the radiances, as a share of the largest.
             */
            readonly error: number;
            readonly height_map?: components["schemas"]["RidgeFacts"] | null;
            /** @description Passes of tracing and fitting. */
            readonly passes: number;
            /**
             * Format: int64
             * @description Paths per pose in the last pass, from the camera and as many from the lamp.
             */
            readonly paths_per_pose: number;
            /** @description Whether polarisation was followed from bounce to bounce. */
            readonly polarised: boolean;
            /**
             * Format: double
             * @description Effective ridge angle of the given profile before it was scaled to the fitted one.
             */
            readonly profile_theta_r_deg?: number | null;
            /** @description Whether that profile was reversed so that its facets lean to +v. */
            readonly profile_turned?: boolean;
        };
        /**
         * @description Why a tracing ended.
         * @enum {string}
         */
        readonly FitTracerEnd: "settled" | "most-paths" | "most-passes" | "stopped";
        /** @description One variant in the comparison. */
        readonly FitVariant: {
            /**
             * Format: double
             * @description Roughness along the ridges.
             */
            readonly alpha_u?: number | null;
            /**
             * Format: double
             * @description Roughness across the ridges.
             */
            readonly alpha_v?: number | null;
            /**
             * Format: double
             * @description χ² per degree of freedom with counting noise only.
             */
            readonly chi2_reduced_without_model: number;
            /**
             * Format: double
             * @description Quasi-Akaike criterion; ĉ is taken from the variant that fits the data best. Only differences are meaningful.
             */
            readonly qaic: number;
            /**
             * Format: double
             * @description Diffuse reflectance.
             */
            readonly rho_d?: number | null;
            /**
             * Format: double
             * @description Root mean square residual, as a share of the largest observation.
             */
            readonly rms_residual: number;
            /** @description How its fit ended. */
            readonly status: components["schemas"]["FitStatus"];
            /**
             * Format: double
             * @description Ridge angle.
             */
            readonly theta_r_deg?: number | null;
            /** @description Which variant. */
            readonly variant: components["schemas"]["FitVariantName"];
        };
        /**
         * @description Names of the variants in the JSON form.
         * @enum {string}
         */
        readonly FitVariantName: "paper" | "sawtooth" | "traced";
        /** @description An observation with the value that the fit expects; angles as recorded. */
        readonly FittedPoint: {
            /**
             * Format: double
             * @description Value of the fitted model.
             */
            readonly fitted: number;
            /**
             * Format: double
             * @description Sample rotation as recorded.
             */
            readonly phi_s_deg: number;
            /**
             * Format: double
             * @description Its standard uncertainty.
             */
            readonly sigma: number;
            /**
             * Format: double
             * @description Observed signal.
             */
            readonly signal: number;
            /**
             * Format: double
             * @description Camera tilt as recorded.
             */
            readonly theta_c_deg: number;
        };
        /** @description `[flat]`: the white reference. */
        readonly FlatFacts: {
            /**
             * Format: double
             * @description Diffuse reflectance from the certificate; without one the flats give no absolute scale.
             */
            readonly reflectance?: number | null;
            /**
             * Format: double
             * @description Its standard uncertainty.
             */
            readonly reflectance_std?: number | null;
        };
        /** @description White-reference frames of a plan. */
        readonly FlatPlan: {
            /** @description Exposures. */
            readonly exposures_s: readonly number[];
            /**
             * Format: int32
             * @description Frames per tilt and exposure; 0 for none.
             */
            readonly repeats: number;
            /** @description Tilts. */
            readonly theta_c_deg: readonly number[];
        };
        /** @description White-reference frames of a request. */
        readonly FlatRequest: {
            /** @description Exposures; the rig's for the white reference if not given. */
            readonly exposures_s?: readonly number[] | null;
            /**
             * Format: int32
             * @description Frames per tilt and exposure; 0 leaves the white reference out.
             */
            readonly repeats?: number | null;
            readonly theta_c_deg?: components["schemas"]["Values"] | null;
        };
        /** @description Time, work and error that a calculation is expected to take. */
        readonly Forecast: {
            readonly amount?: components["schemas"]["ForecastAmount"] | null;
            readonly at_limit?: components["schemas"]["ForecastAtLimit"] | null;
            /** @description Whether `seconds` is a bound, not an estimate. */
            readonly at_most: boolean;
            /** @description Whether the time limit is too short for the whole calculation; parts, work and error are those of the whole. */
            readonly cut_short?: boolean;
            readonly error?: components["schemas"]["ForecastError"] | null;
            /** @description Parts of that time, in the order in which they are spent; empty where parts are not separated. */
            readonly parts?: readonly components["schemas"]["ForecastPart"][];
            /**
             * Format: double
             * @description Seconds in all.
             */
            readonly seconds: number;
            /**
             * Format: double
             * @description Seconds of the whole calculation, where a limit cuts it.
             */
            readonly uncut_seconds?: number | null;
        };
        /** @description Countable work. */
        readonly ForecastAmount: {
            /**
             * Format: int64
             * @description Number.
             */
            readonly count: number;
            /** @description Noun: "photons". */
            readonly of: string;
        };
        /** @description What random sampling reaches at a time limit. */
        readonly ForecastAtLimit: {
            /**
             * Format: int64
             * @description Number of samples drawn at the limit.
             */
            readonly count?: number | null;
            /**
             * Format: double
             * @description Error at the limit.
             */
            readonly error?: number | null;
        };
        /** @description An expected error. */
        readonly ForecastError: {
            /** @description Quantity: "a reflected bin". */
            readonly of: string;
            /**
             * Format: double
             * @description Relative standard error, or a bound on the share that is left out.
             */
            readonly value: number;
        };
        /** @description A forecast with the time that the work took. */
        readonly ForecastOutcome: {
            /**
             * Format: double
             * @description Seconds forecast before the start.
             */
            readonly forecast_s: number;
            /** @description Scene. */
            readonly scene: string;
            /**
             * Format: double
             * @description Seconds taken.
             */
            readonly taken_s: number;
        };
        /** @description Seconds of a part. */
        readonly ForecastPart: {
            /**
             * Format: double
             * @description Duration, s.
             */
            readonly seconds: number;
            /** @description Purpose: "to read frames". */
            readonly what: string;
        };
        /** @description A frame. */
        readonly FrameBody: {
            /** @description Whether reductions use the frame. */
            readonly accepted: boolean;
            /**
             * Format: int64
             * @description Size of the PNG file, bytes.
             */
            readonly bytes: number;
            /**
             * Format: double
             * @description Exposure time, s.
             */
            readonly exposure_s: number;
            /** @description File name in an export. */
            readonly file: string;
            /**
             * Format: int32
             * @description Rows, px.
             */
            readonly height_px: number;
            /**
             * Format: int64
             * @description Number of the frame.
             */
            readonly id: number;
            /** @description Path of the PNG on this server. */
            readonly image: string;
            /** @description Kind of the frame. */
            readonly kind: components["schemas"]["FrameKind"];
            /**
             * Format: int32
             * @description Largest count of a pixel, DN.
             */
            readonly max_dn: number;
            /**
             * Format: double
             * @description Mean count of all pixels, DN.
             */
            readonly mean_dn: number;
            /** @description SHA-256 of the imported file, hexadecimal; null if that is the PNG itself. */
            readonly original_sha256?: string | null;
            /**
             * Format: double
             * @description Sample azimuth φs read back from the stage, degrees.
             */
            readonly phi_s_deg: number;
            /** @description Why the frame is not used; null if it is used. */
            readonly reason?: string | null;
            /**
             * Format: int32
             * @description Number of the repeat, from 0.
             */
            readonly repeat: number;
            /**
             * Format: int32
             * @description Pixels at or above the saturation level.
             */
            readonly saturated_px: number;
            /**
             * Format: int64
             * @description Number of the scan that took it.
             */
            readonly scan_id: number;
            /** @description SHA-256 of the PNG file, hexadecimal. */
            readonly sha256: string;
            readonly tag?: components["schemas"]["TagBody"] | null;
            /**
             * Format: double
             * @description Camera tilt θc read back from the stage, degrees.
             */
            readonly theta_c_deg: number;
            /** @description Start of the exposure, RFC 3339 in UTC. */
            readonly timestamp: string;
            /**
             * Format: int32
             * @description Columns, px.
             */
            readonly width_px: number;
        };
        /** @description A frame. */
        readonly FrameHash: {
            /** @description File name in the series or in an export. */
            readonly file: string;
            /** @description What it shows. */
            readonly kind: components["schemas"]["FrameKind"];
            /** @description SHA-256 of the file. */
            readonly sha256: string;
        };
        /** @description Frames by their content. */
        readonly FrameHashes: {
            /** @description Number of frames. */
            readonly count: number;
            /** @description The frames, by name. */
            readonly files: readonly components["schemas"]["FrameHash"][];
            /** @description SHA-256 of the text that `sha256sum` prints of the files: a line `HASH  NAME` for each, in the order of `files`. */
            readonly sha256: string;
        };
        /**
         * @description Kind of a frame.
         * @enum {string}
         */
        readonly FrameKind: "sample" | "dark" | "flat";
        /** @description A frame that the reduction left out, with its reason. */
        readonly FrameRejected: {
            /** @description Details in words and numbers; may be empty. */
            readonly detail: string;
            /** @description File name as recorded. */
            readonly file: string;
            /** @description Stable word or short phrase: `saturated`, `black`, `unreadable`, `wrong size`, `shifted`, … */
            readonly reason: string;
        };
        /** @description A gauge R&R study. */
        readonly Gauge: {
            /** @description Whether all combinations have the same number of scans. */
            readonly balanced: boolean;
            readonly by?: components["schemas"]["GroupedBy"] | null;
            /** @description How parts and groups are combined. */
            readonly design: components["schemas"]["GaugeDesign"];
            readonly distinct_categories?: components["schemas"]["GaugeNumber"] | null;
            /** @description Repeatability and reproducibility together (R&R). */
            readonly gauge: components["schemas"]["GaugeSpread"];
            readonly gauge_percent?: components["schemas"]["GaugeNumber"] | null;
            /** @description Whether the interaction is pooled with the repeatability. */
            readonly interaction_pooled: boolean;
            /**
             * Format: double
             * @description Probability of an interaction at least this large by chance; null where it cannot be tested.
             */
            readonly interaction_probability?: number | null;
            /** @description Number of operators or days; 0 without groups. */
            readonly n_groups: number;
            /** @description Number of parts. */
            readonly n_parts: number;
            /** @description What limits the study. */
            readonly notes: readonly string[];
            readonly part_to_part?: components["schemas"]["GaugeSpread"] | null;
            /** @description Repeated scans of one part by one group (equipment variation). */
            readonly repeatability: components["schemas"]["GaugeSpread"];
            readonly reproducibility?: components["schemas"]["GaugeSpread"] | null;
            /** @description The analysis of variance. */
            readonly rows: readonly components["schemas"]["VarianceRow"][];
            readonly total?: components["schemas"]["GaugeSpread"] | null;
        };
        /**
         * @description How parts and groups are combined.
         * @enum {string}
         */
        readonly GaugeDesign: "crossed" | "parts-within-groups" | "groups-within-parts" | "parts-only" | "groups-only";
        /** @description A number with its interval. */
        readonly GaugeNumber: {
            /** @description Interval of 95 %. */
            readonly interval?: readonly number[] | null;
            /** @description Why there is no interval. */
            readonly note?: string | null;
            /**
             * Format: double
             * @description Estimate.
             */
            readonly value: number;
        };
        /** @description A standard deviation with its degrees of freedom and interval. */
        readonly GaugeSpread: {
            /**
             * Format: double
             * @description Effective degrees of freedom.
             */
            readonly degrees_of_freedom?: number | null;
            /** @description Interval of 95 % for the standard deviation. */
            readonly interval?: readonly number[] | null;
            /** @description Why there is no interval. */
            readonly note?: string | null;
            /**
             * Format: double
             * @description Share of the standard deviation of the total, percent; the shares of components do not add up to 100.
             */
            readonly percent_of_total?: number | null;
            /**
             * Format: double
             * @description Standard deviation, in the unit of the parameter; 0 for a component that the data do not show.
             */
            readonly std: number;
        };
        /** @description Positions of lamp and camera. */
        readonly GeometryBody: {
            /**
             * Format: double
             * @description Added to a recorded φs it gives the azimuth of the lean direction v, degrees.
             */
            readonly azimuth_zero_deg: number;
            /**
             * Format: double
             * @description Angular radius of the lens's pupil seen from the sample, degrees; null for a point.
             */
            readonly lens_angular_radius_deg?: number | null;
            /**
             * Format: double
             * @description Angular radius of the lamp seen from the sample, degrees; null for a point.
             */
            readonly light_angular_radius_deg?: number | null;
            /**
             * Format: double
             * @description Azimuth of the lamp about the camera's axis, degrees: 0 in the tilt plane, 90 perpendicular to it.
             */
            readonly light_azimuth_deg: number;
            /**
             * Format: double
             * @description Angle between lamp and camera, degrees.
             */
            readonly theta_l_deg: number;
            /**
             * Format: double
             * @description Wavelength of the lamp, nm; null if not stated.
             */
            readonly wavelength_nm?: number | null;
        };
        /** @description Evenly spaced values. */
        readonly Grid: {
            /**
             * Format: double
             * @description First value.
             */
            readonly from: number;
            /**
             * Format: double
             * @description Distance between values; positive.
             */
            readonly step: number;
            /**
             * Format: double
             * @description Last value, reached if the step meets it.
             */
            readonly to: number;
        };
        /**
         * @description What reproducibility is taken over.
         * @enum {string}
         */
        readonly GroupedBy: "operator" | "day";
        /**
         * @description Where the guard band comes from.
         * @enum {string}
         */
        readonly GuardBasis: "verdict" | "median-uncertainty";
        /** @description A histogram of 64 bins of equal width. */
        readonly HistogramBody: {
            /**
             * Format: int32
             * @description Counts per bin, DN. The first bin begins at 0 DN.
             */
            readonly bin_dn: number;
            /** @description Pixels of each bin. */
            readonly pixels: readonly number[];
        };
        /** @description Who holds the rig. */
        readonly HolderBody: {
            /** @description Name of the lease, or the scan or motion that holds the rig without one. */
            readonly name: string;
            /** @description When the lease expires if it is not used, RFC 3339 in UTC; null for a scan or motion, which holds the rig until its end. */
            readonly until?: string | null;
            /** @description Name of the caller: of its token, or `local`. */
            readonly who: string;
        };
        /** @description Result of an import. */
        readonly ImportBody: {
            /** @description Values of the description that differ. Both scans are kept. */
            readonly differences: readonly string[];
            /**
             * Format: int64
             * @description Otherwise the scan with the same frames whose description differs least; null if there is none.
             */
            readonly like_scan_id?: number | null;
            /** @description Number of frames imported. */
            readonly n_frames: number;
            /**
             * Format: int64
             * @description The newest scan that already holds the same series; null if there is none.
             */
            readonly same_as_scan_id?: number | null;
            /**
             * Format: int64
             * @description Number of its part.
             */
            readonly sample_id: number;
            /**
             * Format: int64
             * @description Number of the new scan.
             */
            readonly scan_id: number;
            /** @description Frames left out, each with the reason. */
            readonly skipped: readonly string[];
        };
        /** @description A series to import. */
        readonly ImportRequest: {
            /** @description Absolute path of the folder on the daemon's machine, below a folder of `import.roots`. */
            readonly folder: string;
            /** @description Leave out unreadable frames instead of refusing the series. */
            readonly skip_unreadable?: boolean;
        };
        /** @description An alarm or a recovery. */
        readonly IncidentBody: {
            /** @description When it was recorded, RFC 3339 in UTC. */
            readonly at: string;
            /** @description Whether a person resumed the scan in between; null for an alarm. */
            readonly attended?: boolean | null;
            /** @description Stable word of the fault. */
            readonly code: string;
            /**
             * Format: int64
             * @description Number of the event.
             */
            readonly id: number;
            /** @description Whether it is a fault or the end of one. */
            readonly kind: components["schemas"]["IncidentKind"];
            /** @description What happened, as a sentence. */
            readonly message: string;
            /** @description Points of the plan that were taken again, by their index. */
            readonly points: readonly number[];
            /**
             * Format: double
             * @description Time from the fault to the first point that counted again, s; null for an alarm.
             */
            readonly took_s?: number | null;
        };
        /**
         * @description Whether something went wrong or is over.
         * @enum {string}
         */
        readonly IncidentKind: "alarm" | "recovered";
        /**
         * @description The kind of a job.
         * @enum {string}
         */
        readonly JobKind: "fit" | "map" | "contrast" | "verdict" | "trace";
        /** @description State of a jog. */
        readonly JogAnswer: {
            /** @description Why the axis waits at the end of its way: its limit, or a forbidden region; null while it moves. */
            readonly at_end?: string | null;
            /** @description Whether the axis has stopped for good. */
            readonly ended: boolean;
            /**
             * Format: int64
             * @description Number of the jog: send it with each renewal.
             */
            readonly jog: number;
        };
        /** @description A jog of one axis. */
        readonly JogBody: {
            /** @description `theta_c` or `phi_s`. */
            readonly axis: string;
            /**
             * Format: int64
             * @description Number of the jog to renew or end; omitted to begin one.
             */
            readonly jog?: number | null;
            /**
             * Format: double
             * @description Speed and direction, degrees per second: positive upwards, 0 to end the jog. A greater speed than that of the axis
             *     is limited to it.
             */
            readonly speed_deg_s: number;
        };
        /** @description The judgement of one limited quantity. */
        readonly JudgedItem: {
            /**
             * Format: double
             * @description Lower acceptance limit: tolerance limit plus guard band; null where the guard bands of two limits meet.
             */
            readonly acceptance_lower?: number | null;
            /**
             * Format: double
             * @description Upper acceptance limit.
             */
            readonly acceptance_upper?: number | null;
            /**
             * Format: double
             * @description Probability that the true value conforms.
             */
            readonly conformance_probability?: number | null;
            /**
             * Format: double
             * @description Ratio of expanded to standard uncertainty.
             */
            readonly coverage_factor?: number | null;
            /**
             * Format: double
             * @description Expanded uncertainty.
             */
            readonly expanded?: number | null;
            /**
             * Format: double
             * @description Width of the guard band. With two limits the risks at both count, which widens it where the tolerance is
             *     only a few standard uncertainties wide.
             */
            readonly guard_band?: number | null;
            /**
             * Format: double
             * @description Lower tolerance limit.
             */
            readonly lower?: number | null;
            /** @description Quantity, with its unit in the name. */
            readonly quantity: string;
            /** @description The reason for it. */
            readonly reason: string;
            /**
             * Format: double
             * @description Standard uncertainty.
             */
            readonly std?: number | null;
            /**
             * Format: double
             * @description Upper tolerance limit.
             */
            readonly upper?: number | null;
            /**
             * Format: double
             * @description Measured value.
             */
            readonly value?: number | null;
            /** @description The result. */
            readonly verdict: components["schemas"]["VerdictWord"];
        };
        /** @description The judgement of one part. */
        readonly Judgement: {
            /**
             * Format: double
             * @description Lower bound of the probability that all items conform (Boole's inequality; a positive correlation raises it); null
             *     where an item is not determined.
             */
            readonly conformance_probability_min?: number | null;
            /** @description The allowed risks. */
            readonly decision: components["schemas"]["DecisionRule"];
            /** @description The rule as a sentence. */
            readonly decision_rule: string;
            /** @description One per limited quantity. */
            readonly items: readonly components["schemas"]["JudgedItem"][];
            /** @description Name of the specification. */
            readonly specification: string;
            /** @description Fails if one item fails, passes if all pass. */
            readonly verdict: components["schemas"]["VerdictWord"];
            /** @description Sentences for the user, including the warnings of the fit. */
            readonly warnings: readonly string[];
            /** @description What would decide the items that are not decided, by quantity. */
            readonly would_decide?: {
                readonly [key: string]: components["schemas"]["WouldDecide"];
            };
        };
        /** @description A lease that was taken. */
        readonly LeaseBody: {
            /** @description When it expires if it is not used, RFC 3339 in UTC. Every request that presents it renews it. */
            readonly expires_at: string;
            /** @description The lease: send it as `Ridged-Lease` with every order. It is shown only now. */
            readonly id: string;
            /** @description Its name. */
            readonly name: string;
            readonly taken_from?: components["schemas"]["HolderBody"] | null;
            /** @description Name of the caller. */
            readonly who: string;
        };
        /** @description A lease to take. */
        readonly LeaseRequest: {
            /** @description Name that others are shown, 1 to 100 characters. */
            readonly name: string;
            /**
             * Format: int64
             * @description Seconds after its last use at which it expires, 10 to 86 400; 600 if omitted.
             */
            readonly seconds?: number | null;
            /** @description Take it from the caller that holds it. */
            readonly take_over?: boolean;
        };
        /** @description State of the lease. */
        readonly LeaseStateBody: {
            readonly holder?: components["schemas"]["HolderBody"] | null;
            /** @description Whether the request presents the lease that holds the rig. */
            readonly own: boolean;
        };
        /** @description A scan that is not part of the study. */
        readonly LeftOutScan: {
            /**
             * Format: int64
             * @description Number of the scan.
             */
            readonly scan_id: number;
            /** @description Why. */
            readonly why: string;
        };
        /** @description A page of a list. */
        readonly List_CalibrationBody: {
            /** @description Rows of this page that the store cannot read; omitted if there are none. */
            readonly damaged?: readonly components["schemas"]["DamagedBody"][];
            /** @description The rows of this page. */
            readonly items: readonly {
                /** @description When the frames were taken, RFC 3339 in UTC. */
                readonly created_at: string;
                /** @description Exposure times, s. */
                readonly exposures_s: readonly number[];
                /**
                 * Format: int64
                 * @description Number of the calibration.
                 */
                readonly id: number;
                /** @description Kind of its frames: dark or flat. */
                readonly kind: components["schemas"]["FrameKind"];
                /**
                 * Format: int32
                 * @description Number of frames.
                 */
                readonly n_frames: number;
                /**
                 * Format: int64
                 * @description Number of the scan that took the frames.
                 */
                readonly scan_id: number;
                /** @description Camera tilts θc, degrees; empty for dark frames. */
                readonly theta_c_deg: readonly number[];
                /** @description Whether scans can use it now. */
                readonly valid: boolean;
                /** @description End of its validity under the current settings, RFC 3339 in UTC. */
                readonly valid_until: string;
            }[];
            /** @description `cursor` of the next page; null at the end. */
            readonly next_cursor?: string | null;
        };
        /** @description A page of a list. */
        readonly List_CertaintyBody: {
            /** @description Rows of this page that the store cannot read; omitted if there are none. */
            readonly damaged?: readonly components["schemas"]["DamagedBody"][];
            /** @description The rows of this page. */
            readonly items: readonly {
                /** @description When it was reported, RFC 3339 in UTC. */
                readonly at: string;
                /**
                 * Format: double
                 * @description Time that the rig had spent moving and exposing, s, without waiting for the operator.
                 */
                readonly elapsed_s: number;
                /**
                 * Format: int64
                 * @description Number of the event that reported it.
                 */
                readonly id: number;
                /**
                 * Format: int32
                 * @description Number of frames used, including dark and white-reference frames.
                 */
                readonly n_frames_used: number;
                /** @description Number of poses fitted. */
                readonly n_observations: number;
                /** @description By name, without the parameters that the frames so far do not determine. */
                readonly parameters: {
                    readonly [key: string]: components["schemas"]["UncertainBody"];
                };
                /** @description How the fit ended. */
                readonly status: components["schemas"]["FitStatus"];
                /** @description Variant of the model that gave the values. */
                readonly variant: components["schemas"]["FitVariantName"];
            }[];
            /** @description `cursor` of the next page; null at the end. */
            readonly next_cursor?: string | null;
        };
        /** @description A page of a list. */
        readonly List_Contrast: {
            /** @description Rows of this page that the store cannot read; omitted if there are none. */
            readonly damaged?: readonly components["schemas"]["DamagedBody"][];
            /** @description The rows of this page. */
            readonly items: readonly {
                /** @description When it was accepted, RFC 3339 in UTC. */
                readonly created_at: string;
                /** @description When it ended, RFC 3339 in UTC; null while it runs. */
                readonly ended_at?: string | null;
                readonly error?: components["schemas"]["FitError"] | null;
                readonly findings?: components["schemas"]["ReportedFindings"] | null;
                readonly forecast?: components["schemas"]["Forecast"] | null;
                /**
                 * Format: int64
                 * @description Number of the job within its kind.
                 */
                readonly id: number;
                /** @description What no uncertainty includes. */
                readonly left_out?: readonly components["schemas"]["WorkLeftOut"][];
                /** @description One line for each tilt, and where it was predicted for each ridge angle. */
                readonly lines?: readonly components["schemas"]["ReportedLine"][];
                /** @description Means of the contrasts. */
                readonly mean?: components["schemas"]["ReportedMeans"];
                /** @description `measured`. */
                readonly mode?: string;
                readonly model_error?: components["schemas"]["ForecastError"] | null;
                /** @description Program and version. */
                readonly program?: string;
                readonly progress?: components["schemas"]["WorkProgress"] | null;
                /** @description Region of the frames; null for the whole frame. */
                readonly region?: string | null;
                readonly request: components["schemas"]["ContrastRequest"];
                /**
                 * Format: int64
                 * @description Number of the part of that scan.
                 */
                readonly sample_id?: number | null;
                /** @description Name of that part. */
                readonly sample_name?: string | null;
                /**
                 * @description `white reference`: radiances and absolute contrasts are for a lamp irradiance of 1; `arbitrary`: they are fractions
                 *     of the brightest level.
                 */
                readonly scale?: string;
                /**
                 * Format: int64
                 * @description Number of its scan; null without one.
                 */
                readonly scan_id?: number | null;
                /** @description State of the job. */
                readonly state: components["schemas"]["TaskState"];
                /** @description Stray light in every signal. */
                readonly stray_light?: components["schemas"]["StrayLight"];
                /** @description What a person must know. */
                readonly warnings?: readonly string[];
                /** @description Who started it: the name of a token, or `local`. */
                readonly who: string;
            }[];
            /** @description `cursor` of the next page; null at the end. */
            readonly next_cursor?: string | null;
        };
        /** @description A page of a list. */
        readonly List_Fit: {
            /** @description Rows of this page that the store cannot read; omitted if there are none. */
            readonly damaged?: readonly components["schemas"]["DamagedBody"][];
            /** @description The rows of this page. */
            readonly items: readonly {
                /** @description The same with the commit of the build; empty in fits of programs that did not state it. */
                readonly build?: string;
                /**
                 * Format: double
                 * @description χ² per degree of freedom with the model error among the uncertainties.
                 */
                readonly chi2_reduced?: number | null;
                /**
                 * Format: double
                 * @description The same with counting noise only.
                 */
                readonly chi2_reduced_without_model?: number | null;
                readonly covariance?: components["schemas"]["FitCovariance"] | null;
                /** @description When it was accepted, RFC 3339 in UTC. */
                readonly created_at: string;
                /** @description When it ended, RFC 3339 in UTC; null while it runs. */
                readonly ended_at?: string | null;
                readonly error?: components["schemas"]["FitError"] | null;
                /**
                 * @description What explains the residual that an ideal sawtooth, a steady lamp and a linear detector leave, largest share
                 *     first.
                 */
                readonly findings?: readonly components["schemas"]["FitFinding"][];
                /** @description Observations with their fitted values. */
                readonly fitted?: readonly components["schemas"]["FittedPoint"][];
                readonly forecast?: components["schemas"]["Forecast"] | null;
                /** @description Degrees of freedom of the two parts of every budget that come from scatter. */
                readonly freedom?: components["schemas"]["FitFreedom"];
                /**
                 * Format: int64
                 * @description Number of the job within its kind.
                 */
                readonly id: number;
                /** @description One descent to the reported minimum, step by step, on request. */
                readonly iterations?: readonly components["schemas"]["FitIteration"][];
                /** @description What the fit leaves out, why, and its possible effect. */
                readonly left_out?: readonly components["schemas"]["WorkLeftOut"][];
                /**
                 * Format: double
                 * @description Model error at the peak, as a share of the largest observation.
                 */
                readonly model_discrepancy?: number | null;
                /**
                 * Format: int32
                 * @description Frames used, including darks and flats.
                 */
                readonly n_frames_used?: number;
                /** @description Number of observations fitted. */
                readonly n_observations?: number;
                /** @description Sentences worth knowing that need no action. */
                readonly notes?: readonly string[];
                /** @description The parameters. */
                readonly parameters?: components["schemas"]["FitParameters"];
                /** @description Program and version. */
                readonly program?: string;
                readonly progress?: components["schemas"]["WorkProgress"] | null;
                /** @description The plane that θr and the azimuth refer to. */
                readonly reference_plane?: components["schemas"]["FitReferencePlane"];
                /** @description Region of interest, if the sample has several. */
                readonly region?: string | null;
                /** @description Rejected frames. */
                readonly rejected_frames?: readonly components["schemas"]["FrameRejected"][];
                readonly request: components["schemas"]["FitRequest"];
                /**
                 * Format: double
                 * @description Root mean square residual, as a share of the largest observation. Like the next three, none if the fit has no
                 *     result.
                 */
                readonly rms_residual?: number | null;
                /**
                 * Format: int64
                 * @description Number of its part
                 */
                readonly sample_id: number;
                /** @description Name of its part */
                readonly sample_name: string;
                /**
                 * Format: int64
                 * @description Number of its scan
                 */
                readonly scan_id: number;
                /**
                 * Format: double
                 * @description Run time, s
                 */
                readonly seconds?: number;
                readonly slope_distribution?: components["schemas"]["FitSlopes"] | null;
                /** @description Outcomes of the starts. */
                readonly starts?: components["schemas"]["FitStarts"];
                /** @description State of the job. */
                readonly state: components["schemas"]["TaskState"];
                /** @description How the fit ended. */
                readonly status?: components["schemas"]["FitStatus"];
                /** @description Durations in seconds. */
                readonly timing_s?: components["schemas"]["FitTiming"];
                readonly tracer?: components["schemas"]["FitTracer"] | null;
                readonly variant: components["schemas"]["VariantChoice"];
                /** @description All variants fitted. */
                readonly variants?: readonly components["schemas"]["FitVariant"][];
                /** @description Sentences on what the user has to check or change. */
                readonly warnings?: readonly string[];
                readonly wedge_across?: components["schemas"]["FitAcross"] | null;
                /** @description Who started it: the name of a token, or `local`. */
                readonly who: string;
            }[];
            /** @description `cursor` of the next page; null at the end. */
            readonly next_cursor?: string | null;
        };
        /** @description A page of a list. */
        readonly List_FrameBody: {
            /** @description Rows of this page that the store cannot read; omitted if there are none. */
            readonly damaged?: readonly components["schemas"]["DamagedBody"][];
            /** @description The rows of this page. */
            readonly items: readonly {
                /** @description Whether reductions use the frame. */
                readonly accepted: boolean;
                /**
                 * Format: int64
                 * @description Size of the PNG file, bytes.
                 */
                readonly bytes: number;
                /**
                 * Format: double
                 * @description Exposure time, s.
                 */
                readonly exposure_s: number;
                /** @description File name in an export. */
                readonly file: string;
                /**
                 * Format: int32
                 * @description Rows, px.
                 */
                readonly height_px: number;
                /**
                 * Format: int64
                 * @description Number of the frame.
                 */
                readonly id: number;
                /** @description Path of the PNG on this server. */
                readonly image: string;
                /** @description Kind of the frame. */
                readonly kind: components["schemas"]["FrameKind"];
                /**
                 * Format: int32
                 * @description Largest count of a pixel, DN.
                 */
                readonly max_dn: number;
                /**
                 * Format: double
                 * @description Mean count of all pixels, DN.
                 */
                readonly mean_dn: number;
                /** @description SHA-256 of the imported file, hexadecimal; null if that is the PNG itself. */
                readonly original_sha256?: string | null;
                /**
                 * Format: double
                 * @description Sample azimuth φs read back from the stage, degrees.
                 */
                readonly phi_s_deg: number;
                /** @description Why the frame is not used; null if it is used. */
                readonly reason?: string | null;
                /**
                 * Format: int32
                 * @description Number of the repeat, from 0.
                 */
                readonly repeat: number;
                /**
                 * Format: int32
                 * @description Pixels at or above the saturation level.
                 */
                readonly saturated_px: number;
                /**
                 * Format: int64
                 * @description Number of the scan that took it.
                 */
                readonly scan_id: number;
                /** @description SHA-256 of the PNG file, hexadecimal. */
                readonly sha256: string;
                readonly tag?: components["schemas"]["TagBody"] | null;
                /**
                 * Format: double
                 * @description Camera tilt θc read back from the stage, degrees.
                 */
                readonly theta_c_deg: number;
                /** @description Start of the exposure, RFC 3339 in UTC. */
                readonly timestamp: string;
                /**
                 * Format: int32
                 * @description Columns, px.
                 */
                readonly width_px: number;
            }[];
            /** @description `cursor` of the next page; null at the end. */
            readonly next_cursor?: string | null;
        };
        /** @description A page of a list. */
        readonly List_IncidentBody: {
            /** @description Rows of this page that the store cannot read; omitted if there are none. */
            readonly damaged?: readonly components["schemas"]["DamagedBody"][];
            /** @description The rows of this page. */
            readonly items: readonly {
                /** @description When it was recorded, RFC 3339 in UTC. */
                readonly at: string;
                /** @description Whether a person resumed the scan in between; null for an alarm. */
                readonly attended?: boolean | null;
                /** @description Stable word of the fault. */
                readonly code: string;
                /**
                 * Format: int64
                 * @description Number of the event.
                 */
                readonly id: number;
                /** @description Whether it is a fault or the end of one. */
                readonly kind: components["schemas"]["IncidentKind"];
                /** @description What happened, as a sentence. */
                readonly message: string;
                /** @description Points of the plan that were taken again, by their index. */
                readonly points: readonly number[];
                /**
                 * Format: double
                 * @description Time from the fault to the first point that counted again, s; null for an alarm.
                 */
                readonly took_s?: number | null;
            }[];
            /** @description `cursor` of the next page; null at the end. */
            readonly next_cursor?: string | null;
        };
        /** @description A page of a list. */
        readonly List_Map: {
            /** @description Rows of this page that the store cannot read; omitted if there are none. */
            readonly damaged?: readonly components["schemas"]["DamagedBody"][];
            /** @description The rows of this page. */
            readonly items: readonly {
                /**
                 * Format: double
                 * @description Usual χ² per degree of freedom; pixels' uncertainties are scaled by its square root.
                 */
                readonly chi2_reduced_usual?: number;
                /** @description When it was accepted, RFC 3339 in UTC. */
                readonly created_at: string;
                /** @description Connected areas that differ from the rest, the largest first. */
                readonly defects?: readonly components["schemas"]["MapDefect"][];
                /** @description When it ended, RFC 3339 in UTC; null while it runs. */
                readonly ended_at?: string | null;
                readonly error?: components["schemas"]["FitError"] | null;
                /**
                 * Format: double
                 * @description Evaluations of all observations per fitted pixel.
                 */
                readonly evaluations_per_pixel?: number;
                /** @description Files written, relative to the output folder. */
                readonly files?: readonly string[];
                /** @description The bit of each flag in `flags.tif`; a pixel's value is the sum of its flags' bits. */
                readonly flag_bits?: {
                    readonly [key: string]: number;
                };
                /** @description Pixels per flag. */
                readonly flags?: {
                    readonly [key: string]: number;
                };
                readonly forecast?: components["schemas"]["Forecast"] | null;
                /**
                 * Format: int64
                 * @description Number of the job within its kind.
                 */
                readonly id: number;
                /** @description Lean directions that many pixels share. */
                readonly lean_directions?: readonly components["schemas"]["MapLean"][];
                /** @description What the model omits, why, and at which cost. */
                readonly left_out?: readonly components["schemas"]["WorkLeftOut"][];
                /** @description Poses, which are the observations per pixel without masks. */
                readonly observations_per_pixel?: number;
                /** @description By layer name; a lean direction has no median where several are common (`lean_directions`). */
                readonly parameters?: {
                    readonly [key: string]: components["schemas"]["MapSpread"];
                };
                /** @description Pixels that were fitted. */
                readonly pixels?: number;
                /** @description Pixels that were not reached within the time limit. */
                readonly pixels_left_out?: number;
                /**
                 * Format: double
                 * @description `pixels` over the seconds of the fit, on all cores.
                 */
                readonly pixels_per_s?: number;
                /** @description Pixels that have values. */
                readonly pixels_with_value?: number;
                /** @description Name and version of the program. */
                readonly program?: string;
                readonly progress?: components["schemas"]["WorkProgress"] | null;
                /** @description Frames that were rejected. */
                readonly rejected_frames?: readonly components["schemas"]["FrameRejected"][];
                readonly request: components["schemas"]["MapRequest"];
                /**
                 * Format: int64
                 * @description Number of the part of that scan.
                 */
                readonly sample_id?: number | null;
                /** @description Name of that part. */
                readonly sample_name?: string | null;
                /**
                 * Format: int64
                 * @description Number of its scan; null without one.
                 */
                readonly scan_id?: number | null;
                /** @description What all pixels share. */
                readonly shared?: components["schemas"]["MapShared"];
                /** @description State of the job. */
                readonly state: components["schemas"]["TaskState"];
                /** @description Seconds per step. */
                readonly timing_s?: components["schemas"]["MapTiming"];
                /** @description Warnings for the user. */
                readonly warnings?: readonly string[];
                /** @description Who started it: the name of a token, or `local`. */
                readonly who: string;
            }[];
            /** @description `cursor` of the next page; null at the end. */
            readonly next_cursor?: string | null;
        };
        /** @description A page of a list. */
        readonly List_OrderBody: {
            /** @description Rows of this page that the store cannot read; omitted if there are none. */
            readonly damaged?: readonly components["schemas"]["DamagedBody"][];
            /** @description The rows of this page. */
            readonly items: readonly {
                /** @description When it was added, RFC 3339 in UTC. */
                readonly created_at: string;
                /** @description Number of the part or order in another system. */
                readonly external_id?: string | null;
                /**
                 * Format: int64
                 * @description How often it failed.
                 */
                readonly failures: number;
                /**
                 * Format: int64
                 * @description Number of the order.
                 */
                readonly id: number;
                /** @description Lot of the part. */
                readonly lot?: string | null;
                /** @description Free text. */
                readonly note?: string | null;
                /** @description The person at the rig. */
                readonly operator_name?: string | null;
                /** @description Name of the part. */
                readonly part: string;
                /** @description Why it failed, or waits again. */
                readonly reason?: string | null;
                /** @description The recipe. */
                readonly recipe: components["schemas"]["DefinitionName"];
                /**
                 * Format: int64
                 * @description Number of the part.
                 */
                readonly sample_id: number;
                /**
                 * Format: int64
                 * @description Its newest scan; null before the first.
                 */
                readonly scan_id?: number | null;
                readonly specification?: components["schemas"]["DefinitionName"] | null;
                /** @description State of the order. */
                readonly state: components["schemas"]["OrderState"];
                /** @description The verdict of that scan: pass, fail or cannot-tell; null without one. */
                readonly verdict?: string | null;
                /** @description Who added it: the name of a token, or `local`. */
                readonly who: string;
            }[];
            /** @description `cursor` of the next page; null at the end. */
            readonly next_cursor?: string | null;
        };
        /** @description A page of a list. */
        readonly List_RecipeBody: {
            /** @description Rows of this page that the store cannot read; omitted if there are none. */
            readonly damaged?: readonly components["schemas"]["DamagedBody"][];
            /** @description The rows of this page. */
            readonly items: readonly {
                /** @description Whether it is archived: no scan can be started with it. */
                readonly archived: boolean;
                /**
                 * Format: int64
                 * @description Number of the recipe.
                 */
                readonly id: number;
                /** @description Its name. */
                readonly name: string;
                /**
                 * Format: int64
                 * @description The newest version.
                 */
                readonly newest_version: number;
                /** @description The recipe. */
                readonly recipe: components["schemas"]["Recipe"];
                /** @description When this version was saved, RFC 3339 in UTC. */
                readonly saved_at: string;
                /**
                 * Format: int64
                 * @description This version, from 1.
                 */
                readonly version: number;
                /** @description Who saved this version: the name of a token, or `local`. */
                readonly who: string;
            }[];
            /** @description `cursor` of the next page; null at the end. */
            readonly next_cursor?: string | null;
        };
        /** @description A page of a list. */
        readonly List_RecordChange: {
            /** @description Rows of this page that the store cannot read; omitted if there are none. */
            readonly damaged?: readonly components["schemas"]["DamagedBody"][];
            /** @description The rows of this page. */
            readonly items: readonly (components["schemas"]["ScanRecord"] & {
                /** @description When, RFC 3339 in UTC. */
                readonly at: string;
                /**
                 * Format: int64
                 * @description Number of the change.
                 */
                readonly id: number;
                /** @description Who made it: the name of a token, or `local`. */
                readonly who: string;
            })[];
            /** @description `cursor` of the next page; null at the end. */
            readonly next_cursor?: string | null;
        };
        /** @description A page of a list. */
        readonly List_SampleBody: {
            /** @description Rows of this page that the store cannot read; omitted if there are none. */
            readonly damaged?: readonly components["schemas"]["DamagedBody"][];
            /** @description The rows of this page. */
            readonly items: readonly {
                /** @description When the part was added, RFC 3339 in UTC. */
                readonly created_at: string;
                /** @description Names that it had, oldest first. */
                readonly earlier_names: readonly components["schemas"]["EarlierName"][];
                /**
                 * Format: int64
                 * @description Number of the part.
                 */
                readonly id: number;
                /** @description Nominal material. */
                readonly material: components["schemas"]["MaterialBody"];
                /** @description Name of the part. */
                readonly name: string;
                /** @description Free text. */
                readonly note?: string | null;
                readonly simulated?: components["schemas"]["SimulatedSurface"] | null;
            }[];
            /** @description `cursor` of the next page; null at the end. */
            readonly next_cursor?: string | null;
        };
        /** @description A page of a list. */
        readonly List_ScanBody: {
            /** @description Rows of this page that the store cannot read; omitted if there are none. */
            readonly damaged?: readonly components["schemas"]["DamagedBody"][];
            /** @description The rows of this page. */
            readonly items: readonly {
                /** @description Whether lists leave the scan out unless they are asked for archived scans. */
                readonly archived: boolean;
                /** @description Calibrations that it uses, including its own. */
                readonly calibration_ids: readonly number[];
                /** @description The camera that took the frames. */
                readonly camera: components["schemas"]["ScanCameraBody"];
                /** @description When the scan was requested, RFC 3339 in UTC. */
                readonly created_at: string;
                /** @description Parts that it was assigned to before, oldest first. */
                readonly earlier_samples: readonly components["schemas"]["EarlierSample"][];
                /** @description When it ended, RFC 3339 in UTC. */
                readonly ended_at?: string | null;
                /** @description Number of the part or order in another system. */
                readonly external_id?: string | null;
                /**
                 * Format: int32
                 * @description Number of frames that were taken and rejected.
                 */
                readonly frames_rejected: number;
                /**
                 * Format: int64
                 * @description Number of the scan.
                 */
                readonly id: number;
                /** @description Lot of the part. */
                readonly lot?: string | null;
                /** @description Free text on the scan. */
                readonly note?: string | null;
                readonly operator?: components["schemas"]["OperatorBody"] | null;
                /** @description The person at the rig. */
                readonly operator_name?: string | null;
                /**
                 * Format: int64
                 * @description The order of the queue that it measures; null for a scan that was started by itself.
                 */
                readonly order_id?: number | null;
                /** @description Origin of the scan. */
                readonly origin: components["schemas"]["ScanOrigin"];
                /** @description The whole plan; of an import, its poses. */
                readonly plan: components["schemas"]["Plan"];
                /** @description Progress of the scan. */
                readonly progress: components["schemas"]["ProgressBody"];
                /** @description Reason for the state, if it is not the normal course. */
                readonly reason?: string | null;
                readonly recipe?: components["schemas"]["DefinitionRef"] | null;
                /** @description Regions of a part with patches, one of which a fit must name; else empty. */
                readonly regions: readonly string[];
                /**
                 * Format: int64
                 * @description Number of the part.
                 */
                readonly sample_id: number;
                /** @description Name of the part. */
                readonly sample_name: string;
                readonly specification?: components["schemas"]["DefinitionRef"] | null;
                /** @description When it started, RFC 3339 in UTC. */
                readonly started_at?: string | null;
                /** @description State of the scan. */
                readonly state: components["schemas"]["ScanState"];
                /** @description Tags, in the order in which they were given. */
                readonly tags: readonly string[];
                /**
                 * Format: double
                 * @description Expanded uncertainty (k = 2) of θr that the recipe asks for, degrees; null if it states none.
                 */
                readonly target_expanded_deg?: number | null;
                /** @description Who started it: the name of a token, or `local`. */
                readonly who: string;
            }[];
            /** @description `cursor` of the next page; null at the end. */
            readonly next_cursor?: string | null;
        };
        /** @description A page of a list. */
        readonly List_SpecificationBody: {
            /** @description Rows of this page that the store cannot read; omitted if there are none. */
            readonly damaged?: readonly components["schemas"]["DamagedBody"][];
            /** @description The rows of this page. */
            readonly items: readonly {
                /** @description Whether it is archived: no scan can be judged against it. */
                readonly archived: boolean;
                /**
                 * Format: int64
                 * @description Number of the specification.
                 */
                readonly id: number;
                /** @description Its name. */
                readonly name: string;
                /**
                 * Format: int64
                 * @description The newest version.
                 */
                readonly newest_version: number;
                /** @description When this version was saved, RFC 3339 in UTC. */
                readonly saved_at: string;
                /** @description The specification. */
                readonly specification: components["schemas"]["Specification"];
                /**
                 * Format: int64
                 * @description This version, from 1.
                 */
                readonly version: number;
                /** @description Who saved this version: the name of a token, or `local`. */
                readonly who: string;
            }[];
            /** @description `cursor` of the next page; null at the end. */
            readonly next_cursor?: string | null;
        };
        /** @description A page of a list. */
        readonly List_Trace: {
            /** @description Rows of this page that the store cannot read; omitted if there are none. */
            readonly damaged?: readonly components["schemas"]["DamagedBody"][];
            /** @description The rows of this page. */
            readonly items: readonly {
                /**
                 * Format: int64
                 * @description Number of independent replicates behind the standard errors.
                 */
                readonly batches?: number;
                /** @description When it was accepted, RFC 3339 in UTC. */
                readonly created_at: string;
                /** @description When it ended, RFC 3339 in UTC; null while it runs. */
                readonly ended_at?: string | null;
                /** @description Fractions of the light. */
                readonly energy?: components["schemas"]["TraceEnergy"];
                readonly error?: components["schemas"]["FitError"] | null;
                readonly forecast?: components["schemas"]["Forecast"] | null;
                /**
                 * Format: int64
                 * @description Number of the job within its kind.
                 */
                readonly id: number;
                /** @description Effects left out, with reason and cost. */
                readonly left_out?: readonly components["schemas"]["WorkLeftOut"][];
                /** @description Scope and limits of the standard errors. */
                readonly notes?: readonly string[];
                /**
                 * Format: int64
                 * @description Photons launched.
                 */
                readonly photons?: number;
                /** @description Whether polarisation was followed. */
                readonly polarised?: boolean;
                /** @description Program and version. */
                readonly program?: string;
                readonly progress?: components["schemas"]["WorkProgress"] | null;
                /**
                 * Format: double
                 * @description Relative error of the reflected bins, root mean square ([`Totals::relative_error`]).
                 */
                readonly relative_error?: number | null;
                readonly request: components["schemas"]["TraceRequest"];
                /** @description Effective ridge angles of the interfaces that have one. */
                readonly ridge_angles?: readonly components["schemas"]["RidgeAngle"][];
                /**
                 * Format: double
                 * @description Part of `seconds` spent on the photons, set-up included.
                 */
                readonly run_seconds?: number | null;
                /**
                 * Format: int64
                 * @description Number of the part of that scan.
                 */
                readonly sample_id?: number | null;
                /** @description Name of that part. */
                readonly sample_name?: string | null;
                /**
                 * Format: int64
                 * @description Number of its scan; null without one.
                 */
                readonly scan_id?: number | null;
                /**
                 * Format: double
                 * @description Duration of the run, s, if known.
                 */
                readonly seconds?: number | null;
                /**
                 * Format: double
                 * @description Part of `run_seconds` before the first photon: finding the illuminated parts and the
                 *     analytic part of the result.
                 */
                readonly setup_seconds?: number | null;
                /** @description State of the job. */
                readonly state: components["schemas"]["TaskState"];
                /**
                 * Format: double
                 * @description Time before `seconds` spent building or reading the surfaces.
                 */
                readonly surface_seconds?: number | null;
                readonly surfaces?: components["schemas"]["TraceSurfaces"] | null;
                /** @description Who started it: the name of a token, or `local`. */
                readonly who: string;
            }[];
            /** @description `cursor` of the next page; null at the end. */
            readonly next_cursor?: string | null;
        };
        /** @description A page of a list. */
        readonly List_Verdict: {
            /** @description Rows of this page that the store cannot read; omitted if there are none. */
            readonly damaged?: readonly components["schemas"]["DamagedBody"][];
            /** @description The rows of this page. */
            readonly items: readonly {
                /**
                 * Format: double
                 * @description Lower bound of the probability that all items conform (Boole's inequality; a positive correlation raises it); null
                 *     where an item is not determined.
                 */
                readonly conformance_probability_min?: number | null;
                /** @description Tilts over which the contrasts are averaged, degrees; null where no contrast is limited. */
                readonly contrast_theta_c_deg?: readonly number[] | null;
                /** @description When it was accepted, RFC 3339 in UTC. */
                readonly created_at: string;
                /** @description The allowed risks. */
                readonly decision?: components["schemas"]["DecisionRule"];
                /** @description The rule as a sentence. */
                readonly decision_rule?: string;
                /** @description When it ended, RFC 3339 in UTC; null while it runs. */
                readonly ended_at?: string | null;
                readonly error?: components["schemas"]["FitError"] | null;
                readonly forecast?: components["schemas"]["Forecast"] | null;
                /**
                 * Format: int64
                 * @description Number of the job within its kind.
                 */
                readonly id: number;
                /** @description One per limited quantity. */
                readonly items?: readonly components["schemas"]["JudgedItem"][];
                /** @description Effects that the fit omits, why, and their possible effect on the result. */
                readonly left_out?: readonly components["schemas"]["WorkLeftOut"][];
                /** @description Name and version of the program. */
                readonly program?: string;
                readonly progress?: components["schemas"]["WorkProgress"] | null;
                /** @description The plane to which θr and the azimuth refer. */
                readonly reference_plane?: components["schemas"]["FitReferencePlane"];
                /** @description Region of the part. */
                readonly region?: string | null;
                readonly request: components["schemas"]["VerdictRequest"];
                /**
                 * Format: int64
                 * @description Number of the part of that scan.
                 */
                readonly sample_id?: number | null;
                /** @description Name of that part. */
                readonly sample_name?: string | null;
                /**
                 * Format: int64
                 * @description Number of its scan; null without one.
                 */
                readonly scan_id?: number | null;
                /** @description Name of the specification. */
                readonly specification?: string;
                /** @description State of the job. */
                readonly state: components["schemas"]["TaskState"];
                /** @description How the fit ended. */
                readonly status?: components["schemas"]["FitStatus"];
                /** @description Seconds of reading, reducing and fitting. */
                readonly timing_s?: components["schemas"]["FitTiming"];
                /** @description Variant of the model. */
                readonly variant?: components["schemas"]["FitVariantName"];
                /** @description Fails if one item fails, passes if all pass. */
                readonly verdict?: components["schemas"]["VerdictWord"];
                /** @description Sentences for the user, including the warnings of the fit. */
                readonly warnings?: readonly string[];
                /** @description Who started it: the name of a token, or `local`. */
                readonly who: string;
                /** @description What would decide the items that are not decided, by quantity. */
                readonly would_decide?: {
                    readonly [key: string]: components["schemas"]["WouldDecide"];
                };
            }[];
            /** @description `cursor` of the next page; null at the end. */
            readonly next_cursor?: string | null;
        };
        /** @description A login. */
        readonly LoginRequest: {
            /** @description The token that `ridged token create` printed. */
            readonly token: string;
        };
        /**
         * @description How residuals count.
         * @enum {string}
         */
        readonly Loss: "linear" | "huber" | "tukey";
        /** @description A map: its request and its state, and the object of `map --json`, once it has completed */
        readonly Map: {
            /**
             * Format: double
             * @description Usual χ² per degree of freedom; pixels' uncertainties are scaled by its square root.
             */
            readonly chi2_reduced_usual?: number;
            /** @description When it was accepted, RFC 3339 in UTC. */
            readonly created_at: string;
            /** @description Connected areas that differ from the rest, the largest first. */
            readonly defects?: readonly components["schemas"]["MapDefect"][];
            /** @description When it ended, RFC 3339 in UTC; null while it runs. */
            readonly ended_at?: string | null;
            readonly error?: components["schemas"]["FitError"] | null;
            /**
             * Format: double
             * @description Evaluations of all observations per fitted pixel.
             */
            readonly evaluations_per_pixel?: number;
            /** @description Files written, relative to the output folder. */
            readonly files?: readonly string[];
            /** @description The bit of each flag in `flags.tif`; a pixel's value is the sum of its flags' bits. */
            readonly flag_bits?: {
                readonly [key: string]: number;
            };
            /** @description Pixels per flag. */
            readonly flags?: {
                readonly [key: string]: number;
            };
            readonly forecast?: components["schemas"]["Forecast"] | null;
            /**
             * Format: int64
             * @description Number of the job within its kind.
             */
            readonly id: number;
            /** @description Lean directions that many pixels share. */
            readonly lean_directions?: readonly components["schemas"]["MapLean"][];
            /** @description What the model omits, why, and at which cost. */
            readonly left_out?: readonly components["schemas"]["WorkLeftOut"][];
            /** @description Poses, which are the observations per pixel without masks. */
            readonly observations_per_pixel?: number;
            /** @description By layer name; a lean direction has no median where several are common (`lean_directions`). */
            readonly parameters?: {
                readonly [key: string]: components["schemas"]["MapSpread"];
            };
            /** @description Pixels that were fitted. */
            readonly pixels?: number;
            /** @description Pixels that were not reached within the time limit. */
            readonly pixels_left_out?: number;
            /**
             * Format: double
             * @description `pixels` over the seconds of the fit, on all cores.
             */
            readonly pixels_per_s?: number;
            /** @description Pixels that have values. */
            readonly pixels_with_value?: number;
            /** @description Name and version of the program. */
            readonly program?: string;
            readonly progress?: components["schemas"]["WorkProgress"] | null;
            /** @description Frames that were rejected. */
            readonly rejected_frames?: readonly components["schemas"]["FrameRejected"][];
            readonly request: components["schemas"]["MapRequest"];
            /**
             * Format: int64
             * @description Number of the part of that scan.
             */
            readonly sample_id?: number | null;
            /** @description Name of that part. */
            readonly sample_name?: string | null;
            /**
             * Format: int64
             * @description Number of its scan; null without one.
             */
            readonly scan_id?: number | null;
            /** @description What all pixels share. */
            readonly shared?: components["schemas"]["MapShared"];
            /** @description State of the job. */
            readonly state: components["schemas"]["TaskState"];
            /** @description Seconds per step. */
            readonly timing_s?: components["schemas"]["MapTiming"];
            /** @description Warnings for the user. */
            readonly warnings?: readonly string[];
            /** @description Who started it: the name of a token, or `local`. */
            readonly who: string;
        };
        /** @description A connected area that differs from the rest. */
        readonly MapDefect: {
            /**
             * Format: double
             * @description Area.
             */
            readonly area_mm2: number;
            /** @description Deviations of every parameter but the lean direction. */
            readonly deviations: readonly components["schemas"]["MapDeviation"][];
            /**
             * Format: double
             * @description See `width_mm`.
             */
            readonly height_mm: number;
            /**
             * Format: double
             * @description Median lean direction.
             */
            readonly lean_azimuth_deg?: number | null;
            /** @description Pixels. */
            readonly pixels: number;
            /**
             * Format: double
             * @description Extent along x and y.
             */
            readonly width_mm: number;
            /** @description The parameter that deviates most, or `fit` if no single surface explains the area. */
            readonly worst: string;
            /**
             * Format: double
             * @description Centre of gravity in the sample's axes at φs = 0, from the rotation axis.
             */
            readonly x_mm: number;
            /**
             * Format: double
             * @description See `x_mm`.
             */
            readonly y_mm: number;
        };
        /** @description Difference of an area from the map's median in one parameter. */
        readonly MapDeviation: {
            /** @description Name of the layer. */
            readonly parameter: string;
            /**
             * Format: double
             * @description (value − usual) over the robust standard deviation of the map's pixels.
             */
            readonly sigmas?: number | null;
            /**
             * Format: double
             * @description Median over the map.
             */
            readonly usual: number;
            /**
             * Format: double
             * @description Median over the area; null if its pixels have no value.
             */
            readonly value?: number | null;
        };
        /** @description A lean direction that many pixels share. */
        readonly MapLean: {
            /**
             * Format: double
             * @description Degrees, counter-clockwise from the sample's x at φs = 0.
             */
            readonly azimuth_deg: number;
            /**
             * Format: double
             * @description Share of the pixels that a single surface explains.
             */
            readonly share: number;
        };
        /** @description A request for a map. */
        readonly MapRequest: {
            /**
             * Format: double
             * @description Start no further pixels after this time, s; pixels that were not reached have no value.
             */
            readonly max_seconds?: number | null;
            /**
             * Format: int64
             * @description Scan to map.
             */
            readonly scan_id: number;
            /**
             * Format: double
             * @description Largest share of the brightest radiance that a pixel's model may neglect.
             */
            readonly target_error?: number | null;
        };
        /** @description The object of `map --json`. */
        readonly MapResult: {
            /**
             * Format: double
             * @description Usual χ² per degree of freedom; pixels' uncertainties are scaled by its square root.
             */
            readonly chi2_reduced_usual: number;
            /** @description Connected areas that differ from the rest, the largest first. */
            readonly defects: readonly components["schemas"]["MapDefect"][];
            /**
             * Format: double
             * @description Evaluations of all observations per fitted pixel.
             */
            readonly evaluations_per_pixel: number;
            /** @description Files written, relative to the output folder. */
            readonly files: readonly string[];
            /** @description The bit of each flag in `flags.tif`; a pixel's value is the sum of its flags' bits. */
            readonly flag_bits: {
                readonly [key: string]: number;
            };
            /** @description Pixels per flag. */
            readonly flags: {
                readonly [key: string]: number;
            };
            /** @description Lean directions that many pixels share. */
            readonly lean_directions: readonly components["schemas"]["MapLean"][];
            /** @description What the model omits, why, and at which cost. */
            readonly left_out: readonly components["schemas"]["WorkLeftOut"][];
            /** @description Poses, which are the observations per pixel without masks. */
            readonly observations_per_pixel: number;
            /** @description By layer name; a lean direction has no median where several are common (`lean_directions`). */
            readonly parameters: {
                readonly [key: string]: components["schemas"]["MapSpread"];
            };
            /** @description Pixels that were fitted. */
            readonly pixels: number;
            /** @description Pixels that were not reached within the time limit. */
            readonly pixels_left_out: number;
            /**
             * Format: double
             * @description `pixels` over the seconds of the fit, on all cores.
             */
            readonly pixels_per_s: number;
            /** @description Pixels that have values. */
            readonly pixels_with_value: number;
            /** @description Name and version of the program. */
            readonly program: string;
            /** @description Frames that were rejected. */
            readonly rejected_frames: readonly components["schemas"]["FrameRejected"][];
            /** @description What all pixels share. */
            readonly shared: components["schemas"]["MapShared"];
            /** @description Seconds per step. */
            readonly timing_s: components["schemas"]["MapTiming"];
            /** @description Warnings for the user. */
            readonly warnings: readonly string[];
        };
        /** @description Shared quantities in a summary; see [`super::Globals`]. */
        readonly MapShared: {
            /**
             * Format: double
             * @description Signal units per unit of radiance (the radiance for a lamp irradiance of 1).
             */
            readonly gain: number;
            /**
             * Format: double
             * @description Relative standard uncertainty of the gain, 0.01 for 1 %.
             */
            readonly gain_relative_std: number;
            /**
             * Format: double
             * @description Stray light, in units of radiance.
             */
            readonly stray_radiance: number;
            /**
             * Format: double
             * @description Its standard uncertainty, in units of radiance.
             */
            readonly stray_radiance_std: number;
            /**
             * Format: double
             * @description Offset Δθc to add to a recorded tilt, degrees.
             */
            readonly tilt_offset_deg: number;
            /**
             * Format: double
             * @description Its standard uncertainty, degrees.
             */
            readonly tilt_offset_deg_std: number;
        };
        /** @description Median and percentiles of a parameter over the pixels that have a value. */
        readonly MapSpread: {
            /**
             * Format: double
             * @description Median; azimuths are counted around their mean direction.
             */
            readonly median?: number | null;
            /**
             * Format: double
             * @description 5th percentile.
             */
            readonly p5?: number | null;
            /**
             * Format: double
             * @description 95th percentile.
             */
            readonly p95?: number | null;
            /**
             * Format: double
             * @description Median of the pixels' own standard uncertainties.
             */
            readonly std_median?: number | null;
            /**
             * Format: double
             * @description Standard uncertainty that all pixels have in common (gain, stray light, tilt offset, model error).
             */
            readonly std_shared?: number | null;
        };
        /** @description Seconds per step. */
        readonly MapTiming: {
            /**
             * Format: double
             * @description All pixels.
             */
            readonly fit: number;
            /**
             * Format: double
             * @description The fit of the pixels' mean, for which frames are read once more.
             */
            readonly mean: number;
            /**
             * Format: double
             * @description Darks, flats, frames read and resampled.
             */
            readonly read: number;
            /**
             * Format: double
             * @description Shared quantities.
             */
            readonly settle: number;
            /**
             * Format: double
             * @description Files.
             */
            readonly write: number;
        };
        /** @description Complex refractive index N = n + ik (convention exp(−iωt)) with standard uncertainties. */
        readonly Material: {
            /**
             * Format: double
             * @description Index of refraction n.
             */
            readonly eta: number;
            /**
             * Format: double
             * @description Standard uncertainty of n.
             */
            readonly eta_std: number;
            /** @enum {string} */
            readonly kind: "dielectric";
        } | {
            /**
             * Format: double
             * @description Real part n.
             */
            readonly eta: number;
            /**
             * Format: double
             * @description Standard uncertainty of n.
             */
            readonly eta_std: number;
            /**
             * Format: double
             * @description Imaginary part k ≥ 0.
             */
            readonly k: number;
            /**
             * Format: double
             * @description Standard uncertainty of k.
             */
            readonly k_std: number;
            /** @enum {string} */
            readonly kind: "conductor";
        };
        /** @description Nominal material: complex index N = n + ik with standard uncertainties. */
        readonly MaterialBody: {
            /**
             * Format: double
             * @description Real part n of the complex index, no unit.
             */
            readonly eta: number;
            /**
             * Format: double
             * @description Standard uncertainty of n; 0.01 if omitted.
             */
            readonly eta_std?: number;
            /** @enum {string} */
            readonly kind: "dielectric";
        } | {
            /**
             * Format: double
             * @description Real part n of the complex index, no unit.
             */
            readonly eta: number;
            /**
             * Format: double
             * @description Standard uncertainty of n; 0.01 if omitted.
             */
            readonly eta_std?: number;
            /**
             * Format: double
             * @description Imaginary part k of the complex index, no unit.
             */
            readonly k: number;
            /**
             * Format: double
             * @description Standard uncertainty of k; 0.01 if omitted.
             */
            readonly k_std?: number;
            /** @enum {string} */
            readonly kind: "conductor";
        };
        /** @description The mean of a ridge angle. */
        readonly MeanAtRidge: components["schemas"]["ReportedContrast"] & {
            /**
             * Format: double
             * @description Ridge angle, degrees.
             */
            readonly theta_r_deg: number;
        };
        /** @description The mean at a tilt. */
        readonly MeanAtTilt: components["schemas"]["ReportedContrast"] & {
            /**
             * Format: double
             * @description Camera tilt, degrees.
             */
            readonly theta_c_deg: number;
        };
        /** @description The mean of all contrasts. */
        readonly MeanOfAll: components["schemas"]["ReportedContrast"] & {
            /** @description The tilts that it includes, degrees. */
            readonly theta_c_deg: readonly number[];
        };
        /** @description The mean of a pair of azimuths. */
        readonly MeanOfPair: components["schemas"]["ReportedContrast"] & {
            /** @description `0-90` or `90-180`. */
            readonly phi_s_deg: string;
        };
        /** @description What was measured. */
        readonly MeasuredPart: {
            /** @description Names that it had, oldest first. */
            readonly earlier_names: readonly components["schemas"]["Earlier"][];
            /** @description Nominal material with standard uncertainties. */
            readonly material: components["schemas"]["Material"];
            /** @description Its name. */
            readonly name: string;
            /** @description Its note. */
            readonly note?: string | null;
            /**
             * Format: int64
             * @description Number of the part in the store.
             */
            readonly sample_id?: number | null;
        };
        /** @description The scan. */
        readonly MeasuredScan: {
            /** @description When it was requested, RFC 3339 in UTC. */
            readonly created_at: string;
            /** @description Parts that it was assigned to before, oldest first. */
            readonly earlier_samples: readonly components["schemas"]["Earlier"][];
            /** @description When it ended. */
            readonly ended_at?: string | null;
            /** @description Number of the part or order in another system. */
            readonly external_id?: string | null;
            /**
             * Format: int32
             * @description Number of frames that were taken and rejected.
             */
            readonly frames_rejected: number;
            /**
             * Format: int64
             * @description Number of the scan.
             */
            readonly id: number;
            /** @description Lot of the part. */
            readonly lot?: string | null;
            /** @description The person at the rig. */
            readonly operator_name?: string | null;
            /**
             * Format: int64
             * @description The order of the queue that it measures.
             */
            readonly order_id?: number | null;
            /** @description `rig` or `import`. */
            readonly origin: string;
            /** @description Program that ran it, with its commit. */
            readonly program: string;
            /** @description Reason for the state, if it is not the normal course. */
            readonly reason?: string | null;
            readonly recipe?: components["schemas"]["UsedDefinition"] | null;
            readonly specification?: components["schemas"]["UsedDefinition"] | null;
            /** @description When it started; null for an import. */
            readonly started_at?: string | null;
            /** @description Its state. */
            readonly state: components["schemas"]["ScanState"];
            /** @description Who started it. */
            readonly who: string;
        };
        /** @description Everything that a report states. */
        readonly MeasurementReport: {
            /** @description Whether a white reference defines the scale of the observations; otherwise their unit is arbitrary. */
            readonly absolute: boolean;
            /** @description Dark and white-reference frames of the store that the scan used; empty for a series, which has its own. */
            readonly calibrations: readonly components["schemas"]["UsedCalibration"][];
            /** @description The fit. */
            readonly fit: components["schemas"]["ReportedFit"];
            /** @description [`FORM`]. */
            readonly form: string;
            /** @description The frames, by their content. */
            readonly frames: components["schemas"]["FrameHashes"];
            /** @description Faults during the scan and their ends, oldest first. */
            readonly incidents: readonly components["schemas"]["IncidentBody"][];
            /** @description The observations that were fitted. */
            readonly observations: readonly components["schemas"]["ReportedObservation"][];
            /** @description What was measured. */
            readonly part: components["schemas"]["MeasuredPart"];
            /** @description Poses, exposures and repeats. */
            readonly plan: components["schemas"]["Plan"];
            /** @description Program that made the report, with its commit. */
            readonly program: string;
            readonly repeatability?: components["schemas"]["Repeatability"] | null;
            /** @description Lamp, camera and stages. */
            readonly rig: components["schemas"]["MeasuringRig"];
            readonly scan?: components["schemas"]["MeasuredScan"] | null;
            readonly verdict?: components["schemas"]["ReportedVerdict"] | null;
            readonly white_reference?: components["schemas"]["FlatFacts"] | null;
        };
        /** @description All measurements. */
        readonly Measurements: {
            /** @description Forecasts against seconds. */
            readonly forecasts: readonly components["schemas"]["ForecastOutcome"][];
            /** @description Errors against seconds. */
            readonly points: readonly components["schemas"]["AccuracyPoint"][];
            /** @description Plans compared with full computations. */
            readonly proofs: readonly components["schemas"]["PlanCheck"][];
            /** @description Rates of solvers. */
            readonly rates: readonly components["schemas"]["ConvergenceRate"][];
        };
        /** @description The rig as the scan used it. */
        readonly MeasuringRig: {
            /** @description How the camera makes counts. */
            readonly camera: components["schemas"]["CameraFacts"];
            /** @description Serial number of the camera, where its program states one. */
            readonly camera_serial?: string | null;
            /** @description Where lamp and camera are, with the stated uncertainties. */
            readonly geometry: components["schemas"]["RigFacts"];
            /** @description Lowest and highest temperature of the sensor, °C, where the camera's program states it. */
            readonly sensor_temperature_c?: readonly number[] | null;
            /** @description Whether it was simulated. */
            readonly simulated: boolean;
            /** @description Controllers of the stages during the scan, the last ones first. */
            readonly stages: readonly components["schemas"]["StageController"][];
        };
        /** @description A metal of the tables, by its name. */
        readonly MetalBody: {
            /** @description `Ag`, `Al`, `Au`, `Cr`, `Cu` or `W`. */
            readonly name: string;
            /**
             * Format: double
             * @description Wavelength, nm; that of the rig's lamp if omitted.
             */
            readonly wavelength_nm?: number | null;
        };
        /** @description A mean and its standard error. */
        readonly MonteCarloEstimate: {
            /**
             * Format: double
             * @description Its standard error, from the spread of the batches.
             */
            readonly std: number;
            /**
             * Format: double
             * @description The mean.
             */
            readonly value: number;
        };
        /** @description A motion. */
        readonly MotionBody: {
            /**
             * Format: int64
             * @description Number of the motion.
             */
            readonly id: number;
            /**
             * Format: double
             * @description Sample azimuth φs read back at its end, degrees.
             */
            readonly phi_s_deg?: number | null;
            readonly problem?: components["schemas"]["MotionProblem"] | null;
            /** @description State of the motion. */
            readonly state: components["schemas"]["MotionState"];
            /**
             * Format: double
             * @description Camera tilt θc read back at its end, degrees; null before, and where the stage did not answer.
             */
            readonly theta_c_deg?: number | null;
        };
        /** @description Why a motion failed. */
        readonly MotionProblem: {
            /** @description Stable word for programs. */
            readonly code: string;
            /** @description Cause and remedy. */
            readonly detail: string;
        };
        /**
         * @description State of a motion.
         * @enum {string}
         */
        readonly MotionState: "moving" | "arrived" | "stopped" | "failed";
        /** @description Target of a motion. */
        readonly MoveBody: {
            /**
             * Format: double
             * @description Absolute position to move to, degrees.
             */
            readonly position_deg: number;
        };
        /** @description Where to move an order. */
        readonly MoveRequest: {
            /**
             * Format: int32
             * @description Place among the waiting orders, from 1 (the next one); beyond the last one, the end.
             */
            readonly to: number;
        };
        /** @description Targets of a motion; an axis without one stays where it is. */
        readonly MoveRigBody: {
            /**
             * Format: double
             * @description Sample azimuth φs to move to, degrees.
             */
            readonly phi_s_deg?: number | null;
            /**
             * Format: double
             * @description Camera tilt θc to move to, degrees.
             */
            readonly theta_c_deg?: number | null;
        };
        /** @description A recipe or specification by its number, or by its name. */
        readonly NameOrId: number | string;
        /** @description A reduced measurement. */
        readonly ObservationBody: {
            /**
             * Format: int32
             * @description Number of frames of this observation.
             */
            readonly n_frames: number;
            /**
             * Format: double
             * @description Sample azimuth φs read back from the stage, degrees.
             */
            readonly phi_s_deg: number;
            /**
             * Format: double
             * @description Its standard uncertainty in the unit of `signal`, without errors common to all observations.
             */
            readonly sigma: number;
            /**
             * Format: double
             * @description Radiance for a lamp irradiance of 1 on a surface that faces the lamp; in an arbitrary unit if not `absolute`.
             */
            readonly signal: number;
            /**
             * Format: double
             * @description Camera tilt θc read back from the stage, degrees.
             */
            readonly theta_c_deg: number;
        };
        /** @description Observations of a scan. */
        readonly ObservationsBody: {
            /** @description Whether a white reference defines the scale. */
            readonly absolute: boolean;
            /** @description False while more frames may follow. */
            readonly complete: boolean;
            /** @description The observations. */
            readonly items: readonly components["schemas"]["ObservationBody"][];
            /** @description Hand it back as `cursor` for the next page; null at the end. */
            readonly next_cursor?: string | null;
            /** @description Region of the part; null for the whole. */
            readonly region?: string | null;
            /** @description Frames left out. */
            readonly rejected_frames: readonly components["schemas"]["FrameRejected"][];
            /**
             * Format: int64
             * @description Number of the scan.
             */
            readonly scan_id: number;
            /** @description Warnings, as sentences. */
            readonly warnings: readonly string[];
        };
        /**
         * @description What follows a failed order of the queue.
         * @enum {string}
         */
        readonly OnFailure: "stop" | "end";
        /**
         * @description What a person has to do at the rig before the scan can go on.
         * @enum {string}
         */
        readonly OperatorAction: "cap-lens" | "place-white-reference" | "place-sample";
        /** @description An operator step. */
        readonly OperatorBody: {
            /** @description The step. */
            readonly action: components["schemas"]["OperatorAction"];
            /** @description What to do, as a sentence. */
            readonly message: string;
        };
        /** @description An order of the queue. */
        readonly OrderBody: {
            /** @description When it was added, RFC 3339 in UTC. */
            readonly created_at: string;
            /** @description Number of the part or order in another system. */
            readonly external_id?: string | null;
            /**
             * Format: int64
             * @description How often it failed.
             */
            readonly failures: number;
            /**
             * Format: int64
             * @description Number of the order.
             */
            readonly id: number;
            /** @description Lot of the part. */
            readonly lot?: string | null;
            /** @description Free text. */
            readonly note?: string | null;
            /** @description The person at the rig. */
            readonly operator_name?: string | null;
            /** @description Name of the part. */
            readonly part: string;
            /** @description Why it failed, or waits again. */
            readonly reason?: string | null;
            /** @description The recipe. */
            readonly recipe: components["schemas"]["DefinitionName"];
            /**
             * Format: int64
             * @description Number of the part.
             */
            readonly sample_id: number;
            /**
             * Format: int64
             * @description Its newest scan; null before the first.
             */
            readonly scan_id?: number | null;
            readonly specification?: components["schemas"]["DefinitionName"] | null;
            /** @description State of the order. */
            readonly state: components["schemas"]["OrderState"];
            /** @description The verdict of that scan: pass, fail or cannot-tell; null without one. */
            readonly verdict?: string | null;
            /** @description Who added it: the name of a token, or `local`. */
            readonly who: string;
        };
        /** @description Number of orders by state. */
        readonly OrderCounts: {
            /**
             * Format: int64
             * @description Orders whose scan is completed.
             */
            readonly done: number;
            /**
             * Format: int64
             * @description Orders that failed.
             */
            readonly failed: number;
            /**
             * Format: int64
             * @description Orders that were removed.
             */
            readonly removed: number;
            /**
             * Format: int64
             * @description Orders whose scan has begun.
             */
            readonly running: number;
            /**
             * Format: int64
             * @description Orders that wait.
             */
            readonly waiting: number;
        };
        /** @description An order to add to the queue: a part, its recipe, and what it is for. */
        readonly OrderRequest: {
            /** @description Number of the part or order in another system, at most 200 characters. No other order of the queue may have it. */
            readonly external_id?: string | null;
            /** @description Lot of the part, at most 200 characters. */
            readonly lot?: string | null;
            /** @description Free text, at most 4000 characters. */
            readonly note?: string | null;
            /** @description The person at the rig, at most 200 characters. */
            readonly operator_name?: string | null;
            /**
             * @description Name of the part in place of its number. A name of several parts is refused; a new name adds a part with the material
             *     of the recipe.
             */
            readonly part?: string | null;
            /** @description The recipe, by name or number. Its newest version at the start of the scan counts. */
            readonly recipe: components["schemas"]["NameOrId"];
            /**
             * Format: int64
             * @description Number of the part.
             */
            readonly sample_id?: number | null;
            readonly specification?: components["schemas"]["NameOrId"] | null;
        };
        /**
         * @description State of an order.
         * @enum {string}
         */
        readonly OrderState: "waiting" | "running" | "done" | "failed" | "removed";
        /** @description Orders to add. */
        readonly OrdersRequest: {
            /** @description 1 to 1000 orders, in sequence. */
            readonly orders: readonly components["schemas"]["OrderRequest"][];
        };
        /** @description A value and the range that it should be in, in the unit of the field. */
        readonly OutOfRange: {
            /**
             * Format: double
             * @description Least allowed value.
             */
            readonly lower: number;
            /**
             * Format: double
             * @description Greatest allowed value.
             */
            readonly upper: number;
            /**
             * Format: double
             * @description The value that was sent.
             */
            readonly value: number;
        };
        /**
         * @description Phase of a scan: the kind of the frames being taken, and done at its end.
         * @enum {string}
         */
        readonly Phase: "dark" | "flat" | "sample" | "done";
        /** @description A picture of a frame. */
        readonly PictureBody: {
            /**
             * Format: int32
             * @description Rows, px.
             */
            readonly height_px: number;
            /**
             * Format: double
             * @description Count that is white, DN: 0.2 % of the pixels are brighter.
             */
            readonly high_dn: number;
            /**
             * Format: double
             * @description Count that is black, DN: 0.2 % of the pixels are darker.
             */
            readonly low_dn: number;
            /** @description Path of the PNG on this server. */
            readonly path: string;
            /**
             * Format: int32
             * @description Columns, px.
             */
            readonly width_px: number;
        };
        /** @description One number for both axes, or one for each. */
        readonly Pitch: number | readonly number[];
        /** @description A whole plan, nothing left open. */
        readonly Plan: {
            /** @description Dark frames, taken at every exposure used. */
            readonly dark: components["schemas"]["DarkPlan"];
            /** @description Exposures of the sample. */
            readonly exposures_s: readonly number[];
            /** @description White-reference frames. */
            readonly flat: components["schemas"]["FlatPlan"];
            /** @description Sample azimuths, degrees; where the plan states poses, each azimuth among them once. */
            readonly phi_s_deg: readonly number[];
            /** @description Poses of the sample in the order of the visits; empty where each tilt is visited at each azimuth. */
            readonly poses?: readonly components["schemas"]["PlanPose"][];
            /**
             * Format: int32
             * @description Points of the sample between two checks of a reference pose; 0 for none.
             */
            readonly reference_every?: number;
            /**
             * Format: int32
             * @description Frames per pose and exposure; 0 for none of the sample.
             */
            readonly repeats: number;
            /** @description Whether valid calibration frames save their operator steps. */
            readonly reuse_calibrations: boolean;
            /** @description Camera tilts, degrees; where the plan states poses, each tilt among them once. */
            readonly theta_c_deg: readonly number[];
        };
        /** @description A plan compared with the full computation. */
        readonly PlanCheck: {
            /**
             * Format: double
             * @description Tolerance and two standard errors of the difference, relative.
             */
            readonly allowed: number;
            /** @description Full computation: value and standard error. */
            readonly full: readonly number[];
            /**
             * Format: double
             * @description Seconds of the full computation, to a standard error equal to the tolerance.
             */
            readonly full_s: number;
            /** @description Whether the difference is allowed. */
            readonly holds: boolean;
            /**
             * Format: double
             * @description Relative difference of the two.
             */
            readonly off: number;
            /** @description The decisions that omit an effect. */
            readonly parts: readonly components["schemas"]["PlanPart"][];
            /** @description Planned computation: value and standard error. */
            readonly planned: readonly number[];
            /**
             * Format: double
             * @description Seconds of the planned computation, planning included.
             */
            readonly planned_s: number;
            /**
             * Format: double
             * @description Seconds of planning.
             */
            readonly planning_s: number;
            /** @description The compared quantity. */
            readonly quantity: string;
            /** @description Scene. */
            readonly scene: string;
            /**
             * Format: double
             * @description Allowed relative error of the plan.
             */
            readonly tolerance: number;
        };
        /** @description The effect of one decision alone. */
        readonly PlanPart: {
            /**
             * Format: double
             * @description Its cost as the plan states it.
             */
            readonly cost?: number | null;
            /** @description The decision. */
            readonly decision: components["schemas"]["Decision"];
            /**
             * Format: double
             * @description Time of the full run over the time without the effect, both to the same standard error; null where the scene does not
             *     have the effect.
             */
            readonly speed_up?: number | null;
            /** @description The omitted effect. */
            readonly what: string;
        };
        /** @description A pose that a plan states. */
        readonly PlanPose: {
            /**
             * Format: double
             * @description Sample azimuth φs, degrees.
             */
            readonly phi_s_deg: number;
            /**
             * Format: double
             * @description Camera tilt θc, degrees.
             */
            readonly theta_c_deg: number;
        };
        /**
         * @description A plan as a file or a request states it: everything may be left out that a preset or the rig's
         *     settings know. Unknown keys are errors.
         */
        readonly PlanRequest: {
            /** @description Dark frames. */
            readonly dark?: components["schemas"]["DarkRequest"];
            /** @description Exposure times of the sample, s; the rig's if omitted. */
            readonly exposures_s?: readonly number[] | null;
            /** @description White-reference frames. */
            readonly flat?: components["schemas"]["FlatRequest"];
            readonly phi_s_deg?: components["schemas"]["Values"] | null;
            /** @description Poses of the sample one by one, visited in this order, instead of tilts and azimuths. */
            readonly poses?: readonly components["schemas"]["PlanPose"][] | null;
            readonly preset?: components["schemas"]["Preset"] | null;
            /**
             * Format: int32
             * @description Points of the sample between two checks of a reference pose; 0 for none. Default: the rig's settings.
             */
            readonly reference_every?: number | null;
            /**
             * Format: int32
             * @description Frames per pose and exposure; 1 if omitted. 0 takes new dark and white-reference frames only, for later scans.
             */
            readonly repeats?: number | null;
            /** @description Whether valid calibration frames replace their operator steps; true if omitted and the plan has a sample. */
            readonly reuse_calibrations?: boolean | null;
            readonly theta_c_deg?: components["schemas"]["Values"] | null;
        };
        /** @description An observation and the prediction of the fit. */
        readonly PointBody: {
            /**
             * Format: double
             * @description Sample azimuth φs as recorded, degrees.
             */
            readonly phi_s_deg: number;
            /**
             * Format: double
             * @description Predicted signal, in the same unit.
             */
            readonly predicted: number;
            /**
             * Format: double
             * @description (signal − predicted) / peak.
             */
            readonly residual: number;
            /**
             * Format: double
             * @description Its standard uncertainty, in the same unit.
             */
            readonly sigma: number;
            /**
             * Format: double
             * @description Observed signal, in the observations' unit of radiance.
             */
            readonly signal: number;
            /**
             * Format: double
             * @description Camera tilt θc as recorded, degrees.
             */
            readonly theta_c_deg: number;
        };
        /**
         * @description Named plans.
         * @enum {string}
         */
        readonly Preset: "paper" | "full";
        /** @description A preview. */
        readonly PreviewAnswer: {
            /** @description The part of the frame that was measured. */
            readonly area: components["schemas"]["AreaBody"];
            /**
             * @description Whether the newest dark frames of this rig name the defect pixels. Otherwise a lone full pixel counts as a
             *     defect.
             */
            readonly defects_known: boolean;
            /** @description One frame per exposure, in the order of the request. */
            readonly frames: readonly components["schemas"]["PreviewFrameBody"][];
            /** @description Whether the lamp was on. */
            readonly lamp: boolean;
            /**
             * Format: double
             * @description Sample azimuth φs read from the stage, degrees.
             */
            readonly phi_s_deg: number;
            /** @description Whether both angles count from a reference position. False until the axes are homed. */
            readonly referenced: boolean;
            readonly suggestion?: components["schemas"]["SuggestionBody"] | null;
            /**
             * Format: double
             * @description Camera tilt θc read from the stage, degrees.
             */
            readonly theta_c_deg: number;
        };
        /** @description A preview to take. */
        readonly PreviewBody: {
            readonly area?: components["schemas"]["AreaBody"] | null;
            /**
             * @description Exposures, s: 1 to 8 values, together at most 60 s. Those of the settings if omitted.
             * @example [
             *       0.02,
             *       0.06
             *     ]
             */
            readonly exposures_s?: readonly number[] | null;
            /**
             * @description Whether the lamp is on. `false` needs the setting `lamp.off`.
             * @default true
             */
            readonly lamp: boolean;
            /**
             * Format: int32
             * @description Number of exposures to suggest for a scan, 0 to 2; as many as are taken, at most 2, if omitted. The daemon may take
             *     further frames of up to 10 s to find them.
             * @example 2
             */
            readonly suggest?: number | null;
        };
        /** @description A frame of a preview. The figures are those of the area without its defect pixels. */
        readonly PreviewFrameBody: {
            /**
             * Format: int32
             * @description Defect pixels of the area; they take no part in the other figures.
             */
            readonly defect_px: number;
            /**
             * Format: double
             * @description Exposure time, s.
             */
            readonly exposure_s: number;
            /**
             * Format: double
             * @description Figure of focus: the change of brightness from pixel to pixel, root mean square, over the mean brightness, without the
             *     part of the noise. The sharpest picture of one pose and one area has the greatest; null without light.
             */
            readonly focus?: number | null;
            /**
             * Format: int32
             * @description Rows of the frame, px.
             */
            readonly height_px: number;
            /** @description Pixels per bin, from 0 DN. */
            readonly histogram: components["schemas"]["HistogramBody"];
            /**
             * Format: int64
             * @description Number of the frame. Only the newest frames are kept, in memory.
             */
            readonly id: number;
            /** @description Picture of 8 bits and at most 512 px on this server. */
            readonly image: components["schemas"]["PictureBody"];
            /**
             * Format: int32
             * @description Greatest count, DN.
             */
            readonly max_dn: number;
            /**
             * Format: double
             * @description Mean count, DN.
             */
            readonly mean_dn: number;
            /**
             * Format: int32
             * @description Median count, DN.
             */
            readonly median_dn: number;
            /**
             * Format: int32
             * @description Least count, DN.
             */
            readonly min_dn: number;
            /** @description Path of the 16-bit counts on this server. */
            readonly pixels: string;
            /**
             * Format: int32
             * @description Pixels at or above the count of a full pixel.
             */
            readonly saturated_px: number;
            /** @description Start of the exposure, RFC 3339 in UTC. */
            readonly taken_at: string;
            /**
             * Format: int32
             * @description Columns of the frame, px.
             */
            readonly width_px: number;
        };
        /** @description Prior knowledge of a parameter: a value and its standard uncertainty. */
        readonly Prior: {
            /**
             * Format: double
             * @description Standard uncertainty.
             */
            readonly std: number;
            /**
             * Format: double
             * @description Value.
             */
            readonly value: number;
        };
        /** @description A problem by RFC 9457 (`application/problem+json`). */
        readonly Problem: {
            /**
             * @description Stable word for programs.
             * @enum {string}
             */
            readonly code: "analysis-failed" | "bad-json" | "bad-request" | "body-too-large" | "body-too-slow" | "broken-off" | "busy" | "camera-failed" | "camera-replaced" | "camera-temperature" | "data-folder-gone" | "disk-full" | "export-failed" | "external-condition" | "external-id-taken" | "fit-not-started" | "forbidden-host" | "forbidden-origin" | "forbidden-region" | "frame-damaged" | "frame-stale" | "frame-unreadable" | "frames-rejected" | "homing-blocked" | "host-suspended" | "idempotency-mismatch" | "internal" | "invalid-value" | "jog-ended" | "lamp-failed" | "lease-held" | "lease-lost" | "map-not-written" | "method-not-allowed" | "name-taken" | "no-contrast" | "no-fit" | "no-lamp-switch" | "no-map" | "no-observations" | "no-rig" | "no-token" | "no-trace" | "not-by-proxy" | "not-found" | "not-judged" | "other-stages" | "other-step" | "outside-limits" | "plan-invalid" | "point-skipped" | "port-failed" | "port-forbidden" | "port-in-use" | "port-missing" | "port-not-serial" | "port-unreachable" | "queue-empty" | "queue-waits" | "reference-changed" | "region-needed" | "region-unknown" | "role-too-low" | "scan-interrupted" | "scan-paused" | "scan-unrecorded" | "series-invalid" | "stage-address-conflict" | "stage-disagrees" | "stage-disconnected" | "stage-fault" | "stage-foreign-traffic" | "stage-homing-failed" | "stage-interrupted" | "stage-lost-steps" | "stage-missed" | "stage-no-scale" | "stage-no-such-axis" | "stage-not-carried-out" | "stage-not-referenced" | "stage-other-device" | "stage-port-changed" | "stage-power-cycled" | "stage-protocol" | "stage-refused" | "stage-setting-wrong" | "stage-settings-restored" | "stage-silent" | "stage-slipped" | "stage-stalled" | "stage-supply" | "stage-timed-out" | "stage-wrong-device" | "stages-accepted" | "stages-changed" | "stages-pinned" | "state-conflict" | "stop-unconfirmed" | "stopped" | "stopping" | "store-damaged" | "store-failed" | "store-in-use" | "store-locked" | "store-missing" | "too-many-bodies" | "too-many-connections" | "too-many-guesses" | "too-many-streams" | "trace-not-written" | "unknown-field" | "version-conflict" | "wrong-content-encoding" | "wrong-content-type" | "wrong-token";
            /** @description What is wrong, and what to do. */
            readonly detail: string;
            /** @description Each wrong value, where the problem is about values. */
            readonly errors?: readonly components["schemas"]["FieldProblem"][];
            /** @description Who holds the rig, where the problem is that another caller does. */
            readonly holder?: components["schemas"]["HolderBody"];
            /**
             * Format: int32
             * @description HTTP status.
             */
            readonly status: number;
            /** @description The kind of problem in words. */
            readonly title: string;
            /** @description `urn:ridged:problem:` and the code. */
            readonly type: string;
        };
        /** @description Progress of a scan. */
        readonly ProgressBody: {
            /**
             * Format: double
             * @description Time spent moving and exposing, s.
             */
            readonly elapsed_s: number;
            /**
             * Format: double
             * @description Elapsed share of the predicted time, 0 to 1.
             */
            readonly fraction: number;
            /**
             * Format: int32
             * @description Frames stored so far.
             */
            readonly frames_done: number;
            /**
             * Format: int32
             * @description Frames of the whole plan.
             */
            readonly frames_total: number;
            readonly phase?: components["schemas"]["Phase"] | null;
            /**
             * Format: int32
             * @description Points (pose and exposure) whose frames are stored.
             */
            readonly shots_done: number;
            /**
             * Format: int32
             * @description Points (pose and exposure) of the whole plan.
             */
            readonly shots_total: number;
            /**
             * Format: double
             * @description Predicted time left, s; null if unknown.
             */
            readonly time_left_s?: number | null;
        };
        /** @description The queue. */
        readonly QueueBody: {
            /** @description When the state changed, RFC 3339 in UTC; null before the first change. */
            readonly changed_at?: string | null;
            /** @description Number of orders by state. */
            readonly counts: components["schemas"]["OrderCounts"];
            readonly current?: components["schemas"]["CurrentOrder"] | null;
            /** @description What the queue does or waits for, as sentences. */
            readonly message: string;
            readonly next?: components["schemas"]["OrderBody"] | null;
            /** @description What follows a failed order (setting `queue.on_failure`). */
            readonly on_failure: components["schemas"]["OnFailure"];
            /** @description Reason for the state, if a person did not ask for it. */
            readonly reason?: string | null;
            /** @description State of the queue. */
            readonly state: components["schemas"]["QueueState"];
            /** @description Who changed the state: the name of a token, `local`, or `daemon`; null before the first change. */
            readonly who?: string | null;
        };
        /**
         * @description State of the queue.
         * @enum {string}
         */
        readonly QueueState: "stopped" | "running" | "stopping" | "paused";
        /** @description Radiances at the paper's azimuths φs. */
        readonly RadianceByAzimuth: {
            /**
             * Format: double
             * @description At 0°.
             */
            readonly 0: number;
            /**
             * Format: double
             * @description At 90°.
             */
            readonly 90: number;
            /**
             * Format: double
             * @description At 180°.
             */
            readonly 180: number;
        };
        /** @description Readiness of the daemon. */
        readonly ReadyBody: {
            /** @description Why it is not ready; null if it is ready. */
            readonly problem?: string | null;
            /** @description Whether store and rig are ready. */
            readonly ready: boolean;
            /** @description Whether the stages answer; true for a daemon without a rig. */
            readonly rig: boolean;
            /** @description Whether the store commits, records all running scans and has disk space. */
            readonly store: boolean;
        };
        /** @description How a part is measured: the keys of docs/examples/recipe.toml. */
        readonly Recipe: {
            /** @description Model and options of the fit that follows the scan. */
            readonly fit?: components["schemas"]["RecipeFit"];
            readonly layout?: components["schemas"]["RecipeLayout"] | null;
            readonly material?: components["schemas"]["RecipeMaterial"] | null;
            /** @description Name, 1 to 200 characters. It stays the same in all versions. */
            readonly name: string;
            /** @description Free text. */
            readonly note?: string | null;
            /** @description Poses, exposures, dark frames and white reference. */
            readonly plan: components["schemas"]["PlanRequest"];
            /**
             * Format: double
             * @description Expanded uncertainty (k = 2) of θr to reach, degrees.
             */
            readonly target_expanded_deg?: number | null;
        };
        /** @description One version of a recipe. */
        readonly RecipeBody: {
            /** @description Whether it is archived: no scan can be started with it. */
            readonly archived: boolean;
            /**
             * Format: int64
             * @description Number of the recipe.
             */
            readonly id: number;
            /** @description Its name. */
            readonly name: string;
            /**
             * Format: int64
             * @description The newest version.
             */
            readonly newest_version: number;
            /** @description The recipe. */
            readonly recipe: components["schemas"]["Recipe"];
            /** @description When this version was saved, RFC 3339 in UTC. */
            readonly saved_at: string;
            /**
             * Format: int64
             * @description This version, from 1.
             */
            readonly version: number;
            /** @description Who saved this version: the name of a token, or `local`. */
            readonly who: string;
        };
        /** @description A change of a recipe. */
        readonly RecipeChange: {
            /** @description The whole recipe. Its name stays. */
            readonly recipe: components["schemas"]["Recipe"];
            /**
             * Format: int64
             * @description The version that it replaces, which has to be the newest one, so that no change of another caller is lost.
             */
            readonly replaces: number;
        };
        /** @description The fit of a recipe: options of POST /fits without those of a single scan. */
        readonly RecipeFit: {
            /**
             * Format: int32
             * @description Number of series drawn for bootstrap intervals; none if omitted.
             * @default null
             */
            readonly bootstrap: number | null;
            /**
             * @description Parameters fixed at a value, by the names of the report, and eta, k: `{"rho_d": 0.3}`.
             * @default {}
             */
            readonly fix: {
                readonly [key: string]: number;
            };
            /**
             * @description Takes the difference to the variant traced as the model error of the budget.
             * @default false
             */
            readonly judge: boolean;
            /**
             * @description Loss function of the residuals; linear if omitted.
             * @default linear
             */
            readonly loss: components["schemas"]["Loss"];
            /**
             * Format: double
             * @description Ends search, ray tracer and bootstrap after this time, s.
             * @default null
             */
            readonly max_seconds: number | null;
            /**
             * @description Priors of parameters, by the same names.
             * @default {}
             */
            readonly priors: {
                readonly [key: string]: components["schemas"]["Prior"];
            };
            /**
             * @description Adds profile-likelihood intervals.
             * @default false
             */
            readonly profile: boolean;
            /**
             * @description The only region to fit; all regions of the layout if omitted.
             * @default null
             */
            readonly region: string | null;
            /**
             * Format: int32
             * @description Largest number of starts of a search per variant.
             * @default null
             */
            readonly starts: number | null;
            /**
             * Format: double
             * @description Ends the ray tracer once its standard error, as a share of the largest radiance, is below this.
             * @default null
             */
            readonly target_error: number | null;
            /**
             * Format: double
             * @description Share of the peak that the model may omit.
             * @default null
             */
            readonly tolerance: number | null;
            /**
             * @description Variant of the model; auto if omitted.
             * @default auto
             */
            readonly variant: components["schemas"]["VariantChoice"];
        };
        /** @description A board of square patches, as `[sample.layout]` of a manifest. */
        readonly RecipeLayout: {
            /** @description Centre of the board from the rotation axis, mm. */
            readonly centre_mm?: readonly number[];
            /** @description Lean direction of patches with i + j even, in words (`v at phi_s`). */
            readonly even_patches?: string | null;
            /** @description Lean direction of patches with i + j odd, in words (`v at phi_s + 90 deg`). */
            readonly odd_patches?: string | null;
            /**
             * Format: double
             * @description Side of a patch, mm.
             */
            readonly patch_size_mm: number;
            /**
             * Format: int32
             * @description Patches along the sample's x.
             */
            readonly patches_x: number;
            /**
             * Format: int32
             * @description Patches along the sample's y.
             */
            readonly patches_y: number;
        };
        /** @description Nominal material of a part: complex index N = n + ik with standard uncertainties. */
        readonly RecipeMaterial: {
            /**
             * Format: double
             * @description Real part n of the index.
             */
            readonly eta: number;
            /**
             * Format: double
             * @description Standard uncertainty of n; 0.01 if omitted.
             */
            readonly eta_std?: number | null;
            /**
             * Format: double
             * @description Imaginary part k of the index; a metal if it is given.
             */
            readonly k?: number | null;
            /**
             * Format: double
             * @description Standard uncertainty of k; 0.01 if omitted.
             */
            readonly k_std?: number | null;
        };
        /** @description A record as it was after a change. */
        readonly RecordChange: components["schemas"]["ScanRecord"] & {
            /** @description When, RFC 3339 in UTC. */
            readonly at: string;
            /**
             * Format: int64
             * @description Number of the change.
             */
            readonly id: number;
            /** @description Who made it: the name of a token, or `local`. */
            readonly who: string;
        };
        /** @description Another name for a part. */
        readonly RenameBody: {
            /** @description Name, 1 to 200 characters. */
            readonly name: string;
        };
        /** @description Scatter of several scans, and gauge R&R. */
        readonly Repeatability: {
            readonly gauge?: components["schemas"]["Gauge"] | null;
            /** @description Why there are no components of variance, and what to measure. */
            readonly gauge_note?: string | null;
            /** @description Scans without a result. */
            readonly left_out: readonly components["schemas"]["LeftOutScan"][];
            /** @description Key of the parameter; its unit is the end of the name. */
            readonly parameter: string;
            /** @description Results, oldest scan first. */
            readonly results: readonly components["schemas"]["StudiedResult"][];
            readonly scatter?: components["schemas"]["Scatter"] | null;
            /** @description Lines of the budget, and whether they have the same error in all scans. */
            readonly shared_lines: readonly components["schemas"]["SharedLine"][];
        };
        /** @description A contrast, with its standard uncertainties (k = 1) where it was measured. */
        readonly ReportedContrast: {
            /**
             * Format: double
             * @description |a − b|, in the unit of the radiances.
             */
            readonly absolute: number;
            /**
             * Format: double
             * @description Its standard uncertainty.
             */
            readonly absolute_std?: number | null;
            /**
             * Format: double
             * @description |a − b|/(a + b); null where both are dark.
             */
            readonly michelson?: number | null;
            /**
             * Format: double
             * @description Its standard uncertainty.
             */
            readonly michelson_std?: number | null;
        };
        /** @description The paper's three findings, each with whether the table shows it. */
        readonly ReportedFindings: {
            /** @description The mean of 0° to 90° is greater than that of 90° to 180°. */
            readonly "0-90_above_90-180": boolean;
            /** @description Mean contrast is greatest at the smallest ridge angle. */
            readonly greatest_at_smallest_theta_r: boolean;
            /** @description Mean contrast is greatest at θc = 0. */
            readonly greatest_at_theta_c_0: boolean;
        };
        /** @description The fit. */
        readonly ReportedFit: components["schemas"]["FitReport"] & {
            /** @description Program that computed it, with its commit. */
            readonly computed_by: string;
            /** @description When it was requested, RFC 3339 in UTC. */
            readonly created_at?: string | null;
            /** @description When it ended. */
            readonly ended_at?: string | null;
            /**
             * Format: int64
             * @description Number of the fit in the store.
             */
            readonly id?: number | null;
            readonly request: components["schemas"]["FitRequest"];
            /** @description Who started it. */
            readonly who?: string | null;
        };
        /** @description A line of the table. */
        readonly ReportedLine: {
            /** @description Contrasts by pair of azimuths. */
            readonly contrast: components["schemas"]["ContrastByPair"];
            /** @description Radiances by azimuth. */
            readonly radiance: components["schemas"]["RadianceByAzimuth"];
            /**
             * Format: double
             * @description Camera tilt, degrees.
             */
            readonly theta_c_deg: number;
            /**
             * Format: double
             * @description Ridge angle, degrees; only of a prediction.
             */
            readonly theta_r_deg?: number | null;
        };
        /** @description Means of contrasts over all other settings. */
        readonly ReportedMeans: {
            readonly all?: components["schemas"]["MeanOfAll"] | null;
            /** @description By pair of azimuths. */
            readonly by_phi_s: readonly components["schemas"]["MeanOfPair"][];
            /** @description By camera tilt. */
            readonly by_theta_c: readonly components["schemas"]["MeanAtTilt"][];
            /** @description Means by ridge angle; only of a prediction. */
            readonly by_theta_r?: readonly components["schemas"]["MeanAtRidge"][] | null;
        };
        /** @description An observation. */
        readonly ReportedObservation: {
            /**
             * Format: int32
             * @description Frames of this observation.
             */
            readonly n_frames: number;
            /**
             * Format: double
             * @description Sample azimuth φs read back, degrees.
             */
            readonly phi_s_deg: number;
            /**
             * Format: double
             * @description Its standard uncertainty by independent errors.
             */
            readonly sigma: number;
            /**
             * Format: double
             * @description Radiance for a lamp irradiance of 1 on a surface that faces the lamp; in an arbitrary unit if not `absolute`.
             */
            readonly signal: number;
            /**
             * Format: double
             * @description Camera tilt θc read back, degrees.
             */
            readonly theta_c_deg: number;
        };
        /** @description A contrast table, measured or predicted. */
        readonly ReportedTable: {
            readonly findings?: components["schemas"]["ReportedFindings"] | null;
            /** @description One line for each tilt, and where it was predicted for each ridge angle. */
            readonly lines: readonly components["schemas"]["ReportedLine"][];
            /** @description Means of the contrasts. */
            readonly mean: components["schemas"]["ReportedMeans"];
            /** @description Program and version. */
            readonly program: string;
        };
        /** @description The verdict. */
        readonly ReportedVerdict: components["schemas"]["VerdictResult"] & {
            /** @description When it was requested, RFC 3339 in UTC. */
            readonly created_at: string;
            /** @description When it ended. */
            readonly ended_at?: string | null;
            /**
             * Format: int64
             * @description Number of the verdict in the store.
             */
            readonly id: number;
            readonly request: components["schemas"]["VerdictRequest"];
            /** @description Who asked for it. */
            readonly who: string;
        };
        /** @description A scan with its newest fit and verdict. Without `fields`, a row has the columns up to `ended_at` that a list needs and at most 600 bytes: texts that are too long for it are shortened. Uncertainties have three significant digits, values end at the same decimal; /fits/{id} has all digits */
        readonly Result: {
            /**
             * Format: double
             * @description Roughness along the ridges, tangent of a slope
             */
            readonly alpha_u?: number | null;
            /**
             * Format: double
             * @description Its standard uncertainty (k = 1)
             */
            readonly alpha_u_std?: number | null;
            /**
             * Format: double
             * @description Roughness across the ridges, tangent of a slope
             */
            readonly alpha_v?: number | null;
            /**
             * Format: double
             * @description Its standard uncertainty (k = 1)
             */
            readonly alpha_v_std?: number | null;
            /** @description Whether the scan is archived; without this filter, rows of archived scans are left out */
            readonly archived?: boolean | null;
            /**
             * Format: double
             * @description Δφs, degrees
             */
            readonly azimuth_offset_deg?: number | null;
            /**
             * Format: double
             * @description Its standard uncertainty (k = 1), degrees
             */
            readonly azimuth_offset_deg_std?: number | null;
            /**
             * Format: double
             * @description Stray light B
             */
            readonly background?: number | null;
            /**
             * Format: double
             * @description Its standard uncertainty (k = 1)
             */
            readonly background_std?: number | null;
            /**
             * Format: double
             * @description k of the expanded uncertainty: U = k·u
             */
            readonly coverage_factor?: number | null;
            /** @description When the scan was started or imported */
            readonly created_at?: string | null;
            /**
             * Format: double
             * @description Radius of the crests divided by the length of the facets
             */
            readonly crest_radius?: number | null;
            /**
             * Format: double
             * @description Its standard uncertainty (k = 1)
             */
            readonly crest_radius_std?: number | null;
            /** @description When it ended; null while it can go on */
            readonly ended_at?: string | null;
            /**
             * Format: double
             * @description Index of refraction n of the material
             */
            readonly eta?: number | null;
            /** @description Number of the part or order in another system */
            readonly external_id?: string | null;
            /**
             * @description Known cause that explains most of the residual; null if none was found
             * @enum {string|null}
             */
            readonly finding?: "tails" | "rounded-crests" | "translucent" | "wedge-across" | "lamp-azimuth" | "non-linear" | "lamp-drift" | "index" | "bad-block" | "bad-pose" | null;
            /**
             * Format: int64
             * @description Number of the newest completed fit
             */
            readonly fit_id?: number | null;
            /** @description When the fit ended */
            readonly fitted_at?: string | null;
            /**
             * Format: double
             * @description Extinction coefficient k of the material; 0 for a dielectric
             */
            readonly k?: number | null;
            /** @description Lot of the part */
            readonly lot?: string | null;
            /**
             * @description Kind of the part's material
             * @enum {string|null}
             */
            readonly material?: "dielectric" | "conductor" | null;
            /** @description Note on the scan */
            readonly note?: string | null;
            /** @description The person at the rig */
            readonly operator_name?: string | null;
            /**
             * @description Scan of the rig, or imported series
             * @enum {string|null}
             */
            readonly origin?: "rig" | "import" | null;
            /** @description Name of the part */
            readonly part?: string | null;
            /** @description Name of the recipe that the scan was started with */
            readonly recipe?: string | null;
            /**
             * Format: int64
             * @description Version of that recipe
             */
            readonly recipe_version?: number | null;
            /** @description Region of a part that has several; omitted from an object if there is none */
            readonly region?: string | null;
            /**
             * Format: double
             * @description Diffuse reflectance
             */
            readonly rho_d?: number | null;
            /**
             * Format: double
             * @description Its standard uncertainty (k = 1)
             */
            readonly rho_d_std?: number | null;
            /**
             * Format: double
             * @description Residual (rms) as a share of the largest observation
             */
            readonly rms_residual?: number | null;
            /**
             * Format: int64
             * @description Number of the part
             */
            readonly sample_id?: number | null;
            /**
             * Format: double
             * @description Gain g of the signals; 1 with a white reference
             */
            readonly scale?: number | null;
            /**
             * Format: double
             * @description Its standard uncertainty (k = 1)
             */
            readonly scale_std?: number | null;
            /**
             * Format: int64
             * @description Number of the scan
             */
            readonly scan_id?: number | null;
            /** @description True where texts of the row are shortened and end with `…`; `fields=usual` sends them whole. Omitted otherwise */
            readonly shortened?: boolean;
            /** @description Name of the specification of that verdict */
            readonly specification?: string | null;
            /**
             * @description State of the scan
             * @enum {string|null}
             */
            readonly state?: "planned" | "waiting-for-operator" | "running" | "pausing" | "paused" | "interrupted" | "completed" | "aborted" | "failed" | null;
            /**
             * @description How the fit ended
             * @enum {string|null}
             */
            readonly status?: "converged" | "at-bound" | "rank-deficient" | "stalled" | "not-finite" | "too-few-observations" | "cancelled" | null;
            /** @description Tags of the scan */
            readonly tags?: readonly string[];
            /**
             * Format: double
             * @description Ridge angle θr, degrees; null where the data do not determine it
             */
            readonly theta_r_deg?: number | null;
            /**
             * Format: double
             * @description Expanded uncertainty U of θr, degrees
             */
            readonly theta_r_deg_expanded?: number | null;
            /**
             * Format: double
             * @description Standard uncertainty u of θr (k = 1), degrees
             */
            readonly theta_r_deg_std?: number | null;
            /**
             * Format: double
             * @description Δθc, degrees
             */
            readonly tilt_offset_deg?: number | null;
            /**
             * Format: double
             * @description Its standard uncertainty (k = 1), degrees
             */
            readonly tilt_offset_deg_std?: number | null;
            /**
             * Format: double
             * @description Share of the body's light that leaves evenly over the ridges
             */
            readonly translucency?: number | null;
            /**
             * Format: double
             * @description Its standard uncertainty (k = 1)
             */
            readonly translucency_std?: number | null;
            /**
             * @description Variant of the model that the fit reports
             * @enum {string|null}
             */
            readonly variant?: "paper" | "sawtooth" | "traced" | null;
            /**
             * @description Newest verdict; null where the scan was not judged
             * @enum {string|null}
             */
            readonly verdict?: "pass" | "fail" | "cannot-tell" | null;
            /**
             * Format: int64
             * @description Number of that verdict
             */
            readonly verdict_id?: number | null;
            /** @description Whether that verdict judged the values of this fit; false where a later fit gave others, null without a verdict */
            readonly verdict_matches?: boolean | null;
            /** @description Who started the scan: the name of a token, or `local` */
            readonly who?: string | null;
        };
        /** @description The control chart of a parameter over the newest 1000 results that the filters select. */
        readonly ResultChart: components["schemas"]["ControlChart"] & {
            /**
             * Format: int64
             * @description Number of all results that the filters select.
             */
            readonly count: number;
            /** @description What the settings ask to measure again at intervals, due or not. */
            readonly due: readonly components["schemas"]["Due"][];
            /** @description Results among the newest 1000 without a converged fit or without this parameter. */
            readonly omitted: number;
            /** @description Key of the parameter; its unit is the end of the name. */
            readonly parameter: string;
            readonly specification?: components["schemas"]["ChartedSpecification"] | null;
        };
        /** @description The scan and fit of a result. */
        readonly ResultOf: {
            /**
             * Format: int64
             * @description Number of the fit: the newest completed one.
             */
            readonly fit_id: number;
            /** @description When the scan started, or was imported; RFC 3339 in UTC. */
            readonly measured_at: string;
            /** @description The person at the rig. */
            readonly operator_name?: string | null;
            /** @description Name of the part. */
            readonly part: string;
            /** @description Region of a part that has several. */
            readonly region?: string | null;
            /**
             * Format: int64
             * @description Number of the part.
             */
            readonly sample_id: number;
            /**
             * Format: int64
             * @description Number of the scan.
             */
            readonly scan_id: number;
            /** @description Variant of the model. */
            readonly variant: components["schemas"]["FitVariantName"];
        };
        /** @description A page of results. */
        readonly ResultsBody_Result: {
            /**
             * Format: int64
             * @description Number of all rows that the filters select, if `count` asks for it.
             */
            readonly count?: number | null;
            /** @description The rows of this page. */
            readonly items: readonly {
                /**
                 * Format: double
                 * @description Roughness along the ridges, tangent of a slope
                 */
                readonly alpha_u?: number | null;
                /**
                 * Format: double
                 * @description Its standard uncertainty (k = 1)
                 */
                readonly alpha_u_std?: number | null;
                /**
                 * Format: double
                 * @description Roughness across the ridges, tangent of a slope
                 */
                readonly alpha_v?: number | null;
                /**
                 * Format: double
                 * @description Its standard uncertainty (k = 1)
                 */
                readonly alpha_v_std?: number | null;
                /** @description Whether the scan is archived; without this filter, rows of archived scans are left out */
                readonly archived?: boolean | null;
                /**
                 * Format: double
                 * @description Δφs, degrees
                 */
                readonly azimuth_offset_deg?: number | null;
                /**
                 * Format: double
                 * @description Its standard uncertainty (k = 1), degrees
                 */
                readonly azimuth_offset_deg_std?: number | null;
                /**
                 * Format: double
                 * @description Stray light B
                 */
                readonly background?: number | null;
                /**
                 * Format: double
                 * @description Its standard uncertainty (k = 1)
                 */
                readonly background_std?: number | null;
                /**
                 * Format: double
                 * @description k of the expanded uncertainty: U = k·u
                 */
                readonly coverage_factor?: number | null;
                /** @description When the scan was started or imported */
                readonly created_at?: string | null;
                /**
                 * Format: double
                 * @description Radius of the crests divided by the length of the facets
                 */
                readonly crest_radius?: number | null;
                /**
                 * Format: double
                 * @description Its standard uncertainty (k = 1)
                 */
                readonly crest_radius_std?: number | null;
                /** @description When it ended; null while it can go on */
                readonly ended_at?: string | null;
                /**
                 * Format: double
                 * @description Index of refraction n of the material
                 */
                readonly eta?: number | null;
                /** @description Number of the part or order in another system */
                readonly external_id?: string | null;
                /**
                 * @description Known cause that explains most of the residual; null if none was found
                 * @enum {string|null}
                 */
                readonly finding?: "tails" | "rounded-crests" | "translucent" | "wedge-across" | "lamp-azimuth" | "non-linear" | "lamp-drift" | "index" | "bad-block" | "bad-pose" | null;
                /**
                 * Format: int64
                 * @description Number of the newest completed fit
                 */
                readonly fit_id?: number | null;
                /** @description When the fit ended */
                readonly fitted_at?: string | null;
                /**
                 * Format: double
                 * @description Extinction coefficient k of the material; 0 for a dielectric
                 */
                readonly k?: number | null;
                /** @description Lot of the part */
                readonly lot?: string | null;
                /**
                 * @description Kind of the part's material
                 * @enum {string|null}
                 */
                readonly material?: "dielectric" | "conductor" | null;
                /** @description Note on the scan */
                readonly note?: string | null;
                /** @description The person at the rig */
                readonly operator_name?: string | null;
                /**
                 * @description Scan of the rig, or imported series
                 * @enum {string|null}
                 */
                readonly origin?: "rig" | "import" | null;
                /** @description Name of the part */
                readonly part?: string | null;
                /** @description Name of the recipe that the scan was started with */
                readonly recipe?: string | null;
                /**
                 * Format: int64
                 * @description Version of that recipe
                 */
                readonly recipe_version?: number | null;
                /** @description Region of a part that has several; omitted from an object if there is none */
                readonly region?: string | null;
                /**
                 * Format: double
                 * @description Diffuse reflectance
                 */
                readonly rho_d?: number | null;
                /**
                 * Format: double
                 * @description Its standard uncertainty (k = 1)
                 */
                readonly rho_d_std?: number | null;
                /**
                 * Format: double
                 * @description Residual (rms) as a share of the largest observation
                 */
                readonly rms_residual?: number | null;
                /**
                 * Format: int64
                 * @description Number of the part
                 */
                readonly sample_id?: number | null;
                /**
                 * Format: double
                 * @description Gain g of the signals; 1 with a white reference
                 */
                readonly scale?: number | null;
                /**
                 * Format: double
                 * @description Its standard uncertainty (k = 1)
                 */
                readonly scale_std?: number | null;
                /**
                 * Format: int64
                 * @description Number of the scan
                 */
                readonly scan_id?: number | null;
                /** @description True where texts of the row are shortened and end with `…`; `fields=usual` sends them whole. Omitted otherwise */
                readonly shortened?: boolean;
                /** @description Name of the specification of that verdict */
                readonly specification?: string | null;
                /**
                 * @description State of the scan
                 * @enum {string|null}
                 */
                readonly state?: "planned" | "waiting-for-operator" | "running" | "pausing" | "paused" | "interrupted" | "completed" | "aborted" | "failed" | null;
                /**
                 * @description How the fit ended
                 * @enum {string|null}
                 */
                readonly status?: "converged" | "at-bound" | "rank-deficient" | "stalled" | "not-finite" | "too-few-observations" | "cancelled" | null;
                /** @description Tags of the scan */
                readonly tags?: readonly string[];
                /**
                 * Format: double
                 * @description Ridge angle θr, degrees; null where the data do not determine it
                 */
                readonly theta_r_deg?: number | null;
                /**
                 * Format: double
                 * @description Expanded uncertainty U of θr, degrees
                 */
                readonly theta_r_deg_expanded?: number | null;
                /**
                 * Format: double
                 * @description Standard uncertainty u of θr (k = 1), degrees
                 */
                readonly theta_r_deg_std?: number | null;
                /**
                 * Format: double
                 * @description Δθc, degrees
                 */
                readonly tilt_offset_deg?: number | null;
                /**
                 * Format: double
                 * @description Its standard uncertainty (k = 1), degrees
                 */
                readonly tilt_offset_deg_std?: number | null;
                /**
                 * Format: double
                 * @description Share of the body's light that leaves evenly over the ridges
                 */
                readonly translucency?: number | null;
                /**
                 * Format: double
                 * @description Its standard uncertainty (k = 1)
                 */
                readonly translucency_std?: number | null;
                /**
                 * @description Variant of the model that the fit reports
                 * @enum {string|null}
                 */
                readonly variant?: "paper" | "sawtooth" | "traced" | null;
                /**
                 * @description Newest verdict; null where the scan was not judged
                 * @enum {string|null}
                 */
                readonly verdict?: "pass" | "fail" | "cannot-tell" | null;
                /**
                 * Format: int64
                 * @description Number of that verdict
                 */
                readonly verdict_id?: number | null;
                /** @description Whether that verdict judged the values of this fit; false where a later fit gave others, null without a verdict */
                readonly verdict_matches?: boolean | null;
                /** @description Who started the scan: the name of a token, or `local` */
                readonly who?: string | null;
            }[];
            /** @description `cursor` of the next page; null at the end. */
            readonly next_cursor?: string | null;
        };
        /** @description The effective ridge angle of an interface. */
        readonly RidgeAngle: {
            /** @description 1 for the topmost. */
            readonly interface: number;
            /**
             * Format: double
             * @description Area-weighted median inclination of the parts whose normal leans to +v, degrees.
             */
            readonly theta_r_deg: number;
        };
        /** @description Properties of a height map; lengths in µm. */
        readonly RidgeFacts: {
            /**
             * Format: double
             * @description Fraction of the variance of the heights that the mean along the ridges explains.
             */
            readonly explained: number;
            /**
             * Format: double
             * @description Fraction of the heights that are missing or spikes; the mean does not use them.
             */
            readonly filled_share?: number;
            /**
             * Format: double
             * @description Height between the lowest and the highest point of the mean along the ridges.
             */
            readonly height_um: number;
            /**
             * Format: double
             * @description Azimuth in the map towards which the facets lean, from its rows of samples (u) towards its
             *     columns (v).
             */
            readonly lean_azimuth_deg: number;
            /**
             * Format: double
             * @description Standard uncertainty of the angle of the lobe at that ridge angle, because of the samples'
             *     width and the heights' noise.
             */
            readonly lobe_error_deg?: number;
            /**
             * Format: double
             * @description Length of a ridge across, in the mean plane.
             */
            readonly period_um: number;
            /** @description Number of whole ridges that are traced. */
            readonly ridges: number;
            /**
             * Format: double
             * @description Width of a sample across the ridges.
             */
            readonly sample_um: number;
            /**
             * Format: double
             * @description Effective ridge angle: the area-weighted median inclination of the surface on the facets'
             *     side.
             */
            readonly theta_r_deg: number;
            /**
             * Format: double
             * @description Root mean square of the variation along a ridge (on the median line), including the
             *     instrument's noise.
             */
            readonly unevenness_um: number;
            /**
             * Format: double
             * @description Fraction of a ridge that was not measured on any line along it, for example on steep walls:
             *     bridged by extending the adjacent flanks.
             */
            readonly unseen_share?: number;
        };
        /**
         * @description What the rig is doing.
         * @enum {string}
         */
        readonly RigActivity: "idle" | "moving" | "homing" | "scanning" | "stopped" | "not-connected";
        /** @description State of the rig. */
        readonly RigBody: {
            /**
             * @description What the rig is doing: idle (accepts commands), moving, homing, scanning, paused (a paused scan holds the rig) or
             *     not-connected (the stages do not answer and nothing is running).
             */
            readonly activity: components["schemas"]["Activity"];
            /** @description The two axes. */
            readonly axes: components["schemas"]["AxesBody"];
            /** @description The camera. */
            readonly camera: components["schemas"]["CameraBody"];
            /** @description Whether the stages answer. */
            readonly connected: boolean;
            /** @description Protocol and port. */
            readonly description: string;
            readonly failure?: components["schemas"]["RigProblem"] | null;
            /** @description Positions of lamp and camera. */
            readonly geometry: components["schemas"]["GeometryBody"];
            readonly problem?: components["schemas"]["RigProblem"] | null;
            readonly refused_stages?: components["schemas"]["StagesBody"] | null;
            /**
             * Format: int64
             * @description Scan that holds the rig.
             */
            readonly scan_id?: number | null;
            /** @description Reason for that state, if there is one. */
            readonly scan_reason?: string | null;
            readonly scan_state?: components["schemas"]["ScanState"] | null;
            /** @description Whether the rig is simulated. */
            readonly simulated: boolean;
            /**
             * Format: double
             * @description Speed of a simulated rig relative to real time; 1 for a real rig.
             */
            readonly time_scale: number;
        };
        /** @description `[rig]`: where lamp and camera stand. */
        readonly RigFacts: {
            /**
             * Format: double
             * @description Added to the recorded φs it gives the azimuth of v.
             */
            readonly azimuth_zero_deg?: number;
            /**
             * Format: double
             * @description Standard uncertainty of where v stands at a recorded φs: of `azimuth_zero_deg`, and of how a sample is laid down.
             */
            readonly azimuth_zero_std_deg?: number | null;
            /** @description `infinity` or `finite`. */
            readonly camera_distance?: string | null;
            /**
             * Format: double
             * @description From the centre of tilt to the camera's pupil, where it is finite.
             */
            readonly camera_distance_mm?: number | null;
            /**
             * Format: double
             * @description Relative standard uncertainty that the lamp's drift between white reference and sample gives the signals.
             */
            readonly lamp_drift_std?: number | null;
            /**
             * Format: double
             * @description Half angle of the lens's pupil seen from the sample; its sine is the numerical aperture there. A point
             *     where neither this nor `lens_radius_mm` is stated.
             */
            readonly lens_angular_radius_deg?: number | null;
            /**
             * Format: double
             * @description Radius of the lens's pupil, where its distance is finite.
             */
            readonly lens_radius_mm?: number | null;
            /**
             * Format: double
             * @description Half angle of the lamp seen from the sample.
             */
            readonly light_angular_radius_deg?: number | null;
            /**
             * Format: double
             * @description Azimuth φl of the lamp about the camera's axis; 0 in the tilt plane.
             */
            readonly light_azimuth_deg?: number;
            /** @description `infinity` or `finite`. */
            readonly light_distance?: string | null;
            /**
             * Format: double
             * @description From the centre of tilt to the lamp, where it is finite.
             */
            readonly light_distance_mm?: number | null;
            /**
             * Format: double
             * @description Radius of the lamp, where its distance is finite.
             */
            readonly light_radius_mm?: number | null;
            /**
             * Format: double
             * @description The same of the recorded φs: of the stage's zero, and of its error once round.
             */
            readonly phi_s_std_deg?: number | null;
            /** @description Column and row at which the rotation axis meets the sample at θc = 0. That of the centre of tilt by default. */
            readonly rotation_axis_px?: readonly number[] | null;
            /**
             * Format: double
             * @description Standard uncertainty of how a sample's mean plane is inclined to the turntable, along any direction.
             */
            readonly sample_wedge_std_deg?: number | null;
            /**
             * Format: double
             * @description Standard uncertainty of the recorded θc that is left once a fit knows the tilt's offset: of the stage's zero, and of
             *     its error at the ends of the range of tilts.
             */
            readonly theta_c_std_deg?: number | null;
            /**
             * Format: double
             * @description Angle θl between lamp and camera.
             */
            readonly theta_l_deg: number;
            /**
             * Format: double
             * @description Standard uncertainty of `theta_l_deg`.
             */
            readonly theta_l_std_deg?: number | null;
            /**
             * @description Column and row of the point about which camera and lamp tilt; (0, 0) is the outer corner of the first pixel. The
             *     frame's centre by default.
             */
            readonly tilt_centre_px?: readonly number[] | null;
            /**
             * Format: double
             * @description Wavelength of the lamp.
             */
            readonly wavelength_nm?: number | null;
        };
        /** @description What is wrong with the stages. */
        readonly RigProblem: {
            /** @description Stable word. */
            readonly code: string;
            /** @description Cause and remedy. */
            readonly detail: string;
        };
        /**
         * @description What the holder of a token may do. Every role may stop the rig.
         * @enum {string}
         */
        readonly Role: "viewer" | "analyst" | "operator" | "admin";
        /** @description A part. */
        readonly SampleBody: {
            /** @description When the part was added, RFC 3339 in UTC. */
            readonly created_at: string;
            /** @description Names that it had, oldest first. */
            readonly earlier_names: readonly components["schemas"]["EarlierName"][];
            /**
             * Format: int64
             * @description Number of the part.
             */
            readonly id: number;
            /** @description Nominal material. */
            readonly material: components["schemas"]["MaterialBody"];
            /** @description Name of the part. */
            readonly name: string;
            /** @description Free text. */
            readonly note?: string | null;
            readonly simulated?: components["schemas"]["SimulatedSurface"] | null;
        };
        /** @description A part to add. */
        readonly SampleRequest: {
            readonly material?: components["schemas"]["MaterialBody"] | null;
            readonly metal?: components["schemas"]["MetalBody"] | null;
            /** @description Name, 1 to 200 characters. */
            readonly name: string;
            /** @description Free text. */
            readonly note?: string | null;
            readonly simulated?: components["schemas"]["SimulatedSurface"] | null;
        };
        /** @description A scan. */
        readonly ScanBody: {
            /** @description Whether lists leave the scan out unless they are asked for archived scans. */
            readonly archived: boolean;
            /** @description Calibrations that it uses, including its own. */
            readonly calibration_ids: readonly number[];
            /** @description The camera that took the frames. */
            readonly camera: components["schemas"]["ScanCameraBody"];
            /** @description When the scan was requested, RFC 3339 in UTC. */
            readonly created_at: string;
            /** @description Parts that it was assigned to before, oldest first. */
            readonly earlier_samples: readonly components["schemas"]["EarlierSample"][];
            /** @description When it ended, RFC 3339 in UTC. */
            readonly ended_at?: string | null;
            /** @description Number of the part or order in another system. */
            readonly external_id?: string | null;
            /**
             * Format: int32
             * @description Number of frames that were taken and rejected.
             */
            readonly frames_rejected: number;
            /**
             * Format: int64
             * @description Number of the scan.
             */
            readonly id: number;
            /** @description Lot of the part. */
            readonly lot?: string | null;
            /** @description Free text on the scan. */
            readonly note?: string | null;
            readonly operator?: components["schemas"]["OperatorBody"] | null;
            /** @description The person at the rig. */
            readonly operator_name?: string | null;
            /**
             * Format: int64
             * @description The order of the queue that it measures; null for a scan that was started by itself.
             */
            readonly order_id?: number | null;
            /** @description Origin of the scan. */
            readonly origin: components["schemas"]["ScanOrigin"];
            /** @description The whole plan; of an import, its poses. */
            readonly plan: components["schemas"]["Plan"];
            /** @description Progress of the scan. */
            readonly progress: components["schemas"]["ProgressBody"];
            /** @description Reason for the state, if it is not the normal course. */
            readonly reason?: string | null;
            readonly recipe?: components["schemas"]["DefinitionRef"] | null;
            /** @description Regions of a part with patches, one of which a fit must name; else empty. */
            readonly regions: readonly string[];
            /**
             * Format: int64
             * @description Number of the part.
             */
            readonly sample_id: number;
            /** @description Name of the part. */
            readonly sample_name: string;
            readonly specification?: components["schemas"]["DefinitionRef"] | null;
            /** @description When it started, RFC 3339 in UTC. */
            readonly started_at?: string | null;
            /** @description State of the scan. */
            readonly state: components["schemas"]["ScanState"];
            /** @description Tags, in the order in which they were given. */
            readonly tags: readonly string[];
            /**
             * Format: double
             * @description Expanded uncertainty (k = 2) of θr that the recipe asks for, degrees; null if it states none.
             */
            readonly target_expanded_deg?: number | null;
            /** @description Who started it: the name of a token, or `local`. */
            readonly who: string;
        };
        /** @description Properties of the camera that displaying its frames needs. */
        readonly ScanCameraBody: {
            /**
             * Format: int32
             * @description Rows of a frame, px.
             */
            readonly height_px: number;
            /**
             * Format: double
             * @description Count at which a pixel is full, DN.
             */
            readonly saturation_dn: number;
            /**
             * @description Whether its program states when each frame of the sample was exposed. If not, the scan could compare pictures only, and
             *     cannot exclude a frame of an earlier pose. Null before the first frame, and for an import.
             */
            readonly states_exposure_start?: boolean | null;
            /**
             * Format: int32
             * @description Columns of a frame, px.
             */
            readonly width_px: number;
        };
        /**
         * @description Where a scan comes from.
         * @enum {string}
         */
        readonly ScanOrigin: "rig" | "import";
        /** @description What changes of a scan; a field that is omitted stays as it is. */
        readonly ScanPatch: {
            /** @description Whether lists leave the scan out from now on. */
            readonly archived?: boolean | null;
            /** @description The note from now on, at most 4000 characters; null or an empty text removes it. */
            readonly note?: string | null;
            /**
             * Format: int64
             * @description Number of the part that was scanned.
             */
            readonly sample_id?: number | null;
            /** @description All tags from now on, at most 20: each 1 to 40 characters without comma, quote and backslash. */
            readonly tags?: readonly string[] | null;
        };
        /** @description The record of a scan. */
        readonly ScanRecord: {
            /** @description Whether lists leave the scan out unless they are asked for archived scans. */
            readonly archived: boolean;
            /** @description Free text. */
            readonly note?: string | null;
            /** @description Tags, in the order in which they were given. */
            readonly tags: readonly string[];
        };
        /** @description A request for a scan: of a plan, or of a recipe. */
        readonly ScanRequest: {
            /** @description Number of the part or order in another system, at most 200 characters. */
            readonly external_id?: string | null;
            /** @description Lot of the part, at most 200 characters. */
            readonly lot?: string | null;
            /** @description The person at the rig, at most 200 characters. */
            readonly operator_name?: string | null;
            readonly plan?: components["schemas"]["PlanRequest"] | null;
            readonly recipe?: components["schemas"]["NameOrId"] | null;
            /**
             * Format: int64
             * @description Number of the part to scan.
             */
            readonly sample_id: number;
            readonly specification?: components["schemas"]["NameOrId"] | null;
        };
        /**
         * @description Where a scan stands.
         * @enum {string}
         */
        readonly ScanState: "planned" | "waiting-for-operator" | "running" | "pausing" | "paused" | "interrupted" | "completed" | "aborted" | "failed";
        /** @description Scatter within parts beside the stated uncertainty. */
        readonly Scatter: {
            /**
             * Format: double
             * @description χ² of the results about the weighted mean of their part, with `scattering_std`; null where a result has none.
             */
            readonly chi_square?: number | null;
            /** @description Degrees of freedom of s and χ². */
            readonly degrees_of_freedom: number;
            /**
             * Format: double
             * @description Mean of the results, in the unit of the parameter; null for several parts.
             */
            readonly mean?: number | null;
            /** @description What the verdict means, and what to do. */
            readonly message?: string | null;
            /** @description Number of results. */
            readonly n: number;
            /** @description Number of parts. */
            readonly n_parts: number;
            /**
             * Format: double
             * @description Probability of a χ² at least this large if the stated uncertainty is right.
             */
            readonly probability?: number | null;
            /**
             * Format: double
             * @description s divided by `scattering_std`; null where that is zero.
             */
            readonly ratio?: number | null;
            /**
             * Format: double
             * @description As `stated_std`, without the lines of the budget that have the same error in all results.
             */
            readonly scattering_std: number;
            /**
             * Format: double
             * @description Root mean square of the stated expanded uncertainties U.
             */
            readonly stated_expanded: number;
            /**
             * Format: double
             * @description Root mean square of the stated standard uncertainties u (k = 1).
             */
            readonly stated_std: number;
            /**
             * Format: double
             * @description Scatter s: standard deviation of one result about the mean of its part.
             */
            readonly std: number;
            /** @description Interval of 95 % for it, of normal errors. */
            readonly std_interval: readonly number[];
            readonly verdict?: components["schemas"]["ScatterVerdict"] | null;
        };
        /**
         * @description Whether the scatter is as large as stated.
         * @enum {string}
         */
        readonly ScatterVerdict: "consistent" | "too-large" | "small";
        /** @description Who sends requests. */
        readonly SessionBody: {
            /** @description Whether a login made this session, so that a logout ends it. */
            readonly logged_in: boolean;
            /** @description What this caller may do. */
            readonly role: components["schemas"]["Role"];
            /** @description Name of the token; `local` for a caller on the daemon's machine without one. */
            readonly who: string;
        };
        /** @description The part's own shape, measured: a profile or a height map (see `docs/reference/height-maps.md`). */
        readonly ShapeFile: {
            /** @description Content, base64. */
            readonly content: components["schemas"]["FileContent"];
            /**
             * Format: double
             * @description Micrometres per unit of height, if the file does not state it.
             */
            readonly height_unit_um?: number | null;
            /** @description Name; the extension states the format (csv, png, tif, x3p, sdf). */
            readonly name: string;
            readonly pitch_um?: components["schemas"]["Pitch"] | null;
        };
        /** @description A line of the budget, and whether it has the same error in all scans. */
        readonly SharedLine: {
            /** @description Key of the line. */
            readonly line: string;
            /** @description Whether its error is the same in all scans. */
            readonly shared: boolean;
            /** @description Why. */
            readonly why: string;
        };
        /** @description Fitted ridge angle in short. */
        readonly ShortValue: {
            /**
             * Format: double
             * @description Expanded uncertainty.
             */
            readonly expanded: number;
            /**
             * Format: double
             * @description Estimate.
             */
            readonly value: number;
        };
        /** @description The surface that a simulated rig renders for a sample; a real rig ignores it. */
        readonly SimulatedSurface: {
            /** @enum {string} */
            readonly surface: "traced";
        } | {
            /**
             * Format: double
             * @description Roughness along the ridges.
             */
            readonly alpha_u: number;
            /**
             * Format: double
             * @description Roughness across the ridges.
             */
            readonly alpha_v: number;
            /**
             * Format: double
             * @description Diffuse reflectance seen outside.
             */
            readonly rho_d: number;
            /** @enum {string} */
            readonly surface: "model";
            /**
             * Format: double
             * @description Ridge angle.
             */
            readonly theta_r_deg: number;
        };
        /** @description Limits and decision rule of one kind of part. */
        readonly Specification: {
            /** @description Allowed risks. */
            readonly decision?: components["schemas"]["DecisionRule"];
            /** @description Limits by quantity; see [`QUANTITIES`]. */
            readonly limits: {
                readonly [key: string]: components["schemas"]["ToleranceLimits"];
            };
            /** @description What it specifies, for instance drawing and revision. */
            readonly name: string;
            readonly reference_plane?: components["schemas"]["FitReferencePlane"] | null;
        };
        /** @description One version of a specification. */
        readonly SpecificationBody: {
            /** @description Whether it is archived: no scan can be judged against it. */
            readonly archived: boolean;
            /**
             * Format: int64
             * @description Number of the specification.
             */
            readonly id: number;
            /** @description Its name. */
            readonly name: string;
            /**
             * Format: int64
             * @description The newest version.
             */
            readonly newest_version: number;
            /** @description When this version was saved, RFC 3339 in UTC. */
            readonly saved_at: string;
            /** @description The specification. */
            readonly specification: components["schemas"]["Specification"];
            /**
             * Format: int64
             * @description This version, from 1.
             */
            readonly version: number;
            /** @description Who saved this version: the name of a token, or `local`. */
            readonly who: string;
        };
        /** @description A change of a specification. */
        readonly SpecificationChange: {
            /**
             * Format: int64
             * @description The version that it replaces, which has to be the newest one, so that no change of another caller is lost.
             */
            readonly replaces: number;
            /** @description The whole specification. Its name stays. */
            readonly specification: components["schemas"]["Specification"];
        };
        /** @description A controller of a stage. */
        readonly StageController: {
            /** @description Axis. */
            readonly axis: string;
            /**
             * Format: int32
             * @description The manufacturer's product number.
             */
            readonly device_id: number;
            /** @description Firmware version. */
            readonly firmware: string;
            /**
             * Format: int32
             * @description Serial number.
             */
            readonly serial: number;
        };
        /** @description Two controllers. */
        readonly StagesBody: {
            /** @description The controller of the sample azimuth. */
            readonly phi_s: components["schemas"]["ControllerBody"];
            /** @description The controller of the camera tilt. */
            readonly theta_c: components["schemas"]["ControllerBody"];
        };
        /** @description A specification, or the name or number of a stored one. For the description: a refusal names the wrong key of a content. */
        readonly StatedSpecification: components["schemas"]["Specification"] | components["schemas"]["NameOrId"];
        /** @description Stray light as radiance where the scale is absolute, otherwise in the unit of the signals. */
        readonly StrayLight: {
            /**
             * Format: double
             * @description Amount in every signal.
             */
            readonly radiance: number;
            /**
             * Format: double
             * @description Its standard uncertainty.
             */
            readonly std: number;
        };
        /** @description A result of the study. */
        readonly StudiedResult: components["schemas"]["ResultOf"] & {
            /** @description Lines of the budget that are not zero: standard uncertainties. */
            readonly budget: {
                readonly [key: string]: number;
            };
            /**
             * Format: double
             * @description U divided by u.
             */
            readonly coverage_factor: number;
            /**
             * Format: double
             * @description Value minus the mean of the part.
             */
            readonly deviation: number;
            /**
             * Format: double
             * @description Expanded uncertainty U, same unit.
             */
            readonly expanded: number;
            /**
             * Format: double
             * @description Standard uncertainty without the lines that have the same error in all scans.
             */
            readonly scattering_std: number;
            /**
             * Format: double
             * @description Standard uncertainty u (k = 1), same unit.
             */
            readonly std: number;
            /**
             * Format: double
             * @description Value, in the unit of the parameter's name.
             */
            readonly value: number;
        };
        /** @description Exposures for a scan. */
        readonly SuggestionBody: {
            /**
             * @description Exposures, s, shortest first; empty if there is no suggestion. At the first one the brightest pixel of this pose reaches
             *     about 70 % of full scale; the second one is three times as long.
             */
            readonly exposures_s: readonly number[];
            /** @description Why there is none, or why the brightest pixel does not reach 70 %; null otherwise. */
            readonly reason?: string | null;
        };
        /** @description What a camera's program states with a frame. */
        readonly TagBody: {
            /**
             * Format: int64
             * @description The camera's count of frames.
             */
            readonly counter?: number | null;
            /**
             * Format: double
             * @description Exposure read back, s.
             */
            readonly exposure_s?: number | null;
            /** @description Start of the exposure, RFC 3339 in UTC. */
            readonly exposure_start?: string | null;
            /**
             * Format: double
             * @description Gain read back, in the camera's unit.
             */
            readonly gain?: number | null;
            /** @description Serial number of the camera. */
            readonly serial?: string | null;
            /**
             * Format: double
             * @description Temperature of the sensor, °C.
             */
            readonly temperature_c?: number | null;
        };
        /**
         * @description The state of a job.
         * @enum {string}
         */
        readonly TaskState: "running" | "completed" | "failed" | "cancelled" | "interrupted";
        /** @description Tolerance limits; one of them may be missing. */
        readonly ToleranceLimits: {
            /**
             * Format: double
             * @description Conforming values are at least this.
             */
            readonly lower?: number | null;
            /**
             * Format: double
             * @description Conforming values are at most this.
             */
            readonly upper?: number | null;
        };
        /** @description A trace: its request and its state, and the object of `trace --json`, once it has completed */
        readonly Trace: {
            /**
             * Format: int64
             * @description Number of independent replicates behind the standard errors.
             */
            readonly batches?: number;
            /** @description When it was accepted, RFC 3339 in UTC. */
            readonly created_at: string;
            /** @description When it ended, RFC 3339 in UTC; null while it runs. */
            readonly ended_at?: string | null;
            /** @description Fractions of the light. */
            readonly energy?: components["schemas"]["TraceEnergy"];
            readonly error?: components["schemas"]["FitError"] | null;
            readonly forecast?: components["schemas"]["Forecast"] | null;
            /**
             * Format: int64
             * @description Number of the job within its kind.
             */
            readonly id: number;
            /** @description Effects left out, with reason and cost. */
            readonly left_out?: readonly components["schemas"]["WorkLeftOut"][];
            /** @description Scope and limits of the standard errors. */
            readonly notes?: readonly string[];
            /**
             * Format: int64
             * @description Photons launched.
             */
            readonly photons?: number;
            /** @description Whether polarisation was followed. */
            readonly polarised?: boolean;
            /** @description Program and version. */
            readonly program?: string;
            readonly progress?: components["schemas"]["WorkProgress"] | null;
            /**
             * Format: double
             * @description Relative error of the reflected bins, root mean square ([`Totals::relative_error`]).
             */
            readonly relative_error?: number | null;
            readonly request: components["schemas"]["TraceRequest"];
            /** @description Effective ridge angles of the interfaces that have one. */
            readonly ridge_angles?: readonly components["schemas"]["RidgeAngle"][];
            /**
             * Format: double
             * @description Part of `seconds` spent on the photons, set-up included.
             */
            readonly run_seconds?: number | null;
            /**
             * Format: int64
             * @description Number of the part of that scan.
             */
            readonly sample_id?: number | null;
            /** @description Name of that part. */
            readonly sample_name?: string | null;
            /**
             * Format: int64
             * @description Number of its scan; null without one.
             */
            readonly scan_id?: number | null;
            /**
             * Format: double
             * @description Duration of the run, s, if known.
             */
            readonly seconds?: number | null;
            /**
             * Format: double
             * @description Part of `run_seconds` before the first photon: finding the illuminated parts and the
             *     analytic part of the result.
             */
            readonly setup_seconds?: number | null;
            /** @description State of the job. */
            readonly state: components["schemas"]["TaskState"];
            /**
             * Format: double
             * @description Time before `seconds` spent building or reading the surfaces.
             */
            readonly surface_seconds?: number | null;
            readonly surfaces?: components["schemas"]["TraceSurfaces"] | null;
            /** @description Who started it: the name of a token, or `local`. */
            readonly who: string;
        };
        /** @description A fraction of the light over several surfaces. */
        readonly TraceBetween: {
            /**
             * Format: double
             * @description Standard error of the mean, as an estimate for all surfaces of these statistics.
             */
            readonly std: number;
            /**
             * Format: double
             * @description Standard deviation between surfaces, without the photons' own error.
             */
            readonly std_between_surfaces: number;
            /**
             * Format: double
             * @description Part of it that more photons would reduce.
             */
            readonly std_by_sampling: number;
            /**
             * Format: double
             * @description Mean over the surfaces.
             */
            readonly value: number;
        };
        /** @description Fractions of the light; the first four sum to 1. */
        readonly TraceEnergy: {
            /** @description Absorbed by metals, layers and diffuse bodies. */
            readonly absorbed: components["schemas"]["MonteCarloEstimate"];
            /** @description R1, R2, … and T1, T2, …: by number of interactions. */
            readonly by_interactions: {
                readonly [key: string]: components["schemas"]["MonteCarloEstimate"];
            };
            /** @description Reflected to the upper side. */
            readonly reflected: components["schemas"]["MonteCarloEstimate"];
            /** @description Transmitted through the last interface. */
            readonly transmitted: components["schemas"]["MonteCarloEstimate"];
            /** @description Given up. */
            readonly truncated: components["schemas"]["MonteCarloEstimate"];
        };
        /** @description The file `plane.json` of a trace: light in the plane of incidence. */
        readonly TracePlane: {
            /** @description Reflected light by direction, where there is some. */
            readonly lobe?: readonly {
                readonly [key: string]: unknown;
            }[] | null;
            /** @description Readings of the virtual ellipsometer by direction, where there are some. */
            readonly points?: readonly {
                readonly [key: string]: unknown;
            }[] | null;
            /** @description Settings of the polarisers before the camera. */
            readonly settings: readonly {
                readonly [key: string]: unknown;
            }[];
            /** @description States of the lamp, the scene's first. */
            readonly states: readonly {
                readonly [key: string]: unknown;
            }[];
        };
        /** @description A request for a trace. */
        readonly TraceRequest: {
            /** @description Trace every path with and without polarisation, and report where the latter is wrong. */
            readonly compare?: boolean;
            /** @description Files that the scene names, by `path`. */
            readonly files?: {
                readonly [key: string]: components["schemas"]["FileContent"];
            };
            /**
             * Format: double
             * @description Stop after this time, s; the result has what is finished until then.
             */
            readonly max_seconds?: number | null;
            /**
             * Format: int64
             * @description Number of photons instead of the scene's.
             */
            readonly photons?: number | null;
            /** @description The scene, as TOML text or as an object with the same keys. */
            readonly scene: unknown;
            /**
             * Format: int32
             * @description Trace this number of surfaces with the same statistics, and report how much they differ.
             */
            readonly surfaces?: number | null;
            /**
             * Format: double
             * @description Stop once the relative error of the reflected bins (root mean square) is below this.
             */
            readonly target_error?: number | null;
        };
        /** @description Energies over several surfaces. */
        readonly TraceSurfaces: {
            /** @description Absorbed by metals, layers and diffuse bodies. */
            readonly absorbed: components["schemas"]["TraceBetween"];
            /** @description Number of surfaces; fewer than requested if time ran out. */
            readonly count: number;
            /** @description Reflected to the upper side. */
            readonly reflected: components["schemas"]["TraceBetween"];
            /** @description Transmitted through the last interface. */
            readonly transmitted: components["schemas"]["TraceBetween"];
        };
        /** @description A parameter with its standard uncertainty. */
        readonly UncertainBody: {
            /**
             * Format: double
             * @description k: the expanded uncertainty is k times `std`.
             */
            readonly coverage_factor?: number;
            /**
             * Format: double
             * @description Standard uncertainty with all known components, in the same unit.
             */
            readonly std: number;
            /**
             * Format: double
             * @description Estimate, in the unit of the parameter's name.
             */
            readonly value: number;
        };
        /** @description A fitted parameter in passing. */
        readonly UncertainValue: {
            /**
             * Format: double
             * @description k: its expanded uncertainty divided by the standard uncertainty.
             */
            readonly coverage_factor?: number;
            /**
             * Format: double
             * @description Standard uncertainty with everything known in it.
             */
            readonly std: number;
            /**
             * Format: double
             * @description Estimate, in the unit of the parameter's name.
             */
            readonly value: number;
        };
        /** @description Dark or white-reference frames of the store. */
        readonly UsedCalibration: {
            /**
             * Format: double
             * @description Age at the start of the scan, h; 0 for frames that the scan took itself.
             */
            readonly age_h?: number | null;
            /** @description When the frames were taken, RFC 3339 in UTC. */
            readonly created_at: string;
            /** @description Exposure times, s. */
            readonly exposures_s: readonly number[];
            /**
             * Format: int64
             * @description Number of the calibration.
             */
            readonly id: number;
            /** @description Kind of its frames. */
            readonly kind: components["schemas"]["FrameKind"];
            /**
             * Format: int32
             * @description Number of frames.
             */
            readonly n_frames: number;
            /**
             * Format: int64
             * @description Number of the scan that took the frames.
             */
            readonly scan_id: number;
            /** @description Camera tilts θc, degrees; empty for dark frames. */
            readonly theta_c_deg: readonly number[];
        };
        /** @description A version of a recipe or specification. */
        readonly UsedDefinition: {
            /**
             * Format: int64
             * @description Number of the recipe or specification in the store.
             */
            readonly id: number;
            /** @description Its name. */
            readonly name: string;
            /**
             * Format: int64
             * @description Its version, from 1.
             */
            readonly version: number;
        };
        /** @description A list of numbers, written out or as a grid. */
        readonly Values: readonly number[] | components["schemas"]["Grid"];
        /** @description A row of the analysis of variance. */
        readonly VarianceRow: {
            /** @description Degrees of freedom. */
            readonly degrees_of_freedom: number;
            /**
             * Format: double
             * @description Mean square, same unit.
             */
            readonly mean_square: number;
            /** @description Source of the variation. */
            readonly source: components["schemas"]["VarianceSource"];
            /**
             * Format: double
             * @description Sum of squares, in the square of the parameter's unit.
             */
            readonly sum_of_squares: number;
        };
        /**
         * @description A source of variation.
         * @enum {string}
         */
        readonly VarianceSource: "part" | "group" | "interaction" | "repeat";
        /**
         * @description Variant that the report is based on.
         * @enum {string}
         */
        readonly VariantChoice: "paper" | "sawtooth" | "traced" | "auto";
        /** @description A verdict: its request and its state, and the object of `judge --json`, once it has completed */
        readonly Verdict: {
            /**
             * Format: double
             * @description Lower bound of the probability that all items conform (Boole's inequality; a positive correlation raises it); null
             *     where an item is not determined.
             */
            readonly conformance_probability_min?: number | null;
            /** @description Tilts over which the contrasts are averaged, degrees; null where no contrast is limited. */
            readonly contrast_theta_c_deg?: readonly number[] | null;
            /** @description When it was accepted, RFC 3339 in UTC. */
            readonly created_at: string;
            /** @description The allowed risks. */
            readonly decision?: components["schemas"]["DecisionRule"];
            /** @description The rule as a sentence. */
            readonly decision_rule?: string;
            /** @description When it ended, RFC 3339 in UTC; null while it runs. */
            readonly ended_at?: string | null;
            readonly error?: components["schemas"]["FitError"] | null;
            readonly forecast?: components["schemas"]["Forecast"] | null;
            /**
             * Format: int64
             * @description Number of the job within its kind.
             */
            readonly id: number;
            /** @description One per limited quantity. */
            readonly items?: readonly components["schemas"]["JudgedItem"][];
            /** @description Effects that the fit omits, why, and their possible effect on the result. */
            readonly left_out?: readonly components["schemas"]["WorkLeftOut"][];
            /** @description Name and version of the program. */
            readonly program?: string;
            readonly progress?: components["schemas"]["WorkProgress"] | null;
            /** @description The plane to which θr and the azimuth refer. */
            readonly reference_plane?: components["schemas"]["FitReferencePlane"];
            /** @description Region of the part. */
            readonly region?: string | null;
            readonly request: components["schemas"]["VerdictRequest"];
            /**
             * Format: int64
             * @description Number of the part of that scan.
             */
            readonly sample_id?: number | null;
            /** @description Name of that part. */
            readonly sample_name?: string | null;
            /**
             * Format: int64
             * @description Number of its scan; null without one.
             */
            readonly scan_id?: number | null;
            /** @description Name of the specification. */
            readonly specification?: string;
            /** @description State of the job. */
            readonly state: components["schemas"]["TaskState"];
            /** @description How the fit ended. */
            readonly status?: components["schemas"]["FitStatus"];
            /** @description Seconds of reading, reducing and fitting. */
            readonly timing_s?: components["schemas"]["FitTiming"];
            /** @description Variant of the model. */
            readonly variant?: components["schemas"]["FitVariantName"];
            /** @description Fails if one item fails, passes if all pass. */
            readonly verdict?: components["schemas"]["VerdictWord"];
            /** @description Sentences for the user, including the warnings of the fit. */
            readonly warnings?: readonly string[];
            /** @description Who started it: the name of a token, or `local`. */
            readonly who: string;
            /** @description What would decide the items that are not decided, by quantity. */
            readonly would_decide?: {
                readonly [key: string]: components["schemas"]["WouldDecide"];
            };
        };
        /** @description A request for a verdict. */
        readonly VerdictRequest: {
            /**
             * Format: int64
             * @description Completed fit of the scan that the verdict rests on, instead of a new one. It states variant, region and options.
             */
            readonly fit_id?: number | null;
            /**
             * Format: double
             * @description Time limit of the fit, s (see [`FitRequest`]).
             */
            readonly max_seconds?: number | null;
            /** @description Region of a part that has several. */
            readonly region?: string | null;
            /**
             * Format: int64
             * @description Scan to judge.
             */
            readonly scan_id: number;
            /** @description The specification: name, limits by quantity, accepted risks; or the name or number of a stored one. */
            readonly specification: components["schemas"]["StatedSpecification"];
            /**
             * Format: double
             * @description Stop the ray tracer once its standard error, as a share of the largest radiance, is below this.
             */
            readonly target_error?: number | null;
            /**
             * Format: double
             * @description Largest share of the peak that the model may neglect.
             */
            readonly tolerance?: number | null;
            /** @description Variant that the verdict rests on; by default the better one. */
            readonly variant?: components["schemas"]["VariantChoice"];
        };
        /** @description A judgement and the fit that it is based on. */
        readonly VerdictResult: components["schemas"]["Judgement"] & {
            /** @description Tilts over which the contrasts are averaged, degrees; null where no contrast is limited. */
            readonly contrast_theta_c_deg?: readonly number[] | null;
            /** @description Effects that the fit omits, why, and their possible effect on the result. */
            readonly left_out?: readonly components["schemas"]["WorkLeftOut"][];
            /** @description Name and version of the program. */
            readonly program: string;
            /** @description The plane to which θr and the azimuth refer. */
            readonly reference_plane?: components["schemas"]["FitReferencePlane"];
            /** @description Region of the part. */
            readonly region?: string | null;
            /** @description How the fit ended. */
            readonly status: components["schemas"]["FitStatus"];
            /** @description Seconds of reading, reducing and fitting. */
            readonly timing_s?: components["schemas"]["FitTiming"];
            /** @description Variant of the model. */
            readonly variant: components["schemas"]["FitVariantName"];
        };
        /**
         * @description The result for one limit, or for all of them.
         * @enum {string}
         */
        readonly VerdictWord: "pass" | "fail" | "cannot-tell";
        /** @description A change of the measurement that suffices by itself. */
        readonly WayToDecide: {
            /** @enum {string} */
            readonly change: "repeats";
            /**
             * Format: int32
             * @description Times as many frames per pose, a whole number.
             */
            readonly factor: number;
        } | {
            /** @enum {string} */
            readonly change: "poses";
            /**
             * Format: int32
             * @description Poses in addition to the present ones.
             */
            readonly more: number;
            /**
             * Format: int32
             * @description Poses in all.
             */
            readonly total: number;
        } | {
            /** @enum {string} */
            readonly change: "reference";
            /**
             * Format: double
             * @description The present one.
             */
            readonly reflectance_rel_std: number;
            /**
             * Format: double
             * @description Largest relative standard uncertainty of its reflectance.
             */
            readonly reflectance_rel_std_max: number;
        } | {
            /** @enum {string} */
            readonly change: "line";
            /** @description Name of the line. */
            readonly line: string;
            /**
             * Format: double
             * @description Share of its present size that it may have.
             */
            readonly share_max: number;
        };
        /** @description What happened, by `type`. */
        readonly WhatHappened: {
            /** @description Activity of the rig. */
            readonly activity: components["schemas"]["RigActivity"];
            /** @description Its axes. */
            readonly axes: components["schemas"]["EventAxes"];
            /** @enum {string} */
            readonly type: "rig";
        } | {
            readonly operator?: components["schemas"]["OperatorBody"] | null;
            /** @description State before. */
            readonly previous: components["schemas"]["ScanState"];
            /** @description Progress of the scan. */
            readonly progress: components["schemas"]["ProgressBody"];
            /** @description Reason for the state, if it is not the normal course. */
            readonly reason?: string | null;
            /**
             * Format: int64
             * @description Number of the scan.
             */
            readonly scan_id: number;
            /** @description State now. */
            readonly state: components["schemas"]["ScanState"];
            /** @enum {string} */
            readonly type: "scan";
        } | {
            /** @description Whether the point counts. A rejected frame is kept as well. */
            readonly accepted: boolean;
            /**
             * Format: double
             * @description Exposure time, s.
             */
            readonly exposure_s: number;
            /**
             * Format: int64
             * @description Number of the frame.
             */
            readonly frame_id: number;
            /** @description Path of its image. */
            readonly image: string;
            /** @description What it shows. */
            readonly kind: components["schemas"]["FrameKind"];
            /**
             * Format: int32
             * @description Largest count, DN.
             */
            readonly max_dn: number;
            /**
             * Format: double
             * @description Mean of all counts, DN.
             */
            readonly mean_dn: number;
            /**
             * Format: double
             * @description Sample azimuth φs read back, degrees.
             */
            readonly phi_s_deg: number;
            /** @description Progress of the scan. */
            readonly progress: components["schemas"]["ProgressBody"];
            /** @description Why it does not count. */
            readonly reason?: string | null;
            /**
             * Format: int32
             * @description Number of the repeat, from 0.
             */
            readonly repeat: number;
            /**
             * Format: int32
             * @description Pixels at or above the saturation level.
             */
            readonly saturated_px: number;
            /**
             * Format: int64
             * @description Number of the scan.
             */
            readonly scan_id: number;
            /**
             * Format: double
             * @description Camera tilt θc read back, degrees.
             */
            readonly theta_c_deg: number;
            /** @enum {string} */
            readonly type: "frame";
        } | {
            /**
             * Format: int64
             * @description Number of the fit.
             */
            readonly fit_id: number;
            /**
             * Format: int64
             * @description Scan that it reads.
             */
            readonly scan_id?: number | null;
            /** @description State of the fit. */
            readonly state: components["schemas"]["TaskState"];
            /** @description How the fit ended. */
            readonly status?: string | null;
            readonly theta_r_deg?: components["schemas"]["ShortValue"] | null;
            /** @enum {string} */
            readonly type: "fit";
            /** @description Chosen variant; the requested one until it is chosen. */
            readonly variant?: string | null;
        } | {
            /**
             * Format: double
             * @description Time spent moving and exposing until the newest of its frames, s; without the time that it waited for people.
             */
            readonly elapsed_s: number;
            /**
             * Format: int32
             * @description Frames used, dark and white-reference frames included.
             */
            readonly n_frames_used: number;
            /** @description Poses fitted. */
            readonly n_observations: number;
            /** @description Parameters that the frames so far determine, by name. */
            readonly parameters: {
                readonly [key: string]: components["schemas"]["UncertainValue"];
            };
            /**
             * Format: int64
             * @description Number of the scan.
             */
            readonly scan_id: number;
            /** @description How the fit ended. */
            readonly status: string;
            /** @enum {string} */
            readonly type: "uncertainty";
            /** @description Variant of the fit. */
            readonly variant: string;
        } | {
            /**
             * Format: int64
             * @description Its number within the kind.
             */
            readonly calculation_id: number;
            /** @description Kind of the calculation. */
            readonly kind: components["schemas"]["JobKind"];
            /**
             * Format: int64
             * @description Scan that it reads.
             */
            readonly scan_id?: number | null;
            /** @description State of the calculation. */
            readonly state: components["schemas"]["TaskState"];
            /** @enum {string} */
            readonly type: "calculation";
        } | {
            /** @description The forecast. */
            readonly forecast: components["schemas"]["Forecast"];
            /**
             * Format: int64
             * @description Its number within the kind.
             */
            readonly number: number;
            /** @description Kind of the calculation. */
            readonly of: string;
            /**
             * Format: int64
             * @description Scan that it reads.
             */
            readonly scan_id?: number | null;
            /** @enum {string} */
            readonly type: "forecast";
        } | {
            /** @description Whether a person resumed the scan in between. */
            readonly attended: boolean;
            /** @description Stable word of the fault, as in its alarm. */
            readonly code: string;
            /** @description What happened, and what ended it. */
            readonly message: string;
            /** @description Points of the plan that were taken again, by their index. */
            readonly points: readonly number[];
            /**
             * Format: int64
             * @description Scan concerned.
             */
            readonly scan_id?: number | null;
            /**
             * Format: double
             * @description Time from the fault to the first point that counted again, s.
             */
            readonly took_s: number;
            /** @enum {string} */
            readonly type: "recovered";
        } | {
            /** @description The order: pause, resume, abort, continue, or a change of the lease. */
            readonly order: string;
            /**
             * Format: int64
             * @description Scan concerned.
             */
            readonly scan_id?: number | null;
            /** @enum {string} */
            readonly type: "order";
        } | {
            /** @description Stable word of the fault. */
            readonly code: string;
            /** @description What happened and what to do. */
            readonly message: string;
            /**
             * Format: int64
             * @description Scan concerned.
             */
            readonly scan_id?: number | null;
            /** @enum {string} */
            readonly type: "alarm";
        };
        /** @description Something that a computation omits. */
        readonly WorkLeftOut: {
            /**
             * Format: double
             * @description The error that it may cause, as a share of the result (of the peak, if that is a radiance); null if unknown.
             */
            readonly cost?: number | null;
            /** @description The omission. */
            readonly what: string;
            /** @description The reason. */
            readonly why: string;
        };
        /** @description A snapshot of a job's progress. */
        readonly WorkProgress: {
            /**
             * Format: double
             * @description Seconds since the job got its slot, or since it was requested while it waits for one.
             */
            readonly elapsed_s: number;
            /**
             * Format: double
             * @description Completed share of this stage, 0 to 1.
             */
            readonly fraction: number;
            /** @description Position in the queue, 1 for the next job to start; only while the job waits for a slot. */
            readonly queued_position?: number | null;
            /** @description Current stage. */
            readonly stage: string;
            /**
             * Format: double
             * @description Seconds left of this stage at its pace so far; for a stage without a known fraction, seconds left of the
             *     forecast. None before there is a pace, and once the job takes longer than forecast.
             */
            readonly time_left_s?: number | null;
        };
        /** @description What would decide an item. */
        readonly WouldDecide: {
            /** @description The same as sentences. */
            readonly message: string;
            /**
             * Format: double
             * @description Largest standard uncertainty that gives it, in the unit of the value.
             */
            readonly std_max: number;
            /** @description The verdict at the present value once the uncertainty is small enough. */
            readonly verdict: components["schemas"]["VerdictWord"];
            /** @description Changes that suffice, each by itself. */
            readonly ways: readonly components["schemas"]["WayToDecide"][];
        };
    };
    responses: never;
    parameters: never;
    requestBodies: never;
    headers: never;
    pathItems: never;
}
export type AcceptStagesBody = components['schemas']['AcceptStagesBody'];
export type AccuracyPoint = components['schemas']['AccuracyPoint'];
export type AccuracyReport = components['schemas']['AccuracyReport'];
export type Activity = components['schemas']['Activity'];
export type AreaBody = components['schemas']['AreaBody'];
export type AxesBody = components['schemas']['AxesBody'];
export type AxisBody = components['schemas']['AxisBody'];
export type AxisEvent = components['schemas']['AxisEvent'];
export type Begun = components['schemas']['Begun'];
export type Binary = components['schemas']['Binary'];
export type BirdColumn = components['schemas']['BirdColumn'];
export type BirdFile = components['schemas']['BirdFile'];
export type CalibrationBody = components['schemas']['CalibrationBody'];
export type CameraBody = components['schemas']['CameraBody'];
export type CameraFacts = components['schemas']['CameraFacts'];
export type CertaintyBody = components['schemas']['CertaintyBody'];
export type ChartPoint = components['schemas']['ChartPoint'];
export type ChartRun = components['schemas']['ChartRun'];
export type ChartedResult = components['schemas']['ChartedResult'];
export type ChartedSpecification = components['schemas']['ChartedSpecification'];
export type ComparedLine = components['schemas']['ComparedLine'];
export type ComparedParameter = components['schemas']['ComparedParameter'];
export type ComparedValue = components['schemas']['ComparedValue'];
export type Comparison = components['schemas']['Comparison'];
export type ContinueBody = components['schemas']['ContinueBody'];
export type Contrast = components['schemas']['Contrast'];
export type ContrastByPair = components['schemas']['ContrastByPair'];
export type ContrastRequest = components['schemas']['ContrastRequest'];
export type ControlChart = components['schemas']['ControlChart'];
export type ControlLimits = components['schemas']['ControlLimits'];
export type ControllerBody = components['schemas']['ControllerBody'];
export type ConvergenceRate = components['schemas']['ConvergenceRate'];
export type CurrentOrder = components['schemas']['CurrentOrder'];
export type CurveBody = components['schemas']['CurveBody'];
export type CurvesBody = components['schemas']['CurvesBody'];
export type DamagedBody = components['schemas']['DamagedBody'];
export type DarkPlan = components['schemas']['DarkPlan'];
export type DarkRequest = components['schemas']['DarkRequest'];
export type Decision = components['schemas']['Decision'];
export type DecisionRule = components['schemas']['DecisionRule'];
export type DefinitionName = components['schemas']['DefinitionName'];
export type DefinitionRef = components['schemas']['DefinitionRef'];
export type Difference = components['schemas']['Difference'];
export type Due = components['schemas']['Due'];
export type DueBody = components['schemas']['DueBody'];
export type DueKind = components['schemas']['DueKind'];
export type Earlier = components['schemas']['Earlier'];
export type EarlierName = components['schemas']['EarlierName'];
export type EarlierSample = components['schemas']['EarlierSample'];
export type EstimateBody = components['schemas']['EstimateBody'];
export type Event = components['schemas']['Event'];
export type EventAxes = components['schemas']['EventAxes'];
export type FieldProblem = components['schemas']['FieldProblem'];
export type FileContent = components['schemas']['FileContent'];
export type FileFingerprint = components['schemas']['FileFingerprint'];
export type Fit = components['schemas']['Fit'];
export type FitAcross = components['schemas']['FitAcross'];
export type FitCovariance = components['schemas']['FitCovariance'];
export type FitError = components['schemas']['FitError'];
export type FitFinding = components['schemas']['FitFinding'];
export type FitFindingCode = components['schemas']['FitFindingCode'];
export type FitFreedom = components['schemas']['FitFreedom'];
export type FitInterval = components['schemas']['FitInterval'];
export type FitIteration = components['schemas']['FitIteration'];
export type FitParameter = components['schemas']['FitParameter'];
export type FitParameters = components['schemas']['FitParameters'];
export type FitReferencePlane = components['schemas']['FitReferencePlane'];
export type FitReport = components['schemas']['FitReport'];
export type FitRequest = components['schemas']['FitRequest'];
export type FitSlopes = components['schemas']['FitSlopes'];
export type FitStarts = components['schemas']['FitStarts'];
export type FitStatus = components['schemas']['FitStatus'];
export type FitTiming = components['schemas']['FitTiming'];
export type FitTracer = components['schemas']['FitTracer'];
export type FitTracerEnd = components['schemas']['FitTracerEnd'];
export type FitVariant = components['schemas']['FitVariant'];
export type FitVariantName = components['schemas']['FitVariantName'];
export type FittedPoint = components['schemas']['FittedPoint'];
export type FlatFacts = components['schemas']['FlatFacts'];
export type FlatPlan = components['schemas']['FlatPlan'];
export type FlatRequest = components['schemas']['FlatRequest'];
export type Forecast = components['schemas']['Forecast'];
export type ForecastAmount = components['schemas']['ForecastAmount'];
export type ForecastAtLimit = components['schemas']['ForecastAtLimit'];
export type ForecastError = components['schemas']['ForecastError'];
export type ForecastOutcome = components['schemas']['ForecastOutcome'];
export type ForecastPart = components['schemas']['ForecastPart'];
export type FrameBody = components['schemas']['FrameBody'];
export type FrameHash = components['schemas']['FrameHash'];
export type FrameHashes = components['schemas']['FrameHashes'];
export type FrameKind = components['schemas']['FrameKind'];
export type FrameRejected = components['schemas']['FrameRejected'];
export type Gauge = components['schemas']['Gauge'];
export type GaugeDesign = components['schemas']['GaugeDesign'];
export type GaugeNumber = components['schemas']['GaugeNumber'];
export type GaugeSpread = components['schemas']['GaugeSpread'];
export type GeometryBody = components['schemas']['GeometryBody'];
export type Grid = components['schemas']['Grid'];
export type GroupedBy = components['schemas']['GroupedBy'];
export type GuardBasis = components['schemas']['GuardBasis'];
export type HistogramBody = components['schemas']['HistogramBody'];
export type HolderBody = components['schemas']['HolderBody'];
export type ImportBody = components['schemas']['ImportBody'];
export type ImportRequest = components['schemas']['ImportRequest'];
export type IncidentBody = components['schemas']['IncidentBody'];
export type IncidentKind = components['schemas']['IncidentKind'];
export type JobKind = components['schemas']['JobKind'];
export type JogAnswer = components['schemas']['JogAnswer'];
export type JogBody = components['schemas']['JogBody'];
export type JudgedItem = components['schemas']['JudgedItem'];
export type Judgement = components['schemas']['Judgement'];
export type LeaseBody = components['schemas']['LeaseBody'];
export type LeaseRequest = components['schemas']['LeaseRequest'];
export type LeaseStateBody = components['schemas']['LeaseStateBody'];
export type LeftOutScan = components['schemas']['LeftOutScan'];
export type ListCalibrationBody = components['schemas']['List_CalibrationBody'];
export type ListCertaintyBody = components['schemas']['List_CertaintyBody'];
export type ListContrast = components['schemas']['List_Contrast'];
export type ListFit = components['schemas']['List_Fit'];
export type ListFrameBody = components['schemas']['List_FrameBody'];
export type ListIncidentBody = components['schemas']['List_IncidentBody'];
export type ListMap = components['schemas']['List_Map'];
export type ListOrderBody = components['schemas']['List_OrderBody'];
export type ListRecipeBody = components['schemas']['List_RecipeBody'];
export type ListRecordChange = components['schemas']['List_RecordChange'];
export type ListSampleBody = components['schemas']['List_SampleBody'];
export type ListScanBody = components['schemas']['List_ScanBody'];
export type ListSpecificationBody = components['schemas']['List_SpecificationBody'];
export type ListTrace = components['schemas']['List_Trace'];
export type ListVerdict = components['schemas']['List_Verdict'];
export type LoginRequest = components['schemas']['LoginRequest'];
export type Loss = components['schemas']['Loss'];
export type Map = components['schemas']['Map'];
export type MapDefect = components['schemas']['MapDefect'];
export type MapDeviation = components['schemas']['MapDeviation'];
export type MapLean = components['schemas']['MapLean'];
export type MapRequest = components['schemas']['MapRequest'];
export type MapResult = components['schemas']['MapResult'];
export type MapShared = components['schemas']['MapShared'];
export type MapSpread = components['schemas']['MapSpread'];
export type MapTiming = components['schemas']['MapTiming'];
export type Material = components['schemas']['Material'];
export type MaterialBody = components['schemas']['MaterialBody'];
export type MeanAtRidge = components['schemas']['MeanAtRidge'];
export type MeanAtTilt = components['schemas']['MeanAtTilt'];
export type MeanOfAll = components['schemas']['MeanOfAll'];
export type MeanOfPair = components['schemas']['MeanOfPair'];
export type MeasuredPart = components['schemas']['MeasuredPart'];
export type MeasuredScan = components['schemas']['MeasuredScan'];
export type MeasurementReport = components['schemas']['MeasurementReport'];
export type Measurements = components['schemas']['Measurements'];
export type MeasuringRig = components['schemas']['MeasuringRig'];
export type MetalBody = components['schemas']['MetalBody'];
export type MonteCarloEstimate = components['schemas']['MonteCarloEstimate'];
export type MotionBody = components['schemas']['MotionBody'];
export type MotionProblem = components['schemas']['MotionProblem'];
export type MotionState = components['schemas']['MotionState'];
export type MoveBody = components['schemas']['MoveBody'];
export type MoveRequest = components['schemas']['MoveRequest'];
export type MoveRigBody = components['schemas']['MoveRigBody'];
export type NameOrId = components['schemas']['NameOrId'];
export type ObservationBody = components['schemas']['ObservationBody'];
export type ObservationsBody = components['schemas']['ObservationsBody'];
export type OnFailure = components['schemas']['OnFailure'];
export type OperatorAction = components['schemas']['OperatorAction'];
export type OperatorBody = components['schemas']['OperatorBody'];
export type OrderBody = components['schemas']['OrderBody'];
export type OrderCounts = components['schemas']['OrderCounts'];
export type OrderRequest = components['schemas']['OrderRequest'];
export type OrderState = components['schemas']['OrderState'];
export type OrdersRequest = components['schemas']['OrdersRequest'];
export type OutOfRange = components['schemas']['OutOfRange'];
export type Phase = components['schemas']['Phase'];
export type PictureBody = components['schemas']['PictureBody'];
export type Pitch = components['schemas']['Pitch'];
export type Plan = components['schemas']['Plan'];
export type PlanCheck = components['schemas']['PlanCheck'];
export type PlanPart = components['schemas']['PlanPart'];
export type PlanPose = components['schemas']['PlanPose'];
export type PlanRequest = components['schemas']['PlanRequest'];
export type PointBody = components['schemas']['PointBody'];
export type Preset = components['schemas']['Preset'];
export type PreviewAnswer = components['schemas']['PreviewAnswer'];
export type PreviewBody = components['schemas']['PreviewBody'];
export type PreviewFrameBody = components['schemas']['PreviewFrameBody'];
export type Prior = components['schemas']['Prior'];
export type Problem = components['schemas']['Problem'];
export type ProgressBody = components['schemas']['ProgressBody'];
export type QueueBody = components['schemas']['QueueBody'];
export type QueueState = components['schemas']['QueueState'];
export type RadianceByAzimuth = components['schemas']['RadianceByAzimuth'];
export type ReadyBody = components['schemas']['ReadyBody'];
export type Recipe = components['schemas']['Recipe'];
export type RecipeBody = components['schemas']['RecipeBody'];
export type RecipeChange = components['schemas']['RecipeChange'];
export type RecipeFit = components['schemas']['RecipeFit'];
export type RecipeLayout = components['schemas']['RecipeLayout'];
export type RecipeMaterial = components['schemas']['RecipeMaterial'];
export type RecordChange = components['schemas']['RecordChange'];
export type RenameBody = components['schemas']['RenameBody'];
export type Repeatability = components['schemas']['Repeatability'];
export type ReportedContrast = components['schemas']['ReportedContrast'];
export type ReportedFindings = components['schemas']['ReportedFindings'];
export type ReportedFit = components['schemas']['ReportedFit'];
export type ReportedLine = components['schemas']['ReportedLine'];
export type ReportedMeans = components['schemas']['ReportedMeans'];
export type ReportedObservation = components['schemas']['ReportedObservation'];
export type ReportedTable = components['schemas']['ReportedTable'];
export type ReportedVerdict = components['schemas']['ReportedVerdict'];
export type Result = components['schemas']['Result'];
export type ResultChart = components['schemas']['ResultChart'];
export type ResultOf = components['schemas']['ResultOf'];
export type ResultsBodyResult = components['schemas']['ResultsBody_Result'];
export type RidgeAngle = components['schemas']['RidgeAngle'];
export type RidgeFacts = components['schemas']['RidgeFacts'];
export type RigActivity = components['schemas']['RigActivity'];
export type RigBody = components['schemas']['RigBody'];
export type RigFacts = components['schemas']['RigFacts'];
export type RigProblem = components['schemas']['RigProblem'];
export type Role = components['schemas']['Role'];
export type SampleBody = components['schemas']['SampleBody'];
export type SampleRequest = components['schemas']['SampleRequest'];
export type ScanBody = components['schemas']['ScanBody'];
export type ScanCameraBody = components['schemas']['ScanCameraBody'];
export type ScanOrigin = components['schemas']['ScanOrigin'];
export type ScanPatch = components['schemas']['ScanPatch'];
export type ScanRecord = components['schemas']['ScanRecord'];
export type ScanRequest = components['schemas']['ScanRequest'];
export type ScanState = components['schemas']['ScanState'];
export type Scatter = components['schemas']['Scatter'];
export type ScatterVerdict = components['schemas']['ScatterVerdict'];
export type SessionBody = components['schemas']['SessionBody'];
export type ShapeFile = components['schemas']['ShapeFile'];
export type SharedLine = components['schemas']['SharedLine'];
export type ShortValue = components['schemas']['ShortValue'];
export type SimulatedSurface = components['schemas']['SimulatedSurface'];
export type Specification = components['schemas']['Specification'];
export type SpecificationBody = components['schemas']['SpecificationBody'];
export type SpecificationChange = components['schemas']['SpecificationChange'];
export type StageController = components['schemas']['StageController'];
export type StagesBody = components['schemas']['StagesBody'];
export type StatedSpecification = components['schemas']['StatedSpecification'];
export type StrayLight = components['schemas']['StrayLight'];
export type StudiedResult = components['schemas']['StudiedResult'];
export type SuggestionBody = components['schemas']['SuggestionBody'];
export type TagBody = components['schemas']['TagBody'];
export type TaskState = components['schemas']['TaskState'];
export type ToleranceLimits = components['schemas']['ToleranceLimits'];
export type Trace = components['schemas']['Trace'];
export type TraceBetween = components['schemas']['TraceBetween'];
export type TraceEnergy = components['schemas']['TraceEnergy'];
export type TracePlane = components['schemas']['TracePlane'];
export type TraceRequest = components['schemas']['TraceRequest'];
export type TraceSurfaces = components['schemas']['TraceSurfaces'];
export type UncertainBody = components['schemas']['UncertainBody'];
export type UncertainValue = components['schemas']['UncertainValue'];
export type UsedCalibration = components['schemas']['UsedCalibration'];
export type UsedDefinition = components['schemas']['UsedDefinition'];
export type Values = components['schemas']['Values'];
export type VarianceRow = components['schemas']['VarianceRow'];
export type VarianceSource = components['schemas']['VarianceSource'];
export type VariantChoice = components['schemas']['VariantChoice'];
export type Verdict = components['schemas']['Verdict'];
export type VerdictRequest = components['schemas']['VerdictRequest'];
export type VerdictResult = components['schemas']['VerdictResult'];
export type VerdictWord = components['schemas']['VerdictWord'];
export type WayToDecide = components['schemas']['WayToDecide'];
export type WhatHappened = components['schemas']['WhatHappened'];
export type WorkLeftOut = components['schemas']['WorkLeftOut'];
export type WorkProgress = components['schemas']['WorkProgress'];
export type WouldDecide = components['schemas']['WouldDecide'];
export type $defs = Record<string, never>;
export type operations = Record<string, never>;
