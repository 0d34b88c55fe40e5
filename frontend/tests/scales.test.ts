import assert from "node:assert/strict";
import { describe, it } from "node:test";
import { toUplotScale, verticalScale } from "../src/charts/scales";
import { hello } from "./messages";
import { integers, SEEDS } from "./random";

const of = (chart: string): ReturnType<typeof verticalScale> => verticalScale(chart, hello(), "alpha_n");
const near = (actual: number, expected: number): void => assert.ok(Math.abs(actual - expected) < 1e-9, `${actual} is not ${expected}`);

describe("verticalScale", () => {
  it("shows forces from just below zero to above the lowest threshold", () => {
    const [low, high] = of("force").range(null, null);
    near(low, -0.1);
    near(high, 6.5);
  });

  it("makes room for every force and displacement, and ends on a round step", () => {
    for (const [chart, step, unit] of [["force", 0.5, 1], ["displacement", 1e-3, 1e-3]] as const) {
      for (const seed of SEEDS) {
        const integer = integers(seed);
        const [min, max] = [(integer(-3000, 0) / 1000) * unit, (integer(0, 30_000) / 1000) * unit];
        const [low, high] = of(chart).range(min, max);
        assert.ok(low < 0 && low <= min + 1e-9 && high > max, `${chart}: ${low} to ${high} does not hold ${min} to ${max}`);
        near(high / step, Math.round(high / step));
      }
    }
  });

  it("shows probabilities from 0 to 1 whatever the data are", () => {
    const scale = of("probability");
    assert.deepEqual(scale.range(0.3, 0.4), [-0.04, 1.04]);
    assert.deepEqual(scale.splits?.(0, 1).map(scale.label), ["0", "25", "50", "75", "100"]);
  });

  it("shows a parameter in whole decades that hold the library and the estimates", () => {
    const scale = of("parameter"); // the library's alpha: 0.05 N and 2 N
    assert.equal(scale.logarithmic, true);
    assert.deepEqual(scale.range(null, null), [0.01, 10]);
    assert.deepEqual(scale.range(0.3, 15), [0.01, 100]);
    assert.deepEqual(scale.splits?.(0.01, 10), [0.01, 0.1, 1, 10]);
  });

  it("does not follow an estimate that runs away", () => {
    const [low, high] = of("parameter").range(1e-9, 1e9);
    assert.ok(low >= 0.05 / 100 && high <= 2 * 100, `${low} to ${high}`);
  });

  it("writes displacements in millimetres and forces in newtons", () => {
    assert.equal(of("displacement").label(0.0025), "2.5");
    assert.equal(of("displacement").readout(0.002567), "2.57");
    assert.equal(of("force").label(2), "2.0");
    assert.equal(of("force").readout(2.345), "2.35");
    assert.equal(of("parameter").readout(0.123456), "0.123");
  });

  it("is linear or logarithmic for uPlot, with its own range", () => {
    assert.equal(toUplotScale(of("force")).distr, 1);
    assert.equal(toUplotScale(of("parameter")).distr, 3);
  });
});
