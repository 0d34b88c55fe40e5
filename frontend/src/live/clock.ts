/** How long a reading of the offset counts; clocks drift apart by some 50 ms an hour. */
const REMEMBER_MS = 30_000;

/**
 * The server's clock in terms of `performance.now()`. The smallest difference seen lately is the least delayed message,
 * so latencies measured with it leave out only the network's shortest way.
 */
export class ServerClock {
  private readings: { at: number; offset: number }[] = [];

  reset(): void {
    this.readings = [];
  }

  heard(serverMs: number, nowMs: number): void {
    this.readings = this.readings.filter((reading) => nowMs - reading.at < REMEMBER_MS);
    this.readings.push({ at: nowMs, offset: nowMs - serverMs });
  }

  /** The page's time at which the server's clock showed `serverMs`; NaN before the first message. */
  toPage(serverMs: number): number {
    if (this.readings.length === 0) return NaN;
    return serverMs + Math.min(...this.readings.map((reading) => reading.offset));
  }
}
