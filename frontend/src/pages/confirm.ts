import { create, setHidden } from "../dom";

const DOUBLE_PRESS_MS = 600; // slower than a double click
const ANSWER_AFTER_MS = 700;
const TIMEOUT_MS = 15_000;
let lastPressMs = -Infinity;

/** Calls `act` on a press, but not on the second press of a double click: the list may have moved under the pointer. */
export function onSinglePress(button: HTMLButtonElement, act: () => void): void {
  button.addEventListener("click", (event) => {
    const isRepeated = event.detail > 1 || performance.now() - lastPressMs < DOUBLE_PRESS_MS;
    lastPressMs = performance.now();
    if (!isRepeated) act();
  });
}

/** Creates a question for a button that acts only after a second press elsewhere. It accepts no answer at first, and goes
 * away without an answer. It never blocks the page, because STOP must work. */
export function confirmFirst(button: HTMLButtonElement, question: string, yes: string, act: () => void): HTMLElement {
  const box = create("div", "confirm");
  box.dataset.testid = "confirm";
  box.role = "group";
  box.ariaLabel = question;
  const [yesButton, keepButton] = [create("button", "action", yes), create("button", "action", "Keep")];
  for (const each of [yesButton, keepButton]) each.type = "button";
  yesButton.dataset.testid = "confirm-yes";
  box.append(create("span", "", question), yesButton, keepButton);
  box.hidden = true;
  let timers: number[] = [];
  const show = (shown: boolean): void => {
    for (const timer of timers) window.clearTimeout(timer);
    setHidden(box, !shown);
    button.ariaExpanded = String(shown);
    yesButton.disabled = true;
    if (!shown) return;
    timers = [
      window.setTimeout(() => void (yesButton.disabled = false), ANSWER_AFTER_MS),
      window.setTimeout(() => show(false), TIMEOUT_MS),
    ];
    keepButton.focus();
  };
  onSinglePress(button, () => show(box.hidden === true));
  onSinglePress(keepButton, () => (show(false), button.focus()));
  onSinglePress(yesButton, () => (show(false), act()));
  show(false);
  return box;
}
