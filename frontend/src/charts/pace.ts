/** Time per repaint above which each repaint draws one half of the charts, and below which it draws all again, ms. */
const SLOW_MS = 6;
const FAST_MS = 2.5;
const MEAN_WEIGHT = 0.95;

/**
 * Measures whether this machine can draw all charts thirty times a second. If it cannot, each repaint draws one half of
 * them, so that numbers, verdicts and alarms stay on time.
 */
export class Pace {
  drawsHalf = false;
  private half = 0;
  private meanMs = 0;
  private readonly channel = new MessageChannel();
  private began = 0;

  constructor() {
    this.channel.port1.onmessage = () => this.addDuration(performance.now() - this.began);
  }

  /** Measures the time of a repaint. The page's message to itself comes back after layout and painting. */
  measure(began: number): void {
    this.began = began;
    this.channel.port2.postMessage(null);
  }

  close(): void {
    this.channel.port1.close(); // an open port would keep this object in memory
  }

  /** Whether this repaint draws the chart. */
  shouldDraw(chart: number): boolean {
    return !this.drawsHalf || chart % 2 === this.half;
  }

  nextPicture(): void {
    this.half = 1 - this.half;
  }

  private addDuration(ms: number): void {
    this.meanMs = MEAN_WEIGHT * this.meanMs + (1 - MEAN_WEIGHT) * ms;
    if (this.meanMs > SLOW_MS) this.drawsHalf = true;
    else if (this.meanMs < FAST_MS) this.drawsHalf = false;
  }
}
