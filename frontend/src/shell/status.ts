import { byId, setData, setHidden, setText } from "../dom";
import { fixed, NO_VALUE } from "../format";
import type { Model } from "../live/model";
import type { ShownAlarm } from "./alarms";
import type { ToolKind } from "../wire";

const KIND: Record<ToolKind, string> = { simulated: "SIMULATED", nidaq: "REAL TOOL", recording: "REPLAY" };
/** Share of the old mean that stays at each frame: about one second at 30 frames a second. */
const MEAN_KEEPS = 0.97;

/** Which tool this is, and how well the chain from sample to screen runs. */
export class StatusStrip {
  private toScreenMs = NaN;

  constructor(private readonly model: Model) {}

  render(): void {
    const { hello, state } = this.model;
    setData(byId("tool"), "kind", hello?.tool.kind ?? "none");
    setText(byId("tool-kind"), hello ? `${KIND[hello.tool.kind]}${state?.demo ? " · DEMO" : ""}` : "NOT CONNECTED");
    setText(byId("tool-title"), hello ? hello.tool.title : "waiting for the server");
    setText(byId("status-rate"), fixed(state?.rate_hz, 0, "Hz"));
    setText(byId("status-lost"), state ? String(state.lost_samples) : NO_VALUE);
    setData(byId("status-lost"), "warn", String((state?.lost_samples ?? 0) > 0));
    setText(byId("status-estimator"), fixed(state?.estimator_latency_ms, 1, "ms"));
    setText(byId("status-screen"), fixed(this.toScreenMs, 0, "ms"));
    setText(byId("status-viewers"), state ? String(state.viewers) : NO_VALUE);
    this.renderNews(state?.faults ?? []);
  }

  /** What is at fault, or else the last thing that happened. */
  private renderNews(faults: string[]): void {
    const news = faults.length > 0 ? faults.join("; ") : this.model.lastEvent;
    setHidden(byId("status-news"), news === null);
    setText(byId("status-news-kind"), faults.length > 0 ? "Fault" : "Latest");
    setText(byId("status-event"), news ?? "");
    setData(byId("status-event"), "warn", String(faults.length > 0));
  }

  /** A frame has just been drawn whose newest sample was taken at `newestMs` by the server's clock. */
  drawn(newestMs: number, nowMs: number): void {
    const latency = Math.max(0, nowMs - this.model.clock.toPage(newestMs));
    if (!Number.isFinite(latency)) return;
    this.toScreenMs = Number.isFinite(this.toScreenMs)
      ? MEAN_KEEPS * this.toScreenMs + (1 - MEAN_KEEPS) * latency
      : latency;
  }

  alarms(): ShownAlarm[] {
    if (!this.model.wrongVersion) return [];
    const text = "This page is older or newer than the server: reload it";
    return [{ id: "page:version", priority: "high", text, beganAt: NaN }];
  }
}
