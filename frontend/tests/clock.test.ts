import assert from "node:assert/strict";
import { describe, it } from "node:test";
import { ServerClock } from "../src/live/clock";

describe("ServerClock", () => {
  it("does not know the time before the first message", () => {
    assert.ok(Number.isNaN(new ServerClock().toPage(1000)));
  });

  it("trusts the message that was delayed least", () => {
    const clock = new ServerClock();
    clock.addReading(10_000, 150);
    clock.addReading(10_100, 220);
    clock.addReading(10_200, 400);
    assert.equal(clock.toPage(10_100), 220);
  });

  it("forgets messages of half a minute ago, since clocks drift", () => {
    const clock = new ServerClock();
    clock.addReading(0, 0);
    clock.addReading(29_000, 29_010);
    assert.equal(clock.toPage(29_000), 29_000);
    clock.addReading(29_980, 30_000);
    assert.equal(clock.toPage(30_000), 30_010);
  });

  it("forgets everything on a reset", () => {
    const clock = new ServerClock();
    clock.addReading(0, 0);
    clock.reset();
    assert.ok(Number.isNaN(clock.toPage(0)));
  });
});
