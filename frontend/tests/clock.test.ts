import assert from "node:assert/strict";
import { describe, it } from "node:test";
import { clockTime } from "../src/format";
import { readServerDate, ServerClock, serverTimeMs } from "../src/live/clock";

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

describe("serverTimeMs", () => {
  it("is the viewer's clock until the server has answered, also without a date", () => {
    for (const date of [null, "", "yesterday"]) {
      readServerDate(date);
      assert.ok(Math.abs(serverTimeMs() - Date.now()) < 1000);
    }
  });

  it("is the server's clock, whatever the viewer's says, and stays steady within the second of the header", () => {
    const server = new Date(Date.UTC(2031, 4, 6, 7, 8, 9));
    readServerDate(server.toUTCString());
    const [read, page] = [serverTimeMs(), performance.now()];
    assert.ok(Math.abs(read - server.getTime()) < 1000);
    assert.equal(clockTime(page), new Date(server.getTime() + 500).toLocaleTimeString("en-GB", { hour12: false }));
    readServerDate(server.toUTCString());
    assert.ok(serverTimeMs() >= read);
  });
});
