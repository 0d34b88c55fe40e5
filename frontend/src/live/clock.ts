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

/** `Date` has full seconds, so a smaller difference says nothing. */
const DATE_HEADER_STEP_MS = 1000;

/** The server's clock, ms since 1970, when `performance.now()` was 0; the viewer's own until the first answer. */
let serverOriginMs = performance.timeOrigin;

/** Reads the server's clock from the `Date` of an answer: the viewer's own may be wrong. */
export function readServerDate(date: string | null): void {
  const originMs = Date.parse(date ?? "") + DATE_HEADER_STEP_MS / 2 - performance.now();
  if (Math.abs(originMs - serverOriginMs) > DATE_HEADER_STEP_MS) serverOriginMs = originMs;
}

/** Returns the time of the server's clock, ms since 1970, at a moment of `performance.now()`; to about a second. */
export const serverTimeMs = (pageMs = performance.now()): number => serverOriginMs + pageMs;
