import assert from "node:assert/strict";
import { describe, it } from "node:test";
import { tissueStyles, UNKNOWN_SLOT } from "../src/tissues";
import { tissue } from "./messages";

const marksOf = (...titles: string[]): string[] => tissueStyles(titles.map((title) => tissue(title, title))).map(({ mark }) => mark);

describe("tissueStyles", () => {
  it("adds the unknown tissue, which is none of the library", () => {
    const [unknown, ...others] = tissueStyles([]);
    assert.deepEqual(unknown, { name: "unknown", title: "Unknown", slot: UNKNOWN_SLOT, mark: "?" });
    assert.deepEqual(others, []);
  });

  it("marks a tissue with its initials, or with as many letters as tell it from the others", () => {
    assert.deepEqual(marksOf("Liver", "Small bowel"), ["L", "SB", "?"]);
    assert.deepEqual(marksOf("Spleen", "Stomach"), ["Sp", "St", "?"]);
    assert.deepEqual(marksOf("Gall", "Gallbladder"), ["Gall", "Gallb", "?"]);
  });

  it("gives no two tissues the same mark", () => {
    const marks = marksOf("Liver", "Lung", "Large bowel", "Lymph node", "Ligament");
    assert.equal(new Set(marks).size, marks.length);
  });

  it("begins the seven colors again at the eighth tissue", () => {
    const slots = tissueStyles(Array.from({ length: 8 }, (_, i) => tissue(`t${i}`, `T${i}`))).map(({ slot }) => slot);
    assert.deepEqual(slots, ["1", "2", "3", "4", "5", "6", "7", "1", UNKNOWN_SLOT]);
  });
});
