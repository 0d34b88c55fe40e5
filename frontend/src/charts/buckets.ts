import type { SampleRing } from "../live/ring";

type Point = number | null;

/**
 * The last samples as pairs of minimum and maximum, in the order in which they came, for charts. Buckets begin at
 * multiples of `bucketTicks`, so a peak stays the same pair while it moves across the chart; only new samples are read.
 * A bucket without a value is null, which leaves a gap in the line.
 */
export class Buckets {
  /** Seconds since tick 0, two points a bucket. */
  readonly time: number[];
  private readonly points = new Map<number, Point[]>();
  private readonly min: Float64Array;
  private readonly max: Float64Array;
  private readonly minAt: Float64Array;
  private readonly maxAt: Float64Array;
  private lastBucket = -1;
  private next = 0;
  private stale = true;
  private generation = -1;

  constructor(
    private readonly ring: SampleRing,
    columns: number[],
    private readonly rateHz: number,
    private readonly bucketTicks: number,
    private readonly bucketCount: number,
  ) {
    this.time = Array.from({ length: 2 * bucketCount }, () => 0);
    for (const column of columns) this.points.set(column, Array.from({ length: 2 * bucketCount }, () => null));
    const most = Math.max(0, ...columns) + 1;
    this.min = new Float64Array(most);
    this.max = new Float64Array(most);
    this.minAt = new Float64Array(most);
    this.maxAt = new Float64Array(most);
  }

  channel(column: number): Point[] {
    const points = this.points.get(column);
    if (!points) throw new RangeError(`no channel ${column}`);
    return points;
  }

  /** Read everything again at the next update: older samples have changed. */
  invalidate(): void {
    this.stale = true;
  }

  /** Folds in what came since the last update, up to the tick `end`. */
  update(end = this.ring.end): void {
    const windowTicks = this.bucketTicks * this.bucketCount;
    const anew = this.stale || this.generation !== this.ring.generation;
    if (anew || end < this.next || end - this.next > windowTicks) this.restart(end);
    while (this.next < end) {
      const bucket = Math.floor(this.next / this.bucketTicks);
      if (bucket !== this.lastBucket) this.advanceTo(bucket);
      const stop = Math.min(end, (bucket + 1) * this.bucketTicks);
      for (const column of this.points.keys()) this.fold(column, this.next, stop);
      this.next = stop;
    }
  }

  private restart(end: number): void {
    const oldest = Math.floor(Math.max(0, end - 1) / this.bucketTicks) - this.bucketCount + 1;
    this.next = Math.max(this.ring.start, oldest * this.bucketTicks);
    this.lastBucket = Math.floor(this.next / this.bucketTicks) - this.bucketCount;
    this.stale = false;
    this.generation = this.ring.generation;
  }

  /** Shifts the window so that `bucket` is its last. */
  private advanceTo(bucket: number): void {
    const shift = 2 * Math.min(this.bucketCount, bucket - this.lastBucket);
    const keep = 2 * this.bucketCount - shift;
    for (const points of this.points.values()) {
      points.copyWithin(0, shift);
      points.fill(null, keep);
    }
    this.time.copyWithin(0, shift);
    for (let i = keep / 2; i < this.bucketCount; i++) this.stamp(i, bucket - this.bucketCount + 1 + i);
    this.min.fill(Infinity);
    this.max.fill(-Infinity);
    this.lastBucket = bucket;
  }

  private stamp(index: number, bucket: number): void {
    this.time[2 * index] = ((bucket + 0.25) * this.bucketTicks) / this.rateHz;
    this.time[2 * index + 1] = ((bucket + 0.75) * this.bucketTicks) / this.rateHz;
  }

  private fold(channel: number, from: number, to: number): void {
    let min = this.min[channel] ?? Infinity;
    let max = this.max[channel] ?? -Infinity;
    for (let tick = from; tick < to; tick++) {
      const value = this.ring.at(channel, tick);
      if (value < min) {
        min = value;
        this.minAt[channel] = tick;
      }
      if (value > max) {
        max = value;
        this.maxAt[channel] = tick;
      }
    }
    this.min[channel] = min;
    this.max[channel] = max;
    if (min > max) return;
    const minFirst = (this.minAt[channel] ?? 0) <= (this.maxAt[channel] ?? 0);
    const points = this.channel(channel);
    points[points.length - 2] = minFirst ? min : max;
    points[points.length - 1] = minFirst ? max : min;
  }
}
