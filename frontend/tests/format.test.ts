import assert from "node:assert/strict";
import { describe, it } from "node:test";
import { bytes, clockTime, count, duration, elapsed, fixed, inOneLine, newtons, NO_VALUE, percent, shortTime, wholePercent } from "../src/format";
import { integers, SEEDS } from "./random";

/** With plain spaces: the page uses narrow ones that do not break. */
const plain = (text: string): string => text.replaceAll("\u202f", " ");

describe("numbers", () => {
  it("stand with their unit", () => {
    assert.equal(fixed(1.25, 1, "V"), "1.3\u202fV");
    assert.equal(plain(newtons(2.345)), "2.35 N");
  });

  it("are a dash where there is no value", () => {
    for (const none of [null, undefined, NaN, Infinity]) {
      assert.equal(fixed(none, 1, "V"), NO_VALUE);
      assert.equal(newtons(none), NO_VALUE);
      assert.equal(percent(none), NO_VALUE);
    }
    assert.equal(wholePercent(NaN), NO_VALUE);
    assert.equal(shortTime(null), NO_VALUE);
    assert.equal(shortTime(NaN), NO_VALUE);
  });

  it("have no minus before a force that rounds to zero", () => {
    assert.equal(plain(newtons(-0.004)), "0.00 N");
    assert.equal(plain(newtons(-0.006)), "-0.01 N");
  });
});

describe("percent", () => {
  it("rounds to whole percent", () => {
    assert.equal(plain(percent(0.505)), "51 %");
    assert.equal(plain(percent(0)), "0 %");
    assert.equal(plain(percent(1)), "100 %");
  });

  it("reads 0 % or 100 % only where the share is 0 or 1", () => {
    for (const share of [1e-9, 0.0049]) assert.equal(plain(percent(share)), "< 1 %");
    for (const share of [0.9901, 0.995, 1 - 1e-9]) assert.equal(plain(percent(share)), "> 99 %");
    for (const seed of SEEDS) {
      const share = integers(seed)(1, 999_999) / 1e6;
      assert.ok(!["0 %", "100 %"].includes(plain(percent(share))), `${share}`);
    }
  });
});

describe("times", () => {
  it("change their unit at ten seconds, a minute and an hour", () => {
    assert.equal(plain(duration(-5)), "0.0 s");
    assert.equal(plain(duration(1250)), "1.3 s");
    assert.equal(plain(duration(59_900)), "59 s");
    assert.equal(plain(duration(61_500)), "1 min 1 s");
    assert.equal(plain(duration(3_600_000 + 59_000)), "1 h 0 min");
  });

  it("that have elapsed are whole seconds", () => {
    assert.equal(plain(elapsed(1999)), "1 s");
    assert.equal(plain(elapsed(-1)), "0 s");
    assert.equal(plain(elapsed(60_999)), "1 min 0 s");
  });

  it("of a decision are milliseconds below a second", () => {
    assert.equal(plain(shortTime(0.1234)), "123 ms");
    assert.equal(plain(shortTime(1)), "1.00 s");
  });

  it("of the wall clock follow from the page's own clock", () => {
    assert.match(clockTime(performance.now()), /^\d\d:\d\d:\d\d$/);
  });
});

describe("bytes", () => {
  it("have decimal prefixes", () => {
    const texts = [0, 0.5, 999, 1000, 1.5e6, 2e9, 3.25e12, 4e15].map((size) => plain(bytes(size)));
    assert.deepEqual(texts, ["0 B", "1 B", "999 B", "1 kB", "2 MB", "2.0 GB", "3.3 TB", "4000.0 TB"]);
  });
});

describe("words", () => {
  it("have a plural", () => {
    assert.deepEqual([count(1, "grasp"), count(2, "grasp"), count(0, "entry", "entries")], ["1 grasp", "2 grasps", "0 entries"]);
  });

  it("of several sentences stand in one line", () => {
    assert.equal(inOneLine(["One.", "Two", "3.5 N."]), "One · Two · 3.5 N");
  });
});
