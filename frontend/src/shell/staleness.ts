import { byId, setData, setHidden, setText } from "../dom";
import { clockTime, duration } from "../format";
import type { Freshness } from "../live/freshness";
import type { Model } from "../live/model";
import type { ShownAlarm } from "./alarms";

const NOTICE_MS = 15_000;

/** Sees to it that old data are never taken for live ones. */
export class Staleness {
  private readonly ages = [...document.querySelectorAll<HTMLElement>("[data-age]")];
  private noticeUntil = 0;

  constructor(private readonly model: Model) {}

  /** Greys what is old and returns the page's own alarm when the data are gone. */
  render(nowMs: number): ShownAlarm[] {
    const { freshness } = this.model;
    if (this.model.isStarting) freshness.nothingDue(nowMs);
    const state = freshness.at(nowMs);
    const age = freshness.ageMs(nowMs);
    setData(document.body, "freshness", state);
    for (const element of this.ages) setText(element, this.ageText(state, age));
    const banner = byId("stale-banner");
    setHidden(banner, state !== "lost");
    if (state === "lost") setText(banner, this.lostText(nowMs - age, age));
    this.tellBlindTime(nowMs);
    return state === "lost" && !this.replayIsOver ? [this.alarm(nowMs - age)] : [];
  }

  private get replayIsOver(): boolean {
    return this.model.connected && this.model.state?.phase === "ended";
  }

  private ageText(state: Freshness, age: number): string {
    return this.model.freshness.everHadData && (state === "old" || state === "lost") ? `${duration(age)} old` : "";
  }

  private lostText(since: number, age: number): string {
    if (this.replayIsOver) return "The replay is over. What you see is its end, nothing is live.";
    const how = this.model.connected
      ? "The server is connected but sends no samples."
      : "No connection to the server; trying again.";
    const what = this.model.freshness.everHadData ? "No data since" : "No data yet. Waiting since";
    return `${what} ${clockTime(since)} (${duration(age)}). ${how}`;
  }

  private alarm(since: number): ShownAlarm {
    const grasping = this.model.state?.run !== null || this.model.identification?.in_grasp === true;
    return {
      id: "page:no-data",
      priority: this.model.freshness.everHadData && grasping ? "high" : "medium",
      text: this.model.connected ? "No data from the tool" : "No connection to the server",
      beganAt: since,
    };
  }

  private tellBlindTime(nowMs: number): void {
    const blind = this.model.freshness.takeBlindTime();
    const notice = byId("notice");
    if (blind) {
      this.noticeUntil = nowMs + NOTICE_MS;
      setText(notice, `Data are back. This page saw nothing for ${duration(blind.forMs)}, from ${clockTime(blind.from)} on.`);
    }
    setHidden(notice, nowMs > this.noticeUntil || this.model.freshness.at(nowMs) === "lost");
  }
}
