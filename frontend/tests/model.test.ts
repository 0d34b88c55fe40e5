import assert from "node:assert/strict";
import { describe, it } from "node:test";
import { plotSpecs } from "../src/charts/traces";
import { Model } from "../src/live/model";
import { SCHEMA_VERSION } from "../src/wire";
import { alarm, frame, graspEnded, hello, identification, state } from "./messages";

/** A connected model that has had the hello message. */
function greeted(isReplay = false): Model {
  const model = new Model(isReplay);
  model.connected = true;
  model.onMessage(hello(), 0);
  return model;
}

const indicesOf = ({ grasps }: Model): number[] => grasps.map(({ grasp }) => grasp.index);

describe("Model", () => {
  it("finds columns by channel and tissue", () => {
    const model = greeted();
    assert.equal(model.column("jaw_force_n"), 1);
    assert.equal(model.column("alpha_n", "liver"), 2);
    assert.equal(model.column("alpha_n"), -1);
    assert.equal(new Model().column("jaw_force_n"), -1);
    assert.ok(Number.isNaN(model.newest("jaw_force_n")), "no sample yet");
  });

  it("says that the server speaks another version", () => {
    const model = greeted();
    assert.equal(model.wrongVersion, false);
    model.onMessage(hello({ schema_version: SCHEMA_VERSION + 1 }), 0);
    assert.equal(model.wrongVersion, true);
  });

  it("counts the samples that never came, but not those before history", () => {
    const model = greeted();
    model.onFrame(frame(0, [[0, 0], [1, 2]]), 10);
    model.onFrame(frame(5, [[0], [3]]), 20);
    assert.equal(model.samplesMissed, 3);
    model.onFrame(frame(9, [[0], [4]], true), 30);
    assert.equal(model.samplesMissed, 3);
    assert.equal(model.newest("jaw_force_n"), 4);
  });

  it("keeps the ring over a new connection with the same channels only", () => {
    const model = greeted();
    const { ring } = model;
    model.onMessage(hello(), 0);
    assert.equal(model.ring, ring);
    model.onMessage(hello({ channels: [] }), 0);
    assert.notEqual(model.ring, ring);
  });

  it("says that events were missed, if the server could not catch up on them", () => {
    const model = greeted();
    model.onMessage({ type: "event", number: 7, server_time_ms: 0, text: "Run started" }, 0);
    model.onMessage(hello({ resumed: true }), 10);
    assert.equal(model.lastEvent, "Run started");
    model.onMessage(hello({ resumed: false }), 20);
    assert.match(model.lastEvent ?? "", /Events were missed.*journal/);
  });

  it("remembers when the grasp ended, until the next one begins", () => {
    const model = greeted();
    model.onMessage(identification({ in_grasp: false }), 100);
    assert.equal(model.graspEndedAt, null);
    model.onMessage(identification(), 200);
    model.onMessage(identification({ in_grasp: false }), 300);
    model.onMessage(identification({ in_grasp: false }), 400);
    assert.equal(model.graspEndedAt, 300);
    model.onMessage(identification({ grasp: 2 }), 500);
    assert.equal(model.graspEndedAt, null);
  });

  it("keeps an alarm until it is neither active nor latched", () => {
    const model = greeted();
    model.onMessage(alarm(), 0);
    model.onMessage(alarm({ active: false }), 0);
    assert.equal(model.alarms.get("force")?.active, false);
    model.onMessage(alarm({ active: false, latched: false }), 0);
    assert.equal(model.alarms.size, 0);
  });

  it("lists the grasps of one run, newest first and each once", () => {
    const model = greeted();
    for (const index of [1, 2, 2, 3]) model.onMessage(graspEnded("a", index), 0);
    assert.deepEqual(indicesOf(model), [3, 2, 1]);
    model.onMessage(graspEnded(null, 4), 0);
    assert.deepEqual(indicesOf(model), [4, 3, 2, 1], "one outside of a run goes with those before it");
    model.onMessage(graspEnded("b", 1), 0);
    assert.deepEqual(indicesOf(model), [1]);
  });

  it("says that the tool stands still only on news of after the question", () => {
    const model = greeted();
    const command = (volts: number, at: number): void => {
      model.onFrame({ ...frame(at, [[volts], [0]]), newestMs: at }, at);
      model.onMessage(state({ server_time_ms: at }), at);
    };
    command(0, 100);
    assert.equal(model.standsStillSince(50, 110), true);
    assert.equal(model.standsStillSince(100, 110), false, "news of before");
    assert.equal(model.standsStillSince(50, 1000), false, "old samples");
    command(0.5, 200);
    assert.equal(model.standsStillSince(50, 210), false, "the motor is driven");
    command(0, 300);
    model.onMessage(state({ server_time_ms: 300, safety: "holding back" }), 300);
    assert.equal(model.standsStillSince(50, 310), false, "a run is under way");
    model.onMessage(state({ server_time_ms: 300 }), 300);
    model.connected = false;
    assert.equal(model.standsStillSince(50, 310), false, "no connection");
  });

  it("calls tissues by their titles", () => {
    const model = greeted();
    assert.deepEqual(["liver", "unknown", "undecided", "other"].map((label) => model.titleOf(label)), ["Liver", "Unknown", "Undecided", "other"]);
  });
});

describe("plotSpecs", () => {
  it("has a line for each channel that the server sends, and no other", () => {
    const specs = plotSpecs(greeted(), "alpha_n");
    const lines = specs.map(({ id, traces }) => [id, traces.map(({ key, column, sdColumn }) => [key, column, sdColumn])]);
    assert.deepEqual(lines, [
      ["force", [["raw", 1, -1]]],
      ["displacement", []],
      ["probability", [["unknown", 4, -1]]],
      ["parameter", [["liver", 2, 3]]],
    ]);
  });
});
