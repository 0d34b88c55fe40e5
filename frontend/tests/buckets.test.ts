import assert from "node:assert/strict";
import { describe, it } from "node:test";
import { Buckets } from "../src/charts/buckets";
import { SampleRing } from "../src/live/ring";
import { frame } from "./messages";
import { integers, SEEDS } from "./random";

const ringOf = (values: number[], firstTick = 0, capacity = 1000): SampleRing => {
  const ring = new SampleRing(1, capacity);
  ring.write(frame(firstTick, [values]));
  return ring;
};

describe("Buckets", () => {
  it("keeps the minimum and the maximum of each bucket in the order in which they came", () => {
    const buckets = new Buckets(ringOf([1, 5, 2, 3, 9, 4, 4, 0]), [0], 100, 4, 2);
    buckets.update();
    assert.deepEqual(buckets.channel(0), [1, 5, 9, 0]);
  });

  it("gives seconds that increase, within each bucket's ticks", () => {
    const buckets = new Buckets(ringOf([1, 5, 2, 3, 9, 4, 4, 0]), [0], 100, 4, 2);
    buckets.update();
    assert.deepEqual(buckets.time, [0.01, 0.03, 0.05, 0.07]);
  });

  it("leaves a bucket without a value null", () => {
    const buckets = new Buckets(ringOf([1, 2, NaN, NaN, NaN, 7]), [0], 100, 2, 3);
    buckets.update();
    assert.deepEqual(buckets.channel(0), [1, 2, null, null, 7, 7]);
  });

  it("shows a peak as the same pair while it moves across the chart", () => {
    const ring = ringOf([0, 0, 9, 0]);
    const buckets = new Buckets(ring, [0], 100, 4, 3);
    buckets.update();
    assert.deepEqual(buckets.channel(0).slice(4), [0, 9]);
    for (const tick of [4, 6, 8]) {
      ring.write(frame(tick, [[1, 1]]));
      buckets.update();
      const place = buckets.channel(0).indexOf(9);
      assert.deepEqual(buckets.channel(0).slice(place - 1, place + 1), [0, 9]);
      assert.equal(buckets.time[place], 0.03);
    }
    assert.equal(buckets.channel(0).indexOf(9), 1);
  });

  it("reads older samples again after `invalidate`", () => {
    const ring = ringOf([4, 5], 2);
    const buckets = new Buckets(ring, [0], 100, 2, 3);
    buckets.update();
    ring.write(frame(0, [[1, 2, 3, 4, 5, 6]], true));
    buckets.update();
    assert.deepEqual(buckets.channel(0), [null, null, 4, 5, 5, 6]);
    buckets.invalidate();
    buckets.update();
    assert.deepEqual(buckets.channel(0), [1, 2, 3, 4, 5, 6]);
  });

  it("goes back to an earlier end", () => {
    const buckets = new Buckets(ringOf([1, 2, 3, 4, 5, 6]), [0], 100, 2, 2);
    buckets.update();
    assert.deepEqual(buckets.channel(0), [3, 4, 5, 6]);
    buckets.update(4);
    assert.deepEqual(buckets.channel(0), [1, 2, 3, 4]);
  });

  it("refuses a channel that it does not keep", () => {
    assert.throws(() => new Buckets(ringOf([1]), [0], 100, 2, 2).channel(1), RangeError);
  });

  it("keeps the extremes of any samples, however they arrive", () => {
    for (const seed of SEEDS) {
      const integer = integers(seed);
      const [bucketTicks, bucketCount] = [integer(1, 7), integer(1, 9)];
      const ring = new SampleRing(1, 200);
      const buckets = new Buckets(ring, [0], 100, bucketTicks, bucketCount);
      const all: number[] = [];
      for (let n = 0; n < 15; n++) {
        const values = Array.from({ length: integer(1, 20) }, () => (integer(0, 9) === 0 ? NaN : integer(-50, 50) / 8));
        ring.write(frame(all.length, [values]));
        all.push(...values);
        if (integer(0, 2) > 0) buckets.update();
      }
      buckets.update();
      const last = Math.floor((all.length - 1) / bucketTicks);
      for (let i = 0; i < bucketCount; i++) {
        const bucket = last - bucketCount + 1 + i;
        const from = Math.max(0, bucket * bucketTicks);
        const values = all.slice(from, Math.max(0, (bucket + 1) * bucketTicks)).filter((value) => !Number.isNaN(value));
        const pair = buckets.channel(0).slice(2 * i, 2 * i + 2);
        const [min, max] = [Math.min(...values), Math.max(...values)];
        const expected = values.length === 0 ? [null, null] : values.indexOf(min) <= values.indexOf(max) ? [min, max] : [max, min];
        assert.deepEqual(pair, expected, `seed ${seed}, bucket ${bucket}`);
      }
    }
  });
});
