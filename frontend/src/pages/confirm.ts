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

/** A question that the page shows. */
export interface Question {
  readonly box: HTMLElement;
  /** Shows the question, or hides it. */
  readonly show: (shown: boolean) => void;
}

/** Creates a hidden question, and calls `act` for a yes. It accepts no answer at first, and goes away without an answer.
 * It never blocks the page, because STOP must work. */
export function createQuestion(question: string, yes: string, act: () => void, onShow: (shown: boolean) => void = () => {}): Question {
  const box = create("div", "confirm");
  box.dataset.testid = "confirm";
  box.role = "group";
  box.ariaLabel = question;
  const [yesButton, keepButton] = [create("button", "action", yes), create("button", "action", "Keep")];
  for (const each of [yesButton, keepButton]) each.type = "button";
  yesButton.dataset.testid = "confirm-yes";
  box.append(create("span", "", question), yesButton, keepButton);
  let timers: number[] = [];
  const show = (shown: boolean): void => {
    for (const timer of timers) window.clearTimeout(timer);
    onShow(shown);
    setHidden(box, !shown);
    yesButton.disabled = true;
    if (!shown) return;
    timers = [
      window.setTimeout(() => void (yesButton.disabled = false), ANSWER_AFTER_MS),
      window.setTimeout(() => show(false), TIMEOUT_MS),
    ];
    keepButton.focus();
  };
  onSinglePress(keepButton, () => show(false));
  onSinglePress(yesButton, () => (show(false), act()));
  box.hidden = true;
  return { box, show };
}

/** Creates a question for a button that acts only after a second press elsewhere. Returns its box. */
export function confirmFirst(button: HTMLButtonElement, question: string, yes: string, act: () => void): HTMLElement {
  const { box, show } = createQuestion(question, yes, act, (shown) => {
    if (box.contains(document.activeElement)) button.focus(); // what is hidden loses it
    button.ariaExpanded = String(shown);
  });
  button.ariaExpanded = "false";
  onSinglePress(button, () => show(box.hidden === true)); // TypeScript knows a third value
  return box;
}
