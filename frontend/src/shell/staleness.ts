import { byId, setHidden, setText } from "../dom";
import { clockTime, duration } from "../format";
import type { Model } from "../live/model";
import { pageAlarm, type ShownAlarm } from "./alarms";
import { QUIET_START_MS } from "./status";

const NOTICE_MS = 15_000;

/** Says on every page that no data arrive from the tool and, once they are back, how long they were missing. */
export class StalenessBanner {
  private noticeUntil = 0;

  constructor(private readonly model: Model) {}

  /** Returns the page's own alarm while no data arrive. */
  render(nowMs: number): ShownAlarm[] {
    const { freshness } = this.model;
    const isOpening = !this.model.connected && nowMs < QUIET_START_MS;
    if (isOpening || this.model.isStarting || this.model.hasNoTool) freshness.expectNoData(nowMs);
    const lost = freshness.at(nowMs) === "lost";
    const age = freshness.ageMs(nowMs);
    const banner = byId("stale-banner");
    setHidden(banner, !lost);
    if (lost) setText(banner, this.lostText(nowMs - age, age));
    this.showOutage(nowMs);
    return lost ? [this.alarm(nowMs - age)] : [];
  }

  private lostText(since: number, age: number): string {
    const how = this.model.connected
      ? "The server is connected but sends no samples."
      : "No connection to the server; trying again.";
    const what = this.model.freshness.everHadData ? "No data since" : "No data yet. Waiting since";
    return `${what} ${clockTime(since)} (${duration(age)}). ${how}`;
  }

  private alarm(since: number): ShownAlarm {
    const grasping = this.model.state?.run !== null || this.model.identification?.in_grasp === true;
    const priority = this.model.freshness.everHadData && grasping ? "high" : "medium";
    return pageAlarm("page:no-data", priority, this.model.connected ? "No data from the tool" : "No connection to the server", since);
  }

  private showOutage(nowMs: number): void {
    const outage = this.model.freshness.takeOutage();
    const notice = byId("notice");
    if (outage) {
      this.noticeUntil = nowMs + NOTICE_MS;
      setText(notice, `Data are back. This page saw nothing for ${duration(outage.forMs)}, from ${clockTime(outage.from)} on.`);
    }
    setHidden(notice, nowMs > this.noticeUntil || this.model.freshness.at(nowMs) === "lost");
  }
}
