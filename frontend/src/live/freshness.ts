export const OLD_AFTER_MS = 250;
export const LOST_AFTER_MS = 1000;

export type Freshness = "waiting" | "live" | "old" | "lost";

/** Measures the age of the shown data by the page's own clock, independent of server and network. */
export class FreshnessWatch {
  private dataAt: number | null = null;
  private waitingSince: number;
  private outage: { from: number; forMs: number } | null = null;

  constructor(nowMs: number) {
    this.waitingSince = nowMs;
  }

  /** Records a frame whose newest sample is `lagMs` old. */
  frameArrived(nowMs: number, lagMs: number): void {
    const at = nowMs - Math.max(0, Number.isFinite(lagMs) ? lagMs : 0);
    const gap = this.dataAt === null ? 0 : at - this.dataAt;
    if (this.dataAt !== null && gap > LOST_AFTER_MS && nowMs - at <= LOST_AFTER_MS) {
      this.outage = { from: this.dataAt, forMs: gap };
    }
    this.dataAt = at;
  }

  /** Records that no data are expected yet, because the tool is still starting. */
  expectNoData(nowMs: number): void {
    this.waitingSince = nowMs;
  }

  ageMs(nowMs: number): number {
    return nowMs - (this.dataAt ?? this.waitingSince);
  }

  at(nowMs: number): Freshness {
    const age = this.ageMs(nowMs);
    if (this.dataAt === null) return age > LOST_AFTER_MS ? "lost" : "waiting";
    if (age > LOST_AFTER_MS) return "lost";
    return age > OLD_AFTER_MS ? "old" : "live";
  }

  get everHadData(): boolean {
    return this.dataAt !== null;
  }

  /** Returns the last time without data once: its start in page time and its length. Null if there was none. */
  takeOutage(): { from: number; forMs: number } | null {
    const outage = this.outage;
    this.outage = null;
    return outage;
  }
}
