import assert from "node:assert/strict";
import { describe, it } from "node:test";
import { SampleRing } from "../src/live/ring";
import { frame } from "./messages";
import { integers, SEEDS } from "./random";

const valuesOf = (ring: SampleRing, channel = 0): number[] =>
  Array.from({ length: ring.end - ring.start }, (_, i) => ring.at(channel, ring.start + i));

describe("SampleRing", () => {
  it("is empty at first", () => {
    const ring = new SampleRing(1, 4);
    assert.equal(ring.isEmpty, true);
    assert.ok(Number.isNaN(ring.newest(0)));
  });

  it("keeps the newest samples when it wraps", () => {
    const ring = new SampleRing(2, 4);
    ring.write(frame(0, [[0, 1, 2], [10, 11, 12]]));
    ring.write(frame(3, [[3, 4, 5], [13, 14, 15]]));
    assert.deepEqual([ring.start, ring.end], [2, 6]);
    assert.deepEqual(valuesOf(ring, 0), [2, 3, 4, 5]);
    assert.deepEqual(valuesOf(ring, 1), [12, 13, 14, 15]);
    assert.ok(Number.isNaN(ring.at(0, 1)), "an overwritten tick has no value");
    assert.ok(Number.isNaN(ring.at(0, 6)), "a tick to come has no value");
  });

  it("keeps the end of a frame that is longer than the ring", () => {
    const ring = new SampleRing(1, 3);
    ring.write(frame(0, [[0, 1, 2, 3, 4, 5, 6]]));
    assert.deepEqual([ring.start, ring.end], [4, 7]);
    assert.deepEqual(valuesOf(ring), [4, 5, 6]);
  });

  it("fills the ticks that never came with NaN", () => {
    const ring = new SampleRing(1, 8);
    ring.write(frame(0, [[0, 1, 2, 3, 4, 5, 6, 7]]));
    ring.write(frame(11, [[11]]));
    assert.deepEqual(valuesOf(ring), [4, 5, 6, 7, NaN, NaN, NaN, 11]);
    assert.equal(ring.generation, 1);
  });

  it("begins again after a gap as long as the ring, and when the ticks go back", () => {
    const ring = new SampleRing(1, 4);
    ring.write(frame(0, [[0, 1]]));
    ring.write(frame(6, [[6, 7]]));
    assert.deepEqual([ring.start, ring.end, ring.generation], [6, 8, 2]);
    ring.write(frame(3, [[3]]));
    assert.deepEqual([ring.start, ring.end, ring.generation], [3, 4, 3]);
  });

  it("takes history that overlaps its samples and ends later", () => {
    const ring = new SampleRing(1, 8);
    ring.write(frame(4, [[4, 5]]));
    ring.write(frame(2, [[20, 30, 40, 50, 60]], true));
    assert.deepEqual(valuesOf(ring), [20, 30, 40, 50, 60]);
    assert.deepEqual([ring.start, ring.end, ring.generation], [2, 7, 1]);
  });

  it("ignores a frame without rows", () => {
    const ring = new SampleRing(1, 4);
    ring.write(frame(9, [[]]));
    assert.equal(ring.isEmpty, true);
    assert.equal(ring.generation, 0);
  });

  it("holds the last `capacity` ticks of any sequence of frames and gaps", () => {
    for (const seed of SEEDS) {
      const integer = integers(seed);
      const capacity = integer(1, 20);
      const ring = new SampleRing(1, capacity);
      const all = new Map<number, number>();
      let next = integer(0, 100);
      for (let n = 0; n < 20; n++) {
        if (n > 0 && integer(0, 1) === 1) next += integer(0, capacity - 1); // a gap as long as the ring would empty it
        const values = Array.from({ length: integer(1, 30) }, () => integer(-1000, 1000));
        ring.write(frame(next, [values]));
        for (const [i, value] of values.entries()) all.set(next + i, value);
        next += values.length;
        assert.equal(ring.end, next);
        assert.ok(ring.end - ring.start <= capacity);
        for (let tick = ring.start; tick < ring.end; tick++) {
          assert.deepEqual(ring.at(0, tick), all.get(tick) ?? NaN, `seed ${seed}, tick ${tick}`);
        }
      }
      assert.equal(ring.end - ring.start, capacity, `seed ${seed}: full in the end`);
    }
  });
});
