import assert from "node:assert/strict";
import { describe, it } from "node:test";
import { tissueStyles, UNKNOWN_SLOT } from "../src/tissues";
import { tissue } from "./messages";
import libraries from "./tissue-slots.json";

const marksOf = (...titles: string[]): string[] => tissueStyles(titles.map((title) => tissue(title, title))).map(({ mark }) => mark);

const slotsOf = (count: number): string[] =>
  tissueStyles(Array.from({ length: count }, (_, i) => tissue(`t${i}`, `T${i}`)))
    .slice(0, -1)
    .map(({ slot }) => slot);
const slotOf = (name: string, ...names: string[]): string | undefined =>
  tissueStyles(names.map((each) => tissue(each, each))).find((style) => style.name === name)?.slot;

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

  it("gives seven tissues seven colors, and begins again at the eighth", () => {
    assert.equal(new Set(slotsOf(7)).size, 7);
    assert.equal(new Set(slotsOf(8)).size, 7);
  });

  it("colors a tissue by its name, whatever else the library holds", () => {
    assert.equal(slotOf("liver", "bladder", "liver"), slotOf("liver", "liver", "spleen", "kidney"));
    assert.equal(slotOf("spleen", "spleen"), slotOf("spleen", "bladder", "liver", "spleen"));
    assert.notEqual(slotOf("spleen", "spleen", "liver"), slotOf("liver", "spleen", "liver"));
  });

  it("gives the colors of reports and pages of studies", () => {
    // tests/estimator/studies/test_tissue_colors.py reads the same file
    for (const slots of libraries as Record<string, string>[]) {
      const styles = tissueStyles(Object.keys(slots).map((name) => tissue(name, name)));
      assert.deepEqual(Object.fromEntries(styles.slice(0, -1).map(({ name, slot }) => [name, slot])), slots);
    }
  });
});
