/** Main-thread time for a picture above which the charts are drawn in two halves, and below which in one again, ms. */
const TOO_MUCH_MS = 6;
const LITTLE_MS = 2.5;
const MEAN_KEEPS = 0.95;

/**
 * Whether this machine can draw all charts thirty times a second beside everything else. Where it cannot, every picture
 * draws one half of them, so that numbers, answers and alarms keep their pace.
 */
export class Pace {
  halved = false;
  private turn = 0;
  private mean = 0;
  private readonly channel = new MessageChannel();
  private began = 0;

  constructor() {
    this.channel.port1.onmessage = () => this.took(performance.now() - this.began);
  }

  /** Call while a picture is being made: a message to the page itself comes back when layout and painting are done. */
  measure(began: number): void {
    this.began = began;
    this.channel.port2.postMessage(null);
  }

  close(): void {
    this.channel.port1.close(); // an open one would keep all of this for good
  }

  /** Whether the chart is drawn in this picture. */
  draws(chart: number): boolean {
    return !this.halved || chart % 2 === this.turn;
  }

  next(): void {
    this.turn = 1 - this.turn;
  }

  private took(ms: number): void {
    this.mean = MEAN_KEEPS * this.mean + (1 - MEAN_KEEPS) * ms;
    if (this.mean > TOO_MUCH_MS) this.halved = true;
    else if (this.mean < LITTLE_MS) this.halved = false;
  }
}
