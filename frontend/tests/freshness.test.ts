import assert from "node:assert/strict";
import { describe, it } from "node:test";
import { FreshnessWatch, LOST_AFTER_MS, OLD_AFTER_MS } from "../src/live/freshness";

describe("FreshnessWatch", () => {
  it("waits for the first data, and then calls them lost", () => {
    const watch = new FreshnessWatch(1000);
    assert.equal(watch.everHadData, false);
    assert.equal(watch.at(1000 + LOST_AFTER_MS), "waiting");
    assert.equal(watch.at(1001 + LOST_AFTER_MS), "lost");
  });

  it("goes on waiting while no data are due", () => {
    const watch = new FreshnessWatch(0);
    watch.expectNoData(5000);
    assert.equal(watch.at(5000 + LOST_AFTER_MS), "waiting");
  });

  it("calls data live, old and lost by their age", () => {
    const watch = new FreshnessWatch(0);
    watch.frameArrived(500, 0);
    assert.equal(watch.everHadData, true);
    assert.equal(watch.at(500 + OLD_AFTER_MS), "live");
    assert.equal(watch.at(501 + OLD_AFTER_MS), "old");
    assert.equal(watch.at(500 + LOST_AFTER_MS), "old");
    assert.equal(watch.at(501 + LOST_AFTER_MS), "lost");
  });

  it("counts the delay of the newest sample as age", () => {
    const watch = new FreshnessWatch(0);
    watch.frameArrived(500, 300);
    assert.equal(watch.ageMs(500), 300);
    assert.equal(watch.at(500), "old");
  });

  it("takes a delay that is negative or not known as none", () => {
    const watch = new FreshnessWatch(0);
    watch.frameArrived(500, -20);
    assert.equal(watch.ageMs(500), 0);
    watch.frameArrived(600, NaN);
    assert.equal(watch.ageMs(600), 0);
  });

  it("tells a time without data once, as soon as live data are back", () => {
    const watch = new FreshnessWatch(0);
    watch.frameArrived(100, 0);
    watch.frameArrived(100 + LOST_AFTER_MS, 0);
    assert.equal(watch.takeOutage(), null, "a gap of exactly the limit is none");
    watch.frameArrived(5000, 0);
    assert.deepEqual(watch.takeOutage(), { from: 1100, forMs: 3900 });
    assert.equal(watch.takeOutage(), null);
  });

  it("does not end a time without data with samples that are old themselves", () => {
    const watch = new FreshnessWatch(0);
    watch.frameArrived(100, 0);
    watch.frameArrived(9000, 2000);
    assert.equal(watch.takeOutage(), null);
    assert.equal(watch.at(9000), "lost");
  });
});
