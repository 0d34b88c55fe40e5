export const OLD_AFTER_MS = 250;
export const LOST_AFTER_MS = 1000;

export type Freshness = "waiting" | "live" | "old" | "lost";

/** How old what the page shows is, by the page's own clock, whatever the server or the network do. */
export class FreshnessWatch {
  private dataAt: number | null = null;
  private waitingSince: number;
  private blind: { from: number; forMs: number } | null = null;

  constructor(nowMs: number) {
    this.waitingSince = nowMs;
  }

  /** A frame came whose newest sample was `lagMs` old. */
  frameArrived(nowMs: number, lagMs: number): void {
    const at = nowMs - Math.max(0, Number.isFinite(lagMs) ? lagMs : 0);
    const gap = this.dataAt === null ? 0 : at - this.dataAt;
    if (this.dataAt !== null && gap > LOST_AFTER_MS && nowMs - at <= LOST_AFTER_MS) {
      this.blind = { from: this.dataAt, forMs: gap };
    }
    this.dataAt = at;
  }

  /** No data are due yet: the tool is still starting. */
  nothingDue(nowMs: number): void {
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

  /** The last time without data, once: when it began (page time) and how long it was. */
  takeBlindTime(): { from: number; forMs: number } | null {
    const blind = this.blind;
    this.blind = null;
    return blind;
  }
}
