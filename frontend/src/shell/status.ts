import { byId, setAttribute, setData, setHidden, setText } from "../dom";
import { bytes, duration, fixed, inOneLine, NO_VALUE } from "../format";
import type { Model } from "../live/model";
import { pageAlarm, type ShownAlarm } from "./alarms";
import type { ToolInfo, ToolKind } from "../wire";

const KIND: Record<ToolKind, string> = { simulated: "SIMULATED", nidaq: "REAL TOOL", serial: "NO MOTOR", recording: "NO TOOL" };
/** Weight of the old mean at each frame: averages over about one second at 30 frames a second. */
const MEAN_WEIGHT = 0.97;
const LOW_DISK_BYTES = 1e9;
/** Time that a page which has just been opened may take to connect before it says so. */
export const QUIET_START_MS = 2_000;

/** Shows which tool this is, and the rates and delays on the way from a sample to the screen. */
export class StatusStrip {
  private toScreenMs = NaN;

  constructor(private readonly model: Model) {}

  render(): void {
    const { state } = this.model;
    const hello = state && this.model.hello; // both, because the state says whether it is a demonstration
    setData(byId("tool"), "kind", hello?.tool.kind ?? "none");
    setText(byId("tool-kind"), hello ? `${this.kindOf(hello.tool)}${state.demo ? " · DEMO" : ""}` : this.notConnected("NOT CONNECTED"));
    setText(byId("tool-title"), this.titleInWords());
    setHidden(byId("demo"), !state?.demo);
    setText(byId("demo"), state?.demo ? `Demonstration: ${state.demo}` : "");
    const live = this.model.connected && state !== null; // without a connection the last state is out of date
    setText(byId("status-rate"), live ? fixed(state.rate_hz, 0, "Hz") : NO_VALUE);
    setText(byId("status-lost"), state ? String(state.lost_samples) : NO_VALUE);
    setData(byId("status-lost"), "warn", String((state?.lost_samples ?? 0) > 0));
    setText(byId("status-estimator"), live ? fixed(state.estimator_latency_ms, 1, "ms") : NO_VALUE);
    setText(byId("status-screen"), live ? fixed(this.toScreenMs, 0, "ms") : NO_VALUE);
    const dropped = this.model.samplesMissed;
    setText(byId("status-dropped"), String(dropped));
    setData(byId("status-dropped"), "warn", String(dropped > 0));
    this.renderRecording();
    const free = state?.free_disk_bytes ?? null;
    setText(byId("status-disk"), free === null ? NO_VALUE : bytes(free));
    setData(byId("status-disk"), "warn", String(free !== null && free < LOW_DISK_BYTES));
    setText(byId("status-viewers"), state ? String(state.viewers) : NO_VALUE);
    this.renderNews(state?.faults ?? []);
  }

  /** Shows whether a recording is being written and for how long, or why not. */
  private renderRecording(): void {
    const recording = this.model.state?.recording;
    const rateHz = this.model.hello?.tool.sample_rate_hz ?? NaN;
    const words = (): string => {
      if (!recording?.enabled) return "off";
      if (recording.file !== null) return `● ${duration((recording.samples / rateHz) * 1000)}`;
      return recording.problem === null ? "ready" : "stopped";
    };
    setText(byId("status-recording"), words());
    setData(byId("status-recording"), "warn", String((recording?.problem ?? null) !== null));
    setAttribute(byId("status-recording"), "title", recording?.problem ?? recording?.file ?? "");
  }

  private kindOf({ kind, has_motor: hasMotor }: ToolInfo): string {
    return kind === "nidaq" && !hasMotor ? KIND.serial : KIND[kind];
  }

  /** Returns the words once the page has waited for long enough that they are worth a look. */
  private readonly notConnected = (words: string): string => (performance.now() < QUIET_START_MS ? "" : words);

  private titleInWords(): string {
    const { hello, state } = this.model;
    if (!hello || !state) return this.notConnected("waiting for the server");
    if (this.model.hasNoTool) return "this service only shows recordings";
    return hello.tool.title;
  }

  /** Shows the faults or, if there are none, the last event. */
  private renderNews(faults: string[]): void {
    const news = faults.length > 0 ? inOneLine(faults) : this.model.lastEvent;
    setHidden(byId("status-news"), news === null);
    setText(byId("status-news-kind"), faults.length > 0 ? "Fault" : "Latest");
    setText(byId("status-event"), news ?? "");
    setData(byId("status-event"), "warn", String(faults.length > 0));
  }

  /** Records the delay of a drawn frame. `newestMs` is the time of its newest sample on the server's clock. */
  onDrawn(newestMs: number, nowMs: number): void {
    const latency = Math.max(0, nowMs - this.model.clock.toPage(newestMs));
    if (!Number.isFinite(latency)) return;
    this.toScreenMs = Number.isFinite(this.toScreenMs)
      ? MEAN_WEIGHT * this.toScreenMs + (1 - MEAN_WEIGHT) * latency
      : latency;
  }

  alarms(): ShownAlarm[] {
    if (!this.model.wrongVersion) return [];
    const text = "This page is older or newer than the server: reload it";
    return [pageAlarm("page:version", "high", text, NaN)];
  }
}
