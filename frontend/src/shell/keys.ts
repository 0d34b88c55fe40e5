import { byId, create } from "../dom";

export interface KeyAction {
  key: string;
  shown: string;
  does: string;
  run: () => void;
}

/** Escape stops, wherever the focus is; the other keys work outside of fields. */
export class Keys {
  private readonly dialog = byId("keys", HTMLDialogElement);
  private readonly help: KeyAction = { key: "?", shown: "?", does: "Show or hide these keys", run: () => this.toggle() };

  /** `ofPage` tells the keys of the page that is open. */
  constructor(
    private readonly stop: () => void,
    private readonly everywhere: KeyAction[],
    private readonly ofPage: () => KeyAction[],
    private readonly onEscape: () => void,
  ) {
    byId("help").addEventListener("click", () => this.toggle());
    window.addEventListener("keydown", (event) => this.onKey(event), { capture: true });
  }

  close(): void {
    this.dialog.close();
  }

  private onKey(event: KeyboardEvent): void {
    if (event.key === "Escape") {
      if (!event.repeat) this.stop();
      this.close();
      this.onEscape();
      return;
    }
    if (event.ctrlKey || event.metaKey || event.altKey || event.repeat || isField(event.target)) return;
    if (event.key.startsWith("Arrow") && event.target instanceof HTMLInputElement) return; // moves that slider
    if (event.key === " " && event.target instanceof HTMLButtonElement) return; // presses that button
    const action = [...this.everywhere, ...this.ofPage(), this.help].find(({ key }) => key === event.key);
    if (!action || (this.dialog.open && action !== this.help)) return;
    event.preventDefault();
    action.run();
  }

  private toggle(): void {
    if (this.dialog.open) return this.dialog.close();
    const rows = [{ shown: "Esc", does: "STOP: ends the run, motor to zero" }, ...this.ofPage(), ...this.everywhere, this.help];
    byId("keys-list").replaceChildren(
      ...rows.flatMap(({ shown, does }) => [create("dt", "", shown), create("dd", "", does)]),
    );
    this.dialog.show(); // not modal: STOP must stay within reach
  }
}

/** Where the stylesheet cannot keep an open list inside the page, lists stay open instead: Esc must always get here. */
export function keepListsInThePage(root: ParentNode): void {
  if (CSS.supports("appearance", "base-select")) return;
  for (const select of root.querySelectorAll("select")) select.size = 3;
}

const isField = (target: EventTarget | null): boolean =>
  (target instanceof HTMLInputElement && target.type !== "range") || target instanceof HTMLSelectElement;
