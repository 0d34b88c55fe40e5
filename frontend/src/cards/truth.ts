import { create, find, setAttribute, setHidden, setText } from "../dom";
import { addMark, deleteMark, messageOf, stateTruth } from "../live/rest";
import type { Model } from "../live/model";
import type { KeyAction } from "../shell/keys";
import type { Person } from "../shell/person";
import type { GraspRemark, Mark, TissueInfo, TruthRequest } from "../wire";

export const REMARKS: GraspRemark[] = ["empty", "slipped", "two tissues"];
const MAX_KEYS = 6;
/** Keys of the remarks, in their order. */
const REMARK_KEYS = ["7", "8", "9"];
/** Marks shown; the journal has them all. */
const MAX_MARKS = 5;

/** Returns the name of a tissue as the service writes it, from what a person typed. */
export const tissueNameOf = (text: string): string => text.trim().toLowerCase().replaceAll(/[\s-]+/g, "_");

/** Says what the jaws hold, for the recording alone, and sets marks. */
export class TruthCard {
  private readonly other: HTMLInputElement;
  private readonly place: HTMLInputElement;
  private readonly markText: HTMLInputElement;
  private readonly message: HTMLElement;
  private buttonsFor: TissueInfo[] | null = null;
  private marksShown: readonly Mark[] | null = null;
  private placeShown = "";
  private readonly buttons = new Map<string, HTMLButtonElement>();

  constructor(
    private readonly root: HTMLElement,
    private readonly model: Model,
    private readonly person: Person,
  ) {
    this.other = find(root, "truth-other", HTMLInputElement);
    this.place = find(root, "truth-place", HTMLInputElement);
    this.markText = find(root, "mark-text", HTMLInputElement);
    this.message = find(root, "truth-message");
    const remarks = REMARKS.map((remark, i) => this.button(`remark ${remark}`, remark, REMARK_KEYS[i], () => this.stateRemark(remark)));
    const unknown = this.button("nothing", "not known", "0", () => this.state({ held: null, remark: null }));
    find(root, "truth-remarks").replaceChildren(...remarks, unknown);
    find(root, "truth-form").addEventListener("submit", (event) => {
      event.preventDefault();
      this.state({ held: tissueNameOf(this.other.value), remark: null });
      this.other.value = "";
      this.other.blur();
    });
    find(root, "place-form").addEventListener("submit", (event) => {
      event.preventDefault();
      this.state({ held: this.model.state?.stated.held ?? null, remark: this.model.state?.stated.remark ?? null });
      this.place.blur();
    });
    find(root, "mark-form").addEventListener("submit", (event) => {
      event.preventDefault();
      void this.mark();
    });
  }

  /** One key for each tissue, for no statement, and for a mark. */
  get keys(): KeyAction[] {
    const tissues = this.model.tissues.slice(0, MAX_KEYS);
    return [
      ...tissues.map(({ name, title }, i) => ({
        key: String(i + 1),
        label: String(i + 1),
        description: `The jaws hold: ${title}`,
        run: () => this.state({ held: name, remark: null }),
      })),
      { key: "0", label: "0", description: "The jaws hold something unknown", run: () => this.state({ held: null, remark: null }) },
      ...REMARKS.map((remark, i) => ({
        key: REMARK_KEYS[i] ?? "",
        label: REMARK_KEYS[i] ?? "",
        description: `Remark on the grasp under way or the next one: ${remark}`,
        run: () => this.stateRemark(remark),
      })),
      { key: "m", label: "M", description: "Set a mark on the recording, with the text that was typed before", run: () => void this.mark() },
    ];
  }

  render(): void {
    const { state, tissues } = this.model;
    const shown = !this.model.isReplay && !this.model.hasNoTool;
    setHidden(find(this.root, "truth"), !shown);
    if (!shown) return;
    if (tissues !== this.buttonsFor) this.listTissues(tissues);
    const stated = state?.stated;
    const words = [stated?.held ? this.model.titleOf(stated.held) : "", stated?.place ?? "", stated?.remark ?? ""].filter(Boolean);
    this.showPlace(stated?.place ?? "");
    setText(find(this.root, "truth-now"), words.length > 0 ? words.join(", ") : "not stated");
    for (const [key, button] of this.buttons) {
      const pressed = stated !== undefined && (key === stated.held || key === `remark ${stated.remark ?? ""}`);
      setAttribute(button, "aria-pressed", String(pressed));
    }
    if (this.model.marks !== this.marksShown) this.listMarks(this.model.marks);
  }

  /** Follows the place that counts, such as none after a new spot, but never while somebody types. */
  private showPlace(place: string): void {
    if (place === this.placeShown || document.activeElement === this.place) return;
    this.placeShown = place;
    this.place.value = place;
  }

  private listTissues(tissues: TissueInfo[]): void {
    this.buttonsFor = tissues;
    const buttons = tissues.map(({ name, title }, i) =>
      this.button(name, title, i < MAX_KEYS ? String(i + 1) : undefined, () => this.state({ held: name, remark: null })),
    );
    find(this.root, "truth-tissues").replaceChildren(...buttons);
  }

  private button(key: string, text: string, shortcut: string | undefined, act: () => void): HTMLButtonElement {
    const button = create("button", "", text);
    button.type = "button";
    if (shortcut !== undefined) {
      button.append(" ", create("kbd", "", shortcut));
      setAttribute(button, "aria-keyshortcuts", shortcut);
    }
    button.dataset.testid = `held-${key.replaceAll(" ", "-")}`;
    button.addEventListener("click", act);
    this.buttons.set(key, button);
    return button;
  }

  private stateRemark(remark: GraspRemark): void {
    const stated = this.model.state?.stated;
    this.state({ held: stated?.held ?? null, remark: stated?.remark === remark ? null : remark });
  }

  private state(truth: Pick<TruthRequest, "held" | "remark">): void {
    if (!this.person.may("operator")) return;
    stateTruth({ ...truth, place: this.place.value.trim() || null, by: this.person.name }).then(
      () => this.showMessage(""),
      (error: unknown) => this.showMessage(`Not stated: ${messageOf(error)}`),
    );
  }

  private async mark(): Promise<void> {
    if (!this.person.may("operator")) return;
    const text = this.markText.value.trim() || "mark";
    try {
      await addMark({ text, tick: this.model.newestTick, by: this.person.name });
      this.markText.value = "";
      this.showMessage("");
    } catch (error) {
      this.showMessage(`No mark: ${messageOf(error)}`);
    }
  }

  private listMarks(marks: readonly Mark[]): void {
    this.marksShown = marks;
    find(this.root, "marks").replaceChildren(...marks.slice(0, MAX_MARKS).map((mark) => this.row(mark)));
  }

  private row(mark: Mark): HTMLLIElement {
    const row = create("li", "", `${mark.at_s.toFixed(2)}\u202fs  ${mark.text} `);
    const remove = create("button", "", "Delete");
    remove.type = "button";
    remove.ariaLabel = `Delete the mark ${mark.text}`;
    remove.addEventListener("click", () => {
      deleteMark(mark, this.person.name).catch((error: unknown) => this.showMessage(`Not deleted: ${messageOf(error)}`));
    });
    row.append(remove);
    return row;
  }

  private showMessage(text: string): void {
    setText(this.message, text);
  }
}
