/** How long a reading of the offset counts: clocks drift apart by about 50 ms an hour. */
const REMEMBER_MS = 30_000;

/**
 * Converts times of the server's clock to page time (`performance.now()`). It uses the smallest difference of the last
 * half minute, which belongs to the least delayed message. Delays measured with it exclude the network's shortest delay.
 */
export class ServerClock {
  private readings: { at: number; offset: number }[] = [];

  reset(): void {
    this.readings = [];
  }

  addReading(serverMs: number, nowMs: number): void {
    this.readings = this.readings.filter((reading) => nowMs - reading.at < REMEMBER_MS);
    this.readings.push({ at: nowMs, offset: nowMs - serverMs });
  }

  /** Converts a time of the server's clock to page time; NaN before the first message. */
  toPage(serverMs: number): number {
    if (this.readings.length === 0) return NaN;
    return serverMs + Math.min(...this.readings.map((reading) => reading.offset));
  }
}
