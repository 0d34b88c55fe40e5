import { byId, create } from "../dom";

export interface KeyAction {
  key: string;
  label: string;
  description: string;
  run: () => void;
}

/**
 * Handles keys. Escape stops the run wherever the focus is, and closes a dialog; without a run it closes the dialog
 * only. The other keys work outside of input fields.
 */
export class KeyHandler {
  private readonly dialog = byId("keys", HTMLDialogElement);
  private readonly help: KeyAction = { key: "?", label: "?", description: "Show or hide these keys", run: () => this.toggle() };

  /** `pageKeys` returns the keys of the open page; `mayBeMoving`, whether the motor moves or may move. */
  constructor(
    private readonly stop: () => void,
    private readonly mayBeMoving: () => boolean,
    private readonly globalKeys: KeyAction[],
    private readonly pageKeys: () => KeyAction[],
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
      const onlyCloses = document.querySelector("dialog[open]") !== null && !this.mayBeMoving();
      if (!event.repeat && !onlyCloses) this.stop();
      this.close();
      this.onEscape();
      return;
    }
    if (event.ctrlKey || event.metaKey || event.altKey || event.repeat || isField(event.target)) return;
    if (event.key.startsWith("Arrow") && event.target instanceof HTMLInputElement) return; // the key moves that slider
    if (event.key === " " && event.target instanceof HTMLButtonElement) return; // the key presses that button
    const name = keyName(event);
    const action = [...this.globalKeys, ...this.pageKeys(), this.help].find(({ key }) => key === name);
    if (!action || (this.dialog.open && action !== this.help)) return;
    event.preventDefault();
    action.run();
  }

  private toggle(): void {
    if (this.dialog.open) return this.dialog.close();
    const rows = [{ label: "Esc", description: "STOP: ends the run, motor to zero" }, ...this.pageKeys(), ...this.globalKeys, this.help];
    byId("keys-list").replaceChildren(
      ...rows.flatMap(({ label, description }) => [create("dt", "", label), create("dd", "", description)]),
    );
    this.dialog.show(); // not modal: STOP must stay within reach
    this.dialog.scrollTop = 0;
  }
}

/** Returns the key's character. Digits go by their place: on some keyboards they need Shift, on others Shift makes signs. */
function keyName(event: KeyboardEvent): string {
  const digit = /^Digit(\d)$/.exec(event.code)?.[1];
  if (digit === undefined) return event.key;
  if (!event.shiftKey) return digit;
  return digit >= "1" && digit <= "5" ? `Shift+${digit}` : event.key;
}

/** Shows lists permanently open if the browser would open them outside of the page, where Escape is not STOP. */
export function keepListsInThePage(root: ParentNode): void {
  if (CSS.supports("appearance", "base-select")) return;
  for (const select of root.querySelectorAll("select")) select.size = 3;
}

const isField = (target: EventTarget | null): boolean =>
  (target instanceof HTMLInputElement && target.type !== "range") ||
  target instanceof HTMLSelectElement ||
  target instanceof HTMLTextAreaElement;
