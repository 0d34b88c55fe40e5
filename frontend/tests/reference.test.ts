import assert from "node:assert/strict";
import { describe, it } from "node:test";
import { asksForReference } from "../src/cards/protocol";
import type { State } from "../src/wire";
import { state } from "./messages";

const withReference = (values: Partial<State["reference"]>): State => state({ reference: { ...state().reference, ...values } });

describe("The question for a reference grasp", () => {
  it("comes before the first run of a day that wants one, and not before the reference grasp itself", () => {
    const wanted = withReference({ wanted: true });
    assert.equal(asksForReference(wanted, "trapezoid_2hz"), true);
    assert.equal(asksForReference(wanted, "reference_grasp"), false);
  });

  it("does not come once the day has one or it was declined, nor before the service has said its state", () => {
    assert.equal(asksForReference(withReference({ taken_at: "2026-11-30T09:00:00+00:00", stall_v: 2.6 }), "trapezoid_2hz"), false);
    assert.equal(asksForReference(withReference({ declined: true }), "trapezoid_2hz"), false);
    assert.equal(asksForReference(null, "trapezoid_2hz"), false);
  });
});
