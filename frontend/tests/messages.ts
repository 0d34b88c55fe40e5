import type { Frame } from "../src/live/frame";
import { SCHEMA_VERSION } from "../src/wire";
import type { Alarm, GraspEnded, Hello, Identification, State, TissueInfo } from "../src/wire";

export const tissue = (name: string, title: string, values: Partial<TissueInfo> = {}): TissueInfo => ({
  name,
  title,
  alpha_n: 0.2,
  beta_per_m: 300,
  damping_kg_per_s: 5,
  thickness_m: 0.01,
  threshold_n: 8,
  threshold_pa: 1e5,
  spread: { log_alpha: 0.1, log_beta: 0.1, log_damping: 0.1, log_thickness: 0.1 },
  ...values,
});

export const LIVER = tissue("liver", "Liver", { alpha_n: 0.05, threshold_n: 6 });
export const KIDNEY = tissue("kidney", "Kidney", { alpha_n: 2, threshold_n: 9 });

const channel = (name: string, of: string | null = null): Hello["channels"][number] => ({ name, unit: "", tissue: of });

/** The hello message of a tool that samples 100 times a second, with a library of liver and kidney. */
export const hello = (values: Partial<Hello> = {}): Hello => ({
  type: "hello",
  schema_version: SCHEMA_VERSION,
  version: "0",
  server_time_ms: 0,
  tool: {
    name: "tool",
    title: "Tool",
    kind: "simulated",
    has_motor: true,
    sample_rate_hz: 100,
    max_command_v: 5,
    force_ceiling_n: 20,
    force_scale: { law: "eq2", value: 1, low: 1, high: 1, measured: true, source: "", date: null, expires: null, text: "" },
    calibration_date: "",
    calibrated_by: "",
  },
  library: { name: "library", title: "Library", source: "", mass_kg: 0.1, jaw_area_m2: 1e-4, tissues: [LIVER, KIDNEY] },
  holdable: [],
  lowest_threshold_n: 6,
  decide_at: 0.9,
  warning_shares: [0.5, 0.7, 0.9],
  channels: [
    channel("motor_command_v"),
    channel("jaw_force_n"),
    channel("alpha_n", "liver"),
    channel("log_alpha_sd", "liver"),
    channel("probability_unknown"),
  ],
  frame_rate_hz: 30,
  lab_fields: [],
  resumed: null,
  ...values,
});

export const state = (values: Partial<State> = {}): State => ({
  type: "state",
  server_time_ms: 0,
  phase: "idle",
  safety: "disarmed",
  safety_why: null,
  run: null,
  last_run: null,
  limit_n: null,
  simulated_tissue: null,
  demo: null,
  control: null,
  rate_hz: 100,
  lost_samples: 0,
  estimator_latency_ms: null,
  viewers: 1,
  recording: { enabled: false, file: null, samples: 0, missing_blocks: 0, problem: null },
  session: null,
  stated: { held: null, remark: null, by: null, place: null },
  reference: { taken_at: null, stall_v: null, declined: false, wanted: false, problem: null },
  free_disk_bytes: null,
  faults: [],
  event_number: null,
  ...values,
});

export const identification = (values: Partial<Identification> = {}): Identification => ({
  type: "identification",
  server_time_ms: 0,
  tick: 0,
  grasp: 1,
  in_grasp: true,
  in_contact: true,
  label: "liver",
  probability: 0.95,
  probabilities: { liver: 0.95, kidney: 0.05 },
  time_to_decision_s: null,
  force_n: null,
  peak_force_n: null,
  threshold_n: 6,
  threshold_tissue: null,
  limit_n: null,
  holding_back: false,
  time_to_limit_s: null,
  thickness_m: null,
  convergence_s: {},
  force_error_n: {},
  spots: [],
  nis: {},
  dose_n_s: null,
  spot_dose_n_s: null,
  ...values,
});

export const alarm = (values: Partial<Alarm> = {}): Alarm => ({
  type: "alarm",
  number: null,
  id: "force",
  kind: "force",
  priority: "high",
  active: true,
  latched: true,
  text: "Force",
  value: null,
  limit: null,
  unit: null,
  began_ms: 0,
  ended_ms: null,
  acknowledged_by: null,
  change: 0,
  ...values,
});

export const graspEnded = (runId: string | null, index: number): GraspEnded => ({
  type: "grasp",
  number: null,
  run_id: runId,
  grasp: {
    index,
    start_s: 0,
    contact_s: null,
    end_s: 1,
    label: "liver",
    probability: null,
    probabilities: {},
    time_to_decision_s: null,
    alpha_n: null,
    beta_per_m: null,
    damping_kg_per_s: null,
    peak_force_n: null,
    peak_displacement_m: null,
    convergence_s: {},
    force_error_n: {},
    valid: true,
    why_invalid: null,
    alarms: [],
    held_back: false,
    peak_share_of_limit: null,
    dose_n_s: null,
    time_above_s: {},
    log_sd: {},
    nis: {},
  },
});

/** A frame whose columns hold the values from `firstTick` on. */
export const frame = (firstTick: number, columns: number[][], history = false): Frame => ({
  history,
  sequence: 0,
  firstTick,
  rows: columns[0]?.length ?? 0,
  newestMs: 0,
  columns: columns.map((values) => new Float32Array(values)),
});
