import { SCHEMA_VERSION } from "../wire";
import type { Alarm, GraspEnded, GraspTruth, Hello, Identification, Mark, ReplayState, ServerMessage, State, TissueInfo } from "../wire";
import { ServerClock } from "./clock";
import type { Frame } from "./frame";
import { FreshnessWatch } from "./freshness";
import { SampleRing } from "./ring";

/** Length of the ring, s: about 50 MB at the full rate. */
export const HISTORY_S = 300;
const MAX_GRASPS = 200;
/** Safety states in which a run is under way. */
const RUN_STATES: readonly State["safety"][] = ["running", "holding back", "let go"];
const MISSED_EVENTS = "Events were missed while there was no connection: the journal has them.";
/** Motor commands below this are noise of the line, V. */
const COMMAND_ON_V = 0.02;

/** The page's data, as the server last sent them. Cards read the model; only messages change it. */
export class Model {
  hello: Hello | null = null;
  state: State | null = null;
  identification: Identification | null = null;
  ring: SampleRing | null = null;
  replay: ReplayState | null = null;
  connected = false;
  /** Number of samples that never arrived, between those that did. */
  samplesMissed = 0;
  /** Page time at which the last grasp ended; null during a grasp. */
  graspEndedAt: number | null = null;
  /** Time of the newest sample on the server's clock. */
  newestMs = NaN;
  lastEvent: string | null = null;
  /** Grasps of this run, newest first. */
  grasps: GraspEnded[] = [];
  graspsOfRun: string | null = null;
  /** Stated ground truth of this run's grasps, by their index. */
  truths: ReadonlyMap<number, GraspTruth> = new Map();
  /** Marks of this run, newest first. */
  marks: readonly Mark[] = [];
  readonly alarms = new Map<string, Alarm>();
  readonly clock = new ServerClock();
  readonly freshness = new FreshnessWatch(performance.now());

  /** `isReplay`: the data come from a recording, not from the tool. */
  constructor(readonly isReplay = false) {}

  get wrongVersion(): boolean {
    return this.hello !== null && this.hello.schema_version !== SCHEMA_VERSION;
  }

  get isStarting(): boolean {
    return this.connected && this.state?.phase === "starting";
  }

  /** Whether the service only shows recordings. */
  get hasNoTool(): boolean {
    return this.connected && this.state?.phase === "replay";
  }

  /** Whether Graspwatch drives the tool; without a motor it only warns. */
  get hasMotor(): boolean {
    return this.hello?.tool.has_motor ?? true;
  }

  /** Whether state and samples from after `sinceMs` (page time) show that no run and no command moves the motor. */
  standsStillSince(sinceMs: number, nowMs: number): boolean {
    const { state } = this;
    if (!this.connected || state === null || this.freshness.at(nowMs) !== "live") return false;
    const atRest = state.phase === "idle" && state.run === null && !RUN_STATES.includes(state.safety);
    const toldAt = this.clock.toPage(state.server_time_ms);
    const readAt = this.clock.toPage(this.newestMs);
    const noCommand = !this.hasMotor || Math.abs(this.newest("motor_command_v")) < COMMAND_ON_V;
    return atRest && toldAt > sinceMs && readAt > sinceMs && noCommand;
  }

  /** Newest sample that the page has; null before the first. */
  get newestTick(): number | null {
    return this.ring && !this.ring.isEmpty ? this.ring.end - 1 : null;
  }

  get tissues(): TissueInfo[] {
    return this.hello?.library.tissues ?? [];
  }

  /** Newest value of a channel; NaN if there is none. */
  newest(name: string, tissue: string | null = null): number {
    const column = this.column(name, tissue);
    return column < 0 || !this.ring ? NaN : this.ring.newest(column);
  }

  column(name: string, tissue: string | null = null): number {
    return this.hello?.channels.findIndex((channel) => channel.name === name && channel.tissue === tissue) ?? -1;
  }

  titleOf(label: string): string {
    if (label === "unknown") return "Unknown";
    if (label === "undecided") return "Undecided";
    if (label === "no_answer") return "No answer";
    return this.tissues.find((tissue) => tissue.name === label)?.title ?? label;
  }

  onFrame(frame: Frame, nowMs: number): void {
    if (frame.rows === 0) return;
    if (this.ring && !this.ring.isEmpty && !frame.history) this.samplesMissed += Math.max(0, frame.firstTick - this.ring.end);
    this.ring?.write(frame);
    this.newestMs = frame.newestMs;
    this.freshness.frameArrived(nowMs, nowMs - this.clock.toPage(frame.newestMs));
  }

  onMessage(message: ServerMessage, nowMs: number): void {
    if ("server_time_ms" in message && message.type !== "hello") this.clock.addReading(message.server_time_ms, nowMs);
    switch (message.type) {
      case "hello":
        return this.onHello(message, nowMs);
      case "state":
        this.state = message;
        return this.beginRun(message.run?.id ?? message.last_run?.id ?? null);
      case "identification":
        return this.onIdentification(message, nowMs);
      case "grasp":
        return this.onGraspEnded(message);
      case "truth":
        return this.onTruth(message);
      case "mark":
        return this.onMark(message);
      case "lab_session":
        return; // the state has the one under way
      case "alarm":
        if (message.active || message.latched) this.alarms.set(message.id, message);
        else this.alarms.delete(message.id);
        return;
      case "event":
        this.lastEvent = message.text;
        return;
      case "replay_state":
        this.replay = message;
    }
  }

  private onHello(hello: Hello, nowMs: number): void {
    const sameChannels = JSON.stringify(hello.channels) === JSON.stringify(this.hello?.channels);
    if (!sameChannels || !this.ring) {
      this.ring = new SampleRing(hello.channels.length, Math.ceil(hello.tool.sample_rate_hz * HISTORY_S));
    }
    this.hello = hello;
    this.samplesMissed = 0;
    if (this.isReplay) this.grasps = [];
    this.identification = null;
    this.alarms.clear();
    if (hello.resumed === false) this.lastEvent = MISSED_EVENTS;
    this.clock.reset();
    this.clock.addReading(hello.server_time_ms, nowMs);
  }

  private onIdentification(message: Identification, nowMs: number): void {
    if (message.in_grasp) this.graspEndedAt = null;
    else if (this.identification?.in_grasp) this.graspEndedAt = nowMs;
    this.identification = message;
  }

  private beginRun(id: string | null): void {
    if (id === this.graspsOfRun) return;
    this.graspsOfRun = id;
    this.grasps = [];
    this.truths = new Map();
    this.marks = [];
  }

  /** Takes what a person said of a grasp of this run, and of no other one. */
  onTruth(truth: GraspTruth): void {
    if (truth.run_id === this.graspsOfRun) this.truths = new Map(this.truths).set(truth.grasp, truth);
  }

  onMark(mark: Mark): void {
    if (mark.run_id !== this.graspsOfRun) return;
    const others = this.marks.filter(({ id }) => id !== mark.id);
    this.marks = (mark.deleted ? others : [mark, ...others]).toSorted((a, b) => b.at_s - a.at_s);
  }

  /** Adds a grasp. One outside of a run, such as one cut short by STOP, is listed with the run before it. */
  private onGraspEnded(ended: GraspEnded): void {
    if (ended.run_id !== null) this.beginRun(ended.run_id);
    const isSame = (other: GraspEnded): boolean =>
      ended.run_id !== null && other.run_id === ended.run_id && other.grasp.index === ended.grasp.index;
    this.grasps = [ended, ...this.grasps.filter((other) => !isSame(other))].slice(0, MAX_GRASPS);
  }
}
