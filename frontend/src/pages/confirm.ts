import { create, setHidden } from "../dom";

const QUIET_MS = 600; // a double click is quicker; what is then under the finger was not meant
const SETTLED_MS = 700;
const WITHDRAWN_MS = 15_000;
let pressedMs = -Infinity;

/** Calls `act` on a press, unless it is the second of a double one: the list may have moved under the finger. */
export function onSinglePress(button: HTMLButtonElement, act: () => void): void {
  button.addEventListener("click", (event) => {
    const again = event.detail > 1 || performance.now() - pressedMs < QUIET_MS;
    pressedMs = performance.now();
    if (!again) act();
  });
}

/** Asks before it acts, at another place than the button's, and takes no answer before a moment has passed. No question
 * holds the page up: STOP must work. Without an answer the question goes away by itself. */
export function askFirst(button: HTMLButtonElement, question: string, yes: string, act: () => void): HTMLElement {
  const box = create("div", "confirm");
  box.dataset.testid = "confirm";
  box.role = "group";
  box.ariaLabel = question;
  const [agree, keep] = [create("button", "action", yes), create("button", "action", "Keep")];
  for (const each of [agree, keep]) each.type = "button";
  agree.dataset.testid = "confirm-yes";
  box.append(create("span", "", question), agree, keep);
  box.hidden = true;
  let timers: number[] = [];
  const show = (shown: boolean): void => {
    for (const timer of timers) window.clearTimeout(timer);
    setHidden(box, !shown);
    button.ariaExpanded = String(shown);
    agree.disabled = true;
    if (!shown) return;
    timers = [
      window.setTimeout(() => void (agree.disabled = false), SETTLED_MS),
      window.setTimeout(() => show(false), WITHDRAWN_MS),
    ];
    keep.focus();
  };
  onSinglePress(button, () => show(box.hidden === true));
  onSinglePress(keep, () => (show(false), button.focus()));
  onSinglePress(agree, () => (show(false), act()));
  show(false);
  return box;
}
