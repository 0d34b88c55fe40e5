import assert from "node:assert/strict";
import { describe, it } from "node:test";
import { LIVE_SPAN_S, View } from "../src/charts/view";
import { SampleRing } from "../src/live/ring";
import { frame } from "./messages";
import { integers, SEEDS } from "./random";

const RATE_HZ = 10;
const LIVE_TICKS = LIVE_SPAN_S * RATE_HZ;

/** A view of a ring that holds the ticks 0 to 999. */
function viewed(): { view: View; ring: SampleRing; addSamples: () => void } {
  const ring = new SampleRing(1, 1000);
  ring.write(frame(0, [Array.from({ length: 1000 }, () => 1)]));
  return { view: new View(ring, RATE_HZ), ring, addSamples: () => ring.write(frame(ring.end, [[1, 1, 1, 1, 1]])) };
}

describe("View", () => {
  it("follows the newest sample until it is paused", () => {
    const { view, addSamples } = viewed();
    addSamples();
    assert.deepEqual([view.paused, view.endTick, view.nowTick, view.spanTicks], [false, 1005, 1005, LIVE_TICKS]);
    view.pause();
    addSamples();
    assert.deepEqual([view.paused, view.endTick, view.nowTick], [true, 1005, 1005]);
    view.resume();
    assert.deepEqual([view.paused, view.endTick, view.nowTick], [false, 1010, 1010]);
  });

  it("says whether it shows something else than the newest ten seconds", () => {
    const { view } = viewed();
    view.pause();
    assert.equal(view.changed, false);
    view.move(-0.5);
    assert.equal(view.changed, true);
    assert.equal(view.endTick, 1000 - LIVE_TICKS / 2);
  });

  it("ends the pause when the ticks begin again", () => {
    const { view, ring } = viewed();
    view.move(-1);
    ring.write(frame(3, [[1]]));
    assert.deepEqual([view.paused, view.endTick], [false, 4]);
  });

  it("zooms around the middle, and back", () => {
    const { view } = viewed();
    view.show(400, 600);
    view.zoom(0.5);
    assert.deepEqual([view.endTick - view.spanTicks, view.endTick], [450, 550]);
    view.zoom(2);
    assert.deepEqual([view.endTick - view.spanTicks, view.endTick], [400, 600]);
  });

  it("shows ten seconds again at the next pause", () => {
    const { view } = viewed();
    view.zoom(0.5);
    view.resume();
    view.pause();
    assert.equal(view.spanTicks, LIVE_TICKS);
  });

  it("never leaves the samples, whatever a person does", () => {
    for (const seed of SEEDS) {
      const integer = integers(seed);
      const { view } = viewed();
      for (let n = 0; n < 30; n++) {
        const does = integer(0, 3);
        if (does === 0) view.move(integer(-300, 300) / 100);
        else if (does === 1) view.zoom(integer(1, 400) / 100);
        else if (does === 2) view.moveTo(integer(-500, 2000));
        else view.show(integer(-500, 900), integer(-500, 2000));
        const { first, last } = view.reach;
        assert.ok(view.spanTicks > 0, `seed ${seed}: a span of ${view.spanTicks}`);
        assert.ok(first <= view.endTick && view.endTick <= last && last === 1000, `seed ${seed}: end ${view.endTick}`);
      }
    }
  });
});
