import type { TissueInfo } from "./wire";

/** Slots 1 to 7 are Okabe-Ito colors in `styles/theme.css`. The last slot is gray, for tissues outside the library. */
const SLOTS = ["1", "2", "3", "4", "5", "6", "7"];
/** The tissues of the shipped library keep their colors in every library. */
const SHIPPED_SLOTS: Record<string, string> = { liver: "1", small_bowel: "2", bladder: "3", gallbladder: "4" };
export const UNKNOWN_SLOT = "unknown";

/** How every card and chart marks a tissue: a color by its name, and letters. */
export interface TissueStyle {
  name: string;
  title: string;
  slot: string;
  mark: string;
}

export function tissueStyles(tissues: TissueInfo[]): TissueStyle[] {
  const slots = tissueSlots(tissues.map(({ name }) => name));
  const styles = tissues.map((tissue) => ({
    name: tissue.name,
    title: tissue.title,
    slot: slots.get(tissue.name) ?? UNKNOWN_SLOT,
    mark: uniqueMark(tissue.title, tissues),
  }));
  return [...styles, { name: "unknown", title: "Unknown", slot: UNKNOWN_SLOT, mark: "?" }];
}

/**
 * Returns a slot for each name. A name keeps its first choice unless another one before it in the alphabet has taken it;
 * no two are alike while there are free slots. `estimator/studies/tissue_colors.py` does the same.
 */
function tissueSlots(names: string[]): Map<string, string> {
  const slots = new Map<string, string>();
  for (const name of names) if (SHIPPED_SLOTS[name]) slots.set(name, SHIPPED_SLOTS[name]);
  const shipped = Object.values(SHIPPED_SLOTS);
  const choices = [...SLOTS.filter((slot) => !shipped.includes(slot)), ...shipped];
  const firstChoices = choices.length - shipped.length;
  for (const name of names.filter((each) => !slots.has(each)).toSorted()) {
    const first = sumOfCodes(name) % firstChoices;
    const inTurn = [...choices.slice(first), ...choices.slice(0, first)];
    const taken = new Set(slots.values());
    slots.set(name, inTurn.find((slot) => !taken.has(slot)) ?? inTurn[0] ?? UNKNOWN_SLOT);
  }
  return slots;
}

/** Names consist of small letters, digits and `_`. */
const sumOfCodes = (name: string): number => Array.from(name, (letter) => letter.charCodeAt(0)).reduce((sum, code) => sum + code, 0);

/** Returns the initials of a title or, if another tissue shares them, as many first letters as make it unique. */
function uniqueMark(title: string, tissues: TissueInfo[]): string {
  const others = tissues.map((tissue) => tissue.title).filter((other) => other !== title);
  const initials = initialsOf(title);
  if (!others.some((other) => initialsOf(other) === initials)) return initials;
  for (let length = 2; length < title.length; length++) {
    if (!others.some((other) => other.startsWith(title.slice(0, length)))) return title.slice(0, length);
  }
  return title;
}

const initialsOf = (title: string): string =>
  title
    .split(/\s+/)
    .map((word) => word[0]?.toUpperCase() ?? "")
    .join("");
