import type { SampleRing } from "../live/ring";

type Point = number | null;

/**
 * Minimum and maximum of each bucket of samples, in the order of their ticks, for charts. Buckets begin at multiples of
 * `bucketTicks`, so a peak stays in the same bucket while it moves across the chart. An update reads only new samples.
 * A bucket without a value is null, which leaves a gap in the line.
 */
export class Buckets {
  /** Seconds since tick 0, two points per bucket. */
  readonly time: number[];
  private readonly points = new Map<number, Point[]>();
  private readonly min: Float64Array;
  private readonly max: Float64Array;
  private readonly minAt: Float64Array;
  private readonly maxAt: Float64Array;
  private lastBucket = -1;
  private nextTick = 0;
  private outdated = true;
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
    const columnCount = Math.max(0, ...columns) + 1;
    this.min = new Float64Array(columnCount);
    this.max = new Float64Array(columnCount);
    this.minAt = new Float64Array(columnCount);
    this.maxAt = new Float64Array(columnCount);
  }

  channel(column: number): Point[] {
    const points = this.points.get(column);
    if (!points) throw new RangeError(`no channel ${column}`);
    return points;
  }

  /** Reads all samples again at the next update, because older samples have changed. */
  invalidate(): void {
    this.outdated = true;
  }

  /** Adds the samples since the last update, up to the tick `end`. */
  update(end = this.ring.end): void {
    const windowTicks = this.bucketTicks * this.bucketCount;
    const mustRestart = this.outdated || this.generation !== this.ring.generation;
    if (mustRestart || end < this.nextTick || end - this.nextTick > windowTicks) this.restart(end);
    while (this.nextTick < end) {
      const bucket = Math.floor(this.nextTick / this.bucketTicks);
      if (bucket !== this.lastBucket) this.advanceTo(bucket);
      const stop = Math.min(end, (bucket + 1) * this.bucketTicks);
      for (const column of this.points.keys()) this.merge(column, this.nextTick, stop);
      this.nextTick = stop;
    }
  }

  private restart(end: number): void {
    const oldest = Math.floor(Math.max(0, end - 1) / this.bucketTicks) - this.bucketCount + 1;
    this.nextTick = Math.max(this.ring.start, oldest * this.bucketTicks);
    this.lastBucket = Math.floor(this.nextTick / this.bucketTicks) - this.bucketCount;
    this.outdated = false;
    this.generation = this.ring.generation;
  }

  /** Shifts the window so that `bucket` is its last one. */
  private advanceTo(bucket: number): void {
    const shift = 2 * Math.min(this.bucketCount, bucket - this.lastBucket);
    const kept = 2 * this.bucketCount - shift;
    for (const points of this.points.values()) {
      points.copyWithin(0, shift);
      points.fill(null, kept);
    }
    this.time.copyWithin(0, shift);
    for (let i = kept / 2; i < this.bucketCount; i++) this.writeTimes(i, bucket - this.bucketCount + 1 + i);
    this.min.fill(Infinity);
    this.max.fill(-Infinity);
    this.lastBucket = bucket;
  }

  private writeTimes(index: number, bucket: number): void {
    this.time[2 * index] = ((bucket + 0.25) * this.bucketTicks) / this.rateHz;
    this.time[2 * index + 1] = ((bucket + 0.75) * this.bucketTicks) / this.rateHz;
  }

  private merge(channel: number, from: number, to: number): void {
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
