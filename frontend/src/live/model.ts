import { SCHEMA_VERSION } from "../wire";
import type { Alarm, GraspEnded, Hello, Identification, ReplayState, ServerMessage, State, TissueInfo } from "../wire";
import { ServerClock } from "./clock";
import type { Frame } from "./frame";
import { FreshnessWatch } from "./freshness";
import { SampleRing } from "./ring";

/** What can be looked back over, about 50 MB at the full rate. */
export const RING_S = 300;
const GRASPS_KEPT = 200;
/** States of the tool in which a run is under way. */
const MOVING: readonly State["safety"][] = ["running", "holding back", "let go"];
/** Motor commands below it are noise of the line, V. */
const COMMAND_ON_V = 0.02;

/** Everything the page knows, as the server last told it. Cards read it; only messages change it. */
export class Model {
  hello: Hello | null = null;
  state: State | null = null;
  identification: Identification | null = null;
  ring: SampleRing | null = null;
  replay: ReplayState | null = null;
  connected = false;
  /** Samples between those that came which never did. */
  samplesMissed = 0;
  /** Page time at which the held grasp ended, for "last grasp, 12 s ago"; null while one is held. */
  graspEndedAt: number | null = null;
  /** Newest sample on the server's clock. */
  newestMs = NaN;
  lastEvent: string | null = null;
  /** Newest first. */
  grasps: GraspEnded[] = [];
  graspsOfRun: string | null = null;
  readonly alarms = new Map<string, Alarm>();
  readonly clock = new ServerClock();
  readonly freshness = new FreshnessWatch(performance.now());

  /** `isReplay`: what it shows was once, and nothing of it is live. */
  constructor(readonly isReplay = false) {}

  get wrongVersion(): boolean {
    return this.hello !== null && this.hello.schema_version !== SCHEMA_VERSION;
  }

  get isStarting(): boolean {
    return this.connected && this.state?.phase === "starting";
  }

  /** The service shows recordings only. */
  get hasNoTool(): boolean {
    return this.connected && this.state?.phase === "replay";
  }

  /** The server told, of a moment after `sinceMs` (page time), that nothing moves the motor, and samples come. */
  standsStillSince(sinceMs: number, nowMs: number): boolean {
    const { state } = this;
    if (!this.connected || state === null || this.freshness.at(nowMs) !== "live") return false;
    const atRest = state.phase === "idle" && state.run === null && !MOVING.includes(state.safety);
    const toldAt = this.clock.toPage(state.server_time_ms);
    const readAt = this.clock.toPage(this.newestMs);
    return atRest && toldAt > sinceMs && readAt > sinceMs && Math.abs(this.newest("motor_command_v")) < COMMAND_ON_V;
  }

  get tissues(): TissueInfo[] {
    return this.hello?.library.tissues ?? [];
  }

  /** Newest value of a channel; NaN where there is none. */
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
    return this.tissues.find((tissue) => tissue.name === label)?.title ?? label;
  }

  takeFrame(frame: Frame, nowMs: number): void {
    if (frame.rows === 0) return;
    if (this.ring && !this.ring.isEmpty && !frame.history) this.samplesMissed += Math.max(0, frame.firstTick - this.ring.end);
    this.ring?.write(frame);
    this.newestMs = frame.newestMs;
    this.freshness.frameArrived(nowMs, nowMs - this.clock.toPage(frame.newestMs));
  }

  take(message: ServerMessage, nowMs: number): void {
    if ("server_time_ms" in message && message.type !== "hello") this.clock.heard(message.server_time_ms, nowMs);
    switch (message.type) {
      case "hello":
        return this.takeHello(message, nowMs);
      case "state":
        this.state = message;
        return this.beginRun(message.run?.id ?? message.last_run?.id ?? null);
      case "identification":
        return this.takeIdentification(message, nowMs);
      case "grasp":
        return this.takeGrasp(message);
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

  private takeHello(hello: Hello, nowMs: number): void {
    const sameChannels = JSON.stringify(hello.channels) === JSON.stringify(this.hello?.channels);
    if (!sameChannels || !this.ring) {
      this.ring = new SampleRing(hello.channels.length, Math.ceil(hello.tool.sample_rate_hz * RING_S));
    }
    this.hello = hello;
    this.samplesMissed = 0;
    if (this.isReplay) this.grasps = [];
    this.identification = null;
    this.alarms.clear();
    this.clock.reset();
    this.clock.heard(hello.server_time_ms, nowMs);
  }

  private takeIdentification(message: Identification, nowMs: number): void {
    if (message.in_grasp) this.graspEndedAt = null;
    else if (this.identification?.in_grasp) this.graspEndedAt = nowMs;
    this.identification = message;
  }

  private beginRun(id: string | null): void {
    if (id === this.graspsOfRun) return;
    this.graspsOfRun = id;
    this.grasps = [];
  }

  /** A grasp outside of a run, such as one that a stop cut short, goes with those before it. */
  private takeGrasp(ended: GraspEnded): void {
    if (ended.run_id !== null) this.beginRun(ended.run_id);
    const isSame = (other: GraspEnded): boolean =>
      ended.run_id !== null && other.run_id === ended.run_id && other.grasp.index === ended.grasp.index;
    this.grasps = [ended, ...this.grasps.filter((other) => !isSame(other))].slice(0, GRASPS_KEPT);
  }
}
